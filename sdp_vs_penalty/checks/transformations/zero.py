"""Encoders that count from another zero than the robot's kinematics."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from itertools import combinations, product

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

#: Of the step that is tried beside multiples of 90 degrees: over which it is differentiated [rad, m],
#: and how far it may go at once [rad].
_STEP, _FAR = 0.01, 0.7
#: Zeros are calibrated to so much: [rad], and as a share of the arm's length.
_CALIBRATED, _MEASURED = np.radians(1.5), 2e-3
#: From so many times that on an offset is no matter of calibration, and a model of the log meaningless.
_GROSS = 7.0


class Zero(Transformation):
    """What is to be added to one joint's position."""

    def proposals(self, scene: Scene, now: Repair, score: Score) -> Iterator[Repair]:
        poor = bool(scene.poor(score).any())
        for j in scene.joints:
            revolute = scene.revolute(j)
            at = partial(self._at, now, j, revolute)
            step = score.newton(scene.tried.slope(at, now.zero[j], _STEP, score.theta))
            far = _FAR if revolute else 0.3 * scene.length
            steps = [float(np.clip(step, -far, far))]
            steps += [-0.5 * np.pi, 0.5 * np.pi, np.pi] if revolute and poor else []
            for x in steps:
                if x:
                    yield at(now.zero[j] + x)

    def pairs(self, scene: Scene, now: Repair) -> Iterator[Repair]:
        """Two joints a quarter turn off: another convention of the same arm (DH against URDF)."""
        for a, b in combinations([j for j in scene.joints if scene.revolute(j)], 2):
            for x, y in product((-0.5 * np.pi, 0.5 * np.pi), repeat=2):
                yield self._at(self._at(now, a, True, now.zero[a] + x), b, True, now.zero[b] + y)

    @staticmethod
    def _at(now: Repair, j: int, revolute: bool, x: float) -> Repair:
        return now.with_entry("zero", j, wrapped(x, revolute))

    def elements(self, scene: Scene, repair: Repair) -> Iterator[Element]:
        robot = scene.problem.robot
        for j, x in enumerate(repair.zero):
            if x == 0.0:
                continue
            without = repair.with_entry("zero", j, 0.0)
            revolute, name = scene.revolute(j), joints_text([j])
            quarter = revolute and abs(x / (0.5 * np.pi) - round(x / (0.5 * np.pi))) < 1e-9
            cost = choices(scene.n) + (0.0 if quarter else ODD_NUMBER)
            tolerance = float(_CALIBRATED if revolute else _MEASURED * scene.length)
            text = degrees_text if revolute else "{:.4g} m".format
            yield Element(
                "encoder offset", "error" if abs(x) > _GROSS * tolerance else "warning", (j,), name,
                f"the zero of {name} is {text(-x)} away from the robot's kinematics.",
                f"add {x:+.5g} {robot.position_units[j]} to q{j + 1}", without, cost,
                number=Number(
                    x, partial(self._at, repair, j, revolute),
                    tolerance, 0.35 if revolute else 0.1 * scene.length, text,
                    tuple(0.5 * np.pi * k for k in (-1, 1, 2)) if revolute else (),
                ),
                figures={"joints": [j + 1], "shifts": [x]},
            )  # fmt: skip


def wrapped(x: float, revolute: bool) -> float:
    """An angle in (-pi, pi]; a length as it is."""
    return x if not revolute else float(np.pi - (np.pi - x) % (2.0 * np.pi))


def degrees_text(x: float) -> str:
    return f"{np.degrees(x):.4g} degrees"
