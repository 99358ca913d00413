"""A channel that bends towards a limit: tau_log = s tanh(tau / s), an amplifier near its end."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from sdp_vs_penalty.checks.constants import ODD_NUMBER
from sdp_vs_penalty.checks.issue import joints_text
from sdp_vs_penalty.checks.likelihood import Score
from sdp_vs_penalty.checks.repair import Repair
from sdp_vs_penalty.checks.transformation import Element, Number, Scene, Transformation, choices

#: Bends that are tried: the largest logged torque over the limit, which it never reaches.
_TRIED = (0.7, 0.9, 0.98)
#: Below this bend a channel is as straight as sensors are.
_STRAIGHT = 0.2


class Saturation(Transformation):
    def proposals(self, scene: Scene, now: Repair, score: Score) -> Iterator[Repair]:
        for j in scene.joints:
            yield from (now.with_entries("bend", (j,), x) for x in _TRIED)

    def elements(self, scene: Scene, repair: Repair) -> Iterator[Element]:
        for j in np.flatnonzero(repair.bend).tolist():
            x, k = repair.bend[j], repair.tau_order[j]
            limit, unit = scene.judged.data.largest[k] / x, scene.problem.robot.torque_units[j]
            at = lambda v, j=j: repair.with_entries("bend", (j,), float(np.clip(v, 0.0, 0.995)))  # noqa: E731
            what = f"the torque of {joints_text([j])} bends towards a limit of {limit:.3g} {unit}"
            yield Element(
                "saturation", "warning", (j,), f"{what}: its sensor or amplifier is near its end.",
                "record again with a larger range, or slower", at(0.0), choices(scene.n) + ODD_NUMBER,
                Number(x, at, _STRAIGHT, 0.25, lambda v: f"{100.0 * v:.0f} % of the limit is reached"),
                mends=False, figures={"limit": limit},
            )  # fmt: skip
