"""Positions in degrees: of all revolute joints, or of one of them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from sdp_vs_penalty.checks.constants import ODDS
from sdp_vs_penalty.checks.issue import joints_text
from sdp_vs_penalty.checks.likelihood import Score
from sdp_vs_penalty.checks.repair import Repair
from sdp_vs_penalty.checks.transformations.transformation import Element, Scene, Transformation, choices

_DEGREE = float(np.pi / 180.0)
#: Numbers that stay below this are no degrees of a motion.
_LEAST = 6.0


class Degrees(Transformation):
    def proposals(self, scene: Scene, now: Repair, score: Score) -> Iterator[Repair]:
        far = [j for j in scene.revolute if np.abs(scene.reach(now)[:, j]).max() > _LEAST]
        if far:
            every = scene.revolute
            scale = (_DEGREE * s if j in every else s for j, s in enumerate(now.scale))
            yield replace(now, scale=tuple(scale))
        for j in far if scene.n > 1 else ():
            yield now.with_entry("scale", j, _DEGREE * now.scale[j])

    def elements(self, scene: Scene, repair: Repair) -> Iterator[Element]:
        joints = tuple(j for j, s in enumerate(repair.scale) if abs(abs(s) - _DEGREE) < 1e-9)
        if not joints:
            return
        without = repair
        for j in joints:
            without = without.with_entry("scale", j, repair.scale[j] / _DEGREE)
        reach = float(np.abs(scene.reach(without))[:, joints].max())
        every = joints == tuple(scene.revolute)
        named = ", ".join(f"q{j + 1}" for j in joints)
        yield Element(
            "positions in degrees" if every else "position unit", "error", joints,
            f"the position of {joints_text(joints)} is in degrees, not in radians (reaching "
            f"{reach:.4g}).",
            f"multiply {named} (and dq) by pi / 180", without,
            ODDS if every else len(joints) * choices(scene.n), place=named, figures={"largest": reach},
        )  # fmt: skip
