"""Internal joint wrenches: the force and moment that a joint bears, of which torque is
one part.

The wrench w_j = (force [N], moment about the joint frame's origin [N m]), in the axes
of joint j's frame, is what the parent link exerts on everything that joint j carries
(recursive Newton-Euler; Luh, Walker, Paul 1980). Its component along the axis is the
joint's torque; the other five load the bearings. All six are linear in the standard
parameters, w_j = Y_j(q, dq, ddq) theta, but only the torque is a function of the base
parameters: estimates with equal torques can bear different wrenches. How different is
answered by :func:`wrench_intervals`, over all feasible parameters at once. The paper's
supplementary material shows on a spatial 2R why that matters: parameters that reproduce
every torque can bear impossible loads. They come from the relaxed retrieval: torques
and no physics.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import pandas
from numpy.typing import ArrayLike
from scipy import optimize

from sdp_vs_penalty.estimators.estimator import Progress, no_progress
from sdp_vs_penalty.estimators.lmi_sdp import interior_point
from sdp_vs_penalty.estimators.penalty import Penalty
from sdp_vs_penalty.estimators.penalty_paper import PenaltyPaper
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.problem.published import published_links
from sdp_vs_penalty.regression.base_parameters import base_parameters
from sdp_vs_penalty.research.tables.study import Study
from sdp_vs_penalty.research.tables.table import Table, notes, register_table
from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.robot._pinocchio import pin
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.robot import Robot
from sdp_vs_penalty.solvers.extremes import Slice

#: Components of a wrench, and their units.
COMPONENTS = dict(fx="N", fy="N", fz="N", nx="N*m", ny="N*m", nz="N*m")


def wrench_regressor(
    robot: Robot, q: ArrayLike, dq: ArrayLike, ddq: ArrayLike
) -> Array:
    """Y with w_j = Y[:, j] theta, shape (N, n, 6, 10 n), for states of shape (N, n)."""
    q = np.ascontiguousarray(np.atleast_2d(q), float)
    dq = np.ascontiguousarray(np.atleast_2d(dq), float)
    ddq = np.ascontiguousarray(np.atleast_2d(ddq), float)
    model = robot._model
    data = model.createData()
    frames = [inertia.transform(j.link_frame) for j in robot.joints]
    out = np.zeros((len(q), robot.n, 6, robot.n, 10))
    for k in range(len(q)):
        pin.rnea(model, data, q[k], dq[k], ddq[k])
        for link in range(robot.n):
            own_wrench = (
                pin.bodyRegressor(data.v[link + 1], data.a_gf[link + 1]) @ frames[link]
            )
            joint = link
            down = np.eye(6)
            while joint >= 0:
                out[k, joint, :, link] = down @ own_wrench
                down = data.liMi[joint + 1].toDualActionMatrix() @ down
                joint = robot.joints[joint].parent
    return out.reshape(len(q), robot.n, 6, 10 * robot.n)


@dataclass(frozen=True)
class WrenchIntervals:
    """For M instants, n joints and six components, (M, n, 6) each [N, N m].

    lower, upper : attained by parameters with equal torques within the convex
    constraints; lower_bound, upper_bound : certified from the dual, no such parameters
    lie outside.
    """

    lower: Array
    upper: Array
    lower_bound: Array
    upper_bound: Array

    @property
    def slack(self) -> float:
        """Largest distance between attained and certified ends, relative to the widest
        interval."""
        widest = float((self.upper_bound - self.lower_bound).max())
        worst = float(
            np.maximum(
                self.lower - self.lower_bound, self.upper_bound - self.upper
            ).max()
        )
        return worst / widest if widest > 0.0 else 0.0


def wrench_intervals(
    feasible: Slice, regressor: Array, progress: Progress = no_progress
) -> WrenchIntervals:
    """The smallest and largest value of every wrench component, of regressor (M, n, 6,
    10 n), over the parameters of a slice (:class:`Slice` with the base parameters for
    equalities: equal torques).

    Two SDPs a component, each certified.
    """
    ends = np.empty((4, *regressor.shape[:3]))
    for index in np.ndindex(*regressor.shape[:3]):
        progress(f"wrench intervals: instant {index[0] + 1} of {len(regressor)}")
        lower = feasible.minimum(regressor[index])
        upper = feasible.maximum(regressor[index])
        ends[:, *index] = lower.value, upper.value, lower.bound, upper.bound
    return WrenchIntervals(*ends)


def unfeasible_retrievals(
    problem: Problem, pi: Array, count: int, boxed: bool
) -> Iterator[Array]:
    """Links (n, 10) of the first ``count`` relaxed retrievals that reproduce the base
    parameters pi (b,) to 1e-8 of the largest and are physically inconsistent.

    Non-linear least squares |pi(p) - pi|^2 in barycentric parameters p from random
    starts without triangle inequality or shape: what the paper's retrieval is without
    its conditional constraints. boxed : keep the box bounds of the problem's tables,
    which leave the 2R's c1x, c1z, c2y, c2z open; otherwise nothing is bounded. What is
    open starts within 1 kg, m or kg m^2 of zero.
    """
    base, _ = base_parameters(problem.model("rigid_body"), problem.independent)
    box = problem.box.reshape(-1, 2)
    size = float(np.abs(pi).max())
    n_found = 0
    free = np.tile([-1.0, 1.0], (len(box), 1))
    free[::10, 0] = -1.0 if boxed else 0.0  # masses
    known = np.isfinite(box) & (boxed | (np.arange(len(box)) % 10 == 0))[:, None]
    low, high = np.where(known, box, free).T

    def links_of(p: Array) -> Array:
        return inertia.standard_from_barycentric(p.reshape(-1, 10))

    for k in range(20 * count):
        end = optimize.least_squares(
            lambda p: (base @ links_of(p).ravel() - pi) / size,
            np.random.default_rng(k).uniform(low, high),
            bounds=(box[:, 0], box[:, 1]) if boxed else (-np.inf, np.inf),
            x_scale="jac",
            **dict.fromkeys(("xtol", "ftol", "gtol"), 1e-15),
            max_nfev=1000,
        )
        links = links_of(end.x)
        if (
            np.abs(end.fun).max() <= 1e-8
            and inertia.consistency_margin(links).min() < 0.0
        ):
            yield links
            n_found += 1
        if n_found == count:
            return


@dataclass(frozen=True)
class WrenchStudy:
    """Wrenches (M, n, 6) along the exciting trajectory at t (M,), and the intervals.

    feasible : of each method's estimate; penalty_runs : of the exact penalty from other
    starts; boxed, unbounded : of relaxed retrievals that reproduce the torques and are
    inconsistent, with and without the box bounds.
    """

    t: Array
    true: Array
    feasible: dict[str, Array]
    penalty_runs: list[Array]
    boxed: list[Array]
    unbounded: list[Array]
    intervals: WrenchIntervals


def wrench_study(study: Study) -> WrenchStudy:
    problem = study.problem
    x = study.experiment
    t = np.linspace(0.0, x.trajectory.duration, study.effort.instants + 2)[1:-1]
    Y = wrench_regressor(problem.robot, *x.trajectory.states(t))
    model = problem.model("rigid_body")
    links = x.links.ravel()
    bound = problem.parameter_bound(model)
    feasible = Slice(problem.constraints(model), study.base, links, bound)
    intervals = wrench_intervals(feasible, Y, study.progress)
    study.progress("relaxed retrievals")
    pi = study.base @ links
    count = study.effort.retrievals
    boxed = [
        Y @ retrieval.ravel()
        for retrieval in unfeasible_retrievals(problem, pi, count, True)
    ]
    unbounded = [
        Y @ retrieval.ravel()
        for retrieval in unfeasible_retrievals(problem, pi, count, False)
    ]
    estimates = {"published p_hat": published_links(problem, "p_hat")}
    estimates |= {
        k: study.links(m, study.simulated)
        for k, m in study.methods.items()
        if k != "ols"
    }
    named = {name: Y @ retrieval.ravel() for name, retrieval in estimates.items()}
    runs = [Y @ retrieval.ravel() for retrieval in penalty_links(study)]
    return WrenchStudy(t, Y @ links, named, runs, boxed, unbounded, intervals)


def penalty_links(study: Study) -> list[Array]:
    """Links (n, 10) that the exact penalty finds from scattered feasible starts, as
    many as the paper's runs, one run each.

    A start lies near the boundary of the feasible set, where a random linear function
    is least.
    """
    task = study.task(study.simulated)
    links_found = []
    p = len(task.bound)
    interior = interior_point(task, task.constraints)
    everywhere = Slice(task.constraints, np.zeros((0, p)), interior, task.bound)
    rng = np.random.default_rng(study.seed)
    estimator = Penalty(body=False, thickness=0.0, starts=1)
    for k in range(PenaltyPaper.runs):
        study.progress(f"penalty run {k + 1} of {PenaltyPaper.runs}")
        edge = everywhere.minimum(rng.normal(size=p) / task.bound).theta
        # How far towards the boundary such a start lies, from the interior point.
        start = everywhere.interior + 0.9 * (edge - everywhere.interior)
        links_found.append(
            estimator.fit(replace(task, nominal=start)).theta[task.links]
        )
    return links_found


@register_table("wrenches", "two_link")
def wrench_table(study: Study) -> Table:
    """How far internal wrenches differ between parameters that make the same torques.

    Rows: joint and component; largest true value, then largest deviations from it.
    """
    w = study.once(wrench_study)
    low = w.intervals.lower
    high = w.intervals.upper
    columns: dict[str, Array] = {
        "true": np.abs(w.true).max(axis=0),
        "interval_mean_width": (high - low).mean(axis=0),
        "interval_max_width": (high - low).max(axis=0),
        # How far feasible parameters of equal torque can be from the true wrench.
        "interval_deviation": np.maximum(high - w.true, w.true - low).max(axis=0),
    }
    columns |= {
        name: np.abs(value - w.true).max(axis=0) for name, value in w.feasible.items()
    }
    columns["spread_of_penalty_runs"] = np.ptp(w.penalty_runs, axis=0).max(axis=0)
    columns["spread_of_estimates"] = np.ptp(list(w.feasible.values()), axis=0).max(
        axis=0
    )
    for name, group in (
        ("unfeasible_in_box", w.boxed),
        ("unfeasible_unbounded", w.unbounded),
    ):
        if group:
            errors = [np.abs(x - w.true).max(axis=0) for x in group]
            columns[f"{name}_median"] = np.median(errors, axis=0)
            columns[f"{name}_max"] = np.max(errors, axis=0)
    of = [
        (j + 1, *component)
        for j in range(study.problem.robot.n)
        for component in COMPONENTS.items()
    ]
    rows = pandas.DataFrame(of, columns=["joint", "component", "unit"])
    groups = {"runs": w.penalty_runs, "boxed": w.boxed, "unbounded": w.unbounded}
    counts = {name: len(members) for name, members in groups.items()}
    return Table(
        f"Internal joint wrenches of {study.problem.title}",
        rows.assign(**{name: values.ravel() for name, values in columns.items()}),
        notes("wrenches", instants=len(w.t), slack=w.intervals.slack, **counts),
        digits=3,
    )
