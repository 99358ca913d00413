"""Table "global": the published penalised objective's global optimum over its weight,
certified."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import pandas

from sdp_vs_penalty.estimators.estimator import Task
from sdp_vs_penalty.estimators.penalty_paper import PenalisedLoss, PenaltyPaper
from sdp_vs_penalty.paper.annealing import (
    SearchedPoint,
    SearchPlan,
    point_fields,
    search_runs,
)
from sdp_vs_penalty.paper.memo import remembered, source_version, task_content
from sdp_vs_penalty.paper.penalised_box import BoxedOptimum, BoxedProblem
from sdp_vs_penalty.paper.penalised_optimum import (
    PenalisedOptimum,
    PenalisedProblem,
    cvxpy_optima,
)
from sdp_vs_penalty.paper.tables.study import QUICK, Study
from sdp_vs_penalty.paper.tables.table import Row, Table, notes, register_table
from sdp_vs_penalty.robot.arrays import Array

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


@dataclass(frozen=True)
class Certified:
    """What a problem is at every weight."""

    #: Name of the problem, in words.
    label: str
    #: Whether the loss is the distance from the base parameters (two steps).
    two_step: bool
    #: Rows of the loss, all joints together.
    rows: int
    #: Weights xi, increasing.
    weights: tuple[float, ...]
    #: Loss of the best consistent parameters.
    feasible_loss: float
    #: Weight from which the penalty is exact, by the largest multiplier.
    exact_by_theory: float
    #: The same weight, by bisection.
    exact_by_bisection: float
    #: The published problem's optimum: inside its box on barycentric inertias.
    boxed: list[BoxedOptimum]
    #: The optimum without that box.
    free: list[PenalisedOptimum]
    #: The same by CVXPY and Clarabel; NaN without them.
    cvxpy: Array

    @property
    def name(self) -> str:
        """The kind of problem, "one-step" or "two-step"."""
        return "two-step" if self.two_step else "one-step"

    def excess_percent(self, optimum: PenalisedOptimum) -> float:
        """Return by how much an optimum's loss exceeds that of the feasible optimum.

        Parameters
        ----------
        optimum : PenalisedOptimum
            An optimum of this problem.

        Returns
        -------
        float
            [%]; 0 if the feasible optimum's loss is rounding.
        """
        if is_rounding(self.feasible_loss):
            return 0.0
        return 100.0 * (optimum.loss / self.feasible_loss - 1.0)


@register_table("global", slow=True)
def global_optima(study: Study) -> Table:
    """Global optimum of the published penalised objective over its weight, certified."""
    searched = study.once(penalised_optima)
    rows = [row for problem in searched for row in _rows(problem)]
    exact = [
        f"{x.label}, {x.name} ({x.rows} rows): {x.exact_by_theory:.5g} by the largest"
        f" multiplier, {x.exact_by_bisection:.5g} by bisection"
        for x in searched
    ]
    return Table(
        f"Global optimum of the published penalised objective, {study.problem.title}",
        rows,
        notes("global", exact="; ".join(exact)),
        _headline(searched),
        digits=5,
    )


def penalised_optima(study: Study) -> list[Certified]:
    """Return certified optima of the one-step and two-step problem of each data set."""
    items = [
        (data.label, study.task(data), two_step)
        for data in study.whole
        for two_step in (False, True)
    ]
    study.progress("the penalised objective's global optima")
    return list(study.workers.map(_certified, items))


def _certified(item: tuple[str, Task, bool]) -> Certified:
    """Compute everything certified about one problem: optima with and without the box,
    weights from which the penalty is exact, CVXPY's optima.

    A worker process calls this; what takes long is read from the disk if it was
    computed before.
    """
    label, task, two_step = item
    problem = PenalisedProblem(task, two_step)
    weights = weights_of(problem)
    content = (source_version(), *task_content(task), two_step, weights)
    by_cvxpy = remembered("cvxpy", content, partial(_by_cvxpy, problem, weights))
    return Certified(
        label=label,
        two_step=two_step,
        rows=problem.data.rows,
        weights=weights,
        feasible_loss=problem.feasible.upper,
        exact_by_theory=problem.exact_weight_by_theory,
        exact_by_bisection=problem.exact_weight_by_bisection(),
        boxed=BoxedProblem(problem).branch_all(weights, GAP, MOST_CELLS),
        free=problem.solve_all(weights),
        cvxpy=np.array(by_cvxpy),
    )


def weights_of(problem: PenalisedProblem) -> tuple[float, ...]:
    """Return the weights of the table, and those about the least exact one, to three
    digits, where it is more than rounding."""
    exact = problem.exact_weight_by_theory
    shares = NEAR_EXACT if exact > 1e-3 else ()
    near = {float(f"{share * exact:.3g}") for share in shares}
    return tuple(sorted({*WEIGHTS, *near}))


def _by_cvxpy(problem: PenalisedProblem, weights: Sequence[float]) -> list[float]:
    """Return the relaxation's optimum at each weight by CVXPY, NaN if there is none."""
    optima = cvxpy_optima(problem, weights)
    return [optima.get(weight, np.nan) for weight in weights]


def search_table(study: Study) -> pandas.DataFrame:
    """Return where every run of annealing, and of the local search alone, ends.

    With the budget "single" only the last data set (the real run, where it is at hand)
    is searched long.

    Returns
    -------
    DataFrame
        One row for each run and weight, with how far it ends above the certified bound
        inside the box [%].
    """
    rows = list[Row]()
    for data in study.whole:
        is_short = study.budget == "single" and data is not study.whole[-1]
        effort = QUICK if is_short else study.effort
        annealing = SearchPlan(effort.global_runs, effort.global_evaluations)
        task = study.task(data)
        items = [
            (PenalisedProblem(task, two_step).published, task.seed, ANNEALED, plan)
            for two_step in (False, True)
            for plan in (annealing, replace(annealing, annealing=False))
        ]
        study.progress(f"searches, {data.label}")
        names = [name for name in ("one-step", "two-step") for _ in range(2)]
        found = study.workers.map(_runs_of, items)
        lowest_of = {
            (x.name, xi): boxed.lower
            for x in study.once(penalised_optima)
            if x.label == data.label
            for xi, boxed in zip(x.weights, x.boxed, strict=True)
        }
        rows += [
            {
                "data": data.label,
                "problem": name,
                **point_fields(point),
                "above_bound_percent": _above(
                    point.objective, lowest_of[name, point.xi]
                ),
            }
            for name, points in zip(names, found, strict=True)
            for point in points
        ]
    return pandas.DataFrame(rows)


def _runs_of(
    item: tuple[PenalisedLoss, int, Sequence[float], SearchPlan],
) -> list[SearchedPoint]:
    """Search in a worker process, which takes a single argument."""
    return search_runs(*item)


def _rows(problem: Certified) -> list[Row]:
    """Return the table's rows of one problem, one for each weight xi of the penalty.

    A row has the certified optimum of the published problem, with its box on inertias,
    then that without it ("free_...").
    """
    rows = []
    for k, (weight, free, boxed) in enumerate(
        zip(problem.weights, problem.free, problem.boxed, strict=True)
    ):
        best = boxed.best
        rows.append(
            {
                "data": problem.label,
                "problem": problem.name,
                "xi": weight,
                "optimum": best and best.value,
                "lower_bound": boxed.lower,
                "gap": boxed.gap,
                "cells": boxed.n_cells,
                "excess_loss_percent": best and problem.excess_percent(best),
                "links_violated": best and best.n_links_violated,
                "worst_violation": best and best.worst,
                "free_optimum": free.value,
                "free_lower_bound": free.lower,
                "free_gap": free.gap,
                "free_cvxpy": problem.cvxpy[k],
                "free_excess_loss_percent": problem.excess_percent(free),
                "free_links_violated": free.n_links_violated,
            }
        )
    return rows


def _above(value: float | None, lower: float) -> float | None:
    """Return how far a value lies above a lower bound [%]; None if the bound is
    zero.
    """
    if value is None or is_rounding(lower):
        return None
    return 100.0 * (value / lower - 1.0)


def _headline(searched: Sequence[Certified]) -> str:
    """Return the headline: at the paper's largest weight, for each problem, by how much
    the penalised optimum's loss exceeds the feasible optimum's, and how many links
    cannot exist."""
    sentences = []
    largest = max(PenaltyPaper.weights)
    for problem in searched:
        place = problem.weights.index(largest)
        boxed, free = problem.boxed[place].best, problem.free[place]
        assert boxed is not None
        sentences.append(
            f"{problem.label}, {problem.name} ({problem.rows} rows)"
            f" {problem.excess_percent(boxed):.3f} %, {boxed.n_links_violated} links;"
            f" without the box {problem.excess_percent(free):.3f} %,"
            f" {free.n_links_violated} links"
        )
    return (
        f"At the paper's largest weight, {largest:g}, the optimum's loss against the"
        f" feasible optimum's, and links that cannot exist: {'; '.join(sentences)}."
    )
