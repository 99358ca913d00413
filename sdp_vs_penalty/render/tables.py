"""Tables of results: terminal, page and report show the same rows."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from sdp_vs_penalty.diagnosis.where_it_fails import SHARES, JointFailure
from sdp_vs_penalty.estimation.constants import ROUNDING
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.estimation.gains import GainInterval
from sdp_vs_penalty.estimation.model_file import ParameterEntry
from sdp_vs_penalty.formatting import change_of, number, plain_unit
from sdp_vs_penalty.results.facts import Fact, columns_of
from sdp_vs_penalty.results.table import Table
from sdp_vs_penalty.robot import inertia

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
    are_words = [isinstance(one.value, bool) for one in columns.values()]
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
        Facts of each model by its name in the headings; "" for one alone. Of several
        models the figures stand side by side, once where they are the same, and the
        change of the error from the first to the last.
    units : sequence of str
        Torque unit of each joint.
    """
    heads = ["joint"]
    columns = [[f"{j} [{plain_unit(unit)}]" for j, unit in enumerate(units, start=1)]]
    joints = range(1, len(units) + 1)
    last = list(models.values())[-1]
    for k, fact in enumerate(columns_of(last.values(), per_joint=True)):
        of_models = {
            name: one
            for name, facts in models.items()
            for one in columns_of(facts.values(), per_joint=True)
            if (one.name, one.column) == (fact.name, fact.column)
        }
        texts = [[one.of_joint(j) for j in joints] for one in of_models.values()]
        if k > 0 and all(text == texts[-1] for text in texts):
            of_models, texts = {"": fact}, texts[-1:]
        heads += [f"{fact.column} {name}".rstrip() for name in of_models]
        columns += texts
        if k == 0 and len(models) > 1:  # the first fact is the error
            first, *_ = of_models.values()
            begin, *between, end = models
            heads.append(f"change {begin} to {end}" if between else "change")
            columns.append([*map(change_of, first.value, fact.value)])
    rows = [list(row) for row in zip(*columns, strict=True)]
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


#: What determines a parameter, in words.
SOURCES = {
    "data": "data",
    "given": "given",
    "prior": "assumed near nominal",
    "bounds": "set by limits",
}


def link_table(
    estimate: Estimate, centres: bool = True, ranges: Mapping[str, str] | None = None
) -> Table | None:
    """Table of the links' inertial parameters, identified and nominal, a row for each;
    None for a model without links.

    ``centres``: whether to show centres of mass, which are too wide for a terminal.
    ``ranges``: by the name of a mass, between which values it can lie.
    """
    link_indices = estimate.model.rigid_indices
    if not len(link_indices):
        return None
    links = estimate.links
    nominal = estimate.nominal[link_indices].reshape(-1, 10)
    robot = estimate.robot
    masses = link_indices[::10].tolist()
    # A link without mass has no centre of mass: NaN is shown as unknown.
    com = np.where(
        links[:, :1] > 0.0, inertia.barycentric_from_standard(links)[:, 1:4], np.nan
    )
    names = [robot.tree[joint].name for joint in robot.link_joints]
    columns: dict[str, list[str]] = {
        "link": [f"{k} ({name})" for k, name in enumerate(names, start=1)],
        "mass [kg]": [number(x, 4) for x in links[:, 0]],
        "nominal": [number(x, 4) for x in nominal[:, 0]],
        "from": [SOURCES[estimate.sources[k]] for k in masses],
        "can be [kg]": [
            (ranges or {}).get(estimate.model.parameters[k].name, "") for k in masses
        ],
        "centre of mass [m]": [
            ", ".join(number(zero_if_rounding(x)) for x in point) for point in com
        ],
        "gyration [m]": [number(x) for x in inertia.gyration(links)],
        "nominal gyration": [number(x) for x in inertia.gyration(nominal)],
        "thickness [mm]": [number(1e3 * x) for x in inertia.thickness(links)],
    }
    if not centres:
        del columns["centre of mass [m]"]
    if ranges is None:
        del columns["can be [kg]"]
    return Table(
        list(columns),
        list(zip(*columns.values(), strict=True)),
        title="Links, identified and nominal",
        words=(0, 3),
        style="numbers links",
    )


def zero_if_rounding(value: float) -> float:
    """Return 0 for a number [SI] that differs from zero by rounding alone."""
    return 0.0 if abs(value) < ROUNDING else value


def parameter_table(
    entries: Sequence[ParameterEntry], names: Sequence[str] = ()
) -> Table:
    """Table of parameters, a row for each, called by ``names`` where they are given;
    rows that the data do not determine are styled apart."""
    rows = [
        (
            name,
            entry.verdict,
            SOURCES.get(entry.source, entry.source),
            *(
                number(zero_if_rounding(x), 4)
                for x in (entry.value, entry.lower, entry.upper, entry.nominal)
            ),
            plain_unit(entry.unit),
        )
        for name, entry in zip(names or [x.name for x in entries], entries, strict=True)
    ]
    heads = ("parameter", "verdict", "from", "value", "low", "high", "nominal", "unit")
    return Table(
        heads,
        rows,
        words=(0, 1, 2, 7),
        row_classes=[entry.source for entry in entries],
        style="numbers parameters",
    )


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


def gain_table(title: str, gains: Iterable[GainInterval]) -> Table:
    """Table of gains of a servo loop or a motor, a row for each."""
    rows = [
        (gain.name, number(gain.value, 4), gain.spread, plain_unit(gain.unit))
        for gain in gains
    ]
    return Table(("gain", "value", "± (95 %)", "unit"), rows, title=title, words=(0, 3))
