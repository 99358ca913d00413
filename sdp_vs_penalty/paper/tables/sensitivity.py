"""Table "sensitivity": how much of the comparison is the choice of folds, guard, weights,
bounds and effects."""

from dataclasses import dataclass, replace

import numpy as np

from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimators import DEFAULT_METHOD
from sdp_vs_penalty.estimators.lmi_sdp import LmiSdpPlain
from sdp_vs_penalty.paper.tables.folds import error_interval, fold_errors
from sdp_vs_penalty.paper.tables.study import FOLDS, USUAL_FOLDS, FoldSettings, Study
from sdp_vs_penalty.paper.tables.table import Row, StudyTable, notes, register_table
from sdp_vs_penalty.paper.tables.unseen import ADDED_EFFECTS
from sdp_vs_penalty.problem.load import with_bounds

#: The default SDP, and what is compared with it.
METHODS = {"sdp": DEFAULT_METHOD, "ols": "ols", "two_step": "penalty-two-step"}
#: Into how many stretches the motion is cut.
FOLD_COUNTS = (3, FOLDS, 8, 10, 20)


@dataclass(frozen=True)
class Case:
    """One choice that may decide the comparison; all others as usual."""

    #: What is chosen otherwise; "" for nothing.
    choice: str = ""
    #: How motion is left out.
    settings: FoldSettings = USUAL_FOLDS
    #: Other bounds, as `identify --bounds` takes them.
    bounds: str | None = None
    #: Effects that join the problem's own, separated by ", ".
    added: str = ""


CASES = (
    *(Case(settings=FoldSettings(folds=count)) for count in FOLD_COUNTS),
    Case("guard 0.65 s", FoldSettings(guard=0.65)),
    Case("joints weighted alike", FoldSettings(weighting="none")),
    Case("c5z > -0.35 m, as in the authors' program", bounds="c5z=-0.35:0.05"),
    Case("m2 < 20 kg", bounds="m2=0:20"),
    Case("total mass open", bounds="total=:"),
    *(
        Case(f"+ {added}", FoldSettings(folds=count), added=added)
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
    return StudyTable(
        f"What decides the comparison on unseen motion of {study.problem.title}",
        rows,
        notes("sensitivity", method=DEFAULT_METHOD, usual=FOLDS),
        digits=3,
        caption=f"Measured: the authors' real run ({len(study.run.t)} samples).",
    )


def _row(study: Study, case: Case) -> Row:
    """Return the row that compares the methods under one choice."""
    if case.bounds is not None:
        study = study.sibling(with_bounds(study.problem, case.bounds))
    settings = case.settings
    if case.added:
        effects = (*study.problem.default_effects, *case.added.split(", "))
        settings = replace(settings, effects=effects)
    judged = {name: study.unseen(method, settings) for name, method in METHODS.items()}
    # The least loss of any consistent parameters, in units of the unconstrained one.
    optimal_losses = [
        LmiSdpPlain().fit(task).lower / task.data.loss(task.ols)
        for _, _, task, _ in study.folds(settings)[1]
    ]
    row: Row = {
        "data": "measured",
        "choice": case.choice,
        "folds": settings.folds,
        "optimal_loss": float(np.mean(optimal_losses)),
    }
    for name, result in judged.items():
        row[f"{name}_error_percent"] = result.relative_error_percent
    for name in ("ols", "two_step"):
        difference = error_interval(judged[name], baseline=judged["sdp"])
        row[f"{name}_less_sdp_points"] = difference.value
        row[f"{name}_interval_points"] = difference.in_words
        won = fold_errors(judged["sdp"]) < fold_errors(judged[name])
        row[f"{name}_lost_folds"] = int(won.sum())
    return row
