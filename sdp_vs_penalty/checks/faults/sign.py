"""Joints and torques that count the other way."""

from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations

import numpy as np

from sdp_vs_penalty.checks import constants as c
from sdp_vs_penalty.checks.faults.fault import Fault, Transformation, choices
from sdp_vs_penalty.checks.issue import joints_text
from sdp_vs_penalty.checks.likelihood import ArmFit, Likelihood
from sdp_vs_penalty.checks.repair import LogTransform

#: Of more joints not every pattern of signs is looked at.
_MOST_JOINTS = 8


class Sign(Transformation):
    """Joints and torques that count the other way: the torque's sign, the position's,
    or both."""

    name = "sign"

    def proposals(
        self, log: Likelihood, now: LogTransform, score: ArmFit
    ) -> Iterator[LogTransform]:
        for turned in (range(log.n), *((j,) for j in range(log.n))):
            yield now.times("gain", turned, -1.0)
        # The same fit, which physics alone tells apart.
        turned_back = now.times("gain", range(log.n), -1.0)
        upside_down = replace(now, gravity=tuple(-g for g in now.gravity))
        yield replace(turned_back, gravity=upside_down.gravity)
        for same in (turned_back, replace(turned_back, gravity=upside_down.gravity)):
            yield replace(same, reversed=not now.reversed)
        for j in np.flatnonzero(score.poor).tolist():
            yield now.times("scale", (j,), -1.0)
            yield now.times("scale", (j,), -1.0).times("gain", (j,), -1.0)
        yield from _likeliest_patterns(log, now, score)

    def elements(self, log: Likelihood, repair: LogTransform) -> Iterator[Fault]:
        q, tau = np.array(repair.scale) < 0.0, np.array(repair.gain) < 0.0
        for j in np.flatnonzero(q).tolist():
            without = repair.times("scale", (j,), -1.0)
            k = j + 1
            kind = "position sign"
            what = f"the position of joint {k} has the wrong sign."
            remedy = f"flip the sign of q{k} (and dq{k})"
            if tau[j]:
                without = without.times("gain", (j,), -1.0)
                kind = "joint sign"
                what = f"joint {k} counts the other way, position and torque alike."
                remedy = f"flip the signs of q{k}, dq{k} and tau{k}"
            yield Fault(kind, "warning", (j,), what, remedy, without, choices(log.n))
        if alone := tuple(np.flatnonzero(tau & ~q).tolist()):
            every = len(alone) == log.n
            # A convention that differs is one mistake, of any pattern.
            pattern = c.ODDS + log.n * float(np.log(2.0))
            cost = c.ODDS if every else min(len(alone) * choices(log.n), pattern)
            what = (
                f"the torque of {'every joint' if every else joints_text(alone)} has"
                " the wrong sign."
            )
            remedy = "flip the sign of " + ", ".join(f"tau{j + 1}" for j in alone)
            without = repair.times("gain", alone, -1.0)
            yield Fault("torque sign", "warning", alone, what, remedy, without, cost)


def _likeliest_patterns(
    log: Likelihood, now: LogTransform, score: ArmFit
) -> list[LogTransform]:
    """Several torques that count the other way at once, the likeliest few, friction that
    takes power included: joint by joint none of them may look better.

    Looked for where friction drives a joint as the log stands.
    """
    joints = log.joints
    if not 2 < len(joints) <= _MOST_JOINTS or not score.poor.any():
        return []
    if score.physics(now, score.samples) > -c.LOUDEST_INERTIA:
        return []
    patterns = [
        now.times("gain", turned, -1.0)
        for size in range(2, len(joints))
        for turned in combinations(joints, size)
    ]
    fits = log.screen.scores(patterns)
    posteriors = [
        fit.physics(pattern, score.samples) - 0.5 * score.samples * fit.score
        for fit, pattern in zip(fits, patterns, strict=True)
    ]
    order = np.argsort(posteriors)[::-1]
    return [patterns[k] for k in order[: c.MOST].tolist()]
