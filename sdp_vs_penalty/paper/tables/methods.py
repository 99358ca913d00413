"""Methods compared: all of them on every data set."""

from collections.abc import Mapping, Sequence

import pandas

from sdp_vs_penalty.estimation.constants import ROUNDING
from sdp_vs_penalty.estimation.link_figures import link_figures
from sdp_vs_penalty.estimators import estimator_types
from sdp_vs_penalty.estimators.estimator import Estimator
from sdp_vs_penalty.paper.tables.study import FOLDS, WITH_PRIOR, Data, Frozen, Study
from sdp_vs_penalty.paper.tables.table import Row, StudyTable, notes, register_table
from sdp_vs_penalty.robot import inertia


@register_table("methods", slow=True)
def methods(study: Study) -> StudyTable:
    """Method table: every method on every data set, judged by the same independent
    figures.
    """
    rows = [
        _row(study, data, method)
        for data in study.judged
        for method in (*estimator_types(), *WITH_PRIOR)
    ]
    return StudyTable(
        f"Methods compared on {study.problem.title}",
        rows,
        notes("methods", folds=FOLDS, budget=study.budget),
        digits=3,
    )


def _row(study: Study, data: Data, method: str) -> Row:
    """Return the row of a method on a data set: loss, violation, links, errors and
    time.

    The loss is compared with a certified lower bound of the loss of all feasible
    parameters. Reverse engineering identifies a black box (torques of the true links at
    chosen states) instead of a log: its links are taken, and friction is fitted to the
    data set.
    """
    optimum = study.estimated("lmi-sdp-plain", data).certificate.lower
    assert optimum is not None
    of_black_box = (
        method not in WITH_PRIOR and estimator_types()[method].needs_black_box
    )
    estimator: str | Estimator = method
    if of_black_box:
        estimator = Frozen(study.reverse_engineered.theta.reshape(-1, 10))
    result = study.estimated(estimator, data)
    theta = result.theta
    task = study.task(data)
    links = theta[task.links]
    violations = task.constraints.worst(theta)
    family = max(violations, key=lambda name: (violations[name], name))
    worst = violations[family]
    figures = link_figures(study.problem, links)
    # With a joint prior the losses of runs hold it too.
    runs = [] if method in WITH_PRIOR else result.details.get("runs") or []
    return {
        "data": data.label,
        "method": method,
        "excess_loss_percent": 100.0 * (task.data.loss(theta) / optimum - 1.0),
        "worst_violation": worst,
        "violated_family": family if worst >= ROUNDING else None,
        "smallest_eigenvalue": float(inertia.consistency_margin(links).min()),
        "smallest_thickness_mm": 1e3 * figures["smallest_thickness"],
        **_errors(study, data, estimator),
        "positive_definite_percent": 100.0 * figures["positive_definite_share"],
        # No time of a black box beside those of fits to torque.
        "seconds": None if of_black_box else study.seconds(method, data),
        **_independent_runs(runs, optimum),
    }


def _errors(study: Study, data: Data, estimator: str | Estimator) -> Row:
    """Return a method's errors on unseen motion, on the worst fold, and
    repeatability.
    """
    error = data.errors(study.theta(estimator, data))[1]
    if data is study.simulated:
        return {
            "unseen_error_percent": error,
            "worst_fold_error_percent": None,
            "repeatability_error_percent": None,
        }
    unseen = study.unseen(estimator)
    worst = unseen.folds[unseen.worst_fold - 1]
    return {
        "unseen_error_percent": unseen.relative_error_percent,
        "worst_fold_error_percent": worst.relative_error_percent,
        "repeatability_error_percent": error,
    }


def _independent_runs(runs: Sequence[Mapping[str, float]], optimum: float) -> Row:
    """Return the cells on a multi-start method: number of runs, and where they ended.

    - ``runs``: loss and violation of each.
    - ``optimum``: certified lower bound of the loss.
    """
    frame = pandas.DataFrame(runs, columns=["loss", "violation"]).astype(float)
    excess = 100.0 * (frame["loss"] / optimum - 1.0)
    violation = frame["violation"]
    row: Row = {
        "runs": len(frame) or None,
        "feasible_runs": int((violation < 1e-6).sum()) if len(frame) else None,
    }
    for name in ("min", "median", "max"):
        row[f"run_excess_loss_percent_{name}"] = excess.agg(name)
    for name in ("min", "max"):
        row[f"run_violation_{name}"] = violation.agg(name)
    return row
