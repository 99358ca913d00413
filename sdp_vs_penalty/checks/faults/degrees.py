"""Positions in degrees, or in per cent of each joint's range as LeRobot writes them.

A file that does not say its unit fits into the joints' ranges either way: the torques
tell one from the other.
"""

from collections.abc import Iterator

import numpy as np

from sdp_vs_penalty.checks import constants as c
from sdp_vs_penalty.checks.arm_fit import ArmFit
from sdp_vs_penalty.checks.faults.fault import (
    Fault,
    Transformation,
    odds_against_one_of,
)
from sdp_vs_penalty.checks.issue import joints_text
from sdp_vs_penalty.checks.likelihood import Likelihood
from sdp_vs_penalty.checks.repair import LogTransform
from sdp_vs_penalty.data.plausibility import radians_per_percent

#: Scales of positions are 1, -1 (a sign), or a unit's [-]: below this it is a unit.
_BELOW_ANY_OTHER_SCALE = 0.1
_RADIANS_PER_DEGREE = float(np.radians(1.0))


class Degrees(Transformation):
    """Positions in degrees, of all revolute joints or of one of them; or of all in per
    cent of their ranges."""

    name = "degrees"

    def propose(
        self, log: Likelihood, now: LogTransform, fit: ArmFit
    ) -> Iterator[LogTransform]:
        """Yield the repair ``now`` with positions converted to radians: from degrees of
        all revolute joints, and of each single joint that moves beyond a turn; from per
        cent of all.

        Nothing is yielded where no joint moves beyond a turn [rad].

        Parameters
        ----------
        log : Likelihood
            Rows that repairs are judged on.
        fit : ArmFit
            The arm fitted to the rows under ``now``.

        Returns
        -------
        iterator of LogTransform
            Repairs to fit arms to, with all corrections of ``now``.
        """
        largest = np.abs(now.positions(log.data.motion.q)).max(axis=0)  # (n,)
        beyond_a_turn = [j for j in log.revolute if largest[j] > 2.0 * np.pi]
        if not beyond_a_turn:
            return
        yield now.with_multiplied("scale", log.revolute, _RADIANS_PER_DEGREE)
        percent = radians_per_percent(log.problem.robot, log.data.motion.q)
        if percent is not None:
            per_cent = now
            for j, (scale, middle) in percent.items():
                per_cent = per_cent.with_multiplied("scale", (j,), scale)
                per_cent = per_cent.with_entries("zero", (j,), now.zero[j] + middle)
            yield per_cent
        if log.n == 1:
            return  # the only joint is all joints
        for j in beyond_a_turn:
            yield now.with_multiplied("scale", (j,), _RADIANS_PER_DEGREE)

    def list_faults(self, log: Likelihood, repair: LogTransform) -> Iterator[Fault]:
        """Yield one fault about all joints whose positions a repair converts from
        degrees, or from per cent.

        Parameters
        ----------
        log : Likelihood
            Rows that repairs are judged on.
        repair : LogTransform
            A complete repair, with faults of any kinds.

        Returns
        -------
        iterator of Fault
            With the words for the user.
        """
        sizes = np.abs(repair.scale)
        is_in_unit = sizes < _BELOW_ANY_OTHER_SCALE
        is_in_degrees = is_in_unit & np.isclose(sizes, _RADIANS_PER_DEGREE, rtol=1e-6)
        joints = tuple(np.flatnonzero(is_in_degrees).tolist())
        if joints:
            yield _in_degrees(log, repair, joints)
        percent = radians_per_percent(log.problem.robot, log.data.motion.q) or {}
        joints = tuple(np.flatnonzero(is_in_unit & ~is_in_degrees).tolist())
        if joints:
            without = repair
            for j in joints:
                scale, middle = percent[j]
                without = without.with_multiplied("scale", (j,), 1.0 / scale)
                without = without.with_entries("zero", (j,), repair.zero[j] - middle)
            yield Fault(
                kind="positions in per cent",
                severity="warning",
                joints=joints,
                what=f"the positions of {joints_text(joints)} are in per cent of each"
                " joint's range, from -100 to 100, as LeRobot writes them.",
                remedy="multiply q (and dq) by a hundredth of half of the range",
                removal=without,
                log_odds_against=c.LOG_ODDS_AGAINST_FAULT,
                place=", ".join(f"q{j + 1}" for j in joints),
            )


def _in_degrees(
    log: Likelihood, repair: LogTransform, joints: tuple[int, ...]
) -> Fault:
    """Return the fault that a repair converts joints (from 0) from degrees."""
    without = repair.with_multiplied("scale", joints, 1.0 / _RADIANS_PER_DEGREE)
    logged = without.positions(log.data.motion.q)[:, joints]
    is_all = joints == tuple(log.revolute)
    channels = ", ".join(f"q{j + 1}" for j in joints)
    return Fault(
        kind="positions in degrees" if is_all else "position unit",
        severity="warning",
        joints=joints,
        what=f"the position of {joints_text(joints)} is in degrees: it reaches"
        f" {np.abs(logged).max():.4g}.",
        remedy=f"multiply {channels} (and dq) by pi / 180",
        removal=without,
        log_odds_against=c.LOG_ODDS_AGAINST_FAULT
        if is_all
        else len(joints) * odds_against_one_of(log.n),
        place=channels,
    )
