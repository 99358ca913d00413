"""Table III: base parameters and friction, published and ours."""

from dataclasses import replace
from itertools import zip_longest

import numpy as np
import pandas

from sdp_vs_penalty.estimators import DEFAULT_METHOD
from sdp_vs_penalty.estimators.ols import condition_number, standard_deviations
from sdp_vs_penalty.regression.base_parameters import base_parameter_symbols
from sdp_vs_penalty.research.tables.study import Data, Study, torque_errors
from sdp_vs_penalty.research.tables.table import Row, Table, makes, notes

_CONDITION, _ERROR = "condition number", "relative error [%]"
_DETAILS = {_CONDITION: "condition_number", _ERROR: "relative_error_percent"}
#: Figures of the paper's two fits that are in its text: condition number, relative error [%].
_PUBLISHED_FITS = {"pi_RE": ("48.9", "0.0315"), "pi_CLS": ("121.88", "1.41")}


@makes("III")
def base_parameter_table(study: Study) -> Table:
    """Table III: base parameters and friction, published and ours.

    Rows: base parameters, all other parameters, then condition number and relative error.
    """
    base = tuple(base_parameter_symbols(study.problem))
    others = dict.fromkeys(name for data in study.whole for name in _others(data))
    keys = [*base, *others, _CONDITION, _ERROR]
    rows = _published(study, keys) or _own_rows(study, keys)
    truth, found = study.base @ study.experiment.links.ravel(), study.reverse_engineered
    ours = {
        "true_simulated": dict(zip(base, truth, strict=True)),
        "re_simulated": dict(zip(base, study.base @ found.theta, strict=True))
        | {key: found.details[name] for key, name in _DETAILS.items()},
    }
    study.estimate(study.methods.values(), study.whole)
    for data in study.whole:
        ours |= _estimates(study, data, base)
    box, authors = study.black_box
    where = "the authors' 1010" if authors else f"{box.samples} random (the authors' file is absent)"
    shown = [f"{method}_{d.label}" for d in study.whole for method in ("ols", DEFAULT_METHOD)]
    names = (name.replace("-", "_") for name in shown)
    errors = [f"{name} {ours[name][_ERROR]:.3g} %" for name in names]
    return Table(
        f"Table III: base parameters of {study.problem.title}",
        pandas.DataFrame(rows, keys, dtype=object).join(pandas.DataFrame(ours)),
        notes("III", where=where, priors=study.about_priors),
        f"Relative error on the training data: {', '.join(errors)}.",
    )


def _others(data: Data) -> list[str]:
    """Names of the parameters that are no link's."""
    names = (p.name for p in data.model.parameters)
    return np.delete(list(names), data.model.rigid_indices).tolist()


def _published(study: Study, keys: list[str]) -> list[Row]:
    """The paper's own columns, row by row as printed; its two fits' figures below."""
    printed = study.problem.published.get("table_III")
    if printed is None:
        return []
    base = len(study.base)
    by_key = {keys[k] if k < base else row["coefficient"]: row for k, row in enumerate(printed)}
    for which, key in enumerate((_CONDITION, _ERROR)):
        by_key[key] = {column: pair[which] for column, pair in _PUBLISHED_FITS.items()}
    rows = (by_key.get(key, {}) for key in keys)
    return [
        {c: row.get(c, key if c == "coefficient" else None) for c in printed[0]}
        for key, row in zip(keys, rows, strict=True)
    ]


def _own_rows(study: Study, keys: list[str]) -> list[Row]:
    """For robots without a Table III: symbols from the kinematics, published links if any."""
    symbols = [*base_parameter_symbols(study.problem).values(), *keys[len(study.base) :]]
    figures = _CONDITION, _ERROR
    rows: list[Row] = [
        {"row": None if symbol in figures else k, "coefficient": symbol}
        for k, symbol in enumerate(symbols, start=1)
    ]
    for column, links in study.published_links.items():
        pi = (study.base @ links.ravel()).tolist()
        for row, value in zip_longest(rows, pi):
            row[f"pi_{column}"] = value
    return rows


def _estimates(study: Study, data: Data, base: tuple[str, ...]) -> dict[str, dict[str, float]]:
    """Every method; after OLS its percent standard deviations."""
    task, rigid = study.task(data), data.model.rigid_indices
    keys = [*base, *_others(data)]
    out = {}
    for name, method in study.methods.items():
        theta = study.theta(method, data)
        values = dict(zip(keys, [*(study.base @ theta[rigid]), *np.delete(theta, rigid)], strict=True))
        values[_ERROR] = torque_errors(data.regression, theta)[1]
        out[f"{name}_{data.label}"] = values
        if name == "ols":
            values[_CONDITION] = condition_number(replace(task, data=data.regression.least_squares()))
            pi, std = standard_deviations(task, data.regression.oversampling)
            percent = dict(zip(keys, 100.0 * std / np.abs(pi), strict=True))
            out[f"sigma_pct_ols_{data.label}"] = percent
    return out
