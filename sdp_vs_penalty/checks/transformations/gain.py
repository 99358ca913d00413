"""Torque channels too large or too small beside their neighbours'."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from sdp_vs_penalty.checks.issue import joints_text
from sdp_vs_penalty.checks.likelihood import Score
from sdp_vs_penalty.checks.repair import Repair
from sdp_vs_penalty.checks.transformations.transformation import (
    ODD_NUMBER,
    Element,
    Number,
    Scene,
    Transformation,
    choices,
)

#: Factors that are tried.
_GAINS = (
    1e-3,
    1e-2,
    0.1,
    0.3,
    0.5,
    0.63,
    0.77,
    0.87,
    0.94,
    1.06,
    1.14,
    1.3,
    1.6,
    2.0,
    3.0,
    10.0,
    100.0,
    1e3,
)
#: Drives are calibrated to so much (natural logarithm); a model of channels that differ by more than the
#: second is wrong, not only worse.
_CALIBRATED, _MEANINGLESS = 0.06, 0.5
#: Factors of units, and what a channel is in whose torque has to be multiplied by one.
UNITS = {1e-3: "mN m", 1e-2: "N cm", 9.80665: "kgf m", 0.1129848: "lbf in"}


class Gain(Transformation):
    """What one channel has to be multiplied by. The common factor of all is not seen here: see
    scale.py.
    """

    def proposals(self, scene: Scene, now: Repair, score: Score) -> Iterator[Repair]:
        if len(scene.joints) < 2:
            return  # a joint that moves alone has none to be compared with
        for j in scene.joints:
            for factor in _GAINS:
                yield now.with_entry("gain", j, now.gain[j] * factor)

    def elements(self, scene: Scene, repair: Repair) -> Iterator[Element]:
        for j, signed in enumerate(repair.gain):
            g = abs(signed)
            if g == 1.0:
                continue
            sign, name = float(np.sign(signed)), joints_text([j])
            unit = next((UNITS[u] for u in UNITS if abs(g / u - 1.0) < 1e-9), None)
            size = f"{1.0 / g:.3g} times too large" if g < 1.0 else f"{g:.3g} times too small"
            what = f"the torque of {name} is {size} beside those of the joints that it moves with"
            yield Element(
                "torque gain" if unit is None else "torque unit",
                "error" if abs(np.log(g)) > _MEANINGLESS else "warning", (j,), name,
                f"{what}." if unit is None else f"{what}: it is in {unit}.",
                f"multiply tau{j + 1} by {g:.3g}", repair.with_entry("gain", j, sign),
                choices(scene.n) + (ODD_NUMBER if unit is None else 0.0),
                number=Number(
                    float(np.log(g)),
                    lambda v, j=j, s=sign: repair.with_entry("gain", j, s * float(np.exp(v))),  # type: ignore[misc]
                    _CALIBRATED, 0.5, lambda v: f"a factor of {np.exp(v):.3g}",
                    tuple(float(np.log(u)) for u in UNITS),
                ),
                figures={"joints": [j + 1], "factor": g},
            )  # fmt: skip
