"""Internal joint wrenches: the force and moment that a joint bears, of which torque is one part.

The wrench w_j = (force [N], moment about the joint frame's origin [N m]), in the axes of joint j's
frame, is what the parent link exerts on everything that joint j carries (recursive Newton-Euler;
Luh, Walker, Paul 1980). Its component along the axis is the joint's torque; the other five load the
bearings. All six are linear in the standard parameters, w_j = Y_j(q, dq, ddq) theta, but only the
torque is a function of the base parameters: estimates with equal torques can bear different
wrenches. How different is answered by :func:`wrench_intervals`, over all feasible parameters at once.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.robot._pinocchio import pin
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.constraint import ConstraintSet
from sdp_vs_penalty.robot.robot import Robot
from sdp_vs_penalty.solvers.extremes import Slice

COMPONENTS = ("fx", "fy", "fz", "nx", "ny", "nz")
UNITS = ("N", "N", "N", "N*m", "N*m", "N*m")


def wrench_regressor(robot: Robot, q: ArrayLike, dq: ArrayLike, ddq: ArrayLike) -> Array:
    """Y with w_j = Y[:, j] theta, shape (N, n, 6, 10 n), for states of shape (N, n)."""
    q, dq, ddq = (np.ascontiguousarray(np.atleast_2d(x), float) for x in (q, dq, ddq))
    model = robot._model
    data = model.createData()
    frames = [inertia.transform(j.link_frame) for j in robot.joints]
    out = np.zeros((len(q), robot.n, 6, robot.n, 10))
    for k in range(len(q)):
        pin.rnea(model, data, q[k], dq[k], ddq[k])
        for link in range(robot.n):
            own = pin.bodyRegressor(data.v[link + 1], data.a_gf[link + 1]) @ frames[link]
            joint, down = link, np.eye(6)
            while joint >= 0:
                out[k, joint, :, link] = down @ own
                down = data.liMi[joint + 1].toDualActionMatrix() @ down
                joint = robot.joints[joint].parent
    return out.reshape(len(q), robot.n, 6, 10 * robot.n)


def joint_wrenches(robot: Robot, theta: ArrayLike, q: ArrayLike, dq: ArrayLike, ddq: ArrayLike) -> Array:
    """Wrenches (N, n, 6) of rigid links, theta (10 n,); theta need not be physically consistent."""
    return wrench_regressor(robot, q, dq, ddq) @ np.asarray(theta, float).ravel()


@dataclass(frozen=True)
class WrenchIntervals:
    """For M instants, n joints and six components, (M, n, 6) each [N, N m].

    lower, upper : attained by parameters with equal torques within the convex constraints;
    lower_bound, upper_bound : certified from the dual, no such parameters lie outside; centre : of
    the slice's interior point.
    """

    t: Array
    centre: Array
    lower: Array
    upper: Array
    lower_bound: Array
    upper_bound: Array

    @property
    def slack(self) -> float:
        """Largest distance between attained and certified ends, relative to the widest interval."""
        widest = float((self.upper_bound - self.lower_bound).max())
        worst = float(np.maximum(self.lower - self.lower_bound, self.upper_bound - self.upper).max())
        return worst / widest if widest > 0.0 else 0.0


def equal_torques(robot: Robot, constraints: ConstraintSet, theta: Array, bound: Array) -> Slice:
    """All feasible standard parameters (10 n,) that make the same torques as theta in every motion.

    constraints and bound : on the links' parameters only (a model of the rigid body alone). The
    equalities are the robot's base parameters. Raises InputError where theta leaves no interior.
    """
    from sdp_vs_penalty.effects.model import Model
    from sdp_vs_penalty.effects.rigid_body import RigidBody
    from sdp_vs_penalty.regression.base_parameters import base_parameters

    base, _ = base_parameters(Model(robot, (RigidBody(robot),)))
    return Slice.of(constraints, base, np.asarray(theta, float).ravel(), bound)


def wrench_intervals(
    robot: Robot,
    feasible: Slice,
    t: ArrayLike,
    q: ArrayLike,
    dq: ArrayLike,
    ddq: ArrayLike,
    progress: Callable[[str], None] = lambda _: None,
) -> WrenchIntervals:
    """The smallest and largest value of every wrench component at M instants over a slice.

    Two SDPs a component, each certified. The centre is the slice's interior point.
    """
    rows = wrench_regressor(robot, q, dq, ddq)
    shape = rows.shape[:3]
    lower, upper, low_bound, high_bound = (np.empty(shape) for _ in range(4))
    for index in np.ndindex(shape):
        progress(f"wrench intervals: instant {index[0] + 1} of {shape[0]}")
        least, most = feasible.minimum(rows[index]), feasible.maximum(rows[index])
        lower[index], low_bound[index] = least.value, least.bound
        upper[index], high_bound[index] = most.value, most.bound
    centre = rows @ feasible.interior
    return WrenchIntervals(
        np.atleast_1d(np.asarray(t, float)), centre, lower, upper, low_bound, high_bound
    )


def spread(wrenches: Sequence[Array]) -> Array:
    """(M, n, 6) largest difference of each component among several estimates' wrenches."""
    stacked = np.stack(list(wrenches))
    return np.asarray(stacked.max(axis=0) - stacked.min(axis=0))
