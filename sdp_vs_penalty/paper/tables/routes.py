"""Tables "routes" and "arms": one problem, two routes: SDP and penalty on the same
constraints, of the Panda and of other real arms."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from sdp_vs_penalty.data.measurements import Measurements, concatenate
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimation.link_figures import link_figures
from sdp_vs_penalty.estimation.resampling import CrossValidation
from sdp_vs_penalty.estimators.estimator import Estimator
from sdp_vs_penalty.estimators.lmi_sdp import LmiSdp
from sdp_vs_penalty.estimators.ols import Ols
from sdp_vs_penalty.estimators.penalty import Penalty, PenaltyTwoStep
from sdp_vs_penalty.paper.memo import REPEATS
from sdp_vs_penalty.paper.tables.folds import error_interval
from sdp_vs_penalty.paper.tables.study import (
    FOLDS,
    Data,
    Frozen,
    Study,
    worst_violations,
)
from sdp_vs_penalty.paper.tables.table import Row, StudyTable, notes, register_table
from sdp_vs_penalty.problem.load import load_problem
from sdp_vs_penalty.problem.published import measured_runs

#: The rows that solve one problem: torque loss, 20 mm, bodies, no prior on anything.
SDP = "SDP"
PENALTY = "penalty, one-step"
#: Ending of the rows of published links, beside which friction is fitted by us.
PUBLISHED_LINKS = " (published links)"

_JUDGED_BY_FOLDS = (
    f"unseen_error_percent: on {FOLDS} folds by phase of the real run, each estimated"
    " without a stretch of the motion and all its repetitions, of all folds together;"
    " interval_percent: its 95 % interval by the jackknife over the folds (Student's t);"
    " less_sdp: the first row's error subtracted, with its 95 % interval: zero inside it"
    " means that these folds do not tell the two apart, not that they are equal."
)
_JUDGED_BY_RUNS = (
    "unseen_error_percent: on the simulated validation runs; there are no folds, and so"
    " no intervals, without the real run."
)


@dataclass(frozen=True)
class SameConstraints(LmiSdp):
    """The SDP of exactly the demands that ``penalty`` is given by default."""

    name = "lmi-sdp-same-constraints"
    description = "torque SDP with bodies and minimum thickness, without any prior"
    table_place: ClassVar[int | None] = None
    body: bool = Penalty.body
    thickness: float = Penalty.thickness
    entropy: float = 0.0
    joint_prior: float = Penalty.joint_prior


def routes_of(study: Study) -> Mapping[str, str | Estimator]:
    """Return the methods that the table compares, by the names of their rows.

    They are SDP and penalty on the same constraints, the penalty method as published,
    the defaults, and the published links with fitted friction.

    Parameters
    ----------
    study : Study
        The robot's data sets and every method's estimate, computed on demand.

    Returns
    -------
    mapping of str to str or Estimator
        The name of an estimator, or an estimator with settings of its own.
    """
    published = {
        f"{column}{PUBLISHED_LINKS}": Frozen(links)
        for column, links in study.published_links.items()
    }
    return {
        SDP: SameConstraints(),
        PENALTY: Penalty(),
        "penalty, two-step": PenaltyTwoStep(),
        "penalty as published, one-step": "penalty-paper",
        "penalty as published, two-step": study.estimator("penalty-paper-two-step"),
        "SDP, default (entropic prior)": "lmi-sdp",
        "least squares": "ols",
        **published,
    }


@register_table("routes", "panda", slow=True)
def routes(study: Study) -> StudyTable:
    """Routes table: SDP and penalty on the same constraints, and the paper's methods.

    They are judged on folds of the real run; on the simulated runs where it is absent.
    """
    data = study.repeated or study.simulated
    names = routes_of(study)
    study.estimate(names.values(), [data])
    judged: dict[str, CrossValidation] = {}
    if data is not study.simulated:
        judged = {name: study.unseen(method) for name, method in names.items()}
    rows = [row_of(study, data, name, names, judged) for name in names]
    return StudyTable(
        f"One problem, two routes: {study.problem.title}",
        rows,
        notes(
            "routes",
            judged=_JUDGED_BY_FOLDS if judged else _JUDGED_BY_RUNS,
            trained_on=", on the first 14 s" if judged else "",
            budget=study.effort.evaluations or _THEIR_BUDGET,
            runs=study.effort.annealing_runs,
            repeats=REPEATS,
        ),
        digits=3,
    )


def row_of(
    study: Study,
    data: Data,
    name: str,
    methods: Mapping[str, str | Estimator],
    judged: Mapping[str, CrossValidation],
) -> Row:
    """Return a method's row: its error on unseen motion, the difference from the SDP's,
    both with their intervals; its loss above the optimum, violations and time.

    Parameters
    ----------
    name : str
        Name of the row.
    methods, judged : mapping
        Methods, and their cross-validations on the real run (empty without it), by the
        name of their row.
    """
    result = study.estimated(methods[name], data)
    task = study.task(data)
    optimum = study.estimated("lmi-sdp-plain", data).certificate.lower
    assert optimum is not None
    error = error_interval(judged[name]) if judged else None
    is_compared = judged and name != SDP
    difference = error_interval(judged[name], judged[SDP]) if is_compared else None
    of_links, of_friction = worst_violations(task, result.theta)
    links = link_figures(study.problem, result.theta[task.links])
    is_published = name.endswith(PUBLISHED_LINKS)
    return {
        "method": name,
        "unseen_error_percent": error.value if error else data.errors(result.theta)[1],
        "interval_percent": error and error.in_words,
        "less_sdp_points": difference and difference.value,
        "less_sdp_interval": difference and difference.in_words,
        "excess_loss_percent": 100.0 * (task.data.loss(result.theta) / optimum - 1.0),
        "gap": result.certificate.gap,
        "links_violation": of_links,
        "friction_violation": of_friction,
        "positive_definite_percent": 100.0 * links["positive_definite_share"],
        "seconds": None if is_published else study.seconds(methods[name], data),
        "data": f"{data.label}, unseen" if judged else data.label,
    }


#: Evaluations of the loss that a run of annealing has where none are stated.
_THEIR_BUDGET = (
    "at most 3000 a parameter and weight, half for annealing (their program's limit)"
)
#: The public runs of each arm that are taken; empty: all.
RUNS = {
    "ur10e": (
        "ur-20_02_12-50sec_12harm",
        "ur-20_02_19_14harm50sec",
        "ur-20_02_19_15harm50sec",
    ),
    "tx40": (),
}
METHODS: dict[str, str | Estimator] = {
    SDP: SameConstraints(),
    PENALTY: Penalty(),
    "penalty, two-step": PenaltyTwoStep(),
    "SDP, default (entropic prior)": LmiSdp(),
    "least squares": Ols(),
}


@register_table("arms", *RUNS, slow=True)
def arms(study: Study) -> StudyTable:
    """Arms table: SDP beside penalty on the UR10e and the TX40.

    Both arms are in the table, whatever the study's problem. Raises InputError without
    the real runs.
    """
    rows = [row for name in RUNS for row in _rows(study, name)]
    return StudyTable(
        "SDP beside penalty on other arms",
        rows,
        notes("arms", folds=FOLDS, repeats=REPEATS),
        digits=3,
        caption="Measured: public runs of a UR10e (three of 50 s) and a TX40 (9 s).",
    )


def _rows(study: Study, name: str) -> list[Row]:
    """Return the row of each method on an arm's runs."""
    arm = study.sibling(load_problem(name))
    arm.run = _runs(name)
    assert arm.measured is not None
    judged = {method: arm.unseen(estimator) for method, estimator in METHODS.items()}
    return [
        {"arm": name, **row_of(arm, arm.measured, method, METHODS, judged)}
        for method in METHODS
    ]


def _runs(name: str) -> Measurements:
    """Return the chosen public runs of an arm; InputError where they are not at hand."""
    files = measured_runs(name)
    if not files:
        raise InputError(
            f"table arms is about real runs, and those of {name} are not at hand",
            "name the folder of the measurements by SDP_VS_PENALTY_DATA",
        )
    return concatenate([files[run] for run in RUNS[name] or files])
