"""Table "routes": one problem, two routes: SDP and penalty on the same constraints."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from sdp_vs_penalty.estimation.constants import ROUNDING
from sdp_vs_penalty.estimation.link_figures import link_figures
from sdp_vs_penalty.estimation.resampling import CrossValidation
from sdp_vs_penalty.estimators.estimator import Estimator
from sdp_vs_penalty.estimators.lmi_sdp import LmiSdp
from sdp_vs_penalty.estimators.penalty import Penalty, PenaltyTwoStep
from sdp_vs_penalty.paper.tables.folds import (
    FoldInterval,
    difference,
    fold_errors,
    interval_of,
)
from sdp_vs_penalty.paper.tables.study import FOLDS, Data, Frozen, Result, Study
from sdp_vs_penalty.paper.tables.table import Row, Table, notes, register_table

#: The rows that solve one problem: torque loss, 20 mm, bodies, no prior on anything.
SDP = "SDP"
PENALTY = "penalty, one-step"

_JUDGED_BY_FOLDS = (
    f"unseen_error_percent: on {FOLDS} folds by phase of the real run, each estimated"
    " without a stretch of the motion and all its repetitions; interval_percent: 95 %"
    " interval of the mean over folds (Student's t); less_sdp: the first row's error"
    " subtracted fold by fold, with its 95 % interval: zero inside it means that these"
    " folds do not tell the two apart."
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
        f"{column} (published links)": Frozen(links)
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
def routes(study: Study) -> Table:
    """One problem, two routes: SDP and penalty on the same constraints, and the paper's.

    Without the real run the simulated one, whose motion is judged without folds.

    Parameters
    ----------
    study : Study
        The robot's data sets and every method's estimate, computed on demand.

    Returns
    -------
    Table
        Rows, notes and headline.
    """
    data = study.repeated or study.simulated
    names = routes_of(study)
    study.estimate(names.values(), [data])
    judged: dict[str, CrossValidation] = {}
    if data is not study.simulated:
        study.judge_unseen((method, None) for method in names.values())
        judged = {name: study.unseen(method) for name, method in names.items()}
    rows = [_row(study, data, name, names, judged) for name in names]
    return Table(
        f"One problem, two routes: {study.problem.title}",
        rows,
        notes(
            "routes",
            judged=_JUDGED_BY_FOLDS if judged else _JUDGED_BY_RUNS,
            trained_on=", on the first 14 s" if judged else "",
            budget=study.effort.evaluations,
            fold_budget=study.effort.fold_evaluations,
            two_step_budget=study.effort.two_step_fold_evaluations,
            runs=study.effort.annealing_runs,
        ),
        _headline(rows, judged),
        digits=3,
    )


def _row(
    study: Study,
    data: Data,
    name: str,
    names: Mapping[str, str | Estimator],
    judged: Mapping[str, CrossValidation],
) -> Row:
    """Return a method's row: errors, loss above the optimum, violation, time.

    names : methods by row; judged : their cross-validations on the real run, if there
    are any.
    """
    result = study.estimated(names[name], data)
    optimum = study.result("lmi-sdp-plain", data).certificate.lower
    assert optimum is not None
    task = study.task(data)
    worst = max(task.constraints.worst(result.theta).values())
    links = link_figures(study.problem, result.theta[task.links])
    searched = not name.endswith("(published links)")
    return {
        "method": name,
        **_errors(study, data, name, result, judged),
        "excess_loss_percent": 100.0 * (task.data.loss(result.theta) / optimum - 1.0),
        "gap": result.certificate.gap,
        "worst_violation": worst if worst >= ROUNDING else 0.0,
        "positive_definite_percent": 100.0 * links["positive_mass_matrices"],
        "seconds": study.seconds(names[name], data) if searched else None,
        "data": data.label if data is study.simulated else f"{data.label}, unseen",
    }


def _errors(
    study: Study,
    data: Data,
    name: str,
    result: Result,
    judged: Mapping[str, CrossValidation],
) -> Row:
    """Return a method's error on unseen motion, its interval, and its difference from
    the SDP's error.
    """
    if name not in judged:
        error = data.errors(result.theta)[1]
        return {
            "unseen_error_percent": error,
            "interval_percent": None,
            "less_sdp_points": None,
            "less_sdp_interval": None,
        }
    interval: FoldInterval = interval_of(fold_errors(judged[name]))
    less = None if name == SDP else difference(judged[name], judged[SDP])
    return {
        "unseen_error_percent": judged[name].relative_error_percent,
        "interval_percent": interval.in_words,
        "less_sdp_points": None if less is None else less.mean,
        "less_sdp_interval": None if less is None else less.in_words,
    }


def _headline(rows: list[Row], judged: Mapping[str, CrossValidation]) -> str:
    """Return the table's headline: how SDP and penalty compare on the same problem, and
    how the default SDP compares with least squares on unseen motion (only with the real
    run)."""
    by_name = {row["method"]: row for row in rows}
    sdp = by_name[SDP]
    penalty = by_name[PENALTY]
    sentence = (
        f"On one problem the SDP and the exact penalty tie: loss"
        f" {sdp['excess_loss_percent']:.5f} and {penalty['excess_loss_percent']:.5f} %"
        f" over the optimum, {sdp['seconds']:.2g} and {penalty['seconds']:.2g} s."
    )
    if not judged:
        return sentence
    default = judged["SDP, default (entropic prior)"]
    squares = judged["least squares"]
    less = difference(default, squares)
    verdict = "significant" if less.is_significant else "not significant"
    return (
        f"{sentence} The default SDP less least squares: {less.mean:+.2f} points,"
        f" t = {less.t:.2f} on {len(default.folds)} folds, {verdict}."
    )
