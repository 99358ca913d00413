"""Encoders that count from another zero than the robot's kinematics."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from itertools import combinations, product

import numpy as np

from sdp_vs_penalty.checks.constants import CALIBRATED_ZERO, GROSS_ZERO, ODD_NUMBER
from sdp_vs_penalty.checks.issue import joints_text
from sdp_vs_penalty.checks.likelihood import Score
from sdp_vs_penalty.checks.repair import Repair
from sdp_vs_penalty.checks.transformations.transformation import (
    Element,
    Number,
    Scene,
    Transformation,
    choices,
)  # fmt: skip

QUARTER = 0.5 * np.pi


class Zero(Transformation):
    """What is to be added to one joint's position [rad]; of prismatic joints in lengths of the arm."""

    def proposals(self, scene: Scene, now: Repair, score: Score) -> Iterator[Repair]:
        poor = bool(scene.poor(score).any())
        for j in scene.joints:
            turns, unit = j in scene.revolute, self._unit(scene, j)
            step = scene.newton(partial(_at, now, j, turns), now.zero[j], 0.01 * unit, score)
            steps = [float(np.clip(step, -0.7 * unit, 0.7 * unit))]
            steps += [-QUARTER, QUARTER, np.pi] if turns and poor else []
            yield from (_at(now, j, turns, now.zero[j] + x) for x in steps if x)

    def pairs(self, scene: Scene, now: Repair) -> Iterator[Repair]:
        """Two joints a quarter turn off: another convention of the same arm (DH against URDF)."""
        for a, b in combinations(scene.revolute, 2):
            for x, y in product((-QUARTER, QUARTER), repeat=2):
                yield _at(_at(now, a, True, now.zero[a] + x), b, True, now.zero[b] + y)

    def _unit(self, scene: Scene, j: int) -> float:
        return 1.0 if j in scene.revolute else 0.3 * scene.length

    def elements(self, scene: Scene, repair: Repair) -> Iterator[Element]:
        for j in np.flatnonzero(repair.zero).tolist():
            x, turns, unit = repair.zero[j], j in scene.revolute, self._unit(scene, j)
            quarter = turns and abs(x / QUARTER - round(x / QUARTER)) < 1e-9
            tolerance = CALIBRATED_ZERO * unit * (1.0 if turns else 0.25)
            text = _degrees if turns else "{:.4g} m".format
            yield Element(
                "encoder offset", "error" if abs(x) > GROSS_ZERO * tolerance else "warning", (j,),
                f"the zero of {joints_text([j])} is {text(-x)} away from the robot's kinematics.",
                f"add {x:+.5g} {scene.problem.robot.position_units[j]} to q{j + 1}",
                repair.with_entry("zero", j, 0.0), choices(scene.n) + (0.0 if quarter else ODD_NUMBER),
                Number(
                    x, partial(_at, repair, j, turns), tolerance, 0.35 * unit, text,
                    tuple(QUARTER * k for k in (-1, 1, 2)) if turns else (),
                ), figures={"shifts": [x]},
            )  # fmt: skip


def _at(now: Repair, j: int, turns: bool, x: float) -> Repair:
    """An angle in (-pi, pi]; a length as it is."""
    return now.with_entry("zero", j, float(np.pi - (np.pi - x) % (2.0 * np.pi)) if turns else x)


def _degrees(x: float) -> str:
    return f"{np.degrees(x):.4g} degrees"
