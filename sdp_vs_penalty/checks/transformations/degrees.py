"""Positions in degrees."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from sdp_vs_penalty.checks.issue import joints_text
from sdp_vs_penalty.checks.likelihood import Score
from sdp_vs_penalty.checks.repair import Repair
from sdp_vs_penalty.checks.transformations.transformation import (
    ODDS,
    Element,
    Scene,
    Transformation,
    choices,
)

DEGREE = float(np.pi / 180.0)
#: Fewer degrees than this are no motion [degrees].
_LEAST = 6.0


class Degrees(Transformation):
    """All revolute joints, or one of them."""

    def proposals(self, scene: Scene, now: Repair, score: Score) -> Iterator[Repair]:
        reach = np.abs(scene.reach(now)).max(axis=0)
        revolute = [j for j in range(scene.n) if scene.revolute(j)]
        if not revolute or reach[revolute].max() < _LEAST:
            return
        every = [DEGREE * s if j in revolute else s for j, s in enumerate(now.scale)]
        yield replace(now, scale=tuple(every))
        for j in revolute:
            if reach[j] > _LEAST and scene.n > 1:
                yield now.with_entry("scale", j, DEGREE * now.scale[j])

    def elements(self, scene: Scene, repair: Repair) -> Iterator[Element]:
        joints = [j for j, s in enumerate(repair.scale) if abs(abs(s) - DEGREE) < 1e-9]
        if not joints:
            return
        revolute = [j for j in range(scene.n) if scene.revolute(j)]
        every = joints == revolute
        scale = tuple(s / DEGREE if j in joints else s for j, s in enumerate(repair.scale))
        without = replace(repair, scale=scale)
        reach = np.abs(scene.reach(without)).max(axis=0)[joints].max()
        named = (
            ("q1" if scene.n == 1 else f"q1 to q{scene.n}")
            if every
            else ", ".join(f"q{j + 1}" for j in joints)
        )
        what = "the positions are" if every else f"the position of {joints_text(joints)} is"
        yield Element(
            "positions in degrees" if every else "position unit", "error", tuple(joints),
            named, f"{what} in degrees, not in radians (reaching {reach:.4g}).",
            f"multiply q (and dq) of {'revolute joints' if every else named} by pi / 180",
            without, ODDS if every else len(joints) * choices(scene.n),
            figures={"largest": float(reach), "joints": [j + 1 for j in joints]},
        )  # fmt: skip
