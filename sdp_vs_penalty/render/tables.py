"""Tables of results: terminal, page and report show the same rows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from sdp_vs_penalty.diagnosis.comparison import Comparison
from sdp_vs_penalty.diagnosis.where_it_fails import SHARES, JointFailure
from sdp_vs_penalty.estimation.estimate import (
    LINK_HEADS,
    Estimate,
    link_rows,
    zero_if_rounding,
)
from sdp_vs_penalty.estimation.frames import base_expressions
from sdp_vs_penalty.estimation.uncertainty import Interval
from sdp_vs_penalty.estimation.verdict import over_noise
from sdp_vs_penalty.formatting import change_of, finite, number, plain_unit
from sdp_vs_penalty.results.table import Table

#: Of a table of models: what :func:`judged_cells` says after the name.
JUDGED_HEADS = (
    "verdict",
    "error [%]",
    "largest error / noise",
    "links can exist",
    "thinnest link [mm]",
    "distance to best fit",
)
#: Columns of :data:`JUDGED_HEADS` that hold words, the model's name before them.
JUDGED_WORDS = (0, 1, 4)


def judged_cells(compared: Comparison, grade: str = "") -> list[str]:
    """Cells of one model in a table of judged models.

    Parameters
    ----------
    compared : Comparison
        The model on the judged runs.
    grade : str
        Grade of its verdict where a diagnosis is known; empty: that of its errors.

    Returns
    -------
    list of str
        The model's name, then one cell for each of :data:`JUDGED_HEADS`.
    """
    facts = compared.facts()
    return [
        compared.name,
        grade or compared.verdict.grade,
        facts["relative_error"].texts[0],
        _largest_error(compared),
        "yes" if compared.links_can_exist else "no",
        facts["thinnest_link"].texts[0],
        facts["distance_to_best_fit"].texts[0],
    ]


def _largest_error(compared: Comparison) -> str:
    """Return the largest error as text: multiples of its noise, size and joint.

    If the noise floor is unknown, these are the size and the joint alone.
    """
    facts = compared.facts()
    joint = compared.worst_joint
    unit = plain_unit(compared.estimate.torque_units[joint - 1])
    error = f"{facts['joint_error'].of_joint(joint)} {unit}, joint {joint}"
    if compared.error_over_noise is None:
        return error
    return f"{facts['largest_error_over_noise'].texts[0]} ({error})"


def judged_table(
    rows: Sequence[Sequence[str]], what: str = "model", title: str = "", more: str = ""
) -> Table:
    """Table of models that were judged on the same runs.

    Parameters
    ----------
    what : str
        Heading of the first column, such as "model" or "method".
    more : str
        Heading of one more column of numbers; empty: there is none.

    Returns
    -------
    Table
        One row for each model.
    """
    heads = [what, *JUDGED_HEADS, *([more] if more else [])]
    return Table(heads, rows, title=title, words=JUDGED_WORDS, style=f"judged {what}s")


def error_table(
    names: Sequence[str],
    errors: Sequence[Any],
    floor: Any,
    units: Sequence[str],
    r2: Any = (),
    title: str = "",
) -> Table:
    """Table of each joint's RMS error by model.

    Parameters
    ----------
    errors : (models, n) array or lists
        RMS errors [N m or N].
    floor : (n,) array or None
        RMS noise of each joint; None where it is unknown.
    units : sequence of str
        Torque unit of each joint.
    r2 : (n,) array
        Coefficients of determination, shown for one model alone in place of the change.

    Returns
    -------
    Table
        One row for each joint: errors, change from the first model to the last (or R2), noise,
        and the last model's error over it.
    """
    ratios = over_noise(np.asarray(errors[-1], float), floor)
    rows = []
    for j, unit in enumerate(units):
        of_joint = [errors_of_model[j] for errors_of_model in errors]
        change = f"{r2[j]:.4f}" if len(r2) else change_of(of_joint[0], of_joint[-1])
        noise = None if floor is None else floor[j]
        over = None if ratios is None else float(ratios[j])
        name = f"{j + 1} [{plain_unit(unit)}]"
        rows.append([name, *map(number, of_joint), change, number(noise), number(over)])
    last = "R2" if len(r2) else "change"
    heads = ["joint", *names, last, "noise floor", "error / noise"]
    return Table(heads, rows, title=title, style="numbers history")


def failure_table(failures: Sequence[JointFailure]) -> Table:
    """Table of every number of an error analysis.

    Parameters
    ----------
    failures : sequence of JointFailure
        Error analysis of each joint.

    Returns
    -------
    Table
        One row for each quantity, one column for each joint.
    """
    rows: dict[str, list[str]] = {}
    for failure in failures:
        for name, value in failure.numbers().items():
            rows.setdefault(name, []).append(number(value))
    joints = [str(failure.joint) for failure in failures]
    title = f"Error of each joint, and per cent of its variance. {SHARES}"
    return Table(
        ["", *joints], [[name, *cells] for name, cells in rows.items()], title=title
    )


def link_table(estimate: Estimate, centres: bool = True) -> Table | None:
    """Table of the links' inertial parameters, identified and nominal.

    Parameters
    ----------
    centres : bool
        Whether to show centres of mass, which are too wide for a terminal.

    Returns
    -------
    Table or None
        One row for each link; None for a model without links.
    """
    rows = link_rows(estimate)
    if not rows:
        return None
    place = LINK_HEADS.index("centre of mass [m]")
    columns = [k for k in range(len(LINK_HEADS)) if centres or k != place]
    heads = [LINK_HEADS[k] for k in columns]
    words = [heads.index(name) for name in ("link", "from")]
    return Table(
        heads,
        [[row[k] for k in columns] for row in rows],
        title="Links, identified and nominal",
        words=words,
        style="numbers links",
    )


#: Of a table of parameters.
PARAMETER_HEADS = (
    "parameter",
    "verdict",
    "from",
    "value",
    "low",
    "high",
    "nominal",
    "unit",
)


def parameter_cells(
    interval: Interval, source: str = "", nominal: float | None = None
) -> tuple[str, ...]:
    """Return the cells of one parameter in a table of parameters.

    Parameters
    ----------
    interval : Interval
        Name, value, unit and 95 % interval.
    source : str
        What determined the value: data, prior or bounds.

    Returns
    -------
    tuple of str
        One cell for each of :data:`PARAMETER_HEADS`.
    """
    figures = [
        number(zero_if_rounding(x), 4)
        for x in (interval.value, interval.lower, interval.upper, nominal)
    ]
    unit = plain_unit(interval.unit)
    return interval.name, interval.verdict, source, *figures, unit


def parameter_table(rows: Sequence[Sequence[str]]) -> Table:
    """Table of parameters; rows that the data do not determine are styled apart.

    Returns
    -------
    Table
        One row for each parameter.
    """
    return Table(
        PARAMETER_HEADS,
        rows,
        words=(0, 1, 2, 7),
        row_classes=[row[2] for row in rows],
        style="numbers parameters",
    )


def standard_parameters(estimate: Estimate) -> list[tuple[str, ...]]:
    """Rows of every standard parameter of a model, as :func:`parameter_cells` makes them.

    Returns
    -------
    list of tuples
        One row for each parameter.
    """
    columns = zip(
        estimate.uncertainty.standard, estimate.sources, estimate.nominal, strict=True
    )
    return [
        parameter_cells(interval, source, finite(nominal))
        for interval, source, nominal in columns
    ]


def base_parameters(estimate: Estimate) -> list[tuple[str, ...]]:
    """Rows of every base parameter of a model, named by its full expression.

    Returns
    -------
    list of tuples
        One row for each parameter, as :func:`parameter_cells` makes it.
    """
    listed = estimate.details.get("base_parameters", [])
    known = {entry["name"]: (entry["source"], entry["nominal"]) for entry in listed}
    rows = []
    intervals = estimate.uncertainty.base
    for interval, text in zip(intervals, base_expressions(estimate), strict=True):
        _, *cells = parameter_cells(interval, *known.get(interval.name, ()))
        rows.append((text, *cells))
    return rows


def certificate_table(models: Mapping[str, Estimate]) -> Table:
    """Table of what is certified of each model.

    Returns
    -------
    Table
        One row for each figure, one column for each model.
    """
    summaries = [dict(model.certificate.summary()) for model in models.values()]
    names = dict.fromkeys(name for summary in summaries for name in summary)
    rows = [
        [name, *(summary.get(name, "-") for summary in summaries)] for name in names
    ]
    heads = ["figure", *models]
    return Table(heads, rows, words=range(len(heads)), style="wraps")


def gain_table(title: str, gains: Sequence[tuple[str, float, str, str]]) -> Table:
    """Table of gains of a servo loop or a motor.

    Parameters
    ----------
    gains : sequence of tuples
        Name, value, half the 95 % interval in words, and unit of each gain.

    Returns
    -------
    Table
        One row for each gain.
    """
    rows = [
        (name, number(value, 4), spread, plain_unit(unit))
        for name, value, spread, unit in gains
    ]
    return Table(("gain", "value", "± (95 %)", "unit"), rows, title=title, words=(0, 3))
