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
from dataclasses import asdict, dataclass, fields, replace
from functools import partial

import numpy as np
import pandas
import scipy
from numpy.typing import ArrayLike

from sdp_vs_penalty.estimators.estimator import Progress, no_progress
from sdp_vs_penalty.estimators.lmi_sdp import interior_point
from sdp_vs_penalty.estimators.penalty import Penalty
from sdp_vs_penalty.estimators.penalty_paper import PenaltyPaper
from sdp_vs_penalty.paper.memo import load_or_compute, program_version, task_content
from sdp_vs_penalty.paper.tables.study import Study
from sdp_vs_penalty.paper.tables.table import StudyTable, notes, register_table
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.problem.published import published_links
from sdp_vs_penalty.regression.base_parameters import base_parameters
from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.robot._pinocchio import pin
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.robot import Robot
from sdp_vs_penalty.solvers.extremes import Slice

#: Components of a wrench, and their units.
COMPONENTS = {"fx": "N", "fy": "N", "fz": "N", "nx": "N*m", "ny": "N*m", "nz": "N*m"}


def wrench_regressor(
    robot: Robot, q: ArrayLike, dq: ArrayLike, ddq: ArrayLike
) -> Array:
    """Return the regressor Y of the joints' wrenches in the links' parameters, at
    positions q (N, n) [rad, m] and their derivatives dq and ddq.

    A link's wrench is that of its body regressor; every joint below it carries it too,
    so it is transformed from joint to joint down to the base.

    Returns
    -------
    (N, n, 6, 10 n) array
        w_j = Y[:, j] theta: force [N], then moment [N m].
    """
    q, dq, ddq = robot.tree_state(q, dq, ddq)
    n = robot.n
    model = robot._model
    data = model.createData()
    frames = [inertia.transform(j.link_frame) for j in robot.joints]
    regressor = np.zeros((len(q), n, 6, n, 10))
    for k in range(len(q)):
        # Computes velocities and accelerations of all bodies (Pinocchio counts from 1).
        pin.rnea(model, data, q[k], dq[k], ddq[k])
        for link in range(n):
            body = pin.bodyRegressor(data.v[link + 1], data.a_gf[link + 1])
            of_link = body @ frames[link]
            joint = link
            to_joint = np.eye(6)
            while joint >= 0:
                regressor[k, joint, :, link] = to_joint @ of_link
                to_joint = data.liMi[joint + 1].toDualActionMatrix() @ to_joint
                joint = robot.joints[joint].parent
    return regressor.reshape(len(q), n, 6, 10 * n)


@dataclass(frozen=True)
class WrenchIntervals:
    """Ranges of the wrenches of M instants, n joints and six components, (M, n, 6) each
    [N, N m]."""

    #: Smallest values, attained by parameters with equal torques within the convex
    #: constraints.
    lower: Array
    #: Largest values, attained likewise.
    upper: Array
    #: Bounds certified from the dual: no such parameters lie below.
    lower_bound: Array
    #: Bounds certified from the dual: no such parameters lie above.
    upper_bound: Array

    @property
    def slack(self) -> float:
        """Largest distance between attained and certified ends, over the widest
        interval.
        """
        widest = float((self.upper_bound - self.lower_bound).max())
        below = self.lower - self.lower_bound
        above = self.upper_bound - self.upper
        worst = float(np.maximum(below, above).max())
        return worst / widest if widest > 0.0 else 0.0


def wrench_intervals(
    feasible: Slice, regressor: Array, progress: Progress = no_progress
) -> WrenchIntervals:
    """Return the smallest and largest value of every wrench component, of regressor (M,
    n, 6, 10 n).

    The parameters may be any feasible ones that make the same torques. Two SDPs for
    each component and instant are solved and certified.

    Parameters
    ----------
    feasible : Slice
        Feasible parameters with equal torques.
    progress : callable
        Called with the instant that is computed.

    Returns
    -------
    WrenchIntervals
        Arrays (M, n, 6) [N, N m].
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
    """Yield links that make the right torques but cannot exist physically.

    They are local minima of |pi(p) - pi|^2 over barycentric parameters p from random
    starts, without the triangle inequality or shapes: the paper's retrieval without its
    conditional constraints.

    Parameters
    ----------
    pi : (b,) array
        Base parameters, reproduced to 1e-8 of the largest.
    count : int
        Largest number of links to yield; 20 times as many starts are tried.
    boxed : bool
        Whether to keep the box bounds of the problem's tables. What has no bounds
        starts within 1 kg, m or kg m^2 of zero.

    Yields
    ------
    (n, 10) array
        Standard parameters that are physically inconsistent.
    """
    base, _ = base_parameters(problem.model("rigid_body"), problem.independent)
    size = float(np.abs(pi).max())
    low, high = _start_box(problem, boxed)
    bounds: tuple[Array | float, Array | float] = (-np.inf, np.inf)
    if boxed:
        box = problem.box.reshape(-1, 2)
        bounds = (box[:, 0], box[:, 1])

    def residual(p: Array) -> Array:
        """Return the errors (b,) of the base parameters, relative to the largest one."""
        return (base @ _links(p).ravel() - pi) / size

    n_yielded = 0
    for seed in range(20 * count):
        end = scipy.optimize.least_squares(
            residual,
            np.random.default_rng(seed).uniform(low, high),
            bounds=bounds,
            x_scale="jac",
            xtol=1e-15,
            ftol=1e-15,
            gtol=1e-15,
            max_nfev=1000,
        )
        links = _links(end.x)
        reproduces = np.abs(end.fun).max() <= 1e-8
        if reproduces and inertia.consistency_margin(links).min() < 0.0:
            yield links
            n_yielded += 1
        if n_yielded == count:
            return


def _links(p: Array) -> Array:
    """Return links (n, 10) in standard parameters from barycentric ones (10 n,)."""
    return inertia.standard_from_barycentric(p.reshape(-1, 10))


def _start_box(problem: Problem, boxed: bool) -> tuple[Array, Array]:
    """Return the ends (10 n,) between which random starts are drawn.

    They are the bounds of masses, or with ``boxed`` all bounds; other parameters lie
    within 1 kg, m or kg m^2 of zero.
    """
    box = problem.box.reshape(-1, 2)
    is_mass = np.arange(len(box)) % 10 == 0
    free = np.tile([-1.0, 1.0], (len(box), 1))
    if not boxed:
        free[is_mass, 0] = 0.0
    is_bounded = np.isfinite(box) & (boxed | is_mass)[:, None]
    low, high = np.where(is_bounded, box, free).T
    return low, high


@dataclass(frozen=True)
class WrenchStudy:
    """Wrenches (M, n, 6) along the exciting trajectory, and the intervals [N, N m]."""

    #: (M,) instants [s].
    t: Array
    #: (M, n, 6) wrenches of the true links.
    true: Array
    #: Wrenches of each method's estimate, by its name.
    feasible: dict[str, Array]
    #: Wrenches of the exact penalty from other starts.
    penalty_runs: list[Array]
    #: Wrenches of relaxed retrievals that reproduce the torques and are inconsistent,
    #: with the box bounds.
    boxed: list[Array]
    #: The same without the box bounds.
    unbounded: list[Array]
    #: Ranges of the wrenches over all feasible parameters with equal torques.
    intervals: WrenchIntervals


def wrench_study(study: Study) -> WrenchStudy:
    """Return the internal wrenches (force and moment at each joint) of the 2R for true,
    feasible and unfeasible parameters, and certified intervals of all possible ones.

    All parameters make the same torques. What takes long is read from the disk if it
    was computed before.

    Returns
    -------
    WrenchStudy
        Wrenches (M, n, 6) [N, N m] at M instants, as many as the budget allows.
    """
    problem = study.problem
    x = study.experiment
    t = np.linspace(0.0, x.trajectory.duration, study.effort.instants + 2)[1:-1]
    Y = wrench_regressor(problem.robot, *x.trajectory.states(t))
    estimates = {"published p_hat": published_links(problem, "p_hat")}
    for name, method in study.methods.items():
        if name != "ols":
            estimates[name] = study.links(method, study.simulated)
    task = study.task(study.simulated)
    n_retrievals = study.effort.retrievals
    content = (program_version(), *task_content(task), x.links, Y, n_retrievals)
    held = load_or_compute("wrenches", content, partial(_wrench_arrays, study, Y))
    ends = (np.array(held[end.name]) for end in fields(WrenchIntervals))
    return WrenchStudy(
        t=t,
        true=Y @ x.links.ravel(),
        feasible={name: Y @ links.ravel() for name, links in estimates.items()},
        penalty_runs=[*map(np.array, held["penalty_runs"])],
        boxed=[*map(np.array, held["boxed"])],
        unbounded=[*map(np.array, held["unbounded"])],
        intervals=WrenchIntervals(*ends),
    )


def _wrench_arrays(study: Study, Y: Array) -> dict[str, Array]:
    """Compute the arrays of the wrench study, by name; they take long and are cached.

    They are the ends of the intervals (M, n, 6) of each wrench component [N, N m] at M
    instants, and the wrenches (k, M, n, 6) of the links that k penalty runs and k relaxed
    retrievals find. Y : (M, n, 6, 10 n) regressor of the wrenches.
    """
    problem = study.problem
    model = problem.model("rigid_body")
    links = study.experiment.links.ravel()
    bound = problem.parameter_bound(model)
    feasible = Slice(problem.constraints(model), study.base, links, bound)
    intervals = wrench_intervals(feasible, Y, study.progress)
    study.progress("relaxed retrievals")
    pi = study.base @ links
    count = study.effort.retrievals
    searches = {
        "boxed": unfeasible_retrievals(problem, pi, count, boxed=True),
        "unbounded": unfeasible_retrievals(problem, pi, count, boxed=False),
        "penalty_runs": penalty_links(study),
    }
    return asdict(intervals) | {
        name: np.array([Y @ links.ravel() for links in retrieved])
        for name, retrieved in searches.items()
    }


def penalty_links(study: Study) -> list[Array]:
    """Return links that the penalty method finds from scattered feasible starts.

    A start lies close to the boundary of the feasible set, 0.9 of the way from the
    interior point to where a random linear function has its minimum.

    Parameters
    ----------
    study : Study
        The robot's data sets and every method's estimate, computed on demand.

    Returns
    -------
    list of (n, 10) array
        One for each run; there are as many as in the paper.
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
def wrench_table(study: Study) -> StudyTable:
    """How far internal wrenches differ between parameters that make the same torques.

    Rows: joint and component; largest true value, then largest deviations from it.
    """
    w = study.once(wrench_study)
    components = [
        (joint + 1, *component)
        for joint in range(study.problem.robot.n)
        for component in COMPONENTS.items()
    ]
    rows = pandas.DataFrame(components, columns=["joint", "component", "unit"])
    for name, values in _columns(w).items():
        rows[name] = values.ravel()
    table_notes = notes(
        "wrenches",
        instants=len(w.t),
        slack=w.intervals.slack,
        runs=len(w.penalty_runs),
        boxed=len(w.boxed),
        unbounded=len(w.unbounded),
    )
    title = f"Internal joint wrenches of {study.problem.title}"
    return StudyTable(title, rows, table_notes, digits=3)


def _columns(w: WrenchStudy) -> dict[str, Array]:
    """Return the columns of the table, (n, 6) each [N, N m].

    They are the largest values over the instants, or the mean if the name says so.
    """
    low = w.intervals.lower
    high = w.intervals.upper
    width = high - low
    columns: dict[str, Array] = {
        "true": np.abs(w.true).max(axis=0),
        "interval_mean_width": width.mean(axis=0),
        "interval_max_width": width.max(axis=0),
        # How far feasible parameters of equal torque can be from the true wrench.
        "interval_deviation": np.maximum(high - w.true, w.true - low).max(axis=0),
    }
    for name, wrenches in w.feasible.items():
        columns[name] = _largest_error(wrenches, w.true)
    estimates = list(w.feasible.values())
    columns["spread_of_penalty_runs"] = np.ptp(w.penalty_runs, axis=0).max(axis=0)
    columns["spread_of_estimates"] = np.ptp(estimates, axis=0).max(axis=0)
    groups = {"unfeasible_in_box": w.boxed, "unfeasible_unbounded": w.unbounded}
    for name, group in groups.items():
        if group:
            errors = [_largest_error(wrenches, w.true) for wrenches in group]
            columns[f"{name}_median"] = np.median(errors, axis=0)
            columns[f"{name}_max"] = np.max(errors, axis=0)
    return columns


def _largest_error(wrenches: Array, true: Array) -> Array:
    """Return the largest deviation over the instants, (n, 6), of wrenches (M, n, 6)."""
    return np.abs(wrenches - true).max(axis=0)
