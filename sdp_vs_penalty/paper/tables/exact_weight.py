"""Table "xi": from which weight on the published penalty is exact, by what the loss
counts: the weight stands beside a sum over rows."""

from dataclasses import dataclass, replace

import numpy as np

from sdp_vs_penalty.estimators.estimator import Task, make_task
from sdp_vs_penalty.estimators.penalty_paper import PenaltyPaper
from sdp_vs_penalty.paper.penalised_box import BoxedProblem
from sdp_vs_penalty.paper.penalised_optimum import PenalisedProblem
from sdp_vs_penalty.paper.tables.study import Data, Study
from sdp_vs_penalty.paper.tables.table import Row, Table, notes, register_table
from sdp_vs_penalty.regression.regression import LeastSquares

#: Branch and bound inside the box ends at this gap, or after so many relaxations.
GAP, MOST_CELLS = 1e-5, 9


@dataclass(frozen=True)
class Counted:
    """What a loss sums over."""

    #: Weights of the joints, as `identify` takes them.
    weighting: str
    #: Whether every sample of the log counts, or only the decimated rows. Between the
    #: rows nothing is lost behind the low-pass, so that a sum over samples is that over
    #: rows times samples a row.
    samples: bool


COUNTED = (Counted("noise", False), Counted("none", False), Counted("none", True))


@register_table("xi", "panda", slow=True)
def exact_weights(study: Study) -> Table:
    """Weight table: from which xi the one-step penalty is exact, by rows and joint
    weights.
    """
    data = study.whole[-1]
    rows = [_row(study, data, counted) for counted in COUNTED]
    sentences = [
        f"{row['exact_weight']:.0f} for {row['rows']} rows, {row['joint_weights']}"
        for row in rows
    ]
    return Table(
        f"Least exact weight of the published one-step penalty, {study.problem.title}",
        rows,
        notes("xi", largest=max(PenaltyPaper.weights)),
        f"Exact from xi = {'; '.join(sentences)}.",
        digits=4,
    )


def _row(study: Study, data: Data, counted: Counted) -> Row:
    """Return the row of one loss: the least exact weight, and the certified optimum at
    the largest published weight with the box on inertias and without it."""
    task = _task(study, data, counted)
    problem = PenalisedProblem(task, two_step=False)
    weight = max(PenaltyPaper.weights)
    boxed = BoxedProblem(problem).branch_and_bound(weight, GAP, MOST_CELLS)
    free = problem.solve(weight)
    base = problem.feasible.upper
    assert boxed.best is not None
    weighted = counted.weighting == "noise"
    return {
        "data": data.label,
        "rows": task.data.rows,
        "joint_weights": "by residuals" if weighted else "alike",
        "exact_weight": problem.exact_weight_by_theory,
        "boxed_excess_percent": 100.0 * (boxed.best.loss / base - 1.0),
        "boxed_links_violated": boxed.best.n_links_violated,
        "boxed_gap": boxed.gap,
        "free_excess_percent": 100.0 * (free.loss / base - 1.0),
        "free_links_violated": free.n_links_violated,
        "free_gap": free.gap,
    }


def _task(study: Study, data: Data, counted: Counted) -> Task:
    """Return the task of a data set with other joint weights and rows that count."""
    task = make_task(
        study.problem,
        data.model,
        data.regression,
        weighting=counted.weighting,
        seed=study.seed,
    )
    if not counted.samples:
        return task
    rows = len(data.train.t) * data.regression.joints
    return replace(task, data=_repeated(task.data, rows))


def _repeated(data: LeastSquares, rows: int) -> LeastSquares:
    """Return a sum of squares that counts as so many rows."""
    factor = np.sqrt(rows / data.rows)
    return replace(
        data,
        R=factor * data.R,
        rho=factor * data.rho,
        residual_norm=factor * data.residual_norm,
        tau_squared=factor**2 * data.tau_squared,
        rows=rows,
    )
