"""Table VII's bounds taken seriously: what is not convex, by penalty and by certified convex pieces."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty import inertia
from sdp_vs_penalty.estimators.convex_pieces import (
    CataloguePart,
    GlobalFit,
    solve_pieces,
    with_upper_moments,
)
from sdp_vs_penalty.estimators.estimator import Task
from sdp_vs_penalty.estimators.penalty import Penalty
from sdp_vs_penalty.tables.study import Study, sentence
from sdp_vs_penalty.tables.table import Cell, Column, Table

NAME = "VII_not_convex"
PROBLEMS = ("two_link",)

Array = NDArray[np.float64]

_PIECES = {"quick": 150, "paper": 1500}
#: Certified gap at which the search over pieces stops, relative to the loss.
_TOLERANCE = 1e-5
#: The other catalogue part is so much heavier than the real link 2.
_HEAVIER = 1.1


@dataclass(frozen=True)
class _Case:
    name: str
    task: Task
    parts: tuple[CataloguePart, ...] = ()


def build(study: Study) -> Table:
    rows = []
    for case in cases(study):
        study.progress(case.name)
        begin = time.perf_counter()
        best = solve_pieces(
            case.task, case.parts, tolerance=_TOLERANCE, max_pieces=_PIECES[study.budget]
        )
        rows.append(_pieces_row(case, best, time.perf_counter() - begin))
        rows += _penalty_rows(case)
    names = (
        "constraint",
        "method",
        "loss",
        "lower_bound",
        "gap",
        "worst_violation",
        "solved",
        "seconds",
    )
    return Table(
        NAME,
        f"Constraints that are not convex: {study.problem.title}",
        sentence(study),
        tuple(Column(name, 6 if name in ("loss", "lower_bound") else 2) for name in names),
        tuple(rows),
        (
            "loss: weighted sum of squared torque errors; lower_bound: certified from the duals of all "
            "pieces, no parameters within the constraints have a lower loss; gap: between them, "
            "relative to the loss; worst_violation: of any constraint, in its own units; solved: SDPs, "
            "or penalty runs.",
            "Table VII: upper bounds on moments, both bounds on products, as printed. Factors: upper "
            "bounds on moments of the true moments times the factor, which the truth then violates, so "
            "that the bounds cost torque error; link 1's stay as printed.",
            f"catalogue: link 2 is, within 1 %, either the true part or one {100 * (_HEAVIER - 1):.0f} "
            "% heavier of the same shape. The penalty method was given each part in turn, because from "
            "a random start it stays with the part nearest to it: the loss alone does not prove which "
            "is in place, the lower bound of the other part does.",
        ),
    )


def cases(study: Study) -> list[_Case]:
    """The published bounds, tightened ones, and two catalogue parts for link 2."""
    task, links = study.task(study.simulated), study.experiment.links
    moments = inertia.barycentric_from_standard(links)[:, [4, 6, 9]]
    printed = study.problem.box[:, [4, 6, 9], 1]
    out = [_Case("Table VII", task)]
    for factor in (0.5, 0.2):
        upper = np.vstack([printed[:1], factor * moments[1:]])
        out.append(
            _Case(f"moments of link 2 below {factor:g} of the true", with_upper_moments(task, upper))
        )
    heavy = inertia.barycentric_from_standard(links[1])
    heavy[[0, 4, 5, 6, 7, 8, 9]] *= _HEAVIER
    parts = (
        CataloguePart("true part", 1, links[1]),
        CataloguePart("heavier part", 1, inertia.standard_from_barycentric(heavy)),
    )
    out.append(_Case("catalogue", task, parts))
    return out


def _pieces_row(case: _Case, best: GlobalFit, seconds: float) -> tuple[Cell, ...]:
    label = "SDP over pieces"
    if case.parts:
        others = {k: v for k, v in best.choice_lower.items() if k != best.choice}
        label += f": {best.choice}; " + ", ".join(
            f"{k} loses at least {v:.4g}" for k, v in others.items()
        )
    worst = max(case.task.constraints.worst(best.theta).values())
    return (case.name, label, best.upper, best.lower, best.gap, worst, best.solved, seconds)


def _penalty_rows(case: _Case) -> list[tuple[Cell, ...]]:
    rows: list[tuple[Cell, ...]] = []
    estimator = Penalty(thickness=0.0)
    for part in case.parts or (None,):
        task, label = case.task, "penalty"
        if part is not None:
            constraints = task.constraints.plus([part.constraint(task)])
            task, label = replace(task, constraints=constraints), f"penalty: {part.name}"
        begin = time.perf_counter()
        theta = estimator.fit(task).theta
        seconds = time.perf_counter() - begin
        worst = max(task.constraints.worst(theta).values())
        rows.append(
            (case.name, label, task.data.loss(theta), None, None, worst, estimator.starts, seconds)
        )
    return rows
