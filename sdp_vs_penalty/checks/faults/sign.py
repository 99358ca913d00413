"""Joints and torques that count the other way."""

from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations

import numpy as np

from sdp_vs_penalty.checks import constants as c
from sdp_vs_penalty.checks.arm_fit import ArmFit
from sdp_vs_penalty.checks.faults.fault import Fault, Transformation, choices
from sdp_vs_penalty.checks.issue import joints_text
from sdp_vs_penalty.checks.likelihood import Likelihood
from sdp_vs_penalty.checks.repair import LogTransform

#: Of more joints not every pattern of signs is looked at.
_MOST_JOINTS = 8


class Sign(Transformation):
    """Joints and torques that count the other way: the torque's sign, the position's,
    or both."""

    name = "sign"

    def proposals(
        self,
        log: Likelihood,
        now: LogTransform,
        score: ArmFit,
    ) -> Iterator[LogTransform]:
        """Propose repairs that correct one more fault of this kind than ``now`` does."""
        all_turned = now.times("gain", range(log.n), -1.0)
        yield all_turned
        for j in range(log.n):
            yield now.times("gain", (j,), -1.0)
        # The same fit, which physics alone tells apart.
        upside_down = tuple(-g for g in now.gravity)
        turned_upside_down = replace(all_turned, gravity=upside_down)
        yield turned_upside_down
        yield replace(all_turned, reversed=not now.reversed)
        yield replace(turned_upside_down, reversed=not now.reversed)
        for j in np.flatnonzero(score.poor).tolist():
            position = now.times("scale", (j,), -1.0)
            yield position
            yield position.times("gain", (j,), -1.0)
        yield from _likeliest_patterns(log, now, score)

    def elements(self, log: Likelihood, repair: LogTransform) -> Iterator[Fault]:
        """Yield the faults of this kind that a repair corrects."""
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
    return Fault(
        kind="position sign",
        severity="warning",
        joints=(j,),
        what=f"the position of joint {j + 1} has the wrong sign.",
        remedy=f"flip the sign of q{j + 1} (and dq{j + 1})",
        of=repair.times("scale", (j,), -1.0),
        cost=choices(log.n),
    )


def _joint_sign(log: Likelihood, repair: LogTransform, j: int) -> Fault:
    return Fault(
        kind="joint sign",
        severity="warning",
        joints=(j,),
        what=f"joint {j + 1} counts the other way, position and torque alike.",
        remedy=f"flip the signs of q{j + 1}, dq{j + 1} and tau{j + 1}",
        of=repair.times("scale", (j,), -1.0).times("gain", (j,), -1.0),
        cost=choices(log.n),
    )


def _torque_sign(
    log: Likelihood,
    repair: LogTransform,
    turned: tuple[int, ...],
) -> Fault:
    """Several torques at once: a convention that differs is one mistake, of any
    pattern."""
    where = joints_text(turned)
    cost = min(len(turned) * choices(log.n), c.ODDS + log.n * float(np.log(2.0)))
    if len(turned) == log.n:
        where = "every joint"
        cost = c.ODDS
    channels = ", ".join(f"tau{j + 1}" for j in turned)
    return Fault(
        kind="torque sign",
        severity="warning",
        joints=turned,
        what=f"the torque of {where} has the wrong sign.",
        remedy=f"flip the sign of {channels}",
        of=repair.times("gain", turned, -1.0),
        cost=cost,
    )


def _likeliest_patterns(
    log: Likelihood,
    now: LogTransform,
    score: ArmFit,
) -> list[LogTransform]:
    """Several torques that count the other way at once, the likeliest few, friction that
    takes power included: joint by joint none of them may look better.

    Looked for where friction drives a joint as the log stands.
    """
    joints = log.joints
    if not 2 < len(joints) <= _MOST_JOINTS or not score.poor.any():
        return []
    if log.physics(score, now, log.samples(score)) > -c.LOUDEST_INERTIA:
        return []
    patterns = [
        now.times("gain", turned, -1.0)
        for size in range(2, len(joints))
        for turned in combinations(joints, size)
    ]
    fits = log.screen.scores(patterns)
    samples = log.samples(score)
    posteriors = [
        log.screen.physics(fit, pattern, samples) - 0.5 * samples * fit.score
        for fit, pattern in zip(fits, patterns, strict=True)
    ]
    order = np.argsort(posteriors)[::-1]
    return [patterns[k] for k in order[: c.MOST].tolist()]
