"""CSV and other text tables: RUN.csv with the header t,q1..qn,dq1..dqn,tau1..taun, one
row a sample; read piece by piece: memory for the numbers and for one piece, however
long the file."""

import warnings
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from sdp_vs_penalty.data.formats.columns import GROUPS, Choice, Header, columns_of
from sdp_vs_penalty.data.formats.joint_order import (
    Places,
    in_first_order,
    places_of_joints,
)
from sdp_vs_penalty.data.formats.recognition import (
    CellTable,
    columns_of_joint_names,
    joints_of_texts,
)
from sdp_vs_penalty.data.formats.renaming import group_of
from sdp_vs_penalty.data.formats.stamps import past_midnight
from sdp_vs_penalty.data.formats.text_columns import (
    EmptyCellError,
    parse_with_gaps,
    read_cells,
    read_pieces,
)
from sdp_vs_penalty.data.formats.text_table import (
    MarkupError,
    TextTable,
    inspect_table,
    plain_number,
)
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.errors import InputError, Remark
from sdp_vs_penalty.files import writing
from sdp_vs_penalty.robot.arrays import Array

SUFFIXES = (".csv",)
#: What messages call a sample.
SAMPLE = "row"


def read(path: Path, choice: Choice) -> Measurements:
    """Read the run of a text table.

    Three layouts are read: a column for each channel (RUN.csv), a table without a
    header, and the long layout with a row for each joint and instant. Read, too, are
    messages that `ros2 topic echo` has printed, JSON, and what KUKA's RSI sends.

    Parameters
    ----------
    choice : Choice
        The robot's joints, the columns chosen by ``--rename``, and the rate.

    Returns
    -------
    Measurements
        The run in SI units, one row a sample.

    Raises
    ------
    InputError
        Naming the row and column that cannot be used.
    """
    try:
        table = inspect_table(path)
    except MarkupError as error:
        return _read_markup(path, choice, error)
    if choice.rate is None and table.rate is not None:
        said = f"{path}: {table.rate:g} rows a second, as the file's header says"
        warnings.warn(said, Remark, stacklevel=2)
        choice = replace(choice, rate=table.rate)
    _require_equal_clocks(table)
    names = list(table.names)
    is_unnamed = not table.has_header and names[0] == "#1"
    if is_unnamed and not choice.rename:
        from sdp_vs_penalty.data.formats.headerless import names_without_header

        names = names_without_header(
            path, len(names), choice, lambda: read_columns(path)
        )
    if not _has_channels_alone(table):
        from sdp_vs_penalty.data.formats.long_table import find_long_form, read_long

        form = find_long_form(table)
        if form is not None:
            return read_long(table, form, choice)
    header = Header.of(path, names, choice, table=_cell_table(table, names))
    chosen = sorted(names.index(name) for name in header.columns)
    _refuse_texts(table, names, chosen)
    is_chosen = bool(choice.rename or header.joints)
    places = _places_of_joints(table, names, header.joints) if is_chosen else None
    if places is None:
        run = _run_of_columns(table, header, names, chosen)
    else:
        run = header.read(in_first_order(_numeric_columns(table, names), places))
    if table.rate is not None and choice.rate == table.rate:
        run = replace(run, t=np.arange(len(run.t)) / table.rate)
    clock = () if choice.rate is not None else header.groups.get("t", ())
    has_times_of_day = any(table.kinds[names.index(x)] == "stamp" for x in clock)
    return replace(run, t=past_midnight(run.t)) if has_times_of_day else run


def _read_markup(path: Path, choice: Choice, error: MarkupError) -> Measurements:
    """Read the run of a text that is YAML, XML or JSON instead of a table; raise the
    error where it holds none."""
    if error.language == "YAML":
        from sdp_vs_penalty.data.formats import ros_echo

        return ros_echo.read(path, choice)
    if error.language == "JSON":
        from sdp_vs_penalty.data.formats import json_text

        return json_text.read(path, choice, error)
    from sdp_vs_penalty.data.formats import rsi_xml

    return rsi_xml.read(path, choice, error)


def _require_equal_clocks(table: TextTable) -> None:
    """Raise InputError where channels have columns of stamps of their own, and these
    differ."""
    if len(table.clocks) < 2:
        return
    for first, *others in read_pieces(table, table.clocks):
        for place, other in zip(table.clocks[1:], others, strict=True):
            if not np.array_equal(first, other):
                what = f"columns {table.clocks[0] + 1} and {place + 1} are clocks that differ"
                remedy = "export all channels with one sample time and one clock"
                raise InputError(what, remedy, table.path)


def _has_channels_alone(table: TextTable) -> bool:
    """Return whether all columns are called as in RUN.csv (t, q1 ..., tau1 ...).

    Then no column can name the joint of a row, and the table is not in the long layout.
    """
    return {group_of(name) for name in table.names} <= {"t", *GROUPS}


def _run_of_columns(
    table: TextTable, header: Header, names: Sequence[str], chosen: Sequence[int]
) -> Measurements:
    """Read the run of the chosen columns.

    ``chosen`` holds the columns' places from 0. Where cells are empty, the table is
    read once more as a sparse one, whose channels have rows and stamps of their own.
    """
    chosen_names = [names[k] for k in chosen]
    pieces = read_pieces(table, chosen)
    try:
        return header.gather(
            header.run(dict(zip(chosen_names, piece, strict=True))) for piece in pieces
        )
    except EmptyCellError:
        return header.read(_sparse_columns(table, header, chosen, chosen_names))


def read_columns(path: Path) -> dict[str, Array]:
    """Read the columns of a text table that hold numbers, lists of numbers or time
    stamps.

    Returns
    -------
    dict of str to array
        By the column's name (N,) numbers, seconds [s] of time stamps, or (N, n) numbers
        where each cell holds a list.

    Raises
    ------
    InputError
        Naming the row and column that is wrong.
    """
    table = inspect_table(path)
    return _numeric_columns(table, table.names)


def _numeric_columns(table: TextTable, names: Sequence[str]) -> dict[str, Array]:
    """Read the columns that hold numbers, lists of numbers or time stamps, by the names
    that they go by here."""
    numeric_kinds = ("number", "list", "stamp")
    texts = set(_columns_of_joints(table, names))
    chosen = [
        k
        for k, kind in enumerate(table.kinds)
        if kind in numeric_kinds and k not in texts
    ]
    pieces = list(read_pieces(table, chosen))
    columns = dict[str, Array]()
    for place, k in enumerate(chosen):
        columns[names[k]] = np.concatenate([piece[place] for piece in pieces])
    return columns


def _columns_of_joints(table: TextTable, names: Sequence[str]) -> list[int]:
    """List the places, from 0, of the columns that hold joints' names, one or a list in
    each cell."""
    places = [names.index(name) for name in columns_of_joint_names(names)]
    return [
        k
        for k in places
        if table.kinds[k] == "text"
        or (table.kinds[k] == "list" and joints_of_texts(table.first_cells(k)[:1]))
    ]


def _places_of_joints(
    table: TextTable, names: Sequence[str], joints: Sequence[str]
) -> Places | None:
    """Find where each row has the joints of the first row; None where the order never
    changes, or the table has no columns with the names of these joints."""
    name_columns = _columns_of_joints(table, names)
    first_joints = joints_of_texts([table.first_cells(k)[0] for k in name_columns])
    if len(first_joints) < 2 or not set(joints) <= set(first_joints):
        return None
    row_numbers, cells = read_cells(table, name_columns)
    joints_of_rows = [joints_of_texts(row) for row in zip(*cells, strict=True)]
    return places_of_joints(table.path, joints_of_rows, row_numbers)


def inspect(path: Path) -> CellTable:
    """Describe the columns of a text table by its first rows, for the recogniser of
    columns.

    Returns
    -------
    CellTable
        By the column's name its kind ("number", "text", ...) and its first cells.
    """
    table = inspect_table(path)
    return _cell_table(table, table.names)


def _cell_table(table: TextTable, names: Sequence[str]) -> CellTable:
    """Return the kinds and first cells of the columns, by the names that they go by
    here; numbers with a decimal point."""
    kinds = dict(zip(names, table.kinds, strict=True))
    cells = {name: table.first_cells(k) for k, name in enumerate(names)}
    for name, kind in kinds.items():
        if kind == "number":
            cells[name] = [plain_number(x, table.decimal) for x in cells[name]]
    return CellTable(kinds, cells)


def write(measurements: Measurements, path: Path) -> None:
    """Write one run as RUN.csv with the header t,q1..qn,dq1..dqn,tau1..taun.

    The file appears when it is complete: an interruption leaves no half-written file.
    Numbers are written so that they are read back to the last bit.

    Parameters
    ----------
    path : Path
        Path of the file to write.
    """
    with writing(path) as file:
        file.write((",".join(columns_of(measurements)) + "\n").encode())
        for part in measurements.parts():
            rows = np.column_stack(list(columns_of(part).values())).tolist()
            # repr() writes the shortest text that gives back the same number.
            lines = [",".join(map(repr, row)) + "\n" for row in rows]
            file.write("".join(lines).encode())


def numbers(path: Path, width: int) -> Array:
    """Read (N, width) numbers that have no header, with commas between the columns.

    Raises
    ------
    InputError
        Naming the row that is wrong.
    """
    table = TextTable(
        path,
        delimiter=",",
        decimal=".",
        quoted=False,
        nested=False,
        names=tuple(f"#{k}" for k in range(1, width + 1)),
        has_header=False,
        first=1,
        kinds=("number",) * width,
        sample=(),
    )
    pieces = read_pieces(table, range(width))
    columns = [np.concatenate(parts) for parts in zip(*pieces, strict=True)]
    return columns[0][:, None] if width == 1 else np.stack(columns, axis=1)


def _refuse_texts(
    table: TextTable, names: Sequence[str], chosen: Sequence[int]
) -> None:
    """Raise InputError for a chosen column that holds texts in all rows.

    One sentence names the column, where the parser would name its first row alone.
    """
    for k in chosen:
        if table.kinds[k] == "text":
            cell = table.first_cells(k)[0][:40]
            what = f"column {names[k]} is never a number: {cell!r} is not a number"
            remedy = "name the column that holds it with `convert --rename`"
            raise InputError(what, remedy, table.path)


def _sparse_columns(
    table: TextTable, header: Header, chosen: Sequence[int], chosen_names: Sequence[str]
) -> dict[str, Array]:
    """Read a table in which cells are empty
    (:func:`~sdp_vs_penalty.data.formats.sparse.merged_rows`).

    Returns
    -------
    dict of str to array
        (K,) or (K, n) values by the column's name, in the K merged rows.
    """
    from sdp_vs_penalty.data.formats.sparse import merged_rows

    row_numbers, columns = read_cells(table, chosen)
    cells_of_rows = zip(row_numbers, zip(*columns, strict=True), strict=True)
    first_incomplete = next(row for row, cells in cells_of_rows if not all(cells))
    values = dict[str, Array]()  # NaN where a cell is empty
    for name, k, cells in zip(chosen_names, chosen, columns, strict=True):
        values[name] = parse_with_gaps(table, k, row_numbers, cells)
    return merged_rows(header, values, f"row {first_incomplete}")
