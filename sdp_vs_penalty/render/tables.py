"""Tables of results: terminal, page and report show the same rows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from sdp_vs_penalty.diagnosis.where_it_fails import SHARES, JointFailure
from sdp_vs_penalty.estimation.estimate import (
    LINK_HEADS,
    Estimate,
    link_rows,
    zero_if_rounding,
)
from sdp_vs_penalty.estimation.frames import base_expressions
from sdp_vs_penalty.estimation.uncertainty import Interval
from sdp_vs_penalty.formatting import change_of, finite, number, plain_unit
from sdp_vs_penalty.results.facts import Fact, columns_of
from sdp_vs_penalty.results.table import Table

#: Facts of a record, by the name of the method that computes each.
Facts = Mapping[str, Fact]


def facts_from_json(record: Mapping[str, Any]) -> dict[str, Fact]:
    """Return the facts of a record from its JSON."""
    return {name: Fact.from_dict(data) for name, data in record["facts"].items()}


def model_table(
    models: Sequence[tuple[str, str, Facts]], what: str = "model", title: str = ""
) -> Table:
    """Table of models that were judged on the same runs: a row for each, and a column
    for each of their facts that has one.

    Parameters
    ----------
    models : sequence of (str, str, mapping of str to Fact)
        Name, grade of the verdict (or why there is none), and facts of each.
    what : str
        Heading of the first column, such as "model" or "method".
    """
    columns = {
        name: one
        for _, _, facts in models
        for name, one in facts.items()
        if columns_of([one], per_joint=False)
    }
    rows = [
        (name, grade, *(facts[x].texts[0] if x in facts else "" for x in columns))
        for name, grade, facts in models
    ]
    are_words = [isinstance(one.value, str | bool) for one in columns.values()]
    return Table(
        (what, "verdict", *(one.column for one in columns.values())),
        rows,
        title=title,
        words=(0, 1, *(k for k, is_word in enumerate(are_words, start=2) if is_word)),
        style=f"judged {what}s",
    )


def joint_table(
    models: Mapping[str, Facts], units: Sequence[str], title: str = ""
) -> Table:
    """Table of joints: a row for each, and a column for each fact that has a number a
    joint.

    Parameters
    ----------
    models : mapping of str to mapping of str to Fact
        Facts of each model by the heading of its error. Of several models the errors
        stand side by side, with the change from the first to the last, and the other
        facts are the last one's.
    units : sequence of str
        Torque unit of each joint.
    """
    error, *others = columns_of(list(models.values())[-1].values(), per_joint=True)
    errors = [
        one
        for facts in models.values()
        for one in columns_of(facts.values(), per_joint=True)
        if one.name == error.name and one.column == error.column
    ]
    rows = []
    for joint, unit in enumerate(units, start=1):
        row = [f"{joint} [{plain_unit(unit)}]", *(x.of_joint(joint) for x in errors)]
        if len(models) > 1:
            row.append(change_of(errors[0].value[joint - 1], error.value[joint - 1]))
        rows.append([*row, *(one.of_joint(joint) for one in others)])
    change = ["change"] if len(models) > 1 else []
    heads = ["joint", *models, *change, *(one.column for one in others)]
    return Table(heads, rows, title=title, style="numbers history")


def failure_table(failures: Sequence[JointFailure]) -> Table:
    """Table of every number of an error analysis: a row for each quantity, a column for
    each joint.
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
