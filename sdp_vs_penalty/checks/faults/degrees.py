"""Positions in degrees."""

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

#: Scales of positions are 1, -1 (a sign) or pi / 180 (degrees) [-]: below this it is
#: degrees.
_BELOW_ANY_OTHER_SCALE = 0.1


class Degrees(Transformation):
    """Positions in degrees: of all revolute joints, or of one of them."""

    name = "degrees"

    def propose(
        self, log: Likelihood, now: LogTransform, fit: ArmFit
    ) -> Iterator[LogTransform]:
        """Yield the repair ``now`` with positions converted from degrees to radians: of
        all revolute joints, and of each single joint that moves beyond a turn.

        Nothing is yielded where no joint moves beyond a turn [rad].

        Parameters
        ----------
        log : Likelihood
            Rows that repairs are judged on.
        now : LogTransform
            The present repair.
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
        radians_per_degree = float(np.radians(1.0))
        yield now.with_multiplied("scale", log.revolute, radians_per_degree)
        if log.n == 1:
            return  # the only joint is all joints
        for j in beyond_a_turn:
            yield now.with_multiplied("scale", (j,), radians_per_degree)

    def list_faults(self, log: Likelihood, repair: LogTransform) -> Iterator[Fault]:
        """Yield one fault about all joints whose positions a repair converts from
        degrees.

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
        is_in_degrees = np.abs(repair.scale) < _BELOW_ANY_OTHER_SCALE
        joints = tuple(np.flatnonzero(is_in_degrees).tolist())
        if not joints:
            return
        degrees_per_radian = float(np.degrees(1.0))
        without = repair.with_multiplied("scale", joints, degrees_per_radian)
        logged = without.positions(log.data.motion.q)[:, joints]
        is_all = joints == tuple(log.revolute)
        channels = ", ".join(f"q{j + 1}" for j in joints)
        yield Fault(
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
