"""Torque channels too large or too small beside their neighbours'. A factor that all have in common is
not seen by what joints share: see size.py."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from sdp_vs_penalty.checks.constants import CALIBRATED_GAIN, ODD_NUMBER, WRONG_GAIN
from sdp_vs_penalty.checks.issue import joints_text
from sdp_vs_penalty.checks.likelihood import Score
from sdp_vs_penalty.checks.repair import Repair
from sdp_vs_penalty.checks.transformation import Element, Number, Scene, Transformation, choices

#: Factors that are tried: units, and a grid whose steps the refinement bridges.
_TRIED = (1e-3, 1e-2, 0.1, 0.3, 0.6, 0.85, 1.17, 1.7, 3, 10, 100, 1e3)
#: Factors of units, and what a channel is in whose torque has to be multiplied by one.
_UNITS = {1e-3: "mN m", 1e-2: "N cm", 9.80665: "kgf m", 0.1129848: "lbf in"}


class Gain(Transformation):
    def proposals(self, scene: Scene, now: Repair, score: Score) -> Iterator[Repair]:
        for j in scene.joints if len(scene.joints) > 1 else ():
            yield from (now.times("gain", (j,), factor) for factor in _TRIED)

    def elements(self, scene: Scene, repair: Repair) -> Iterator[Element]:
        for j in np.flatnonzero(np.abs(repair.gain) != 1.0).tolist():
            g, sign = abs(repair.gain[j]), float(np.sign(repair.gain[j]))
            unit = next((name for u, name in _UNITS.items() if abs(g / u - 1.0) < 1e-9), None)
            size = f"{1.0 / g:.3g} times too large" if g < 1.0 else f"{g:.3g} times too small"
            what = f"the torque of {joints_text([j])} is {size} beside those of its neighbours"
            at = lambda x, j=j, s=sign: repair.with_entries("gain", (j,), s * x)  # noqa: E731
            yield Element(
                "torque gain" if unit is None else "torque unit",
                "error" if abs(np.log(g)) > WRONG_GAIN else "warning", (j,),
                f"{what}." if unit is None else f"{what}: it is in {unit}.",
                f"multiply tau{j + 1} by {g:.3g}", at(1.0),
                choices(scene.n) + (ODD_NUMBER if unit is None else 0.0),
                Number.factor(g, at, CALIBRATED_GAIN, 0.5, tuple(_UNITS)), figures={"factor": g},
            )  # fmt: skip
