"""Tables with a row for each joint and instant, or for each channel and instant: a
column names what the row is of. They become a log with a column a joint and channel."""

import re
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sdp_vs_penalty.data.hypotheses.recognition import find_clock
from sdp_vs_penalty.data.log import Column, Log, Values
from sdp_vs_penalty.data.words import table
from sdp_vs_penalty.data.words.names import quantity_of
from sdp_vs_penalty.data.words.tokens import parts_of, split_tokens
from sdp_vs_penalty.errors import InputError

#: Words of the columns that say what a row is of, by "joints", "channels" and so on.
_WORDS: dict[str, list[str]] = table()["rows"]
#: Robots have no more joints, and logs no more channels.
_MOST_JOINTS, _MOST_CHANNELS = 100, 1000


def widened(log: Log) -> Log:
    """Return a log with a column for each joint and channel, "elbow/position"; the log
    itself where a row holds all joints.

    A table with one column of positions and one of torques is long where joints repeat
    in another column. A table without positions is long where one column holds values
    and another names the channels.
    """
    labels = _label_columns(log)
    if not labels or log.texts is None:
        _require_one_robot(log)
        return log
    clock = find_clock(log.columns)
    if clock is None:
        what = "no column t, and a row for each joint"
        raise InputError(what, "write the stamp into each row", log.path)
    clocks = parts_of(clock, log.names)
    is_by_channel = log.columns[labels[-1]].kind == "text" and len(_values(log)) == 1
    is_by_channel &= _has_words(labels[-1], _WORDS["channels"]) and "q" not in map(
        quantity_of, log.names
    )
    numeric = [
        name
        for name, x in log.columns.items()
        if x.kind in ("number", "stamp") and name not in labels
    ]
    table = log.read(numeric)
    channels = (
        _values(log) if is_by_channel else [x for x in numeric if x not in clocks]
    )
    # The distinct labels in the order of the file; numbers of joints in their own order.
    rows = [tuple(map(_without_base, row)) for row in log.texts(labels)]
    distinct = list(dict.fromkeys(rows))
    if all(x[0].isdigit() for x in distinct) and not (
        is_by_channel and len(labels) == 1
    ):
        distinct.sort(key=lambda x: int(x[0]))
    place = {label: k for k, label in enumerate(distinct)}
    label_of_row = np.array([place[row] for row in rows])
    wide = {x: table.columns[x] for x in clocks}
    gaps = {}
    for k, label in enumerate(distinct):
        is_other = label_of_row != k
        for channel in channels:
            name = "/".join(label if is_by_channel else (*label, channel))
            wide[name] = table.columns[channel]
            gaps[name] = is_other | table.gaps.get(channel, False)
    columns = {x: log.columns[x] for x in clocks}
    for name in wide.keys() - columns.keys():
        columns[name] = Column(
            "number", [f"{x:.9g}" for x in wide[name][~gaps[name]][:50]]
        )
    columns = {name: columns[name] for name in wide}
    unit_column = [x for x in log.columns if _has_words(x, _WORDS["units"])][:1]
    units = []
    if is_by_channel and unit_column:
        units = [row[0] for row in log.texts(unit_column)]
    for label, unit in {*zip(rows, units, strict=False)}:
        name = "/".join(label)
        columns[name] = replace(columns[name], unit=unit)

    def read(names: Sequence[str]) -> Values:
        return Values(
            {x: wide[x] for x in names},
            table.rows,
            {x: gaps[x] for x in names if x in gaps},
        )

    return replace(log, columns=columns, read=read, texts=None)


def _without_base(label: str) -> str:
    """Return a hexadecimal number, as CAN's, in decimal digits; other labels as they are."""
    is_hexadecimal = re.fullmatch("0[xX][0-9a-fA-F]+", label) is not None
    return str(int(label, 16)) if is_hexadecimal else label


def _require_one_robot(log: Log) -> None:
    """Raise InputError where rows of several robots stand in turn, by a column that names
    the robot of each."""
    for name, column in log.columns.items():
        words = {*split_tokens(name)} - {*_WORDS["joints"], *_WORDS["channels"]}
        is_label = column.kind == "text" or all(x.isdigit() for x in column.cells)
        if not (words and words <= {*_WORDS["robots"]} and is_label):
            continue
        if not (log.texts and _repeats(log, name, _MOST_JOINTS)):
            continue
        cells = [row[0] for row in log.texts([name])]
        robots = sorted({*cells})
        what = (
            f"column {name} says that rows are of several robots ({', '.join(robots)})"
        )
        raise InputError(what, f"keep the rows of one, {robots[0]!r} say", log.path)


def _label_columns(log: Log) -> list[str]:
    """List the columns that name the joint and the channel of a row; none where one row
    holds all joints."""
    joints = [name for name in log.columns if _names_joints(log, name)]
    joints.sort(key=lambda x: log.columns[x].kind != "text")
    quantities = [*map(quantity_of, log.names)]
    if any(x.kind == "list" for x in log.columns.values()):
        return []  # a row holds all joints
    if quantities.count("q") == 1 and quantities.count("tau") == 1:
        return joints[:1] if joints and _repeats(log, joints[0], _MOST_JOINTS) else []
    if "q" in quantities or len(_values(log)) != 1:
        return []
    channels = [
        name
        for name, x in log.columns.items()
        if x.kind == "text"
        and _has_words(name, _WORDS["channels"])
        and _repeats(log, name, _MOST_CHANNELS)
    ]
    if not channels:
        return []
    return list(dict.fromkeys([*joints[:1], channels[-1]]))


def _values(log: Log) -> list[str]:
    """List the columns whose names mean a value of anything."""
    return [name for name in log.columns if _has_words(name, _WORDS["values"])]


def _has_words(name: str, words: Sequence[str]) -> bool:
    """Return whether a column's name consists of some of these words only."""
    tokens = split_tokens(name)
    return bool(tokens) and {*words}.issuperset(tokens)


def _names_joints(log: Log, name: str) -> bool:
    """Return whether a column could hold joints: its name says so ("joint", "axis id"),
    and its cells are texts or whole numbers."""
    column = log.columns[name]
    is_whole = column.kind == "number" and all(x.isdigit() for x in column.cells)
    return _has_words(name, _WORDS["joints"]) and (column.kind == "text" or is_whole)


def _repeats(log: Log, name: str, most: int) -> bool:
    """Return whether the texts of a column repeat: 2 to ``most`` different texts, in at
    least twice as many rows."""
    cells = [row[0] for row in log.texts([name])] if log.texts else []
    return 1 < len({*cells}) <= min(most, len(cells) // 2)
