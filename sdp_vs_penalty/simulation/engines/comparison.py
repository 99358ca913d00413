"""An engine against the identified model: torque, and where the end effector goes.

The paper's experiment (its Table V, Figs. 5 to 7): joints follow velocities, the engine says which
torque that took, the identified model says which it should have taken.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.robot import Robot, joint_limits
from sdp_vs_penalty.simulation.engines.engine import Engine

#: q, dq, ddq (M, n) at the instants (M,) [s].
Course = Callable[[Any], tuple[Array, Array, Array]]


def played(t: Array, q: Array) -> Course:
    """Splines through samples t (N,) [s], q (N, n): what engines are told to follow."""
    spline = CubicSpline(t, q)
    return lambda at: (spline(at), spline(at, 1), spline(at, 2))


def sinusoids(robot: Robot, reach: float = 0.9, speed: float = 0.5) -> Course:
    """q_j(t) = middle_j - a_j cos(w_j t): sinusoidal velocities, from rest; reach, speed : shares of
    every joint's range and of its velocity limit."""
    lower, upper, velocity = joint_limits(robot)
    a, middle = 0.5 * reach * (upper - lower), 0.5 * (lower + upper)
    w = speed * velocity / a

    def states(t: Array) -> tuple[Array, Array, Array]:
        angle = np.outer(t, w)
        return middle - a * np.cos(angle), a * w * np.sin(angle), a * w**2 * np.cos(angle)

    return states


@dataclass(frozen=True)
class EngineRun:
    """One engine along one motion, beside the model of the same links.

    t (N,) middle of each step [s], of which its torque is the mean; torque, model (N, n) of the engine
    and of recursive Newton-Euler [N m, N]; position [m], angle [rad] (N,) : distance and rotation of the
    last link's joint frame from where the commanded motion puts it, at the end of each step.
    """

    engine: str
    t: Array
    torque: Array
    model: Array
    position: Array
    angle: Array

    @property
    def error(self) -> Array:
        """(N, n) torque of the engine less that of the model."""
        return self.torque - self.model


def play(
    kind: type[Engine],
    robot: Robot,
    links: Array,
    motion: Course,
    duration: float,
    step: float = 1e-3,
) -> EngineRun:
    """Let an engine that is present follow a motion. Raises InputError where it rejects a link.

    The velocity commanded for a step is the motion's mean velocity over it, so that an engine that
    obeys ends each step exactly where the motion does.
    """
    steps = np.arange(round(duration / step) + 1)
    q, t = motion(steps * step)[0], np.asarray((steps[:-1] + 0.5) * step, float)
    torque, pose = kind(robot, links).follow(q[0], np.diff(q, axis=0) / step, step)
    model = robot.inverse_dynamics(np.asarray(links).ravel(), *motion(t))
    return EngineRun(kind.name, t, torque, model, *pose_errors(robot, q[1:], pose))


def inverse_dynamics_error(kind: type[Engine], robot: Robot, links: Array) -> float | None:
    """Largest torque difference [N m] to Pinocchio in 100 random states; None without inverse dynamics.

    Positions over the joint range; velocities and accelerations normal, 1 rad/s and 1 rad/s^2.
    """
    q = robot.random_configurations(100, seed=0)
    dq, ddq = np.random.default_rng(0).normal(size=(2, 100, robot.n))
    torque = kind(robot, links).inverse_dynamics(q, dq, ddq)
    if torque is None:
        return None
    return float(np.abs(torque - robot.inverse_dynamics(np.asarray(links).ravel(), q, dq, ddq)).max())


def pose_errors(robot: Robot, q: Array, poses: Array) -> tuple[Array, Array]:
    """Distance [m] and angle [rad] (N,) of poses (N, 4, 4) from the last joint frame at q (N, n)."""
    from scipy.spatial.transform import Rotation

    true = robot.poses(q)[:, robot.n - 1]
    turned = Rotation.from_matrix(np.swapaxes(true[:, :3, :3], 1, 2) @ poses[:, :3, :3])
    return np.linalg.norm(poses[:, :3, 3] - true[:, :3, 3], axis=1), turned.magnitude()
