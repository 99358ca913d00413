"""Where the published search ends: runs of simulated annealing and local search over the
penalty's weight, and what more evaluations buy."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

from sdp_vs_penalty.estimators.penalty_paper import (
    AS_PUBLISHED,
    EVALUATIONS_A_PARAMETER,
    PenalisedLoss,
    Stopping,
    random_numbers_of_step,
    start_of_run,
)
from sdp_vs_penalty.paper.estimates import anneal_once, search_locally_once
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

    def budget(self, n_parameters: int) -> int:
        """Return the evaluations at a weight of a search over so many parameters."""
        if self.evaluations is None:
            return EVALUATIONS_A_PARAMETER * n_parameters
        return self.evaluations

    @property
    def name(self) -> str:
        """The search as tables call it."""
        return "annealing" if self.annealing else "local search"


@dataclass(frozen=True)
class SearchedPoint:
    """Where a run stands after a weight."""

    #: Name of the search plan.
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
            u, n_evaluations = _search(loss, weight, u, plan, (seed, number, step))
            points.append(
                SearchedPoint(
                    search=plan.name,
                    run=number + 1,
                    xi=weight,
                    evaluations=n_evaluations,
                    objective=loss.value(u, weight),
                    loss=loss.value(u, 0.0),
                    worst_violation=max(loss.violations(loss.p(u)).values()),
                )
            )
    return points


def _search(
    loss: PenalisedLoss,
    weight: float,
    u: Array,
    plan: SearchPlan,
    seeds: tuple[int, int, int],
) -> tuple[Array, int]:
    """Search at one weight from u; return the best point and the number of evaluations.

    seeds : seed, number of the run and of the step.
    """
    budget = plan.budget(len(u))
    if not plan.annealing:
        return search_locally_once(loss, weight, u, budget, plan.stopping)
    seed, number, step = seeds
    rng = random_numbers_of_step(seed, number, step)
    return anneal_once(loss, weight, u, budget, rng)


def point_fields(point: SearchedPoint) -> dict[str, Any]:
    """Return a point's fields by name, as a row of a table."""
    return {field.name: getattr(point, field.name) for field in fields(point)}
