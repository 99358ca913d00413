"""Table III: base parameters and friction, published and ours."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sdp_vs_penalty.estimators import DEFAULT_METHOD
from sdp_vs_penalty.estimators.ols import condition_number, standard_deviations
from sdp_vs_penalty.paper.tables.study import Data, Study, sentence
from sdp_vs_penalty.paper.tables.table import Cell, Column, Table
from sdp_vs_penalty.problem.published import box_tables, published_links
from sdp_vs_penalty.regression.base_parameters import base_parameter_names, base_parameter_symbols

NAME = "III"

_CONDITION, _ERROR = "condition number", "relative error [%]"
#: Figures of the paper's two fits that are in its text: condition number, relative error [%].
_PUBLISHED_FITS = {"pi_RE": ("48.9", "0.0315"), "pi_CLS": ("121.88", "1.41")}


def build(study: Study) -> Table:
    """Rows: base parameters, all other parameters, then condition number and relative error."""
    base = base_parameter_names(study.problem)
    keys = [*base, *_other_names(study), _CONDITION, _ERROR]
    columns, rows = _published(study, keys) or _own_rows(study, keys)
    ours = [
        ("true_simulated", dict(zip(base, study.base @ study.experiment.links.ravel(), strict=True)))
    ]
    ours.append(("re_simulated", _reverse_engineered(study, base)))
    study.estimate(study.methods.values(), study.whole)
    for data in study.whole:
        ours += _estimates(study, data, base)
    for name, values in ours:
        columns.append(Column(name))
        for row, key in zip(rows, keys, strict=True):
            row.append(values.get(key))
    return Table(
        NAME,
        f"Table III: base parameters of {study.problem.title}",
        sentence(study),
        tuple(columns),
        tuple(tuple(row) for row in rows),
        _notes(study),
        f"Relative error on the training data: {_errors(study, dict(ours))}.",
    )


def _errors(study: Study, ours: dict[str, dict[str, float]]) -> str:
    """Of least squares and of the default method."""
    methods = "ols", DEFAULT_METHOD.replace("-", "_")
    names = [f"{method}_{data.label}" for data in study.whole for method in methods]
    return ", ".join(f"{name} {ours[name][_ERROR]:.3g} %" for name in names)


def _notes(study: Study) -> tuple[str, ...]:
    box, authors = study.black_box
    where = "the authors' 1010" if authors else f"{box.samples} random (the authors' file is absent)"
    return (
        f"re_simulated is identified from a simulated black box at {where} configurations. Its relative "
        "error is rounding, because the simulated box has exactly this model: it says nothing beside "
        "the paper's 0.0315 % on the real one.",
        "sigma_pct: percent standard deviations of least squares (eq. 14 of the paper), with filtered "
        "rows counted once per independent sample; the paper counts every sample of its log, which "
        "makes its percentages smaller.",
        "Relative error: on the training data, behind the filters. Condition number: of the regressor "
        "in these parameters, all joints in N m, without joint weights.",
        "true_simulated is the truth of the simulation; its friction is not linear and has no entries.",
        *study.about_priors,
    )


def _other_names(study: Study) -> list[str]:
    names: list[str] = []
    for data in study.whole:
        for k, parameter in enumerate(data.model.parameters):
            if k not in data.model.rigid_indices and parameter.name not in names:
                names.append(parameter.name)
    return names


def _published(study: Study, keys: list[str]) -> tuple[list[Column], list[list[Cell]]] | None:
    """The paper's own columns, row by row as printed; its two fits' figures below."""
    printed = study.problem.published.get("table_III")
    if printed is None:
        return None
    header = list(printed[0])
    base = len(study.base)
    by_key = {keys[k] if k < base else row["coefficient"]: row for k, row in enumerate(printed)}
    figures = {
        key: {column: pair[which] for column, pair in _PUBLISHED_FITS.items()}
        for which, key in enumerate((_CONDITION, _ERROR))
    }
    rows: list[list[Cell]] = []
    for key in keys:
        row = by_key.get(key) or {"coefficient": key, **figures.get(key, {})}
        rows.append([row.get(column) for column in header])
    return [Column(name) for name in header], rows


def _own_rows(study: Study, keys: list[str]) -> tuple[list[Column], list[list[Cell]]]:
    """For robots without a Table III: symbols from the kinematics, published links if any."""
    symbols = base_parameter_symbols(study.problem)
    columns = [Column("row"), Column("coefficient")]
    rows: list[list[Cell]] = []
    for k, key in enumerate(keys):
        figure = key in (_CONDITION, _ERROR)
        rows.append([None if figure else k + 1, symbols[k] if k < len(symbols) else key])
    tables = box_tables(study.problem)
    for column in ("p_real", "p_hat", "delta"):
        if tables and column in study.problem.published[tables[0]][0]:
            pi = study.base @ published_links(study.problem, column).ravel()
            columns.append(Column(f"pi_{column}"))
            for k, row in enumerate(rows):
                row.append(float(pi[k]) if k < len(pi) else None)
    return columns, rows


def _reverse_engineered(study: Study, base: tuple[str, ...]) -> dict[str, float]:
    result = study.reverse_engineered
    return {
        **dict(zip(base, study.base @ result.theta, strict=True)),
        _CONDITION: result.details["condition_number"],
        _ERROR: result.details["relative_error_percent"],
    }


def _estimates(study: Study, data: Data, base: tuple[str, ...]) -> list[tuple[str, dict[str, float]]]:
    """Every method; after OLS its percent standard deviations."""
    task, rigid = study.task(data), data.model.rigid_indices
    others = np.setdiff1d(np.arange(len(data.model.parameters)), rigid)
    keys = [*base, *(data.model.parameters[k].name for k in others)]
    plain = data.regression.least_squares()
    out = []
    for name, method in study.methods.items():
        theta = study.result(method, data).theta
        values = dict(zip(keys, [*(study.base @ theta[rigid]), *theta[others]], strict=True))
        values[_ERROR] = 100.0 * float(np.sqrt(plain.loss(theta) / plain.tau_squared))
        out.append((f"{name}_{data.label}", values))
        if name == "ols":
            values[_CONDITION] = condition_number(replace(task, data=plain))
            pi, std = standard_deviations(task, data.regression.oversampling)
            out.append(
                (
                    f"sigma_pct_ols_{data.label}",
                    dict(zip(keys, 100.0 * std / np.abs(pi), strict=True)),
                )
            )
    return out
