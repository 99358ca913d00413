"""Encoders that count from another zero than the robot's kinematics."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np

from sdp_vs_penalty.checks.constants import CALIBRATED_ZERO, GROSS_ZERO, ODD_NUMBER
from sdp_vs_penalty.checks.issue import joints_text
from sdp_vs_penalty.checks.likelihood import Score
from sdp_vs_penalty.checks.repair import Repair
from sdp_vs_penalty.checks.transformation import Element, Number, Scene, Transformation, choices

_QUARTER = 0.5 * np.pi


class Zero(Transformation):
    """What is to be added to one joint's position [rad]; of prismatic joints in lengths of the arm."""

    def proposals(self, scene: Scene, now: Repair, score: Score) -> Iterator[Repair]:
        poor = scene.poor(score).any()
        for j in scene.joints:
            at, unit = partial(_at, scene, now, j), _unit(scene, j)
            step = scene.newton(at, now.zero[j], 0.01 * unit, score)
            steps = [float(np.clip(step, -0.7 * unit, 0.7 * unit))]
            steps += [-_QUARTER, _QUARTER, np.pi] if j in scene.revolute and poor else []
            yield from (at(now.zero[j] + x) for x in steps if x)

    def elements(self, scene: Scene, repair: Repair) -> Iterator[Element]:
        for j in np.flatnonzero(repair.zero).tolist():
            x, turns, unit = repair.zero[j], j in scene.revolute, _unit(scene, j)
            quarter = turns and abs(x / _QUARTER - round(x / _QUARTER)) < 1e-9
            tolerance = CALIBRATED_ZERO * unit * (1.0 if turns else 0.25)
            text = (lambda v: f"{np.degrees(v):.4g} degrees") if turns else "{:.4g} m".format
            snaps = tuple(_QUARTER * k for k in (-1, 1, 2)) if turns else ()
            yield Element(
                "encoder offset", "error" if abs(x) > GROSS_ZERO * tolerance else "warning", (j,),
                f"the zero of {joints_text([j])} is {text(-x)} away from the robot's kinematics.",
                f"add {x:+.5g} {scene.problem.robot.position_units[j]} to q{j + 1}",
                _at(scene, repair, j, 0.0), choices(scene.n) + (0.0 if quarter else ODD_NUMBER),
                Number(x, partial(_at, scene, repair, j), tolerance, 0.35 * unit, text, snaps, _QUARTER),
                figures={"shifts": [x]},
            )  # fmt: skip


def _unit(scene: Scene, j: int) -> float:
    return 1.0 if j in scene.revolute else 0.3 * scene.length


def _at(scene: Scene, now: Repair, j: int, x: float) -> Repair:
    """An angle in (-pi, pi]; a length as it is."""
    wrapped = float(np.pi - (np.pi - x) % (2.0 * np.pi)) if j in scene.revolute else x
    return now.with_entries("zero", (j,), wrapped)
