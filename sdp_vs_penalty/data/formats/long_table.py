"""Text tables with a row for each joint and instant, or for each channel and instant: a
column names what the row is of."""

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sdp_vs_penalty.data.formats.column_names import read_name, split_tokens
from sdp_vs_penalty.data.formats.columns import Choice, Header
from sdp_vs_penalty.data.formats.recognition import CellTable, find_clock
from sdp_vs_penalty.data.formats.renaming import parts_of
from sdp_vs_penalty.data.formats.stamps import units_of_parts
from sdp_vs_penalty.data.formats.text_columns import (
    iter_cells,
    parse_with_gaps,
    read_cells,
)
from sdp_vs_penalty.data.formats.text_table import TextTable
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.data.merging import merge_columns
from sdp_vs_penalty.errors import InputError, Remark
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
    """Layout of a table with a row for each joint, or each channel, and instant."""

    #: Place, from 0, of the column that names or numbers the row's joint; None where no
    #: column does.
    joint: int | None
    #: Place, from 0, of the column that names the row's channel; None where each channel
    #: has a column.
    channel: int | None


def find_long_form(table: TextTable) -> LongForm | None:
    """Find the columns that say to which joint or channel a row belongs.

    A table with one column of positions and one of torques is long where joints repeat
    in another column. A table without positions is long where one column holds values
    and another names the channels.

    Parameters
    ----------
    table : TextTable
        Layout of a text file.

    Returns
    -------
    LongForm or None
        None for the usual layout, in which a row holds all joints.
    """
    joint = _find_joint_column(table)
    quantities = [_quantity_of(name) for name in table.names]
    has_one_of_each = quantities.count("q") == 1 and quantities.count("tau") == 1
    if has_one_of_each:
        is_long = joint is not None and _repeats(table, joint, _MOST_JOINTS)
        return LongForm(joint, channel=None) if is_long else None
    if "q" in quantities:
        return None
    channel = _find_channel_column(table)
    if channel is None or not _repeats(table, channel, _MOST_CHANNELS):
        return None
    return LongForm(None if joint == channel else joint, channel)


def _find_joint_column(table: TextTable) -> int | None:
    """Find the column of joint names, else that of joint numbers; None without one."""
    joints = [k for k in range(table.width) if _names_joints(table, k)]
    texts = [k for k in joints if table.kinds[k] == "text"]
    return next(iter(texts or joints), None)


def _find_channel_column(table: TextTable) -> int | None:
    """Find the last text column that could name channels, in a table with exactly one
    column of values; None without one."""
    values = [name for name in table.names if _has_words(name, _VALUE_WORDS)]
    channels = [
        k
        for k, name in enumerate(table.names)
        if table.kinds[k] == "text" and _has_words(name, _CHANNEL_WORDS)
    ]
    return channels[-1] if channels and len(values) == 1 else None


def _has_words(name: str, words: set[str]) -> bool:
    """Return whether a column's name consists of some of these words only."""
    tokens = split_tokens(name)
    return bool(tokens) and set(tokens) <= words


def _repeats(table: TextTable, column: int, most: int) -> bool:
    """Return whether the texts of a column repeat: 2 to ``most`` different texts, in at
    least twice as many rows."""
    texts = set[str]()
    n_rows = 0
    for cells in iter_cells(table, column):
        texts.update(cells)
        n_rows += len(cells)
        if len(texts) > most:
            return False
    return 1 < len(texts) <= n_rows // 2


def _quantity_of(name: str) -> str | None:
    """Return the quantity that a column's name says ("q", "tau" ...); None where it
    says none."""
    reading = read_name(name)
    return None if reading is None else reading.quantity


def _names_joints(table: TextTable, column: int) -> bool:
    """Return whether a column could hold joints: its name says so ("joint", "axis id"),
    and its cells are texts or whole numbers."""
    if not _has_words(table.names[column], _JOINT_WORDS):
        return False
    cells = table.first_cells(column)
    are_numbers = table.kinds[column] == "number" and _are_numbers(cells)
    return table.kinds[column] == "text" or are_numbers


def read_long(table: TextTable, form: LongForm, choice: Choice) -> Measurements:
    """Read a run from a table with a row for each joint, or each channel, and instant.

    Parameters
    ----------
    form : LongForm
        Columns that say to which joint or channel a row belongs.
    choice : Choice
        The robot's joints, the rate, and the columns chosen by ``--rename``; here they
        are called like "elbow/position".

    Returns
    -------
    Measurements
        The instants of the first joint's torque, to which the other channels are
        interpolated. In SI units.

    Raises
    ------
    InputError
        No clock, or cells that are no numbers.
    """
    clock = find_clock(table.names)
    if clock is None:
        what = "no column t, and a row for each joint"
        raise InputError(what, "write the stamp into each row", table.path)
    clock_columns = parts_of(clock, table.names)
    labels, values = _labels_and_values(table, form)
    # (N,) stamps of the rows; channels are the other columns, or the one of values.
    units = units_of_parts(clock_columns)
    parts = [
        unit * values[name] for name, unit in zip(clock_columns, units, strict=True)
    ]
    stamps = np.sum(parts, axis=0)
    channels = {name: x for name, x in values.items() if name not in clock_columns}
    if form.channel is not None:
        channels = {n: x for n, x in channels.items() if _has_words(n, _VALUE_WORDS)}
    # A column for each joint and channel, merged at the stamps of the first torque.
    wide = _columns_of_labels(labels, channels, form)
    quantities = {_quantity_of(name): name for name in reversed(wide)}
    leading = quantities.get("tau") or quantities.get("q") or next(iter(wide))
    merged = merge_columns(stamps, wide, leading)
    if merged.remark:
        warnings.warn(f"{table.path}: {merged.remark}", Remark, stacklevel=2)
    columns = {name: values[name][merged.rows] for name in clock_columns}
    columns |= merged.columns
    # The wide table is recognised like any other.
    kinds = dict.fromkeys(columns, "number")
    cells = {name: [f"{x:.9g}" for x in block[:50]] for name, block in columns.items()}
    table_of_columns = CellTable(kinds, cells)
    header = Header.of(table.path, list(columns), choice, table=table_of_columns)
    return header.read(columns)


def _labels_and_values(
    table: TextTable, form: LongForm
) -> tuple[list[list[str]], dict[str, Array]]:
    """Read the label columns (joint, channel) as texts, and the numeric columns (N,) by
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


def _columns_of_labels(
    labels: Sequence[Sequence[str]], channels: Mapping[str, Array], form: LongForm
) -> dict[str, Array]:
    """Spread long columns (N,) into one column for each label and channel.

    A column has NaN in the rows of other labels. ``labels`` holds one list of N texts
    for each label column; joints that are numbers are put in the numbers' order, others
    in that of the file.

    Returns (N,) columns by names such as "elbow/position".
    """
    # (N, labels) texts; the distinct rows, where each is first, and which each row has.
    label_rows = np.array(labels).T
    _, first_rows, distinct_of_row = np.unique(
        label_rows, axis=0, return_index=True, return_inverse=True
    )
    in_order = np.argsort(first_rows)
    names = [label_rows[first_rows[k]].tolist() for k in in_order]
    if form.joint is not None and _are_numbers([name[0] for name in names]):
        numbers = [int(name[0]) for name in names]
        by_number = np.argsort(numbers, kind="stable")
        in_order = in_order[by_number]
        names = [names[k] for k in by_number]
    columns = dict[str, Array]()
    for k, name in zip(in_order, names, strict=True):
        has_label = distinct_of_row.ravel() == k
        for channel, values in channels.items():
            words = [*name, channel] if form.channel is None else name
            columns["/".join(words)] = np.where(has_label, values, np.nan)
    return columns


def _are_numbers(texts: Sequence[str]) -> bool:
    """Return whether all texts are whole numbers without a sign."""
    return all(text.isdigit() for text in texts)
