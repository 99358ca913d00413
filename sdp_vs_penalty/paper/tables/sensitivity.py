"""Table "sensitivity": how much of the comparison is the choice of folds, guard, weights,
bounds and effects."""

from dataclasses import dataclass, replace

import numpy as np

from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimation.build_problem import PoseOptions
from sdp_vs_penalty.estimation.resampling import FoldData, Split
from sdp_vs_penalty.estimators import DEFAULT_METHOD
from sdp_vs_penalty.estimators.lmi_sdp import LmiSdpPlain
from sdp_vs_penalty.paper.tables.folds import error_interval, fold_errors
from sdp_vs_penalty.paper.tables.study import FOLDS, Study, cross_validated
from sdp_vs_penalty.paper.tables.table import Row, StudyTable, notes, register_table
from sdp_vs_penalty.paper.tables.unseen import ADDED_EFFECTS
from sdp_vs_penalty.problem.load import with_bounds
from sdp_vs_penalty.regression.regression import compress_cells

#: The default SDP, and what is compared with it.
METHODS = {"sdp": DEFAULT_METHOD, "ols": "ols", "two_step": "penalty-two-step"}
#: Into how many stretches the motion is cut.
FOLD_COUNTS = (3, FOLDS, 8, 10, 20)


@dataclass(frozen=True)
class Case:
    """One choice that may decide the comparison; all others as usual."""

    #: What is chosen otherwise; "" for nothing.
    choice: str = ""
    #: Stretches into which the motion is cut.
    folds: int = FOLDS
    #: What training keeps off the stretch left out [s]; None: the filters' reach.
    guard: float | None = None
    #: Weights of the joints, as `identify` takes them.
    weighting: str = "noise"
    #: Other bounds, as `identify --bounds` takes them.
    bounds: str | None = None
    #: Effects that join the problem's own, separated by ", ".
    added: str = ""


CASES = (
    *(Case(folds=count) for count in FOLD_COUNTS),
    Case("guard 0.65 s", guard=0.65),
    Case("joints weighted alike", weighting="none"),
    Case("c5z > -0.35 m, as in the authors' program", bounds="c5z=-0.35:0.05"),
    Case("m2 < 20 kg", bounds="m2=0:20"),
    Case("total mass open", bounds="total=:"),
    *(
        Case(f"+ {added}", folds=count, added=added)
        for added in ADDED_EFFECTS
        if added
        for count in FOLD_COUNTS
    ),
)


@register_table("sensitivity", "panda", slow=True)
def sensitivity(study: Study) -> StudyTable:
    """Sensitivity table: what folds, guard, weights, bounds and effects decide.

    Raises InputError without the real run.
    """
    if study.run is None:
        raise InputError(
            "table sensitivity is about the real run, which is not at hand",
            "name the folder of the measurements by SDP_VS_PENALTY_DATA",
        )
    rows = [_row(study, case) for case in CASES]
    usual = [row for row in rows if not row["choice"]]
    sentences = [
        f"{row['ols_less_sdp_points']:+.2f} points ({row['ols_interval_points']}) on"
        f" {row['folds']} folds"
        for row in usual
    ]
    return StudyTable(
        f"What decides the comparison on unseen motion of {study.problem.title}",
        rows,
        notes("sensitivity", method=DEFAULT_METHOD, usual=FOLDS),
        f"Least squares less {DEFAULT_METHOD}: {'; '.join(sentences)}.",
        digits=3,
        caption=f"Measured: the authors' real run ({len(study.run.t)} samples).",
    )


def _row(study: Study, case: Case) -> Row:
    """Return the row that compares the methods under one choice."""
    study.progress(f"{case.folds} folds, {case.choice or 'the usual settings'}")
    split, folds = _folds(study, case)
    judged = {
        name: cross_validated(study.workers, split, folds, study.estimator(method))
        for name, method in METHODS.items()
    }
    row: Row = {
        "data": "measured",
        "choice": case.choice,
        "folds": case.folds,
        "optimal_loss": _optimal_loss(folds),
    }
    for name, result in judged.items():
        row[f"{name}_error_percent"] = result.relative_error_percent
    for name in ("ols", "two_step"):
        less = error_interval(judged[name], judged["sdp"])
        row[f"{name}_less_sdp_points"] = less.value
        row[f"{name}_interval_points"] = less.in_words
        won = fold_errors(judged["sdp"]) < fold_errors(judged[name])
        row[f"{name}_lost_folds"] = int(won.sum())
    return row


def _folds(study: Study, case: Case) -> tuple[Split, list[FoldData]]:
    """Compress the training and test rows of each fold of the real run."""
    problem = with_bounds(study.problem, case.bounds)
    effects = [*problem.default_effects]
    if case.added:
        effects += case.added.split(", ")
    assert study.run is not None
    options = PoseOptions(effects, weighting=case.weighting, seed=study.seed)
    split = Split(problem, study.run, options, case.folds)
    if case.guard is not None:
        split.phases = replace(split.phases, guard=case.guard)
        split.common = compress_cells(
            split.runs, split.model.reference_free, split.phases
        )
    return split, study.workers.map(split.fold, split.numbers)


def _optimal_loss(folds: list[FoldData]) -> float:
    """Return the mean over the folds of the least loss of any consistent parameters,
    certified, in units of the unconstrained one."""
    ratios = []
    for _, _, task, _ in folds:
        fit = LmiSdpPlain().fit(task)
        ratios.append(fit.lower / task.data.loss(task.ols))
    return float(np.mean(ratios))
