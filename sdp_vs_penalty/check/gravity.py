"""A base that is not mounted as believed, and a last link that is turned about its axis."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import product

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.check.columns import wide_columns
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
from sdp_vs_penalty.check.issue import Issue, joints_text
from sdp_vs_penalty.check.physics import Physics
from sdp_vs_penalty.effects.effect import Motion
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.robot.arrays import Array

#: Gravity is said to point elsewhere from this angle on [degrees]; less is the effect base_tilt.
_SMALLEST_ANGLE = 2.0
#: ... and from this one on no model of these data means anything.
_MEANINGLESS = 10.0
#: What gravity can be on Earth, with room for rounding [m/s^2]; otherwise it is tried at this size.
_EARTH, _STANDARD = (9.6, 10.0), 9.81
#: Within this angle of an axis of the base gravity is said to point along it [degrees].
_STRAIGHT = 3.0
#: Of its search [rad]: how far apart E is compared, the longest and the last step; and steps at most.
_APART, _LONGEST, _EXACT, _TURNS = 0.02, 0.3, 3e-4, 20


def direction(physics: Physics, moving: NDArray[np.bool_]) -> Iterator[Hypothesis]:
    """Gravity along another direction of the base, or of another size than the problem says."""
    robot = physics.model.robot
    given = float(np.linalg.norm(robot.gravity))
    earthly = _EARTH[0] <= given <= _EARTH[1]
    size = given if earthly else _STANDARD
    direction, _ = FreeGravity(physics).best(size)
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

    apply = partial(Physics.with_gravity, gravity=(x, y, z))
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

    apply = partial(Physics.with_gravity, gravity=(x, y, z))
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
        """(4, 4, p, p) and (4, p) products of Y at g = 0, dY/dgx, dY/dgy, dY/dgz, joints weighted."""
        physics = self.physics
        made, p = physics.by_gravity, physics.p
        gram, cross = np.zeros((4, 4, p, p)), np.zeros((4, p))
        weights = 1.0 / (len(physics.channels) * physics.energy * physics.n)
        for w, y, fixed, *pulled in zip(weights, physics.channels.T, *made, strict=True):
            k, m = fixed.indices, len(fixed.indices)
            stack = np.hstack([fixed.columns, *(x.columns for x in pulled)])
            square = (w * stack.T @ stack).reshape(4, m, 4, m)
            gram[:, :, k[:, None], k] += np.moveaxis(square, 2, 1)
            cross[:, k] += (w * stack.T @ y).reshape(4, m)
        return gram, cross

    def unexplained(self, gravity: Array) -> float:
        """E with this gravity vector [m/s^2]."""
        gram, cross = self._gram
        mix = np.append(1.0, gravity)
        b = mix @ cross
        both = (np.outer(mix, mix).ravel() @ gram.reshape(16, -1)).reshape(gram.shape[2:])
        return max(1.0 - float(b @ solve(both, b[:, None])[:, 0]), 1e-12)

    def best(self, size: float) -> tuple[Array, float]:
        """The direction (unit vector) of gravity of this size that explains the torque best; its E."""
        grid = [np.array(d, float) for d in product((-1, 0, 1), repeat=3) if any(d)]
        grid = [d / np.linalg.norm(d) for d in grid]
        start = min(grid, key=lambda d: self.unexplained(size * d))
        across = np.linalg.svd(start[None, :])[2][1:]

        def direction(x: Array) -> Array:
            d = start + x @ across
            return np.asarray(d / np.linalg.norm(d), float)

        found, least = lowest(lambda x: self.unexplained(size * direction(x)), np.zeros(2))
        return direction(found), least


def lowest(f: Callable[[Array], float], x: Array) -> tuple[Array, float]:
    """Where f of two variables is lowest near x, by damped Newton steps on differences; and how low."""
    value = f(x)
    for _ in range(_TURNS):
        side = [f(x + d) for d in (*(_APART * np.eye(2)), *(-_APART * np.eye(2)), np.full(2, _APART))]
        slope = np.array([side[0] - side[2], side[1] - side[3]]) / (2.0 * _APART)
        twice = np.diag([side[0] + side[2] - 2.0 * value, side[1] + side[3] - 2.0 * value])
        twice[0, 1] = twice[1, 0] = side[4] - side[0] - side[1] + value
        twice /= _APART**2
        curved = np.linalg.eigvalsh(twice)[0] > 0.0
        step = np.linalg.solve(twice, -slope) if curved else -slope
        length = float(np.linalg.norm(step))
        if not curved or length > _LONGEST:
            step *= _LONGEST / max(length, 1e-300)
        after = f(x + step)
        while after >= value and np.linalg.norm(step) > _EXACT:
            step = 0.5 * step
            after = f(x + step)
        if after >= value:
            break
        x, value = x + step, after
        if np.linalg.norm(step) <= _EXACT:
            break
    return x, value


#: Turned by less, or by more in one half of the run than in the other, it says nothing [degrees].
_TURNED_FAR, _ALIKE = 60.0, 15.0
#: The weight's size over the expected one.
_SIZE = (0.6, 1.6)
#: Of the channel, how much must be weight for its direction to be known (root mean square).
_SHARE = 0.1


def last_joint(physics: Physics, problem: Problem) -> Iterator[Issue]:
    """A warning where the last link's weight lies far round its axis from where the problem has it.

    No motion shows the zero of the last joint: turn its link about its axis, count from there, and the
    arm is the same. Where the problem holds inertials of that link, the weight that they let expect,
    u(phi) = u_0 cos(phi) + u_90 sin(phi) with phi the error of the zero, is compared with the identified
    one. A tool changes its size as well: only about the right size, turned far, is called a wrong zero.
    """
    robot, j = physics.model.robot, physics.n - 1
    known = not problem.guessed_links[-1] and robot.mechanism is None
    if not known or robot.joints[j].kind != "revolute" or not any(robot.gravity):
        return
    half = len(physics.motion.t) // 2
    parts = [physics, *(physics.part(rows) for rows in (slice(0, half), slice(half, None)))]
    found = [_turned(part, j) for part in parts]
    sizes, angles = (np.array(x) for x in zip(*found, strict=True))
    spread = np.degrees(np.abs(np.angle(np.exp(1j * (angles - angles[0]))))).max()
    small, large = _SIZE
    if np.any(sizes < small) or np.any(sizes > large) or spread > _ALIKE:
        return
    angle = float(np.degrees(angles[0]))
    if abs(angle) < _TURNED_FAR:
        return
    radians = float(-angles[0])
    yield Issue(
        "encoder offset", "warning", joints_text([j]),
        f"the weight of link {j + 1} lies {angle:.0f} degrees round its axis from where the problem's "
        f"inertials have it: the zero of {joints_text([j])} differs from the robot's kinematics, or it "
        "carries a tool that the problem does not have.",
        "possible: the motion does not show it, the inertials of that link alone do",
        f"compare one pose with the robot; if the zero is wrong add {radians:+.3g} rad to q{j + 1}, "
        "otherwise correct that link's inertial (with its tool)",
        None, {"joints": [j + 1], "shifts": [radians]},
    )  # fmt: skip


def _turned(physics: Physics, j: int) -> tuple[float, float]:
    """Size of the identified weight on joint j over the expected one's, and the angle between [rad]."""
    few = physics.part(few_rows(physics))
    quarter = 0.5 * np.pi * np.eye(physics.n)[j]
    identified = _weight(few, physics.evidence.theta, j)
    if np.linalg.norm(identified) < _SHARE * np.linalg.norm(few.channels[:, j]):
        return 0.0, 0.0
    ahead = replace(few.motion, q=few.motion.q + quarter)
    expected = np.column_stack(
        [_weight(few, few.nominal, j), _weight(replace(few, motion=ahead), few.nominal, j)]
    )
    (a, b), *_ = np.linalg.lstsq(expected, identified)
    # A link turned by phi against what its joint counts is the nominal one at q + phi.
    return float(np.hypot(a, b)), float(np.arctan2(b, a))


def _weight(physics: Physics, theta: Array, j: int) -> Array:
    """(M,) what the last link weighs on joint j at rest."""
    last = physics.model.rigid_indices[-10:]
    rest = np.zeros_like(physics.motion.q)
    still = Motion(physics.motion.t, physics.motion.q, rest, rest)
    return np.asarray(wide_columns(physics.model, still)[j][:, last] @ theta[last])
