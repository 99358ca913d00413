"""The zero of the last joint: no motion of the arm shows it, only what is known of the last link does.

Turn the last link about its axis and count its joint from there: the arm is the same. Where the
problem holds inertials of that link, the weight that they let expect on that joint,

    u(phi) = u_0 cos(phi) + u_90 sin(phi),   phi the error of the zero,

is compared with the weight that was identified. A tool changes its size as well: only a weight of about
the right size, turned far, is called a wrong zero.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from sdp_vs_penalty.check.hypothesis import few_rows
from sdp_vs_penalty.check.issue import Issue, joints_text
from sdp_vs_penalty.check.physics import Array, Physics, wide_columns
from sdp_vs_penalty.effects.effect import Motion
from sdp_vs_penalty.problem.problem import Problem

#: Turned by less, or by more in one half of the run than in the other, it says nothing [degrees].
_FAR, _ALIKE = 60.0, 15.0
#: The weight's size over the expected one.
_SIZE = (0.6, 1.6)
#: Of the channel, how much must be weight for its direction to be known (root mean square).
_SHARE = 0.1


def find(physics: Physics, problem: Problem) -> Iterator[Issue]:
    """A warning where the last link's weight lies far round its axis from where the problem has it."""
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
    if abs(angle) < _FAR:
        return
    radians = float(-angles[0])
    yield Issue(
        "encoder offset", "warning", joints_text([j]),
        f"the weight of link {j + 1} lies {angle:.0f} degrees round its axis from where the problem's "
        f"inertials have it: the zero of {joints_text([j])} differs from the robot's kinematics.",
        "possible: the motion does not show it, the inertials of that link alone do",
        f"compare one pose with the robot; if the zero is wrong add {radians:+.3g} rad to q{j + 1}, "
        "otherwise correct that link's inertial",
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
