"""Table "arms": SDP beside penalty on other real arms, as the table of routes has it for
the Panda."""

from sdp_vs_penalty.data.measurements import Measurements, concatenate
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimation.build_problem import PoseOptions
from sdp_vs_penalty.estimation.resampling import Split
from sdp_vs_penalty.estimators.estimator import make_task
from sdp_vs_penalty.estimators.lmi_sdp import LmiSdp, LmiSdpPlain
from sdp_vs_penalty.estimators.ols import Ols
from sdp_vs_penalty.estimators.penalty import Penalty, PenaltyTwoStep
from sdp_vs_penalty.paper.estimates import (
    REPEATS,
    Remembered,
    estimate_once,
    fit_seconds,
)
from sdp_vs_penalty.paper.tables.routes import (
    PENALTY,
    SDP,
    SameConstraints,
    errors_of,
    figures_of,
)
from sdp_vs_penalty.paper.tables.study import FOLDS, Study, each_judged
from sdp_vs_penalty.paper.tables.table import Row, Table, notes, register_table
from sdp_vs_penalty.problem.load import load_problem
from sdp_vs_penalty.problem.published import measured_runs

#: The public runs of each arm that are taken; empty: all.
RUNS = {
    "ur10e": (
        "ur-20_02_12-50sec_12harm",
        "ur-20_02_19_14harm50sec",
        "ur-20_02_19_15harm50sec",
    ),
    "tx40": (),
}
METHODS = {
    SDP: SameConstraints(),
    PENALTY: Penalty(),
    "penalty, two-step": PenaltyTwoStep(),
    "SDP, default (entropic prior)": LmiSdp(),
    "least squares": Ols(),
}


@register_table("arms", *RUNS, slow=True)
def arms(study: Study) -> Table:
    """Arms table: SDP beside penalty on the UR10e and the TX40.

    Both arms are in the table, whatever the study's problem. Raises InputError without
    the real runs.
    """
    rows = [row for name in RUNS for row in _rows(study, name)]
    sentences = []
    for name in RUNS:
        sdp, penalty = (row for row in rows if row["arm"] == name and _is_pair(row))
        sentences.append(
            f"{name}: {sdp['unseen_error_percent']:.3g} and"
            f" {penalty['unseen_error_percent']:.3g} % on unseen motion,"
            f" {sdp['seconds']:.2g} and {penalty['seconds']:.2g} s"
        )
    return Table(
        "SDP beside penalty on other arms",
        rows,
        notes("arms", folds=FOLDS, repeats=REPEATS),
        f"SDP and exact penalty: {'; '.join(sentences)}.",
        digits=3,
        caption="Measured: public runs of a UR10e (three of 50 s) and a TX40 (9 s).",
    )


def _is_pair(row: Row) -> bool:
    """Whether a row is the SDP's or the exact penalty's on one problem."""
    return row["method"] in (SDP, PENALTY)


def _rows(study: Study, name: str) -> list[Row]:
    """Return the row of each method on an arm's runs."""
    problem = load_problem(name)
    runs = _runs(name)
    study.progress(f"folds of {name}")
    split = Split(problem, runs, PoseOptions(seed=study.seed), FOLDS)
    folds = study.workers.map(split.fold, split.numbers)
    task = make_task(problem, split.model, split.common, seed=study.seed)
    optimum = estimate_once(LmiSdpPlain(), task).certificate.lower
    assert optimum is not None
    judged = {}
    for method, estimator in METHODS.items():
        items = [(Remembered(estimator), fold) for fold in folds]
        judged[method] = split.result(estimator, each_judged(study.workers, items))
    return [
        {
            "arm": name,
            "method": method,
            **errors_of(method, judged),
            **figures_of(problem, task, estimate_once(estimator, task), optimum),
            "seconds": fit_seconds(estimator, task),
            "data": "measured, unseen",
        }
        for method, estimator in METHODS.items()
    ]


def _runs(name: str) -> Measurements:
    """Return the chosen public runs of an arm; InputError where they are not at hand."""
    found = measured_runs(name)
    if not found:
        raise InputError(
            f"table arms is about real runs, and those of {name} are not at hand",
            "name the folder of the measurements by SDP_VS_PENALTY_DATA",
        )
    return concatenate([found[run] for run in RUNS[name] or found])
