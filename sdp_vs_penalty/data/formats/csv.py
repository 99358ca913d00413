"""CSV and other text tables: RUN.csv with the header t,q1..qn,dq1..dqn,tau1..taun, one
row a sample; read piece by piece: memory for the numbers and for one piece, however
long the file."""

import warnings
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from sdp_vs_penalty import formatting
from sdp_vs_penalty.data.formats.columns import GROUPS, Choice, Header, columns_of
from sdp_vs_penalty.data.formats.recognition import CellTable
from sdp_vs_penalty.data.formats.renaming import group_of
from sdp_vs_penalty.data.formats.stamps import past_midnight
from sdp_vs_penalty.data.formats.text_columns import (
    EmptyCellError,
    parse_with_gaps,
    read_cells,
    read_pieces,
)
from sdp_vs_penalty.data.formats.text_table import TextTable, inspect_table
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.errors import InputError, Remark
from sdp_vs_penalty.files import writing
from sdp_vs_penalty.robot.arrays import Array

SUFFIXES = (".csv",)
#: What messages call a sample.
SAMPLE = "row"
#: A table with so many incomplete rows is sparse; fewer are faults [rows].
_SPARSE_ROWS = 3


def read(path: Path, choice: Choice) -> Measurements:
    """Read the run of a text table.

    Parameters
    ----------
    path : Path
        Path of the file.
    choice : Choice
        What of the file to take: joints, columns, rate.

    Returns
    -------
    Measurements
        The run in SI units, one row a sample.

    Raises
    ------
    InputError
        Naming the row and column that cannot be used.
    """
    table = inspect_table(path)
    names = list(table.names)
    if not table.has_header and names[0] == "#1" and not choice.rename:
        from sdp_vs_penalty.data.formats.headerless import names_without_header

        names = names_without_header(
            path,
            len(names),
            choice,
            lambda: read_columns(path),
        )
    if not _has_channels_alone(table):
        from sdp_vs_penalty.data.formats.long_table import find_long_form, read_long

        form = find_long_form(table)
        if form is not None:
            return read_long(table, form, choice)
    header = Header.of(
        path,
        names,
        choice,
        table=_cell_table(table, names),
    )
    chosen = sorted(names.index(name) for name in header.columns)
    _refuse_texts(table, names, chosen)
    run = _run_of_columns(table, header, names, chosen)
    clock = () if choice.rate is not None else header.groups.get("t", ())
    is_text = any(table.kinds[names.index(name)] == "stamp" for name in clock)
    return replace(run, t=past_midnight(run.t)) if is_text else run


def _has_channels_alone(table: TextTable) -> bool:
    """Whether all columns are called as in RUN.csv (t, q1 ..., tau1 ...), so that none
    can say of which joint a row is."""
    return {group_of(name) for name in table.names} <= {"t", *GROUPS}


def _run_of_columns(
    table: TextTable,
    header: Header,
    names: Sequence[str],
    chosen: Sequence[int],
) -> Measurements:
    """The run of the chosen columns; of a sparse table what is nearest in time."""
    called = [names[k] for k in chosen]
    pieces = read_pieces(table, chosen)
    try:
        return header.gather(
            header.run(dict(zip(called, piece, strict=True))) for piece in pieces
        )
    except EmptyCellError:
        columns = _sparse_columns(table, header, chosen, called)
        if columns is None:
            raise
        return header.read(columns)


def read_columns(path: Path) -> dict[str, Array]:
    """Read the columns of a table that are numbers.

    Parameters
    ----------
    path : Path
        Of a text table.

    Returns
    -------
    dict of str to array
        (N,) numbers, or (N, n) of lists, by the column's name.

    Raises
    ------
    InputError
        Naming the row and column that is wrong.
    """
    table = inspect_table(path)
    chosen = [
        k for k, kind in enumerate(table.kinds) if kind in ("number", "list", "stamp")
    ]
    pieces = list(read_pieces(table, chosen))
    return {
        table.names[k]: np.concatenate([piece[place] for piece in pieces])
        for place, k in enumerate(chosen)
    }


def inspect(path: Path) -> CellTable:
    """Describe what the columns of a text table hold.

    Parameters
    ----------
    path : Path
        Path of the file.

    Returns
    -------
    CellTable
        Kinds and first cells, by name.
    """
    table = inspect_table(path)
    return _cell_table(table, table.names)


def _cell_table(table: TextTable, names: Sequence[str]) -> CellTable:
    """What the recogniser needs to know of the columns."""
    kinds = dict(zip(names, table.kinds, strict=True))
    cells = {name: table.first_cells(k) for k, name in enumerate(names)}
    return CellTable(kinds, cells)


def write(measurements: Measurements, path: Path) -> None:
    """Write one run as RUN.csv, whole or not at all.

    Parameters
    ----------
    measurements : Measurements
        The run.
    path : Path
        Of the file to write.
    """
    with writing(path) as file:
        file.write((",".join(columns_of(measurements)) + "\n").encode())
        for part in measurements.parts():
            rows = np.column_stack(list(columns_of(part).values())).tolist()
            file.write(
                "".join(",".join(map(repr, row)) + "\n" for row in rows).encode()
            )


def numbers(path: Path, width: int) -> Array:
    """Read the rows of a file without a header.

    Parameters
    ----------
    path : Path
        Path of the file.
    width : int
        How many columns it has.

    Returns
    -------
    Array
        (N, width) numbers.

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
    table: TextTable,
    names: Sequence[str],
    chosen: Sequence[int],
) -> None:
    """InputError naming a chosen column that never holds a number, once."""
    for k in chosen:
        if table.kinds[k] == "text":
            cell = table.first_cells(k)[0][:40]
            what = f"column {names[k]} is never a number: {cell!r} is not a number"
            remedy = "name the column that holds it with `convert --rename`"
            raise InputError(what, remedy, table.path)


def _sparse_columns(
    table: TextTable,
    header: Header,
    chosen: Sequence[int],
    called: Sequence[str],
) -> dict[str, Array] | None:
    """The columns of a table in which some have rows of their own, as topics of
    different times have: what is nearest in time comes together. None where no more
    than a few rows lack a cell, which is a fault."""
    from sdp_vs_penalty.data.merging import merge_columns

    numbers, columns = read_cells(table, chosen)
    n_incomplete = sum(not all(row) for row in zip(*columns, strict=True))
    if n_incomplete < _SPARSE_ROWS:
        return None
    values = {
        name: parse_with_gaps(table, k, numbers, cells)
        for name, k, cells in zip(called, chosen, columns, strict=True)
    }
    clock = header.groups.get("t", ()) if header.rate is None else ()
    t = np.arange(len(columns[0]), dtype=float)
    if clock:
        parts = [header.factors.get(name, 1.0) * values[name] for name in clock]
        t = np.sum(parts, axis=0)
    channels = {name: x for name, x in values.items() if name not in clock}
    positions = [name for name in header.groups["q"] if name in channels]
    rows, merged = merge_columns(t, channels, positions)
    _say_rows_left_out(table, len(t) - len(rows))
    stamps = {name: values[name][rows] for name in clock}
    return stamps | merged


def _say_rows_left_out(table: TextTable, n_rows: int) -> None:
    """A remark about rows that have not all channels."""
    if n_rows == 0:
        return
    rows = formatting.count(n_rows, "row")
    warning = f"{table.path}: {rows} without all channels left out or joined to the"
    warnings.warn(f"{warning} nearest in time", Remark, stacklevel=3)
