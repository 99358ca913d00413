"""Internal joint wrenches: the force and moment that a joint bears, of which torque is one part.

The wrench w_j = (force [N], moment about the joint frame's origin [N m]), in the axes of joint j's
frame, is what the parent link exerts on everything that joint j carries (recursive Newton-Euler;
Luh, Walker, Paul 1980). Its component along the axis is the joint's torque; the other five load the
bearings. All six are linear in the standard parameters, w_j = Y_j(q, dq, ddq) theta, but only the
torque is a function of the base parameters: estimates with equal torques can bear different
wrenches. How different is answered by :func:`wrench_intervals`, over all feasible parameters at once.
The paper's supplementary material shows on a spatial 2R why that matters: parameters that reproduce
every torque can bear impossible loads. They come from the relaxed retrieval: torques and no physics.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike
from scipy import optimize

from sdp_vs_penalty.effects.model import Model
from sdp_vs_penalty.effects.rigid_body import RigidBody
from sdp_vs_penalty.estimators.penalty import Penalty
from sdp_vs_penalty.estimators.sdp_fit import interior_point
from sdp_vs_penalty.paper.tables.study import Study
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.problem.published import published_links
from sdp_vs_penalty.regression.base_parameters import base_parameters
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
    lower_bound, upper_bound : certified from the dual, no such parameters lie outside.
    """

    t: Array
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

    Two SDPs a component, each certified.
    """
    rows = wrench_regressor(robot, q, dq, ddq)
    shape = rows.shape[:3]
    lower, upper, low_bound, high_bound = (np.empty(shape) for _ in range(4))
    for index in np.ndindex(shape):
        progress(f"wrench intervals: instant {index[0] + 1} of {shape[0]}")
        least, most = feasible.minimum(rows[index]), feasible.maximum(rows[index])
        lower[index], low_bound[index] = least.value, least.bound
        upper[index], high_bound[index] = most.value, most.bound
    return WrenchIntervals(np.atleast_1d(np.asarray(t, float)), lower, upper, low_bound, high_bound)


def spread(wrenches: Sequence[Array]) -> Array:
    """(M, n, 6) largest difference of each component among several estimates' wrenches."""
    stacked = np.stack(list(wrenches))
    return np.asarray(stacked.max(axis=0) - stacked.min(axis=0))


@dataclass(frozen=True)
class Retrieval:
    """links (n, 10) standard parameters; error : largest |pi - pi_hat| over the largest |pi_hat|."""

    seed: int
    links: Array
    error: float


def relaxed_retrieval(
    problem: Problem, pi: Array, seed: int, boxed: bool, wide: float = 1.0
) -> Retrieval:
    """Barycentric parameters p with base parameters pi (b,), without triangle inequality or shape.

    Non-linear least squares |pi(p) - pi|^2 from a random start: what the paper's retrieval is
    without its conditional constraints. boxed : keep the box bounds of the problem's tables, which
    leave the 2R's c1x, c1z, c2y, c2z open; otherwise nothing is bounded. wide : within so many kg, m
    or kg m^2 of zero the search for a parameter without bounds starts.
    """
    base, _ = base_parameters(problem.model("rigid_body"), problem.independent)
    box = problem.box.reshape(-1, 2)
    open_start = np.array([-wide, wide])
    start_box = (
        np.where(np.isfinite(box), box, open_start) if boxed else np.tile(open_start, (len(box), 1))
    )
    if not boxed:
        start_box[::10] = np.where(np.isfinite(box[::10]), box[::10], [0.0, wide])  # masses
    start = np.random.default_rng(seed).uniform(start_box[:, 0], start_box[:, 1])
    size = float(np.abs(pi).max())

    def residual(p: Array) -> Array:
        links = inertia.standard_from_barycentric(p.reshape(-1, 10))
        return np.asarray((base @ links.ravel() - pi) / size)

    found = optimize.least_squares(
        residual,
        start,
        bounds=(box[:, 0], box[:, 1]) if boxed else (-np.inf, np.inf),
        x_scale="jac",
        xtol=1e-15,
        ftol=1e-15,
        gtol=1e-15,
        max_nfev=1000,
    )
    links = inertia.standard_from_barycentric(found.x.reshape(-1, 10))
    return Retrieval(seed, links, float(np.abs(found.fun).max()))


def unfeasible_retrievals(problem: Problem, pi: Array, count: int, boxed: bool) -> Iterator[Retrieval]:
    """The first ``count`` relaxed retrievals that reproduce pi and are physically inconsistent."""
    found = 0
    for k in range(20 * count):
        retrieval = relaxed_retrieval(problem, pi, k, boxed)
        # A retrieval counts as reproducing the torques below this error relative to the largest
        # symbol.
        if retrieval.error > 1e-8 or inertia.consistency_margin(retrieval.links).min() >= 0.0:
            continue
        yield retrieval
        found += 1
        if found == count:
            return


#: Instants of the intervals, and relaxed retrievals of each kind.
INSTANTS = {"quick": 81, "paper": 201}
RETRIEVALS = {"quick": 10, "paper": 50}
#: Starts of the penalty method whose wrenches are compared: as many as the paper's runs.
PENALTY_RUNS = 10


@dataclass(frozen=True)
class WrenchStudy:
    """Wrenches (M, n, 6) along the exciting trajectory at t (M,), states q, dq, ddq; and the intervals.

    feasible : of each method's estimate; penalty_runs : of the exact penalty from other starts;
    boxed, unbounded : relaxed retrievals that reproduce the torques and are inconsistent, with and
    without the box bounds.
    """

    t: Array
    states: tuple[Array, Array, Array]
    true: Array
    feasible: dict[str, Array]
    penalty_runs: tuple[Array, ...]
    boxed: tuple[Retrieval, ...]
    unbounded: tuple[Retrieval, ...]
    intervals: WrenchIntervals

    def wrenches(self, study: Study, links: Array) -> Array:
        return joint_wrenches(study.problem.robot, links, *self.states)


@lru_cache(maxsize=4)
def wrench_study(study: Study) -> WrenchStudy:
    problem, x = study.problem, study.experiment
    t = np.linspace(0.0, x.trajectory.duration, INSTANTS[study.budget] + 2)[1:-1]
    states = x.trajectory.states(t)
    model = problem.model("rigid_body")
    feasible = equal_torques(
        problem.robot, problem.constraints(model), x.links, problem.parameter_bound(model)
    )
    intervals = wrench_intervals(problem.robot, feasible, t, *states, progress=study.progress)
    pi = study.base @ x.links.ravel()
    count = RETRIEVALS[study.budget]
    study.progress("relaxed retrievals")
    estimates = {"published p_hat": published_links(problem, "p_hat")}
    for name, method in study.methods.items():
        if name != "ols":
            estimates[name] = study.links(method, study.simulated)
    return WrenchStudy(
        t,
        states,
        joint_wrenches(problem.robot, x.links, *states),
        {k: joint_wrenches(problem.robot, v, *states) for k, v in estimates.items()},
        tuple(joint_wrenches(problem.robot, v, *states) for v in penalty_links(study)),
        tuple(unfeasible_retrievals(problem, pi, count, boxed=True)),
        tuple(unfeasible_retrievals(problem, pi, count, boxed=False)),
        intervals,
    )


def penalty_links(study: Study) -> list[Array]:
    """Links (n, 10) that the exact penalty finds from scattered feasible starts, one run each.

    A start lies near the boundary of the feasible set, where a random linear function is least.
    """
    task, found = study.task(study.simulated), []
    p = len(task.bound)
    interior = interior_point(task, task.constraints)
    everywhere = Slice.of(task.constraints, np.zeros((0, p)), interior, task.bound)
    rng = np.random.default_rng(study.seed)
    estimator = Penalty(body=False, thickness=0.0, starts=1)
    for k in range(PENALTY_RUNS):
        study.progress(f"penalty run {k + 1} of {PENALTY_RUNS}")
        edge = everywhere.minimum(rng.normal(size=p) / task.bound).theta
        # How far towards the boundary such a start lies, from the interior point.
        start = everywhere.interior + 0.9 * (edge - everywhere.interior)
        found.append(estimator.fit(replace(task, nominal=start)).theta[task.links])
    return found
