"""Joints and torques that count the other way: the torque's sign, the position's, or both."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product

import numpy as np

from sdp_vs_penalty.checks.issue import joints_text
from sdp_vs_penalty.checks.likelihood import Score
from sdp_vs_penalty.checks.repair import Repair
from sdp_vs_penalty.checks.transformation import Element, Scene, Transformation, choices

#: All sets of signs are tried of arms with at most so many joints; of larger ones joint by joint.
_MANY = 8


class Sign(Transformation):
    def proposals(self, scene: Scene, now: Repair, score: Score) -> Iterator[Repair]:
        n = scene.n
        # One arm and its joints by themselves agree: signs could make it no better.
        coupled = float(np.log(score.shares / score.alone)[scene.moving].sum())
        many = n <= _MANY and coupled > 1.0
        sets = product((False, True), repeat=n) if many else [*np.eye(n, dtype=bool), (True,) * n]
        for turned in sets:
            yield now.times("gain", np.flatnonzero(turned).tolist(), -1.0)
        for j in scene.joints if scene.poor(score).any() else ():
            yield now.times("scale", (j,), -1.0)
            yield now.times("scale", (j,), -1.0).times("gain", (j,), -1.0)

    def elements(self, scene: Scene, repair: Repair) -> Iterator[Element]:
        q, tau = np.array(repair.scale) < 0.0, np.array(repair.gain) < 0.0
        for j in np.flatnonzero(q).tolist():
            without, k = repair.times("scale", (j,), -1.0), j + 1
            kind, what = "position sign", f"the position of joint {k} has the wrong sign."
            remedy = f"flip the sign of q{k} (and dq{k})"
            if tau[j]:
                without = without.times("gain", (j,), -1.0)
                kind, what = "joint sign", f"joint {k} counts the other way, position and torque alike."
                remedy = f"flip the signs of q{k}, dq{k} and tau{k}"
            yield Element(kind, "error", (j,), what, remedy, without, choices(scene.n))
        alone = tuple(np.flatnonzero(tau & ~q).tolist())
        if alone:
            every = len(alone) == scene.n
            cost = choices(1) if every else len(alone) * choices(scene.n)
            what = f"the torque of {'every joint' if every else joints_text(alone)} has the wrong sign."
            remedy = "flip the sign of " + ", ".join(f"tau{j + 1}" for j in alone)
            without = repair.times("gain", alone, -1.0)
            yield Element("torque sign", "error", alone, what, remedy, without, cost)
