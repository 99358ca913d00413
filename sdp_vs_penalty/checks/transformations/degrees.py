"""Positions in degrees: of all revolute joints, or of one of them."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from sdp_vs_penalty.checks.constants import ODDS
from sdp_vs_penalty.checks.issue import joints_text
from sdp_vs_penalty.checks.likelihood import Score
from sdp_vs_penalty.checks.repair import Repair
from sdp_vs_penalty.checks.transformation import Element, Scene, Transformation, choices

_DEGREE = float(np.pi / 180.0)
#: Numbers that stay below this are no degrees of a motion.
_LEAST = 6.0


class Degrees(Transformation):
    def proposals(self, scene: Scene, now: Repair, score: Score) -> Iterator[Repair]:
        far = [j for j in scene.revolute if np.abs(scene.reach(now)[:, j]).max() > _LEAST]
        for joints in [scene.revolute, *([j] for j in far if scene.n > 1)] if far else ():
            yield now.times("scale", joints, _DEGREE)

    def elements(self, scene: Scene, repair: Repair) -> Iterator[Element]:
        joints = tuple(j for j, s in enumerate(repair.scale) if abs(abs(s) - _DEGREE) < 1e-9)
        if not joints:
            return
        without = repair.times("scale", joints, 1.0 / _DEGREE)
        reach = float(np.abs(scene.reach(without))[:, joints].max())
        every = joints == tuple(scene.revolute)
        named = ", ".join(f"q{j + 1}" for j in joints)
        what = f"the position of {joints_text(joints)} is in degrees, not in radians"
        yield Element(
            "positions in degrees" if every else "position unit", "error", joints,
            f"{what} (reaching {reach:.4g}).", f"multiply {named} (and dq) by pi / 180", without,
            ODDS if every else len(joints) * choices(scene.n), place=named, figures={"largest": reach},
        )  # fmt: skip
