"""Text tables with a row for each joint and instant, or for each channel and instant: a
column names what the row is of."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sdp_vs_penalty.data.formats.column_names import read_name, split_tokens
from sdp_vs_penalty.data.formats.columns import Choice, Header
from sdp_vs_penalty.data.formats.recognition import CellTable, find_clock
from sdp_vs_penalty.data.formats.renaming import parts_of
from sdp_vs_penalty.data.formats.stamps import second_part_unit
from sdp_vs_penalty.data.formats.text_columns import (
    iter_cells,
    parse_with_gaps,
    read_cells,
)
from sdp_vs_penalty.data.formats.text_table import TextTable
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.data.merging import merge_columns
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.robot.arrays import Array

#: Words of which the name of a column is made that says which joint a row is of.
_JOINT_WORDS = {
    *("joint", "joints", "name", "names", "axis", "motor", "actuator", "servo"),
    *("dof", "id", "index", "idx", "number", "nr", "no", "channel", "link"),
}
#: ... or which channel, whose number is in a column of the other words.
_CHANNEL_WORDS = {
    *("variable", "field", "signal", "channel", "key", "metric", "quantity", "tag"),
    *("measurement", "topic", "property", "item", "type", "name"),
}
_VALUE_WORDS = {"value", "values", "val", "reading"}
#: Robots have no more joints, and logs no more channels.
_MOST_JOINTS = 100
_MOST_CHANNELS = 1000


@dataclass(frozen=True)
class LongForm:
    """Where a table says what a row is of.

    Parameters
    ----------
    joint : the column of the joints' names or numbers, from 0; None without
    channel : the column of the channels' names; None where each has its own column
    """

    joint: int | None
    channel: int | None


def find_long_form(table: TextTable) -> LongForm | None:
    """Find the columns that say what a row is of.

    Parameters
    ----------
    table : TextTable
        Of any text file.

    Returns
    -------
    LongForm or None
        None where a row holds all joints.
    """
    joint = _find_joint_column(table)
    quantities = [_quantity_of(name) for name in table.names]
    if quantities.count("q") == 1 and quantities.count("tau") == 1:
        is_long = joint is not None and _repeats(table, joint, _MOST_JOINTS)
        return LongForm(joint, None) if is_long else None
    if "q" in quantities:
        return None
    channel = _find_channel_column(table)
    if channel is None or not _repeats(table, channel, _MOST_CHANNELS):
        return None
    return LongForm(None if joint == channel else joint, channel)


def _find_joint_column(table: TextTable) -> int | None:
    """The column that could hold the joints' names, else their numbers; None without."""
    joints = [k for k in range(table.width) if _names_joints(table, k)]
    texts = [k for k in joints if table.kinds[k] == "text"]
    return next(iter(texts or joints), None)


def _find_channel_column(table: TextTable) -> int | None:
    """The last column that could hold the channels' names beside one column of values;
    None without."""
    values = [name for name in table.names if _has_words(name, _VALUE_WORDS)]
    channels = [
        k
        for k, name in enumerate(table.names)
        if table.kinds[k] == "text" and _has_words(name, _CHANNEL_WORDS)
    ]
    return channels[-1] if channels and len(values) == 1 else None


def _has_words(name: str, words: set[str]) -> bool:
    """Whether a name is made of some words alone."""
    tokens = split_tokens(name)
    return bool(tokens) and set(tokens) <= words


def _repeats(table: TextTable, column: int, most: int) -> bool:
    """Whether a column has several texts, at most so many, each of them in several
    rows."""
    texts = set[str]()
    n_rows = 0
    for cells in iter_cells(table, column):
        texts.update(cells)
        n_rows += len(cells)
        if len(texts) > most:
            return False
    return 1 < len(texts) <= n_rows // 2


def _quantity_of(name: str) -> str | None:
    """The quantity that a column's name says; None where it says none, or a joint."""
    reading = read_name(name)
    return None if reading is None else reading.quantity


def _names_joints(table: TextTable, column: int) -> bool:
    """Whether a column could hold the joints' names or numbers."""
    if not _has_words(table.names[column], _JOINT_WORDS):
        return False
    cells = table.first_cells(column)
    are_numbers = table.kinds[column] == "number" and _are_numbers(cells)
    return table.kinds[column] == "text" or are_numbers


def read_long(table: TextTable, form: LongForm, choice: Choice) -> Measurements:
    """Read a run whose rows are of one joint or channel each.

    Parameters
    ----------
    table : TextTable
        Of the file.
    form : LongForm
        Which columns say what a row is of.
    choice : Choice
        What of the file to take; its columns are called "elbow/position" then.

    Returns
    -------
    Measurements
        The instants of the first joint's position, with those of the other channels that
        are nearest in time, within half a period. In SI units.

    Raises
    ------
    InputError
        No clock, or cells that are no numbers.
    """
    clock = find_clock(table.names)
    if clock is None:
        what = "no column t, and a row for each joint"
        raise InputError(what, "write the stamp into each row", table.path)
    stamps = parts_of(clock, table.names)
    labels, values = _labels_and_values(table, form)
    parts = [_unit_of(k, name) * values[name] for k, name in enumerate(stamps)]
    channels = {name: x for name, x in values.items() if name not in stamps}
    if form.channel is not None:
        channels = {n: x for n, x in channels.items() if _has_words(n, _VALUE_WORDS)}
    wide = _columns_of_labels(labels, channels, form)
    positions = [name for name in wide if _quantity_of(name) == "q"]
    leading = positions[0] if positions else next(iter(wide))
    places, merged = merge_columns(
        np.sum(parts, axis=0),
        wide,
        [leading],
    )
    columns = {name: values[name][places] for name in stamps} | merged
    kinds = dict.fromkeys(columns, "number")
    shown = {name: [f"{x:.9g}" for x in block[:50]] for name, block in columns.items()}
    header = Header.of(
        table.path,
        list(columns),
        choice,
        table=CellTable(kinds, shown),
    )
    return header.read(columns)


def _labels_and_values(
    table: TextTable, form: LongForm
) -> tuple[list[list[str]], dict[str, Array]]:
    """The columns that say what a row is of, and (N,) the numbers of the others by
    name."""
    labels = [k for k in (form.joint, form.channel) if k is not None]
    numeric = [
        k
        for k, kind in enumerate(table.kinds)
        if kind in ("number", "stamp") and k not in labels
    ]
    rows, cells = read_cells(table, labels + numeric)
    values = {
        table.names[k]: parse_with_gaps(table, k, rows, texts)
        for k, texts in zip(numeric, cells[len(labels) :], strict=True)
    }
    return cells[: len(labels)], values


def _unit_of(place: int, name: str) -> float:
    """What the first or second part of a stamp counts in [units of the first one]."""
    return second_part_unit(name) if place else 1.0


def _columns_of_labels(
    labels: Sequence[Sequence[str]],
    channels: Mapping[str, Array],
    form: LongForm,
) -> dict[str, Array]:
    """(N,) a column for each label and channel, NaN in the rows of other labels."""
    rows = np.array(labels).T
    _, first_rows, places = np.unique(
        rows,
        axis=0,
        return_index=True,
        return_inverse=True,
    )
    in_order = np.argsort(first_rows)
    names = [rows[first_rows[k]].tolist() for k in in_order]
    if form.joint is not None and _are_numbers([name[0] for name in names]):
        numbers = [int(name[0]) for name in names]
        by_number = np.argsort(numbers, kind="stable")
        in_order = in_order[by_number]
        names = [names[k] for k in by_number]
    columns = dict[str, Array]()
    for k, name in zip(in_order, names, strict=True):
        is_here = places.ravel() == k
        for channel, values in channels.items():
            words = [*name, channel] if form.channel is None else name
            columns["/".join(words)] = np.where(
                is_here,
                values,
                np.nan,
            )
    return columns


def _are_numbers(texts: Sequence[str]) -> bool:
    """Whether all texts are whole numbers."""
    return all(text.isdigit() for text in texts)
