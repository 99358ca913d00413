"""Table "global": the published penalised objective's global optimum over its weight,
certified."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from sdp_vs_penalty.estimators.estimator import Task
from sdp_vs_penalty.estimators.penalty_paper import (
    PenaltyPaper,
    anneal_and_search,
    search_locally,
)
from sdp_vs_penalty.research.penalised_box import BoxedOptimum, BoxedProblem
from sdp_vs_penalty.research.penalised_optimum import (
    PenalisedOptimum,
    PenalisedProblem,
    cvxpy_optima,
)
from sdp_vs_penalty.research.tables.study import Study
from sdp_vs_penalty.research.tables.table import Row, Table, notes, register_table
from sdp_vs_penalty.robot.arrays import Array


@dataclass(frozen=True)
class Searches:
    """How many independent runs of annealing, and of the local search alone; branch and
    bound ends at a gap, or after so many relaxations."""

    #: The paper's weights, smaller ones, and larger ones until every penalty is exact;
    #: and those at which annealing is run, as published and then on.
    weights: ClassVar = (0.0, 0.1, 10.0, 20.0, 30.0, 40.0, 100.0, 300.0, 1000.0)
    annealed: ClassVar = (*PenaltyPaper.weights, 100.0, 1000.0)

    annealing_runs: int
    local_runs: int
    gap: float = 1e-3
    most_cells: int = 40

    @classmethod
    def of(cls, budget: str) -> "Searches":
        """Those of a budget."""
        return cls(10, 10) if budget == "paper" else cls(3, 2)


def is_rounding(loss: float) -> bool:
    """Whether a loss is too small for shares of it to mean anything."""
    return loss <= 1e-12


@dataclass(frozen=True)
class Searched:
    """What a problem is at every weight.

    free : the optimum without the box on inertias; boxed : with it; cvxpy : the former
    by CVXPY and Clarabel, NaN without them; annealed, multi_start (runs, weights, 3) :
    penalised objective, loss and worst violation where each run of annealing, and of
    the local search alone, ends inside the box, at the weights of Searches.annealed.
    """

    label: str
    two_step: bool
    feasible_loss: float
    exact_by_theory: float
    exact_by_bisection: float
    free: list[PenalisedOptimum]
    boxed: list[BoxedOptimum]
    cvxpy: Array
    annealed: Array
    multi_start: Array

    @property
    def name(self) -> str:
        return "two-step" if self.two_step else "one-step"

    def excess_percent(self, optimum: PenalisedOptimum) -> float:
        """Its loss over the feasible optimum's; 0 where that is rounding."""
        if is_rounding(self.feasible_loss):
            return 0.0
        return 100.0 * (optimum.loss / self.feasible_loss - 1.0)


@dataclass(frozen=True)
class _Item:
    """What a worker is given."""

    label: str
    task: Task
    two_step: bool
    budget: str
    evaluations: int


@register_table("global", slow=True)
def global_optima(study: Study) -> Table:
    """Global optimum of the published penalised objective over its weight, certified."""
    searched = study.once(penalised_optima)
    rows = [row for found in searched for row in _rows(found)]
    searches = Searches.of(study.budget)
    evaluations = _evaluations(study)
    exact = [
        f"{x.label}, {x.name}: {x.exact_by_theory:.5g} by the largest multiplier,"
        f" {x.exact_by_bisection:.5g} by bisection"
        for x in searched
    ]
    return Table(
        f"Global optimum of the published penalised objective, {study.problem.title}",
        rows,
        notes(
            "global",
            runs=searches.annealing_runs,
            starts=searches.local_runs,
            evaluations=evaluations,
            exact="; ".join(exact),
        ),
        _headline(searched),
        digits=5,
    )


def penalised_optima(study: Study) -> list[Searched]:
    """Both problems of every data set."""
    items = [
        _Item(data.label, study.task(data), two_step, study.budget, _evaluations(study))
        for data in study.whole
        for two_step in (False, True)
    ]
    study.progress("the penalised objective's global optima")
    return list(study.workers.map(_searched, items))


def _evaluations(study: Study) -> int:
    """Loss evaluations at one weight: as many as the method has for each of its five."""
    return study.effort.evaluations // len(PenaltyPaper.weights)


def _searched(item: _Item) -> Searched:
    problem = PenalisedProblem(item.task, item.two_step)
    searches = Searches.of(item.budget)
    free = problem.solve_all(Searches.weights)
    boxed = BoxedProblem(problem).branch_all(
        Searches.weights, searches.gap, searches.most_cells
    )
    by_cvxpy = cvxpy_optima(problem, Searches.weights)
    return Searched(
        item.label,
        item.two_step,
        problem.feasible.upper,
        problem.exact_weight_by_theory,
        problem.exact_weight_by_bisection(),
        free,
        boxed,
        np.array([by_cvxpy.get(weight, np.nan) for weight in Searches.weights]),
        search_runs(
            problem, Searches.annealed, item.evaluations, searches.annealing_runs
        ),
        search_runs(
            problem,
            Searches.annealed,
            item.evaluations,
            searches.local_runs,
            annealing=False,
        ),
    )


def search_runs(
    problem: PenalisedProblem,
    weights: Sequence[float],
    evaluations: int,
    runs: int,
    annealing: bool = True,
) -> Array:
    """(runs, weights, 3) penalised objective, loss and worst violation where each run
    ends; every weight continues from the last one's answer, the first from a random
    point of the box, with so many evaluations each."""
    loss = problem.published
    rng = np.random.default_rng(problem.task.seed)
    out = np.zeros((runs, len(weights), 3))
    for run in out:
        u = rng.uniform(size=len(loss.free))
        for k, weight in enumerate(weights):
            if annealing:
                u, _ = anneal_and_search(loss, weight, u, evaluations, rng)
            else:
                u, _ = search_locally(loss, weight, u, evaluations)
            worst = max(loss.violations(loss.p(u)).values())
            run[k] = loss.value(u, weight), loss.value(u, 0.0), worst
    return out


def _rows(found: Searched) -> list[Row]:
    rows = []
    for k, (weight, free, boxed) in enumerate(
        zip(Searches.weights, found.free, found.boxed, strict=True)
    ):
        annealed = _best(found.annealed, weight)
        started = _best(found.multi_start, weight)
        rows.append(
            {
                "data": found.label,
                "problem": found.name,
                "xi": weight,
                "optimum": free.value,
                "lower_bound": free.lower,
                "gap": free.gap,
                "cvxpy_optimum": found.cvxpy[k],
                "excess_loss_percent": found.excess_percent(free),
                "links_violated": free.n_links_violated,
                "worst_violation": free.worst,
                "box_optimum": np.nan if boxed.best is None else boxed.best.value,
                "box_lower_bound": boxed.lower,
                "box_gap": boxed.gap,
                "box_cells": boxed.n_cells,
                "annealing_best": annealed,
                "annealing_above_percent": _above(annealed, boxed.lower),
                "multi_start_best": started,
                "multi_start_above_percent": _above(started, boxed.lower),
            }
        )
    return rows


def _best(runs: Array, weight: float) -> float | None:
    """The lowest objective of all runs; None at a weight at which none was run."""
    if weight not in Searches.annealed:
        return None
    return float(runs[:, Searches.annealed.index(weight), 0].min())


def _above(value: float | None, lower: float) -> float | None:
    """By how much a value is above a lower bound [%]; None above a bound of zero."""
    if value is None or is_rounding(lower):
        return None
    return 100.0 * (value / lower - 1.0)


def _headline(searched: Sequence[Searched]) -> str:
    said = []
    largest = max(PenaltyPaper.weights)
    for found in searched:
        free = found.free[Searches.weights.index(largest)]
        excess = found.excess_percent(free)
        said.append(
            f"{found.label}, {found.name} {excess:.3f} %, {free.n_links_violated} links"
        )
    return (
        f"At the paper's largest weight, {largest:g}, the optimum's loss against the"
        f" feasible optimum's, and links that cannot exist: {'; '.join(said)}."
    )
