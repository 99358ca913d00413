"""Motion that was not trained on: how much data a method needs for it, and what lowers
its errors."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pandas

from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.diagnosis.comparison import Comparison, compare
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimation.build_problem import PoseOptions, read_and_filter
from sdp_vs_penalty.estimation.identify import estimate_parameters
from sdp_vs_penalty.estimation.resampling import CrossValidation, Fold
from sdp_vs_penalty.estimators import DEFAULT_METHOD
from sdp_vs_penalty.estimators.estimator import make_task
from sdp_vs_penalty.estimators.penalty import Penalty
from sdp_vs_penalty.paper.tables.study import (
    CUT,
    FOLDS,
    Data,
    FoldSettings,
    Study,
    halves,
    refitted,
    torque_errors,
)
from sdp_vs_penalty.paper.tables.table import (
    Row,
    StudyTable,
    by_joint,
    notes,
    register_table,
)
from sdp_vs_penalty.regression.regression import Regression, compress_cells
from sdp_vs_penalty.signals.filtered import FilteredRuns
from sdp_vs_penalty.signals.phases import PhaseFolds, phase_folds

#: With a joint prior: the observations that `lmi-sdp` adds, so that each optimiser
#: stands in the table with them and without.
_METHODS = (
    *("ols", "ols, joint prior", "lmi-sdp-plain", "lmi-sdp-plain, joint prior"),
    *("penalty", "penalty, joint prior", "lmi-sdp", "lmi-sdp-entropic"),
)

#: Lengths of the windows [s]; of the real motion's 13.3 s the longest leaves one to
#: judge on.
_LENGTHS = (1, 2, 4, 7, 9)
#: Windows of each length.
_MOST_WINDOWS = 6
#: Rows to train on, and rows of other motion to judge on.
_Window = tuple[Regression, Regression]


@register_table("data", slow=True)
def data_needed(study: Study) -> StudyTable:
    """Data table: how much measured motion each method needs.

    Every method is trained on several windows of each length, and judged on other
    motion.

    Parameters
    ----------
    study : Study
        The robot's data sets and every method's estimate, computed on demand.

    Returns
    -------
    StudyTable
        Rows of each data set, length and method; notes.
    """
    rows = list[Row]()
    for data in study.whole:
        windows_of = _windows(data, _MOST_WINDOWS, 0.5 * min(_LENGTHS))
        for length in _LENGTHS:
            windows = windows_of(length)
            study.progress(f"{len(windows)} window(s) of {length} s, {data.label}")
            about = {"data": data.label, "seconds": length, "windows": len(windows)}
            rows += [
                {**about, "method": m, **_errors(study, data, windows, m)}
                for m in _METHODS
            ]
    return StudyTable(
        f"How much data each method needs: {study.problem.title}",
        rows,
        notes("data", most=_MOST_WINDOWS),
        digits=3,
    )


def _windows(
    data: Data, most_windows: int, cell: float
) -> Callable[[int], list[_Window]]:
    """Return a function that cuts windows of a length from the motion, each with rows to
    train on and rows to test on.

    The motion's period is cut into cells; a window trains on consecutive cells, with all
    their repetitions. Where the data have no test rows, it is tested on the cells that the
    filters keep apart from these.

    Parameters
    ----------
    most_windows : int
        Number of windows, evenly spread over the period.
    cell : float
        Length of a cell [s].

    Returns
    -------
    callable
        Maps a length [s] to pairs of training rows and test rows.
    """
    all_phases = phase_folds(data.train, data.preprocessing, 1)
    n_cells = round(all_phases.clocks[0].length / cell)  # in a period
    n_of_gap = math.ceil(all_phases.guard / cell)  # cells that the filters reach
    split = PhaseFolds(all_phases.clocks, n_cells)
    runs = FilteredRuns.filtering(data.train, data.preprocessing)
    cells = compress_cells(runs, data.model, split)
    starts = np.linspace(0, n_cells, most_windows, endpoint=False).round().astype(int)

    def cut(length: int) -> list[_Window]:
        """Return pairs of training and test rows: windows of this length [s], from each
        start."""
        n_of_window = round(length / cell)
        windows = []
        for start in starts:
            # The period from the start on: window, gap, cells to test on, gap.
            in_order = (start + np.arange(n_cells)) % n_cells
            of_window = in_order[:n_of_window]
            outside = in_order[n_of_window + n_of_gap : n_cells - n_of_gap]
            has_test_rows = data.make_test is not None
            test = data.test_regression if has_test_rows else cells.select(outside)
            windows.append((cells.select(of_window), test))
        return windows

    return cut


def _errors(study: Study, data: Data, windows: list[_Window], method: str) -> Row:
    """Return a method's held-out errors [%]: median, smallest and largest over the
    windows.

    "links_error_percent" is that of the links alone: all other parameters are fitted to
    the test rows.
    """
    pairs = []
    for train, test in windows:
        task = make_task(study.problem, data.model, train, seed=study.seed)
        estimator = study.estimator(method)
        if isinstance(estimator, Penalty):
            estimator = replace(estimator, starts=1)  # to save time
        theta = estimator.fit(task).theta
        # The same links, with the other parameters (nan) fitted to the test rows.
        links = np.full(len(theta), np.nan)
        links[task.links] = theta[task.links]
        refit = refitted(test.least_squares(), links)
        pairs.append([torque_errors(test, x)[1] for x in (theta, refit)])
    frame = pandas.DataFrame(
        pairs, columns=["error_percent", "links_error_percent"], dtype=float
    )
    words = "median", "min", "max"
    return {
        f"{name}_{word}": errors.agg(word)
        for name, errors in frame.items()
        for word in words
    }


METHODS_TRIED = tuple(
    dict.fromkeys(("ols", "lmi-sdp-plain", "lmi-sdp-entropic", DEFAULT_METHOD))
)
#: What joins the problem's effects, one after the other.
ADDED_EFFECTS = ("", "presliding_hysteresis", "presliding_hysteresis, torque_gain:6")


@register_table("unseen", "panda", slow=True)
def unseen(study: Study) -> StudyTable:
    """Unseen table: errors on motion that was not trained on, fold by fold, and what
    lowers them.

    Each method is cross-validated on the real run, with the problem's effects and with
    further ones (ADDED_EFFECTS) that might explain more of the torque.

    Parameters
    ----------
    study : Study
        The robot's data sets and every method's estimate, computed on demand.

    Returns
    -------
    StudyTable
        Rows of each fold, of all folds together and of repeated motion, for each method
        and set of effects; notes.
    """
    if study.run is None:
        raise InputError(
            "table unseen is about the real run, which is not at hand",
            "name the folder of the measurements by SDP_VS_PENALTY_DATA",
        )
    rows: list[Row] = []
    for method in METHODS_TRIED:
        for added in ADDED_EFFECTS:
            study.progress(f"unseen motion: {method}, {added or 'the usual effects'}")
            rows += _rows(study, study.run, method, added)
    return StudyTable(
        f"Errors on unseen motion of {study.problem.title}",
        rows,
        notes("unseen", folds=FOLDS, cut=CUT),
        digits=3,
        caption=f"Measured: the authors' real run ({len(study.run.t)} samples).",
    )


def _rows(study: Study, run: Measurements, method: str, added: str) -> list[Row]:
    """Return the table's rows of one method: one for each fold of the real run, then
    one for all folds together ("all"), then one for repeated motion ("repeatability").

    Repeatability: the method is trained on the run's motion and judged on the
    repetition of that motion. ``added`` names effects that join the problem's own,
    separated by ", "; "" for none.
    """
    problem = study.problem
    effects = (*problem.default_effects, *(text for text in added.split(", ") if text))
    result = study.unseen(method, FoldSettings(effects))
    train, test = halves(run)
    runs = read_and_filter(problem, train)
    options = PoseOptions(effects=effects, seed=study.seed)
    again = compare(estimate_parameters(problem, runs, method, options), test)[0]
    judged: list[tuple[str, Fold | CrossValidation | Comparison]] = [
        *((f"{f.start:.2f}-{f.stop:.2f} s", f) for f in result.folds),
        ("all", result),
        ("repeatability", again),
    ]
    about = {
        "data": "measured",
        "method": method,
        "added_effects": f"+ {added}" if added else "",
    }
    return [
        about
        | {"judged_on": name, "relative_error_percent": x.relative_error_percent}
        | by_joint(x.rmse, "rmse_joint")
        for name, x in judged
    ]
