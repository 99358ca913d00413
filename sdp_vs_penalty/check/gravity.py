"""A base that is not mounted as believed."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from sdp_vs_penalty.check.evidence import solve
from sdp_vs_penalty.check.hypothesis import (
    AGREES,
    NEAR,
    SIGNIFICANT,
    Hypothesis,
    Number,
    few_rows,
    propose,
)
from sdp_vs_penalty.check.physics import Array, Physics, turned_gravity

#: Gravity is said to point elsewhere from this angle on [degrees]; less is the effect base_tilt.
_SMALLEST_ANGLE = 2.0
#: ... and from this one on no model of these data means anything.
_MEANINGLESS = 10.0
#: What gravity can be on Earth, with room for rounding [m/s^2]; otherwise it is tried at this size.
_EARTH, _STANDARD = (9.6, 10.0), 9.81
#: Within this angle of an axis of the base gravity is said to point along it [degrees].
_STRAIGHT = 3.0


def direction(physics: Physics, moving: NDArray[np.bool_]) -> Iterator[Hypothesis]:
    """Gravity along another direction of the base, or of another size than the problem says."""
    robot = physics.model.robot
    given = float(np.linalg.norm(robot.gravity))
    earthly = _EARTH[0] <= given <= _EARTH[1]
    size = given if earthly else _STANDARD
    direction, _ = FreeGravity(physics.part(few_rows(physics))).best(size)
    assumed = np.array(robot.gravity) / max(given, 1e-300)
    angle = float(np.degrees(np.arccos(np.clip(direction @ assumed, -1.0, 1.0))))
    if earthly and angle < _SMALLEST_ANGLE:
        return
    measured = _vector(tuple(float(f"{g:.3f}") + 0.0 for g in size * direction))
    nearest = np.eye(3)[int(np.argmax(np.abs(direction)))] * np.sign(
        direction[np.argmax(np.abs(direction))]
    )
    if direction @ nearest > np.cos(np.radians(_STRAIGHT)):
        direction = nearest  # a base mounted straight, seen through the error of the fit
    x, y, z = (float(round(g, 2)) + 0.0 for g in size * direction)

    def apply(p: Physics) -> Physics:
        return p.with_gravity((x, y, z))

    kind, mend = "gravity direction", f"identify with --gravity {x:g},{y:g},{z:g}"
    what = (
        f"gravity is {angle:.0f} degrees away from the assumed {_vector(robot.gravity)}, along "
        f"{measured} m/s^2 as measured: {_mounting(angle)}."
    )
    if not earthly:
        kind, mend = "gravity of the problem", f"{mend}, or correct the problem's gravity"
        what = (
            f"the problem assumes gravity {_vector(robot.gravity)} m/s^2, but the weight in the "
            f"torques points along {measured} m/s^2 as measured."
        )
    across = direction - (direction @ assumed) * assumed
    across /= max(float(np.linalg.norm(across)), 1e-300)

    def tilted(radians: float) -> Callable[[Physics], Physics]:
        vector = size * (np.cos(radians) * assumed + np.sin(radians) * across)
        return lambda p: p.with_gravity(vector.tolist())

    yield propose(
        apply, 2, (kind, "the base", what, mend), None, gravity=(x, y, z),
        number=Number(float(np.radians(angle)), tilted) if earthly and angle < 170.0 else None,
        severity="warning" if earthly and angle < _MEANINGLESS else "error", angle_degrees=angle,
        vector=[x, y, z],
    )  # fmt: skip


def hanging(physics: Physics) -> Hypothesis | None:
    """Gravity upside down: with all weights negative it explains the torque about as well.

    Only that masses are positive tells the two apart: the weight of any plausible arm has the
    measured torque's sign.
    """
    robot = physics.model.robot
    if not any(robot.gravity):
        return None
    x, y, z = (-g + 0.0 for g in robot.gravity)

    def apply(p: Physics) -> Physics:
        return p.with_gravity((x, y, z))

    before, after = physics.unexplained, apply(physics).unexplained
    agreement = physics.agreement_with_weight()
    negative = float(apply(physics).inertia.sum()) < -SIGNIFICANT
    if after > NEAR * before or agreement > -AGREES or negative:
        return None
    half = len(physics.motion.t) // 2
    if any(physics.part(k).agreement_with_weight() > 0.0 for k in (slice(0, half), slice(half, None))):
        return None
    texts = (
        "gravity direction",
        "the base",
        f"gravity points the other way, along {_vector((x, y, z))} m/s^2: {_mounting(180.0)}.",
        f"identify with --gravity {x:g},{y:g},{z:g}",
    )
    sure = f"likely: as recorded, link masses would be negative (correlation {agreement:.2f})"
    return propose(
        apply, 1, texts, None, gravity=(x, y, z), certainty=sure, angle_degrees=180.0, vector=[x, y, z]
    )


def _vector(values: tuple[float, ...]) -> str:
    return "(" + ", ".join(f"{v:g}" for v in values) + ")"


def _mounting(angle: float) -> str:
    if angle > 160.0:
        return "the base hangs from the ceiling"
    if 70.0 < angle < 110.0:
        return "the base is mounted sideways, on a wall"
    return "the base is tilted"


@dataclass(frozen=True)
class FreeGravity:
    """The same test with the direction of gravity free: columns are linear in the vector g."""

    physics: Physics

    @cached_property
    def _gram(self) -> tuple[Array, Array]:
        """Gram matrix and cross products of [Y at g = 0, dY/dgx, dY/dgy, dY/dgz], joints weighted."""
        physics = self.physics
        robot = physics.model.robot
        fixed = physics.columns_of(turned_gravity(physics.model, (0.0, 0.0, 0.0)))
        parts = [fixed]
        for axis in range(3):
            unit = np.eye(3)[axis]
            pulled = physics.columns_of(turned_gravity(physics.model, tuple(unit)))
            parts.append([a - b for a, b in zip(pulled, fixed, strict=True)])
        p = fixed[0].shape[1]
        gram, cross = np.zeros((4 * p, 4 * p)), np.zeros(4 * p)
        weights = 1.0 / (len(physics.channels) * physics.energy * robot.n)
        for j in range(robot.n):
            stack = np.hstack([part[j] for part in parts])
            gram += weights[j] * stack.T @ stack
            cross += weights[j] * stack.T @ physics.channels[:, j]
        return gram, cross

    def unexplained(self, gravity: Array) -> float:
        """E with this gravity vector [m/s^2]."""
        gram, cross = self._gram
        p = len(cross) // 4
        mix = np.vstack([np.eye(p), *(g * np.eye(p) for g in gravity)])
        b = mix.T @ cross
        return max(1.0 - float(b @ solve(mix.T @ gram @ mix, b[:, None])[:, 0]), 1e-12)

    def best(self, size: float) -> tuple[Array, float]:
        """The direction (unit vector) of gravity of this size that explains the torque best; its E."""
        grid = [np.array(d, float) for d in product((-1, 0, 1), repeat=3) if any(d)]
        grid = [d / np.linalg.norm(d) for d in grid]
        start = min(grid, key=lambda d: self.unexplained(size * d))
        across = np.linalg.svd(start[None, :])[2][1:]

        def direction(x: Array) -> Array:
            d = start + x @ across
            return np.asarray(d / np.linalg.norm(d), float)

        found = minimize(
            lambda x: np.log(self.unexplained(size * direction(x))), np.zeros(2), method="Nelder-Mead",
            options={"xatol": 1e-3, "fatol": 1e-4, "initial_simplex": [[0, 0], [0.2, 0], [0, 0.2]]},
        )  # fmt: skip
        return direction(found.x), float(np.exp(found.fun))
