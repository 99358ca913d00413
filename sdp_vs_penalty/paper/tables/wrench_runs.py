"""What the wrench table and Figure 10 share: wrenches of real, feasible and unfeasible parameters."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from sdp_vs_penalty.estimators.lmi_sdp import interior_point
from sdp_vs_penalty.estimators.penalty import Penalty
from sdp_vs_penalty.paper.relaxed_retrieval import Retrieval, unfeasible_retrievals
from sdp_vs_penalty.paper.tables.study import METHODS, Study
from sdp_vs_penalty.paper.wrenches import (
    WrenchIntervals,
    equal_torques,
    joint_wrenches,
    wrench_intervals,
)
from sdp_vs_penalty.problem.published import published_links
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.solvers.extremes import Slice

#: Instants of the intervals, and relaxed retrievals of each kind.
INSTANTS = {"quick": 81, "paper": 201}
RETRIEVALS = {"quick": 10, "paper": 50}
#: Starts of the penalty method whose wrenches are compared: as many as the paper's runs.
PENALTY_RUNS = 10
#: How far towards the boundary such a start lies, from the interior point.
_TOWARDS = 0.9


@dataclass(frozen=True)
class WrenchStudy:
    """Along the exciting trajectory at t (M,): true and other wrenches (M, n, 6), and the intervals.

    feasible : of each method's estimate; penalty_runs : of the exact penalty from other starts;
    boxed, unbounded : relaxed retrievals that reproduce the torques and are inconsistent, with and
    without the box bounds.
    """

    t: Array
    q: Array
    dq: Array
    ddq: Array
    true: Array
    feasible: dict[str, Array]
    penalty_runs: tuple[Array, ...]
    boxed: tuple[Retrieval, ...]
    unbounded: tuple[Retrieval, ...]
    intervals: WrenchIntervals

    def wrenches(self, study: Study, links: Array) -> Array:
        return joint_wrenches(study.problem.robot, links, self.q, self.dq, self.ddq)


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
    for name, method in METHODS.items():
        if name != "ols":
            estimates[name] = study.links(method, study.simulated)
    return WrenchStudy(
        t,
        *states,
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
        start = everywhere.interior + _TOWARDS * (edge - everywhere.interior)
        found.append(estimator.fit(replace(task, nominal=start)).theta[task.links])
    return found
