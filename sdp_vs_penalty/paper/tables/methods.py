"""Method table: every method on every data set, judged by the same independent figures."""

from __future__ import annotations

import numpy as np

from sdp_vs_penalty.estimation.certify import positive_mass_matrices
from sdp_vs_penalty.estimators import estimator_types
from sdp_vs_penalty.paper.tables.study import Data, Result, Study, sentence
from sdp_vs_penalty.paper.tables.table import ROUNDING, Cell, Column, Table
from sdp_vs_penalty.robot import inertia

NAME = "methods"
SLOW = True

_COLUMNS = (
    "data",
    "method",
    "excess_loss_percent",
    "worst_violation",
    "violated_family",
    "smallest_eigenvalue",
    "smallest_thickness_mm",
    "held_out_error_percent",
    "positive_definite_percent",
    "seconds",
    "runs",
    "feasible_runs",
    "run_excess_loss_percent_min",
    "run_excess_loss_percent_median",
    "run_excess_loss_percent_max",
    "run_violation_min",
    "run_violation_max",
)


def build(study: Study) -> Table:
    rows = []
    for data in study.judged:
        optimum = certified_optimum(study, data)
        for method, kind in estimator_types().items():
            if kind.needs_black_box:
                links = study.reverse_engineered.theta.reshape(-1, 10)
                result = _with_links(study, data, links)
            else:
                result = study.result(method, data)
            rows.append(_row(study, data, method, result, optimum))
    return Table(
        NAME,
        f"Methods compared on {study.problem.title}",
        sentence(study),
        tuple(Column(name, digits=3) for name in _COLUMNS),
        tuple(rows),
        (
            "excess_loss_percent: loss over the certified lower bound of the constrained optimum (that "
            "of lmi-sdp-plain); negative only for what is not feasible. Two-step methods minimise "
            "another distance, bodies, minimum thickness and entropy cost some loss by design.",
            "worst_violation: over every constraint family of the problem, in that family's units, "
            "those included that the method did not receive; smallest_eigenvalue: of the links' "
            "pseudo-inertias.",
            "held_out_error_percent: simulated validation trajectories, or the rest of the real run. "
            "reverse-engineering has the links of the simulated black box, friction refitted on the "
            "training part: on measured data it says how far the published p_hat is from the real "
            "arm.",
            "positive_definite_percent: share of 10 000 random poses at which M(q) is positive "
            "definite. seconds: to fit from compressed data, on the machine that wrote this table.",
            "runs: independent starts of one fit; feasible_runs end with every violation below 1e-6; "
            f"budget {study.budget}.",
        ),
    )


def certified_optimum(study: Study, data: Data) -> float:
    """The lower bound on the least loss that any feasible theta has."""
    lower = study.result("lmi-sdp-plain", data).certificate.lower
    assert lower is not None
    return lower


def _with_links(study: Study, data: Data, links: np.ndarray) -> Result:
    theta = study.frozen_links(links, data)
    found = study.reverse_engineered
    return Result(theta, found.certificate, found.seconds, {})


def _row(study: Study, data: Data, method: str, result: Result, optimum: float) -> tuple[Cell, ...]:
    task = study.task(data)
    links = result.theta[task.links]
    violations = task.constraints.worst(result.theta)
    family = max(violations, key=lambda name: violations[name])
    worst = violations[family]
    _, error = data.errors(result.theta)
    share = positive_mass_matrices(study.problem.robot, links)
    return (
        data.label,
        method,
        _excess(task.data.loss(result.theta), optimum),
        worst,
        family if worst >= ROUNDING else None,
        float(inertia.consistency_margin(links).min()),
        1e3 * float(inertia.thickness(links).min()),
        error,
        100.0 * share,
        result.seconds,
        *_runs(result, optimum),
    )


def _runs(result: Result, optimum: float) -> tuple[Cell, ...]:
    """How the independent runs of a multi-start method ended."""
    runs = result.details.get("runs")
    if not runs:
        return (None,) * 7
    excess = [_excess(run["loss"], optimum) for run in runs]
    violations = [float(run["violation"]) for run in runs]
    return (
        len(runs),
        sum(v < 1e-6 for v in violations),
        min(excess),
        float(np.median(excess)),
        max(excess),
        min(violations),
        max(violations),
    )


def _excess(loss: float, optimum: float) -> float:
    return 100.0 * (loss / optimum - 1.0)
