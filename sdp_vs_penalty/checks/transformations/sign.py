"""Joints and torques that count the other way: the torque's sign, the position's, or both."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import product

import numpy as np

from sdp_vs_penalty.checks.issue import joints_text
from sdp_vs_penalty.checks.likelihood import Score
from sdp_vs_penalty.checks.repair import Repair
from sdp_vs_penalty.checks.transformations.transformation import Element, Scene, Transformation, choices

#: All sets of signs are tried of arms with at most so many joints; of larger ones joint by joint.
_MANY = 8
#: Several signs at once are one habit of a driver: each after the first is likelier (natural logarithm).
_NEXT = 2.0


class Sign(Transformation):
    def proposals(self, scene: Scene, now: Repair, score: Score) -> Iterator[Repair]:
        n, gain = scene.n, np.array(now.gain)
        # One arm and its joints by themselves agree: signs could make it no better.
        coupled = float(np.log(score.shares / score.alone)[scene.moving].sum())
        if n <= _MANY and coupled > 1.0:
            patterns = np.array(list(product((1.0, -1.0), repeat=n)))[1:]
        else:
            patterns = np.vstack([1.0 - 2.0 * np.eye(n), -np.ones(n)])
        for signs in patterns:
            yield replace(now, gain=tuple((signs * gain).tolist()))
        for j in scene.joints if scene.poor(score).any() else ():
            turned = now.with_entry("scale", j, -now.scale[j])
            yield turned
            yield turned.with_entry("gain", j, -now.gain[j])

    def elements(self, scene: Scene, repair: Repair) -> Iterator[Element]:
        q, tau = np.array(repair.scale) < 0.0, np.array(repair.gain) < 0.0
        for j in np.flatnonzero(q).tolist():
            without, k = repair.with_entry("scale", j, -repair.scale[j]), j + 1
            kind, what = "position sign", f"the position of joint {k} has the wrong sign."
            remedy = f"flip the sign of q{k} (and dq{k})"
            if tau[j]:
                without = without.with_entry("gain", j, -repair.gain[j])
                kind, what = "joint sign", f"joint {k} counts the other way, position and torque alike."
                remedy = f"flip the signs of q{k}, dq{k} and tau{k}"
            yield Element(kind, "error", (j,), what, remedy, without, choices(scene.n))
        alone = tuple(np.flatnonzero(tau & ~q).tolist())
        if alone:
            gain = tuple(-g if j in alone else g for j, g in enumerate(repair.gain))
            every = len(alone) == scene.n
            cost = choices(1) if every else choices(scene.n) + _NEXT * (len(alone) - 1)
            yield Element(
                "torque sign", "error", alone,
                f"the torque of {'every joint' if every else joints_text(alone)} has the wrong sign.",
                "flip the sign of " + ", ".join(f"tau{j + 1}" for j in alone),
                replace(repair, gain=gain), cost,
            )  # fmt: skip
