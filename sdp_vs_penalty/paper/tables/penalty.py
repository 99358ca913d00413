"""Tables "global", "xi", "p_hat" and "opponent": the published penalised objective beside
its certified global optimum.

"global": over the penalty's weight. "xi": from which weight on the penalty is exact, by what
the loss counts: the weight stands beside a sum over rows. "p_hat": how far the published
links lie above the optimum of the authors' own objective,

    phi(theta) = sum_k (pi_k(theta) - target_k)^2

over the 41 coefficients that their retrieval keeps, with the targets of their public program
(problems/panda/published/two_step_targets.csv). "opponent": the two-step method as published,
and at its best: the published weights jump from 0 to 10, where the penalty is exact from a
tenth on, and a loose search ends on the way down; both can be mended without another method.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial

import numpy as np
import pandas

from sdp_vs_penalty.estimators.estimator import Task, make_task
from sdp_vs_penalty.estimators.penalty_paper import (
    AS_PUBLISHED,
    EVALUATIONS_A_PARAMETER,
    PenalisedLoss,
    PenaltyPaper,
    Stopping,
    random_numbers_of_step,
    start_of_run,
)
from sdp_vs_penalty.paper.memo import anneal_once, search_locally_once
from sdp_vs_penalty.paper.penalised_box import BoxedProblem
from sdp_vs_penalty.paper.penalised_optimum import PenalisedOptimum, PenalisedProblem
from sdp_vs_penalty.paper.tables.study import Data, Study, worst_violations
from sdp_vs_penalty.paper.tables.table import Row, StudyTable, notes, register_table
from sdp_vs_penalty.problem.load import with_bounds
from sdp_vs_penalty.regression.regression import LeastSquares
from sdp_vs_penalty.robot.arrays import Array


@dataclass(frozen=True)
class SearchPlan:
    """How the published search is repeated."""

    #: Independent runs.
    runs: int
    #: Evaluations of the loss at every weight; None: as the authors' program allows.
    evaluations: int | None
    #: Whether annealing goes before the local search.
    annealing: bool = True
    #: When a local search without annealing ends.
    stopping: Stopping = AS_PUBLISHED


@dataclass(frozen=True)
class SearchedPoint:
    """Where a run stands after a weight."""

    #: "annealing" or "local search".
    search: str
    #: Number of the run, from 1.
    run: int
    #: Weight of the penalty.
    xi: float
    #: Evaluations of the loss at this weight.
    evaluations: int
    #: Penalised objective.
    objective: float
    #: Loss without the penalty.
    loss: float
    #: Largest violation of all external demands [kg m^2, kg, m].
    worst_violation: float


def search_runs(
    loss: PenalisedLoss, seed: int, weights: Sequence[float], plan: SearchPlan
) -> list[SearchedPoint]:
    """Run the published search several times, over increasing weights of the penalty.

    Every weight continues from the point of the last one; the first one starts at a
    random point of the box. Every step is cached on the disk.

    Parameters
    ----------
    seed : int
        Seed of starts and annealing.
    weights : sequence of float
        xi of each step, in this order.
    plan : SearchPlan
        Number and length of the runs.

    Returns
    -------
    list of SearchedPoint
        The point after each weight, run by run.
    """
    points = list[SearchedPoint]()
    for number in range(plan.runs):
        u = start_of_run(seed, number, len(loss.free))
        for step, weight in enumerate(weights):
            budget = plan.evaluations or EVALUATIONS_A_PARAMETER * len(u)
            if plan.annealing:
                rng = random_numbers_of_step(seed, number, step)
                u, spent = anneal_once(loss, weight, u, budget, rng)
            else:
                u, spent = search_locally_once(loss, weight, u, budget, plan.stopping)
            points.append(
                SearchedPoint(
                    search="annealing" if plan.annealing else "local search",
                    run=number + 1,
                    xi=weight,
                    evaluations=spent,
                    objective=loss.value(u, weight),
                    loss=loss.value(u, 0.0),
                    worst_violation=max(loss.violations(loss.p(u)).values()),
                )
            )
    return points


#: The paper's weights, smaller ones, and larger ones until every penalty is exact.
WEIGHTS = (0.0, 0.1, 10.0, 20.0, 30.0, 40.0, 100.0, 300.0, 1000.0)
#: Those at which annealing is run: as published, and then on.
ANNEALED = (*PenaltyPaper.weights, 100.0, 1000.0)
#: Branch and bound ends at this gap, or after so many relaxations.
GAP = 1e-5
MOST_CELLS = 40
#: Further weights, in units of the least exact one, where the optimum becomes consistent.
NEAR_EXACT = (0.5, 0.8, 0.95, 1.01, 1.1)


def is_rounding(loss: float) -> bool:
    """Tell whether a loss is zero up to rounding, so that ratios to it mean nothing.

    Parameters
    ----------
    loss : float
        A loss in its units.
    """
    return loss <= 1e-12


@register_table("global", slow=True)
def global_optima(study: Study) -> StudyTable:
    """Global optimum of the published penalised objective over its weight, certified."""
    items = [
        (data.label, study.task(data), two_step)
        for data in study.whole
        for two_step in (False, True)
    ]
    study.progress("the penalised objective's global optima")
    problems = list(study.workers.map(_rows, items))
    exact = [f"{_title(rows[0])}: {rows[0]['exact_weight']:.5g}" for rows in problems]
    return StudyTable(
        f"Global optimum of the published penalised objective, {study.problem.title}",
        [row for rows in problems for row in rows],
        notes("global", exact="; ".join(exact)),
        digits=5,
    )


def _title(row: Row) -> str:
    """Return what a row's problem is, in words."""
    return f"{row['data']}, {row['problem']} ({row['rows']} rows)"


def _rows(item: tuple[str, Task, bool]) -> list[Row]:
    """Return the table's rows of one problem, one for each weight xi of the penalty.

    A row has the certified optimum of the published problem, with its box on inertias,
    then that without it ("free_..."). A worker process calls this; solves are kept on
    the disk.
    """
    label, task, two_step = item
    problem = PenalisedProblem(task, two_step)
    box = BoxedProblem(problem)
    exact = problem.exact_weight_by_theory
    # And those about the least exact one where it is more than rounding.
    shares = NEAR_EXACT if exact > 1e-3 else ()
    near = {float(f"{share * exact:.3g}") for share in shares}
    weights = sorted({*WEIGHTS, *near})
    inside = problem.solve_all(
        weights, lambda weight: box.branch_and_bound(weight, GAP, MOST_CELLS)
    )
    best = problem.feasible.upper

    def excess_percent(found: PenalisedOptimum) -> float:
        """Loss above that of the best consistent parameters [%]."""
        return 0.0 if is_rounding(best) else 100.0 * (found.loss / best - 1.0)

    return [
        {
            "data": label,
            "problem": "two-step" if two_step else "one-step",
            "rows": problem.data.rows,
            "xi": weight,
            "optimum": boxed.value,
            "lower_bound": boxed.lower,
            "gap": boxed.gap,
            "cells": boxed.n_cells,
            "excess_loss_percent": excess_percent(boxed),
            "links_violated": boxed.n_links_violated,
            "worst_violation": boxed.worst,
            "free_optimum": free.value,
            "free_lower_bound": free.lower,
            "free_gap": free.gap,
            "free_excess_loss_percent": excess_percent(free),
            "free_links_violated": free.n_links_violated,
            "free_worst_violation": free.worst,
            "feasible_loss": best,
            "exact_weight": exact,
        }
        for weight, boxed, free in zip(
            weights, inside, problem.solve_all(weights), strict=True
        )
    ]


def search_table(study: Study, optima: pandas.DataFrame) -> pandas.DataFrame:
    """Return where every run of annealing, and of the local search alone, ends on the last
    data set: the real run, where it is at hand.

    Parameters
    ----------
    optima : DataFrame
        The table of global optima.

    Returns
    -------
    DataFrame
        One row for each run and weight, with how far it ends above the certified bound
        inside the box [%].
    """
    bounds = optima.set_index(["data", "problem", "xi"])["lower_bound"]
    data = study.whole[-1]
    task = study.task(data)
    annealing = SearchPlan(study.effort.annealing_runs, study.effort.evaluations)
    plans = [
        (name, plan)
        for name in ("one-step", "two-step")
        for plan in (annealing, replace(annealing, annealing=False))
    ]
    study.progress(f"searches, {data.label}")
    rows = list[Row]()
    points_of_plans = study.workers.map(partial(_runs_of, task), plans)
    for (name, _), points in zip(plans, points_of_plans, strict=True):
        for point in points:
            lower = bounds[data.label, name, point.xi]
            above = None
            if not is_rounding(lower):
                above = 100.0 * (point.objective / lower - 1.0)
            about = {"data": data.label, "problem": name}
            rows.append(about | asdict(point) | {"above_bound_percent": above})
    return pandas.DataFrame(rows)


def _runs_of(
    task: Task, problem_and_plan: tuple[str, SearchPlan]
) -> list[SearchedPoint]:
    """Run a plan on one of the published problems, "one-step" or "two-step"."""
    name, plan = problem_and_plan
    loss = PenalisedProblem(task, name == "two-step").published
    return search_runs(loss, task.seed, ANNEALED, plan)


#: What the loss sums over: weights of the joints, and whether every sample of the log
#: counts or only the decimated rows. Between the rows nothing is lost behind the
#: low-pass, so that a sum over samples is that over rows times samples a row.
COUNTED = (("noise", False), ("none", False), ("none", True))


@register_table("xi", "panda", slow=True)
def exact_weights(study: Study) -> StudyTable:
    """Weight table: from which xi the one-step penalty is exact, by rows and joint
    weights.
    """
    data = study.whole[-1]
    rows = [_row_of_sum(study, data, *counted) for counted in COUNTED]
    return StudyTable(
        f"Least exact weight of the published one-step penalty, {study.problem.title}",
        rows,
        notes("xi", largest=max(PenaltyPaper.weights)),
        digits=4,
    )


def _row_of_sum(study: Study, data: Data, weighting: str, samples: bool) -> Row:
    """Return the row of one loss: the least exact weight, and the certified optimum at
    the largest published weight with the box on inertias and without it."""
    task = make_task(
        study.problem, data.model, data.regression, weighting, seed=study.seed
    )
    if samples:
        # Every row of the task stands for several samples: its square counts so often.
        decimated = task.data
        rows = len(data.train.t) * data.regression.joints
        factor = np.sqrt(rows / decimated.rows)
        counted = replace(
            decimated,
            R=factor * decimated.R,
            rho=factor * decimated.rho,
            residual_norm=factor * decimated.residual_norm,
            tau_squared=factor**2 * decimated.tau_squared,
            rows=rows,
        )
        task = replace(task, data=counted)
    problem = PenalisedProblem(task, two_step=False)
    weight = max(PenaltyPaper.weights)
    boxed = BoxedProblem(problem).branch_and_bound(weight, GAP, MOST_CELLS)
    free = problem.solve(weight)
    base = problem.feasible.upper
    return {
        "data": data.label,
        "rows": task.data.rows,
        "joint_weights": "by residuals" if weighting == "noise" else "alike",
        "exact_weight": problem.exact_weight_by_theory,
        "boxed_excess_percent": 100.0 * (boxed.loss / base - 1.0),
        "boxed_links_violated": boxed.n_links_violated,
        "boxed_gap": boxed.gap,
        "free_excess_percent": 100.0 * (free.loss / base - 1.0),
        "free_links_violated": free.n_links_violated,
        "free_gap": free.gap,
    }


#: The authors' program has this bound on c5z where their Table VIII has -.05 (erratum 7).
THEIR_BOUNDS = "c5z=-0.35:0.05"
#: Weight of the penalty inside the box, in units of the least exact one.
WEIGHT = 2.0
#: Branch and bound for it ends at this gap, or after so many relaxations.
RETRIEVAL_GAP, RETRIEVAL_CELLS = 1e-6, 3


@dataclass(frozen=True)
class Retrieval:
    """The authors' own two-step objective, what they published, and its optima."""

    #: Rows |R theta - rho|^2 of the kept coefficients.
    distance: LeastSquares
    #: (r, k) torque rows by the kept coefficients, of a run, unweighted [SI].
    torque: Array
    #: Torque samples behind them, all joints.
    n_samples: int
    #: (10 n,) the published links.
    p_hat: Array
    #: Task with the published bounds.
    task: Task
    #: Certified optimum inside them.
    best: PenalisedOptimum
    #: Task with the bound on c5z of the authors' program.
    their_task: Task
    #: Certified optimum inside these.
    wider: PenalisedOptimum

    def residual(self, theta: Array) -> Array:
        """Return pi(theta) - target (k,) of the kept coefficients."""
        return self.distance.R @ theta - self.distance.rho


@register_table("p_hat", "panda")
def retrieved(study: Study) -> StudyTable:
    """p_hat table: the published links against the certified optimum of their own
    objective.
    """
    result = study.once(retrieval)
    row_of = partial(_row_of_links, result)
    rows = [
        row_of("p_hat (published links)", result.p_hat, result.task),
        row_of("certified optimum, bounds as published", result.best.theta, result.task)
        | {"lower_bound": result.best.lower, "gap": result.best.gap},
        row_of(
            "certified optimum, c5z > -0.35 m", result.wider.theta, result.their_task
        )
        | {"lower_bound": result.wider.lower, "gap": result.wider.gap},
    ]
    for row in rows:
        row["data"] = f"published; torque along the {study.whole[-1].label} run"
    return StudyTable(
        "The published links and the optimum of the authors' own objective",
        rows,
        notes("p_hat", n=len(result.distance.rho)),
        caption=(
            "Targets, p_hat: published (erratum 1 corrected). Optima:"
            " computed. Torque: along the authors' run where it is at hand."
        ),
    )


def retrieval(study: Study) -> Retrieval:
    """Return the published links and the certified optima of the authors' two-step
    objective, the squared distance of the base parameters B theta from their targets.

    It is about the links alone, without friction. One optimum is within the bounds as
    published, the other within those of the authors' program.
    """
    data = replace(study.whole[-1], model=study.problem.model("rigid_body"))
    task = study.task(data)
    cells = study.problem.published["two_step_targets"]
    in_objective = np.array([int(row["row"]) - 1 for row in cells])
    target = np.array([float(row["target"]) for row in cells])
    distance = LeastSquares(
        study.base[in_objective],
        rho=target,
        residual_norm=0.0,
        tau_squared=float(target @ target),
        rows=len(target),
    )
    rows = data.regression.least_squares()
    # Y theta = Y_base B theta, B with independent rows.
    torque_by_base = rows.R @ np.linalg.pinv(study.base)
    authors_problem = with_bounds(study.problem, THEIR_BOUNDS)
    their_task = make_task(authors_problem, data.model, data.regression)
    return Retrieval(
        distance,
        torque=torque_by_base[:, in_objective],
        n_samples=rows.rows,
        p_hat=study.published_links["p_hat"].ravel(),
        task=task,
        best=optimum_inside_box(task, distance),
        their_task=their_task,
        wider=optimum_inside_box(their_task, distance),
    )


def optimum_inside_box(task: Task, distance: LeastSquares) -> PenalisedOptimum:
    """Return the least distance over consistent links inside all published bounds.

    The bound is that without the box, or of the relaxation inside it, whichever is
    higher: an optimum with fewer demands, or with a penalty, is never above. The point
    is one inside the box that violates nothing.

    Parameters
    ----------
    task : Task
        Constraints, bounds and the box on barycentric inertias.
    """
    problem = PenalisedProblem(task, two_step=True, target=distance)
    box = BoxedProblem(problem)
    exact = problem.exact_weight_by_theory
    # A point of a smaller weight counts at a larger one: the relaxation's are better there.
    *_, found = problem.solve_all(
        [share * exact for share in (*NEAR_EXACT, WEIGHT)],
        lambda weight: box.branch_and_bound(weight, RETRIEVAL_GAP, RETRIEVAL_CELLS),
    )
    assert not found.is_violated
    return replace(found, lower=max(found.lower, problem.feasible.lower))


def _row_of_links(found: Retrieval, name: str, theta: Array, task: Task) -> Row:
    """Return the row of some links: the objective, what it means, and violations of the
    demands of a task."""
    residual = found.residual(theta)
    phi = float(residual @ residual)
    # Torque that the coefficients' errors make, RMS over samples and joints [N m].
    torque = np.linalg.norm(found.torque @ residual) / np.sqrt(found.n_samples)
    return {
        "links": name,
        "phi": phi,
        "above_optimum_percent": 100.0 * (phi / found.best.value - 1.0),
        "rms_coefficient": float(np.sqrt(np.mean(residual**2))),
        "rms_torque": float(torque),
        "worst_violation": worst_violations(task, theta)[0],
        "lower_bound": None,
        "gap": None,
    }


#: Weights without the jump, up to the largest published one.
GENTLE = (0.0, 0.01, 0.1, 1.0, 40.0)
Weights = tuple[float, ...]
#: SLSQP until it no longer helps.
TO_THE_END = Stopping(tolerance=1e-12, gain=1e-5, restarts=6, steps=400)
#: Independent runs of each search, of annealing where it is as long as the authors'.
RUNS = 9
#: A run that ends within this of the certified optimum has found it [%].
FOUND = 0.1


@register_table("opponent", "panda", slow=True)
def opponents(study: Study) -> StudyTable:
    """Opponent table: the published two-step penalty by four searches, certified."""
    data = study.whole[-1]
    task = study.task(data)
    problem = PenalisedProblem(task, two_step=True)
    optimum = optimum_inside_box(task, problem.data)
    effort = study.effort
    loose = SearchPlan(RUNS, None, annealing=False)
    tight = SearchPlan(RUNS, None, annealing=False, stopping=TO_THE_END)
    published = PenaltyPaper.weights
    # None: each run is as long as the authors allow, and there are as many as theirs.
    runs = RUNS if effort.evaluations is None else effort.annealing_runs
    annealing = SearchPlan(runs, effort.evaluations)
    tried = [
        ("annealing, then local search: as published", published, annealing),
        ("local search alone, as published", published, loose),
        ("local search to the end", published, tight),
        ("local search to the end, without the jump", GENTLE, tight),
    ]
    rows = list(
        study.workers.map(partial(_row_of_search, problem, optimum.lower), tried)
    )
    for row in rows:
        row["data"] = data.label
    return StudyTable(
        f"The published two-step penalty by four searches, {study.problem.title}",
        rows,
        notes(
            "opponent",
            optimum=f"{optimum.value:.5g}",
            gap=f"{optimum.gap:.1g}",
            found=FOUND,
            links=len(problem.published.free),
        ),
        digits=3,
    )


def _row_of_search(
    problem: PenalisedProblem, lower: float, tried: tuple[str, Weights, SearchPlan]
) -> Row:
    """Return where the runs of a search end, above the certified bound [%]; the search
    has a name, the weights xi one after the other, and a plan."""
    name, weights, plan = tried
    points = search_runs(problem.published, problem.task.seed, weights, plan)
    last = [point for point in points if point.xi == weights[-1]]
    above = [100.0 * (point.objective / lower - 1.0) for point in last]
    spent = [
        sum(point.evaluations for point in points if point.run == end.run)
        for end in last
    ]
    return {
        "search": name,
        "weights": " ".join(f"{weight:g}" for weight in weights),
        "runs": len(last),
        "above_percent_best": float(np.min(above)),
        "above_percent_median": float(np.median(above)),
        "above_percent_worst": float(np.max(above)),
        "runs_that_found_it": int(np.sum(np.array(above) <= FOUND)),
        "evaluations_median": float(np.median(spent)),
        "worst_violation": max(point.worst_violation for point in last),
    }
