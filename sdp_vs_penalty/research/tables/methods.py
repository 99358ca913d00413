"""Methods compared: all of them on every data set."""

import pandas

from sdp_vs_penalty.estimation.constants import ROUNDING
from sdp_vs_penalty.estimation.identify import link_figures
from sdp_vs_penalty.estimators import estimator_types
from sdp_vs_penalty.estimators.estimator import Estimator
from sdp_vs_penalty.research.tables.study import (
    FOLDS,
    WITH_PRIOR,
    Data,
    Frozen,
    Result,
    Study,
)
from sdp_vs_penalty.research.tables.table import Row, Table, notes, register_table
from sdp_vs_penalty.robot import inertia


@register_table("methods", slow=True)
def methods(study: Study) -> Table:
    """Method table: every method on every data set, judged by the same independent
    figures."""
    rows = [
        _row(study, data, method)
        for data in study.judged
        for method in (*estimator_types(), *WITH_PRIOR)
    ]
    last = [row for row in rows if row["data"] == rows[-1]["data"]]
    errors = [f"{row['method']} {row['unseen_error_percent']:.3g} %" for row in last]
    return Table(
        f"Methods compared on {study.problem.title}",
        rows,
        notes("methods", folds=FOLDS, budget=study.budget),
        f"On unseen motion ({last[0]['data']}): {', '.join(errors)}.",
        digits=3,
    )


def _row(study: Study, data: Data, method: str) -> Row:
    # The lower bound on the least loss that any feasible theta has.
    optimum = study.result("lmi-sdp-plain", data).certificate.lower
    assert optimum is not None
    estimator: str | Estimator = method
    seconds: float
    if method not in WITH_PRIOR and estimator_types()[method].needs_black_box:
        retrieved = study.reverse_engineered
        estimator = Frozen(retrieved.theta.reshape(-1, 10))
        result = Result(
            study.theta(estimator, data), retrieved.certificate, retrieved.seconds, {}
        )
        seconds = retrieved.seconds
    else:
        result = study.result(method, data)
        seconds = study.seconds(method, data)
    error = data.errors(result.theta)[1]
    fold = None
    again = None
    if data is not study.simulated:
        unseen = study.unseen(estimator)
        again = error
        error = unseen.relative_error_percent
        fold = unseen.folds[unseen.worst - 1].relative_error_percent
    task = study.task(data)
    links = result.theta[task.links]
    violations = task.constraints.worst(result.theta)
    worst, family = max((x, name) for name, x in violations.items())
    figures_of_links = link_figures(study.problem, links)
    # The independent ones of a multi-start method; with a joint prior their losses hold
    # it too.
    runs = pandas.DataFrame(
        [] if method in WITH_PRIOR else result.details.get("runs") or [],
        columns=["loss", "violation"],
    ).astype(float)
    excess = 100.0 * (runs["loss"] / optimum - 1.0)
    broken = runs["violation"]
    return {
        "data": data.label,
        "method": method,
        "excess_loss_percent": 100.0 * (task.data.loss(result.theta) / optimum - 1.0),
        "worst_violation": worst,
        "violated_family": family if worst >= ROUNDING else None,
        "smallest_eigenvalue": float(inertia.consistency_margin(links).min()),
        "smallest_thickness_mm": 1e3 * figures_of_links["smallest_thickness"],
        "unseen_error_percent": error,
        "worst_fold_error_percent": fold,
        "repeatability_error_percent": again,
        "positive_definite_percent": 100.0 * figures_of_links["positive_mass_matrices"],
        "seconds": seconds,
        "runs": len(runs) or None,
        "feasible_runs": int((broken < 1e-6).sum()) if len(runs) else None,
        **{
            f"run_excess_loss_percent_{name}": excess.agg(name)
            for name in ("min", "median", "max")
        },
        **{f"run_violation_{name}": broken.agg(name) for name in ("min", "max")},
    }
