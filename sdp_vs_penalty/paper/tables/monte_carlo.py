"""Table "monte_carlo": methods by Monte Carlo, where the truth is known."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from sdp_vs_penalty.paper.monte_carlo import (
    AS_PUBLISHED,
    DEFAULT,
    FAST,
    FULL,
    SETTINGS,
    UNSEEN,
    Draw,
    Method,
    Setting,
    can_exist,
    drawn,
    truth_of,
)
from sdp_vs_penalty.paper.tables.folds import interval_of
from sdp_vs_penalty.paper.tables.study import Study
from sdp_vs_penalty.paper.tables.table import Row, Table, notes, register_table
from sdp_vs_penalty.regression.regression import LeastSquares
from sdp_vs_penalty.robot.arrays import Array

#: Draws of a quick study, of a whole one, and of the published annealing.
QUICK, WHOLE, LONG = 20, 100, 5
#: What every draw of a method gives: theta, seconds, covered.
Draws = list[dict[str, Any]]


@register_table("monte_carlo", "panda", slow=True)
def monte_carlo(study: Study) -> Table:
    """Monte Carlo table: methods on simulated draws whose truth is known.

    Parameters
    ----------
    study : Study
        The robot, the budget, and workers.
    """
    is_quick = study.budget == "quick"
    count = QUICK if is_quick else WHOLE
    plan: list[tuple[tuple[Method, ...], int]] = [(FAST if is_quick else FULL, count)]
    if not is_quick:
        plan += [((method,), LONG) for method in AS_PUBLISHED]
    found = _all_draws(study, plan)
    rows = [
        row
        for setting in SETTINGS
        for row in _rows(study, setting, found[setting.name])
    ]
    return Table(
        f"Methods by Monte Carlo, {study.problem.title}",
        rows,
        notes(
            "monte_carlo", draws=count, long=LONG, default=DEFAULT, unseen=len(UNSEEN)
        ),
        _headline(rows),
        digits=3,
        caption=(
            f"Simulated: {count} draws of each of {len(SETTINGS)} settings; links as the"
            " published p_hat (erratum 1 corrected). Nothing is measured but the noise's"
            " size and colour."
        ),
    )


def _all_draws(
    study: Study, plan: Sequence[tuple[tuple[Method, ...], int]]
) -> dict[str, dict[str, Draws]]:
    """Return every draw by setting and method. Each is kept on the disk when it is done:
    a study that was stopped goes on where it was."""
    draws = [
        Draw(study.problem.name, setting, number, methods)
        for methods, count in plan
        for number in range(count)
        for setting in SETTINGS
    ]
    draws.sort(key=lambda draw: len(draw.methods) > 1)  # annealing first: it is long
    study.progress(f"{len(draws)} draws")
    found: dict[str, dict[str, Draws]] = {setting.name: {} for setting in SETTINGS}
    for draw, results in zip(draws, study.workers.map(drawn, draws), strict=True):
        for name, result in results.items():
            found[draw.setting.name].setdefault(name, []).append(result)
    return found


def _rows(study: Study, setting: Setting, draws: dict[str, Draws]) -> list[Row]:
    """Return the row of each method in a setting."""
    truth = truth_of(study.problem.name, setting)
    unseen = truth.unseen.least_squares()
    rigid = truth.model.rigid_indices
    usual = _errors(unseen, draws[DEFAULT])
    rows = []
    for method in (*FULL, *AS_PUBLISHED):
        if method.name not in draws:
            continue
        of_method = draws[method.name]
        errors = _errors(unseen, of_method)
        thetas = np.array([draw["theta"] for draw in of_method])
        mean = thetas.mean(axis=0)
        spread = [_percent(unseen, unseen.R @ (theta - mean)) for theta in thetas]
        less = interval_of(errors - usual[: len(errors)])
        links = thetas[:, rigid].reshape(len(thetas), -1, 10)
        is_default = method.name == DEFAULT
        rows.append(
            {
                "setting": setting.name,
                "method": method.name,
                "draws": len(errors),
                "error_percent": float(errors.mean()),
                "interval_percent": interval_of(errors).in_words,
                "less_default_points": None if is_default else less.value,
                "less_default_interval": None if is_default else less.in_words,
                "worse_than_default": (
                    None if is_default else int((errors > usual[: len(errors)]).sum())
                ),
                "bias_percent": _error(unseen, mean),
                "spread_percent": float(np.sqrt(np.mean(np.square(spread)))),
                "coverage_percent": 100.0
                * float(np.mean([draw["covered"] for draw in of_method])),
                "exist_percent": 100.0 * float(np.mean([can_exist(x) for x in links])),
                "seconds": float(np.median([draw["seconds"] for draw in of_method])),
                "data": "simulated",
            }
        )
    return rows


def _errors(unseen: LeastSquares, draws: Draws) -> Array:
    """Return each draw's torque error on unseen motion (draws,) [%]."""
    return np.array([_error(unseen, np.array(draw["theta"])) for draw in draws])


def _error(unseen: LeastSquares, theta: Array) -> float:
    """Return 100 |tau - Y theta| / |tau| on the unseen motion, tau without noise."""
    return float(100.0 * np.sqrt(unseen.loss(theta) / unseen.tau_squared))


def _percent(unseen: LeastSquares, torque: Array) -> float:
    """Return the size of a torque in that of the unseen motion [%]."""
    return float(100.0 * np.linalg.norm(torque) / np.sqrt(unseen.tau_squared))


def _headline(rows: Sequence[Row]) -> str:
    """Say for each setting which method errs least, and how the default does."""
    sentences = []
    for setting in SETTINGS:
        mine = [row for row in rows if row["setting"] == setting.name]
        best = min(mine, key=lambda row: row["error_percent"])
        (default,) = (row for row in mine if row["method"] == DEFAULT)
        sentences.append(
            f"{setting.name}: {best['method']} {best['error_percent']:.3g} %, default"
            f" {default['error_percent']:.3g} %"
        )
    return f"Least error on unseen motion: {'; '.join(sentences)}."
