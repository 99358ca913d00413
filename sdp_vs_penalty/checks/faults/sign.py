"""Joints and torques that count the other way."""

from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations

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

#: Largest number of joints for which every pattern of signs is tried (2^8).
_MOST_JOINTS = 8


class Sign(Transformation):
    """Joints and torques that count the other way: the torque's sign, the position's,
    or both."""

    name = "sign"

    def propose(
        self, log: Likelihood, now: LogTransform, fit: ArmFit
    ) -> Iterator[LogTransform]:
        """Yield the repair ``now`` with other signs: of all torques, of each torque, of
        the positions of poorly explained joints, and of the likeliest sets of torques.

        Gravity upside down and time reversed come with all torques' signs: they fit the
        same, and physics alone distinguishes them.

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
        all_turned = now.with_multiplied("gain", range(log.n), -1.0)
        yield all_turned
        for j in range(log.n):
            yield now.with_multiplied("gain", (j,), -1.0)
        # The same fit, which physics alone tells apart.
        upside_down = tuple(-g for g in now.gravity)
        turned_upside_down = replace(all_turned, gravity=upside_down)
        yield turned_upside_down
        yield replace(all_turned, reversed=not now.reversed)
        yield replace(turned_upside_down, reversed=not now.reversed)
        for j in np.flatnonzero(fit.is_poorly_explained).tolist():
            position = now.with_multiplied("scale", (j,), -1.0)
            yield position
            yield position.with_multiplied("gain", (j,), -1.0)
        yield from _likeliest_patterns(log, now, fit)

    def list_faults(self, log: Likelihood, repair: LogTransform) -> Iterator[Fault]:
        """Yield a fault for each position whose sign a repair changes, alone or with
        its torque, and one fault about all other torques whose sign it changes.

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
        is_q_turned = np.array(repair.scale) < 0.0
        is_tau_turned = np.array(repair.gain) < 0.0
        for j in np.flatnonzero(is_q_turned).tolist():
            if is_tau_turned[j]:
                yield _joint_sign(log, repair, j)
            else:
                yield _position_sign(log, repair, j)
        turned = np.flatnonzero(is_tau_turned & ~is_q_turned).tolist()
        if turned:
            yield _torque_sign(log, repair, tuple(turned))


def _position_sign(log: Likelihood, repair: LogTransform, j: int) -> Fault:
    """Return the fault that joint j's position, and not its torque, has the wrong sign."""
    return Fault(
        kind="position sign",
        severity="warning",
        joints=(j,),
        what=f"the position of joint {j + 1} has the wrong sign.",
        remedy=f"flip the sign of q{j + 1} (and dq{j + 1})",
        removal=repair.with_multiplied("scale", (j,), -1.0),
        log_odds_against=odds_against_one_of(log.n),
    )


def _joint_sign(log: Likelihood, repair: LogTransform, j: int) -> Fault:
    """Return the fault that joint j's position and torque both have the wrong sign."""
    return Fault(
        kind="joint sign",
        severity="warning",
        joints=(j,),
        what=f"joint {j + 1} counts the other way, position and torque alike.",
        remedy=f"flip the signs of q{j + 1}, dq{j + 1} and tau{j + 1}",
        removal=repair.with_multiplied("scale", (j,), -1.0).with_multiplied(
            "gain", (j,), -1.0
        ),
        log_odds_against=odds_against_one_of(log.n),
    )


def _torque_sign(
    log: Likelihood, repair: LogTransform, turned: tuple[int, ...]
) -> Fault:
    """Return the fault that the torques of some joints have the wrong sign.

    They are one fault, since a convention that differs is one mistake: its prior odds
    are those of single mistakes or those of one pattern of 2^n, whichever are smaller.
    """
    where = joints_text(turned)
    of_single_mistakes = len(turned) * odds_against_one_of(log.n)
    of_one_pattern = c.LOG_ODDS_AGAINST_FAULT + log.n * float(np.log(2.0))
    log_odds = min(of_single_mistakes, of_one_pattern)
    if len(turned) == log.n:
        where = "every joint"
        log_odds = c.LOG_ODDS_AGAINST_FAULT
    channels = ", ".join(f"tau{j + 1}" for j in turned)
    return Fault(
        kind="torque sign",
        severity="warning",
        joints=turned,
        what=f"the torque of {where} has the wrong sign.",
        remedy=f"flip the sign of {channels}",
        removal=repair.with_multiplied("gain", turned, -1.0),
        log_odds_against=log_odds,
    )


def _likeliest_patterns(
    log: Likelihood, now: LogTransform, fit: ArmFit
) -> list[LogTransform]:
    """List the likeliest sets of two torques or more that have the wrong sign.

    They are ranked by posterior: the fit and the log-probability of physics (friction
    takes power, inertia is positive). Turned one by one, none of the torques may look
    better. The list is empty unless friction drives a joint in the log as it is.
    """
    joints = log.joints
    is_searchable = 2 < len(joints) <= _MOST_JOINTS
    if not is_searchable or not fit.is_poorly_explained.any():
        return []
    samples_now = log.count_independent_samples(fit)
    if log.physics(fit, now, samples_now) > -c.MAX_INERTIA_LOG_ODDS:
        return []
    patterns = [
        now.with_multiplied("gain", turned, -1.0)
        for size in range(2, len(joints))
        for turned in combinations(joints, size)
    ]
    screen = log.on_third_of_rows
    posteriors = []
    for pattern, fit_of_pattern in zip(patterns, screen.fit_all(patterns), strict=True):
        physics = screen.physics(fit_of_pattern, pattern, samples_now)
        posteriors.append(fit_of_pattern.log_likelihood(samples_now) + physics)
    order = np.argsort(posteriors)[::-1]
    return [patterns[k] for k in order[: c.MAX_FAULTS].tolist()]
