"""Table "opponent": the two-step penalty method as published, and at its best.

The published weights jump from 0 to 10, where the penalty is exact from a tenth on, and a
loose search ends on the way down. Both can be mended without another method.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from sdp_vs_penalty.estimators.penalty_paper import PenaltyPaper, Stopping
from sdp_vs_penalty.paper.annealing import SearchPlan, search_runs
from sdp_vs_penalty.paper.penalised_optimum import PenalisedProblem
from sdp_vs_penalty.paper.tables.retrieved import optimum_inside_box
from sdp_vs_penalty.paper.tables.study import Study
from sdp_vs_penalty.paper.tables.table import Row, Table, notes, register_table

#: Weights without the jump, up to the largest published one.
GENTLE = (0.0, 0.01, 0.1, 1.0, 40.0)
#: SLSQP until it no longer helps.
TO_THE_END = Stopping(tolerance=1e-12, gain=1e-5, restarts=6, steps=400)
#: Independent runs of each search, of annealing where it is as long as the authors'.
RUNS = 9
#: A run that ends within this of the certified optimum has found it [%].
FOUND = 0.1


@dataclass(frozen=True)
class Opponent:
    """A search, and its weights."""

    #: What it is, in words.
    name: str
    #: xi, one after the other.
    weights: tuple[float, ...]
    #: Runs, their length and their end.
    plan: SearchPlan


@register_table("opponent", "panda", slow=True)
def opponents(study: Study) -> Table:
    """Opponent table: the two-step penalty as published and at its best, certified."""
    data = study.whole[-1]
    task = study.task(data)
    problem = PenalisedProblem(task, two_step=True)
    optimum = optimum_inside_box(task, problem.data)
    effort = study.effort
    loose = SearchPlan(RUNS, None, annealing=False)
    tight = SearchPlan(RUNS, None, annealing=False, stopping=TO_THE_END)
    published = PenaltyPaper.weights
    is_long = effort.global_evaluations is None
    annealing = SearchPlan(
        RUNS if is_long else effort.global_runs, effort.global_evaluations
    )
    tried = [
        Opponent("annealing, then local search: as published", published, annealing),
        Opponent("local search alone, as published", published, loose),
        Opponent("local search to the end", published, tight),
        Opponent("local search to the end, without the jump", GENTLE, tight),
    ]
    rows = list(study.workers.map(partial(_row, problem, optimum.lower), tried))
    for row in rows:
        row["data"] = data.label
    best = rows[-1]
    return Table(
        f"The two-step penalty at its best, {study.problem.title}",
        rows,
        notes(
            "opponent",
            optimum=f"{optimum.value:.5g}",
            gap=f"{optimum.gap:.1g}",
            found=FOUND,
        ),
        f"As published {rows[0]['above_percent_median']:.3g} % above the certified optimum"
        f" in the median, at its best {best['above_percent_median']:.3g} %"
        f" ({best['runs_that_found_it']} of {best['runs']} runs find it).",
        digits=3,
    )


def _row(problem: PenalisedProblem, lower: float, tried: Opponent) -> Row:
    """Return where the runs of a search end, above the certified bound [%]."""
    points = search_runs(
        problem.published, problem.task.seed, tried.weights, tried.plan
    )
    last = [point for point in points if point.xi == tried.weights[-1]]
    above = [100.0 * (point.objective / lower - 1.0) for point in last]
    spent = [
        sum(point.evaluations for point in points if point.run == end.run)
        for end in last
    ]
    return {
        "search": tried.name,
        "weights": _in_words(tried.weights),
        "runs": len(last),
        "above_percent_best": float(np.min(above)),
        "above_percent_median": float(np.median(above)),
        "above_percent_worst": float(np.max(above)),
        "runs_that_found_it": int(np.sum(np.array(above) <= FOUND)),
        "evaluations_median": float(np.median(spent)),
        "worst_violation": max(point.worst_violation for point in last),
    }


def _in_words(weights: Sequence[float]) -> str:
    """Return weights as text."""
    return " ".join(f"{weight:g}" for weight in weights)
