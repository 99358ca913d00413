"""Table "routes": one problem, two routes: SDP and penalty on the same constraints."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from sdp_vs_penalty.estimation.link_figures import link_figures
from sdp_vs_penalty.estimation.resampling import CrossValidation
from sdp_vs_penalty.estimators.estimator import Estimator, Task
from sdp_vs_penalty.estimators.lmi_sdp import LmiSdp
from sdp_vs_penalty.estimators.penalty import Penalty, PenaltyTwoStep
from sdp_vs_penalty.paper.estimates import REPEATS
from sdp_vs_penalty.paper.tables.folds import error_interval
from sdp_vs_penalty.paper.tables.study import (
    FOLDS,
    Data,
    Frozen,
    Result,
    Study,
    worst_violations,
)
from sdp_vs_penalty.paper.tables.table import Row, Table, notes, register_table
from sdp_vs_penalty.problem.problem import Problem

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
def routes(study: Study) -> Table:
    """One problem, two routes: SDP and penalty on the same constraints, and the paper's.

    Without the real run the simulated one, whose motion is judged without folds.
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
            budget=budget_in_words(study.effort.evaluations),
            runs=study.effort.annealing_runs,
            repeats=REPEATS,
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
    """Return a method's row: errors, loss above the optimum, violations, time.

    names : methods by row; judged : their cross-validations on the real run, if there
    are any.
    """
    result = study.estimated(names[name], data)
    is_published = name.endswith(PUBLISHED_LINKS)
    errors = errors_of(name, judged)
    if not judged:
        errors["unseen_error_percent"] = data.errors(result.theta)[1]
    optimum = study.result("lmi-sdp-plain", data).certificate.lower
    assert optimum is not None
    return {
        "method": name,
        **errors,
        **figures_of(study.problem, study.task(data), result, optimum),
        "seconds": None if is_published else study.seconds(names[name], data),
        "data": data.label if data is study.simulated else f"{data.label}, unseen",
    }


def figures_of(problem: Problem, task: Task, result: Result, optimum: float) -> Row:
    """Return what an estimate is, whatever motion it is judged on.

    optimum : certified least loss of any consistent parameters.
    """
    of_links, of_friction = worst_violations(task, result.theta)
    links = link_figures(problem, result.theta[task.links])
    return {
        "excess_loss_percent": 100.0 * (task.data.loss(result.theta) / optimum - 1.0),
        "gap": result.certificate.gap,
        "links_violation": of_links,
        "friction_violation": of_friction,
        "positive_definite_percent": 100.0 * links["positive_mass_matrices"],
    }


def errors_of(name: str, judged: Mapping[str, CrossValidation]) -> Row:
    """Return a method's error on unseen motion with its interval, and its difference
    from the SDP's; without values where nothing was judged."""
    error = less = None
    if judged:
        error = error_interval(judged[name])
        if name != SDP:
            less = error_interval(judged[name], judged[SDP])
    return {
        "unseen_error_percent": error and error.value,
        "interval_percent": error and error.in_words,
        "less_sdp_points": less and less.value,
        "less_sdp_interval": less and less.in_words,
    }


def budget_in_words(evaluations: int | None) -> str:
    """Return how many evaluations of the loss a run of annealing has, as text."""
    if evaluations is None:
        return "3000 a parameter and weight (the authors' program allows as many)"
    return str(evaluations)


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
    less = error_interval(default, squares)
    verdict = "significant" if less.is_significant else "not significant"
    return (
        f"{sentence} The default SDP less least squares: {less.value:+.2f} points,"
        f" t = {less.t:.2f} on {len(default.folds)} folds, {verdict}."
    )
