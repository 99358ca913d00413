"""Motion that was not trained on: errors, and what lowers them."""

import numpy as np

from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.diagnosis.comparison import Comparison, compare
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimation.cross_validation import CrossValidation, Fold
from sdp_vs_penalty.estimation.identify import identify
from sdp_vs_penalty.estimators import DEFAULT_METHOD
from sdp_vs_penalty.research.tables.study import FOLDS, TEST_START, TRAIN_STOP, Study
from sdp_vs_penalty.research.tables.table import Cell, Row, Table, by_joint, makes

_TRIED = tuple(dict.fromkeys(("ols", "lmi-sdp-plain", "lmi-sdp-entropic", DEFAULT_METHOD)))
#: What joins the problem's effects, one after the other.
_ADDED = ("", "presliding_hysteresis", "presliding_hysteresis, torque_gain:6")


@makes("unseen", "panda", slow=True)
def unseen(study: Study) -> Table:
    """Unseen table: errors on motion that was not trained on, fold by fold, and what lowers them."""
    if study.run is None:
        raise InputError(
            "table unseen is about the real run, which is not at hand",
            "name the folder of the measurements by SDP_VS_PENALTY_DATA",
        )
    rows: list[Row] = []
    told: dict[tuple[str, str], Cell] = {}
    for method in _TRIED:
        for added in _ADDED:
            study.progress(f"unseen motion: {method}, {added or 'the usual effects'}")
            rows += (found := _rows(study, study.run, method, added))
            told[method, added] = found[FOLDS]["relative_error_percent"]
    usual, friction, all_of_it = (told[DEFAULT_METHOD, added] for added in _ADDED)
    return Table(
        f"Errors on unseen motion of {study.problem.title}",
        rows,
        (
            f"Folds by phase: each of the {FOLDS} leaves out a stretch of the motion, all its "
            "repetitions and what the filters reach around it, and is judged on that stretch, whose "
            "seconds of the motion's clock are given. all: every row, each judged by the fold that has "
            f"not seen it. repeatability: fitted to the first {TRAIN_STOP:g} s, judged from "
            f"{TEST_START:g} s on, where the run repeats its beginning.",
            "RMSE in N m behind the problem's filters. Added effects have their default shape "
            "constants, on all joints where none is named.",
        ),
        f"{DEFAULT_METHOD}: {usual:.3g} % on unseen motion, {friction:.3g} % with pre-sliding "
        f"hysteresis, {all_of_it:.3g} % with a gain on joint 6 as well.",
        digits=3,
        caption=f"Measured: the authors' real run ({len(study.run.t)} samples).",
    )


def _rows(study: Study, run: Measurements, method: str, added: str) -> list[Row]:
    """The folds, all of them together, and repeatability."""
    problem = study.problem
    effects = [*problem.default_effects, *(text for text in added.split(", ") if text)]
    result = study.unseen(method, effects)
    train, test = run.window(0.0, TRAIN_STOP), run.window(TEST_START, np.inf)
    again = compare(identify(problem, train, method, effects=effects, seed=study.seed), test)[0]
    judged: list[tuple[str, Fold | CrossValidation | Comparison]] = [
        *((f"{f.start:.2f}-{f.stop:.2f} s", f) for f in result.folds),
        ("all", result),
        ("repeatability", again),
    ]
    about = {"data": "measured", "method": method, "added_effects": f"+ {added}" if added else ""}
    return [
        about
        | {"judged_on": name, "relative_error_percent": x.relative_error_percent}
        | by_joint(x.rmse, "rmse_joint")
        for name, x in judged
    ]
