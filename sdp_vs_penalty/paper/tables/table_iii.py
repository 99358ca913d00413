"""Table III: base parameters and friction, published and ours."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas

from sdp_vs_penalty.estimators.ols import condition_number, standard_deviations
from sdp_vs_penalty.paper.tables.study import Data, Study, torque_errors
from sdp_vs_penalty.paper.tables.table import StudyTable, notes, register_table
from sdp_vs_penalty.regression.base_parameters import base_parameter_symbols
from sdp_vs_penalty.regression.black_box import compress_black_box
from sdp_vs_penalty.regression.linalg import deviations
from sdp_vs_penalty.robot.arrays import Array

_CONDITION = "condition number"
_ERROR = "relative error [%]"
_DETAILS = {_CONDITION: "condition_number", _ERROR: "relative_error_percent"}
#: Figures of the paper's two fits that are in its text: condition number, relative
#: error [%].
_PUBLISHED_FITS = {"pi_RE": ("48.9", "0.0315"), "pi_CLS": ("121.88", "1.41")}
#: Where published cells are from that are easily taken for misread ones.
_SOURCES = (
    "Published cells are those of the supplementary material, revised October 15th, 2019."
    " Rows 2 (its symbol) and 17 (pi_p_hat) are as printed there, though errata 5 and 2"
    " show that they are wrong; pi_p_hat of rows 8 and 24 is empty there. The published"
    " condition numbers and relative errors are not of that table but of the paper's"
    " text (secs. III and IV)."
)


@dataclass(frozen=True)
class PrintedDeviations:
    """How the standard deviations that Table III prints of the reverse engineering
    agree with those of its design."""

    #: Number of rows of the table.
    n_rows: int
    #: Number of rows whose printed digits allow the common factor.
    n_agreeing: int
    #: Residual standard deviation that all deviations share [N m, kg m^2].
    factor: float


def printed_deviations(
    printed: Sequence[Mapping[str, str]], design: Array
) -> PrintedDeviations:
    """Check whether printed values and standard deviations of Table III agree.

    |pi_RE| sigma_pct_RE / 100 must be the standard deviations of the design times one
    factor, within the digits that are printed.

    Parameters
    ----------
    printed : sequence of mapping
        The table's rows as printed, one for each base parameter.
    design : (b,) array
        sqrt(diag((W^T W)^-1)) of the regressor W in the base parameters.

    Returns
    -------
    PrintedDeviations
        With the factor on which most rows agree.
    """
    values = np.array([_digits_range(row["pi_RE"]) for row in printed])
    percent = np.array([_digits_range(row["sigma_pct_RE"]) for row in printed])
    # The factors between which each row's printed digits leave the one of all rows. How
    # many rows agree on a factor changes for the better at lower ends only.
    low, high = (values * percent / 100.0).T / design
    agreeing = [int(((low <= x) & (x <= high)).sum()) for x in low]
    best = int(np.argmax(agreeing))
    allowed = high[(low <= low[best]) & (low[best] <= high)]
    factor = 0.5 * float(low[best] + allowed.min())
    return PrintedDeviations(len(design), agreeing[best], factor)


def _digits_range(text: str) -> tuple[float, float]:
    """Return the smallest and the largest absolute value that is printed as this text:
    "-1.25e-2" gives (0.01245, 0.01255), half a unit of the last digit on both sides."""
    mantissa, _, exponent = text.lower().partition("e")
    n_decimals = len(mantissa.partition(".")[2])
    half = 0.5 * 10.0 ** (int(exponent or 0) - n_decimals)
    size = abs(float(text))
    return max(size - half, 0.0), size + half


def _published_checks(study: Study, printed: Sequence[Mapping[str, str]]) -> str:
    """Say whether the printed figures of the reverse engineering agree with each other.

    "" if the authors' configurations are not at hand.
    """
    box, has_authors_file = study.black_box
    if not has_authors_file:
        return ""
    data = compress_black_box(box, study.problem.model("rigid_body")).least_squares()
    design = deviations(data.R @ np.linalg.pinv(study.base))
    found = printed_deviations(printed[: len(design)], design)
    return (
        "pi_RE and sigma_pct_RE check each other. Their product is the standard deviation"
        " that least squares have at the authors' 1010 configurations, times one factor"
        f" ({found.factor:.4g}), within the printed digits in {found.n_agreeing} of"
        f" {found.n_rows} rows. So rows 8 and 24, whose figures (30.3622 %, 218.6430 %)"
        " look misread, are as printed. This checks sizes, not signs. pi_p_hat is checked"
        " by Tables VIII and IX (table errata); pi_CLS and pi_OSI cannot be: their filters"
        " are not public."
    )


@register_table("III")
def base_parameter_table(study: Study) -> StudyTable:
    """Table III: base parameters and friction, published and ours.

    Rows: base parameters, all other parameters, then condition number and relative
    error.
    """
    base = tuple(base_parameter_symbols(study.problem))
    others = dict.fromkeys(
        name for data in study.whole for name in _effect_parameter_names(data)
    )
    keys = [*base, *others, _CONDITION, _ERROR]
    printed = study.problem.published.get("table_III")
    known = {"true_simulated": study.experiment.links}
    if printed is not None:
        rows = _published(printed, keys, len(base))
    else:
        # Number and symbol of each row; condition number and error have no number.
        symbols = [*base_parameter_symbols(study.problem).values(), *keys[len(base) :]]
        numbers = [*range(1, len(keys) - 1), None, None]
        rows = pandas.DataFrame(
            {"row": numbers, "coefficient": symbols}, keys, dtype=object
        )
        published = {f"pi_{k}": links for k, links in study.published_links.items()}
        known = published | known
    our_values = {
        name: dict(zip(base, study.base @ links.ravel(), strict=True))
        for name, links in known.items()
    }
    # From the black box: torques of the true links at chosen states.
    retrieved = study.reverse_engineered
    our_values["re_simulated"] = {
        **dict(zip(base, study.base @ retrieved.theta, strict=True)),
        **{key: retrieved.details[name] for key, name in _DETAILS.items()},
    }
    study.estimate(study.methods.values(), study.whole)
    for data in study.whole:
        our_values |= _estimates(study, data, base)
    table = StudyTable(
        f"Table III: base parameters of {study.problem.title}",
        rows.join(pandas.DataFrame(our_values)),
        _notes(study, printed),
    )
    printed_columns = [name for name in rows if name != "row"]
    links = [f"pi_{column}" for column in study.published_links]
    columns = [*printed_columns, *links, *study.compared_columns]
    return table.shortened(dict.fromkeys(columns))


def _notes(study: Study, printed: Sequence[Mapping[str, str]] | None) -> list[str]:
    """Return the notes below the table; printed : the published rows, if there are
    any.
    """
    box, has_authors_file = study.black_box
    where = f"{box.samples} random (the authors' file is absent)"
    if has_authors_file:
        where = "the authors' 1010"
    return notes(
        "III",
        where=where,
        priors=study.about_priors,
        published="" if printed is None else _SOURCES,
        checks="" if printed is None else _published_checks(study, printed),
    )


def _effect_parameter_names(data: Data) -> list[str]:
    """Return the names of the parameters that belong to effects such as friction, not
    to links: ["f_v1", "f_c1", ...], in the order of theta."""
    names = (p.name for p in data.model.parameters)
    return np.delete(list(names), data.model.rigid_indices).tolist()


def _published(
    printed: Sequence[Mapping[str, str]], keys: list[str], base: int
) -> pandas.DataFrame:
    """Return the paper's columns as printed, with its condition numbers and errors
    below.

    - ``keys``: names of all rows of the table.
    - ``base``: number of base parameters.
    """
    names = [*keys[:base], *(row["coefficient"] for row in printed[base:])]
    fits = pandas.DataFrame(_PUBLISHED_FITS, [_CONDITION, _ERROR])
    rows = pandas.concat(
        [pandas.DataFrame(printed, names, dtype=object), fits]
    ).reindex(keys)
    return rows.assign(
        coefficient=rows["coefficient"].fillna(pandas.Series(keys, keys))
    )


def _estimates(
    study: Study, data: Data, base_names: tuple[str, ...]
) -> dict[str, dict[str, float]]:
    """Return the columns of the table for one data set: name of column -> row -> value.

    Rows are the base parameters (``base_names``), the parameters of the effects, and
    the relative torque error. Least squares (``ols``) have a row more, the condition
    number of the regressor, and a column more: their standard deviations in per cent
    of the estimates.
    """
    task = study.task(data)
    rigid = data.model.rigid_indices  # places of the links' parameters in theta
    row_names = [*base_names, *_effect_parameter_names(data)]
    columns = {}
    for name, method in study.methods.items():
        theta = study.theta(method, data)
        base_parameters = study.base @ theta[rigid]  # (b, 10 n) @ (10 n,)
        effect_parameters = np.delete(theta, rigid)
        cells = [*base_parameters, *effect_parameters]
        values = dict(zip(row_names, cells, strict=True))
        _, relative_error = torque_errors(data.regression, theta)
        values[_ERROR] = relative_error
        columns[f"{name}_{data.label}"] = values
        if name == "ols":
            # As the paper's, the condition number is that of rows without weights.
            unweighted = replace(task, data=data.regression.least_squares())
            values[_CONDITION] = condition_number(unweighted)
            pi, std = standard_deviations(task, data.regression.oversampling)
            percent = 100.0 * std / np.abs(pi)
            # A row that other effects share with the links has no deviation of its own.
            leading = (task.base.parameters[k] for k in task.base.leading)
            columns[f"sigma_pct_ols_{data.label}"] = {
                row: percent_of_row
                for row, percent_of_row in zip(leading, percent, strict=True)
                if row in row_names
            }
    return columns
