"""CSV and other text tables: RUN.csv with the header t,q1..qn,dq1..dqn,tau1..taun, one
row a sample; read piece by piece: memory for the numbers and for one piece, however
long the file."""

import re
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from sdp_vs_penalty import formatting
from sdp_vs_penalty.data.catalogue import fetch_remedy
from sdp_vs_penalty.data.formats.columns import HEADER, Choice, Header, columns_of
from sdp_vs_penalty.data.formats.recognition import CellTable
from sdp_vs_penalty.data.formats.stamps import past_midnight, seconds_of
from sdp_vs_penalty.data.formats.text_table import (
    PIECE,
    TextTable,
    inspect_table,
    is_number,
    iter_rows,
    split_cells,
)
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.data.merging import merge_columns
from sdp_vs_penalty.errors import InputError, Remark
from sdp_vs_penalty.files import path_or_file, writing
from sdp_vs_penalty.robot.arrays import Array

SUFFIXES = (".csv",)
#: What messages call a sample.
SAMPLE = "row"
#: A table with so many incomplete rows is sparse; fewer are faults [rows].
_SPARSE_ROWS = 3
#: What research code writes of each joint.
_THREE_GROUPS: tuple[str, ...] = ("q", "dq", "tau")


class _EmptyCellError(InputError):
    """A chosen column has no number in a row."""


def read(path: Path, choice: Choice) -> Measurements:
    """The run of a table; InputError naming the row and column that cannot be used."""
    table = inspect_table(path)
    names = list(table.names)
    if not table.has_header and names[0] == "#1" and not choice.rename:
        if choice.rate is None:
            raise _no_header(table, choice)
        names = _three_groups(path, names)
    header = Header.of(path, names, choice, table=_cell_table(table, names))
    chosen = sorted(names.index(name) for name in header.columns)
    _refuse_texts(table, names, chosen)
    run = _run_of_columns(table, header, names, chosen)
    clock = () if choice.rate is not None else header.groups.get("t", ())
    is_text = any(table.kinds[names.index(name)] == "stamp" for name in clock)
    return replace(run, t=past_midnight(run.t)) if is_text else run


def _run_of_columns(
    table: TextTable, header: Header, names: Sequence[str], chosen: Sequence[int]
) -> Measurements:
    """The run of the chosen columns; of a sparse table what is nearest in time."""
    called = [names[k] for k in chosen]
    pieces = _read_columns(table, chosen)
    try:
        return header.gather(
            header.run(dict(zip(called, piece, strict=True))) for piece in pieces
        )
    except _EmptyCellError:
        columns = _sparse_columns(table, header, chosen, called)
        if columns is None:
            raise
        return header.read(columns)


def inspect(path: Path) -> CellTable:
    """What the columns of a table hold."""
    table = inspect_table(path)
    return _cell_table(table, table.names)


def _cell_table(table: TextTable, names: Sequence[str]) -> CellTable:
    """What the recogniser needs to know of the columns."""
    kinds = dict(zip(names, table.kinds, strict=True))
    cells = {name: table.first_cells(k) for k, name in enumerate(names)}
    return CellTable(kinds, cells)


def write(measurements: Measurements, path: Path) -> None:
    """Write one run as RUN.csv, whole or not at all."""
    with writing(path) as file:
        file.write((",".join(columns_of(measurements)) + "\n").encode())
        for part in measurements.parts():
            rows = np.column_stack(list(columns_of(part).values())).tolist()
            file.write(
                "".join(",".join(map(repr, row)) + "\n" for row in rows).encode()
            )


def numbers(path: Path, width: int) -> Array:
    """The rows (N, width) of a file without a header; InputError naming the row that is
    wrong."""
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
    pieces = _read_columns(table, range(width))
    columns = [np.concatenate(parts) for parts in zip(*pieces, strict=True)]
    return columns[0][:, None] if width == 1 else np.stack(columns, axis=1)


def _three_groups(path: Path, names: Sequence[str]) -> list[str]:
    """Names of 3 n columns without header and clock, as research code writes them:
    positions, velocities and torques."""
    width = len(names)
    if width % 3:
        remedy = "keep q, dq and tau of each joint, or name columns by --rename q1=#2"
        raise InputError(f"{width} columns are not three a joint", remedy, path)
    joints = range(1, width // 3 + 1)
    return [f"{group}{k}" for group in _THREE_GROUPS for k in joints]


def _no_header(table: TextTable, choice: Choice) -> InputError:
    """The error of a table whose first row holds numbers, with the command that names
    its columns."""
    path = table.path
    problem = "row 1 holds numbers instead of a header"
    public = fetch_remedy(path)
    if public is not None:
        return InputError(problem, public, path)
    remedy = f"put {HEADER} above them, or "
    layout = _layout(table.width, None if choice.joints is None else len(choice.joints))
    if layout is None:
        remedy += "name columns by their numbers with `convert --rename t=#1,q1=#2`"
        return InputError(problem, remedy, path)
    words = ["--rename", ",".join(f"{name}=#{k}" for k, name in enumerate(layout, 1))]
    has_clock = layout[0] == "t"
    if not has_clock:
        words += ["--rate", "HZ"]
    groups = [name for name in ("t", "q", "dq", "tau") if f"{name}1" in layout]
    groups = ["t", *groups] if has_clock else groups
    shown = f"{', '.join(groups[:-1])} and {groups[-1]}"
    command = formatting.convert_command(path, *words)
    return InputError(
        problem, f"{remedy}where its columns are {shown}, `{command}`", path
    )


def _layout(width: int, n_joints: int | None) -> list[str] | None:
    """Our names of so many columns without a header: those of the robot's number of
    joints, else of three groups; None where neither fits."""
    layouts = list[tuple[int, int, tuple[str, ...]]]()
    for n_clocks in (0, 1):
        for groups in (_THREE_GROUPS, ("q", "tau")):
            n, n_left = divmod(width - n_clocks, len(groups))
            if n > 0 and n_left == 0:
                layouts.append((n_clocks, n, groups))
    if n_joints is None:
        usual = [layout for layout in layouts if layout[2] == _THREE_GROUPS]
    else:
        usual = [layout for layout in layouts if layout[1] == n_joints]
    if not usual:
        return None
    n_clocks, n, groups = usual[0]
    clock = ["t"] * n_clocks
    return clock + [f"{group}{k}" for group in groups for k in range(1, n + 1)]


def _refuse_texts(
    table: TextTable, names: Sequence[str], chosen: Sequence[int]
) -> None:
    """InputError naming a chosen column that never holds a number, once."""
    for k in chosen:
        if table.kinds[k] == "text":
            cell = table.first_cells(k)[0][:40]
            what = f"column {names[k]} is never a number: {cell!r} is not a number"
            remedy = "name the column that holds it with `convert --rename`"
            raise InputError(what, remedy, table.path)


def _read_columns(table: TextTable, chosen: Sequence[int]) -> Iterator[list[Array]]:
    """The chosen columns of consecutive pieces, at least one (empty) piece: (N,)
    numbers, or (N, n) where cells hold lists."""
    from pyarrow import ArrowException

    yield [_no_values(table, k) for k in chosen]
    first = table.first
    has_single_marks = table.delimiter is not None or _has_single_blanks(table)
    if has_single_marks and not table.nested and not table.has_wrapped_cells:
        try:
            for piece in _read_by_arrow(table, chosen):
                yield piece
                first += len(piece[0])
        except ArrowException:
            pass  # what it does not take, the careful reader names or reads
        else:
            return
    yield from _read_carefully(table, chosen, first)


def _read_by_arrow(table: TextTable, chosen: Sequence[int]) -> Iterator[list[Array]]:
    """The same by the fast reader, whose errors name no cell."""
    from pyarrow import csv as arrow

    is_text = {str(k): table.kinds[k] in ("list", "stamp") for k in chosen}
    types = {name: "string" if text else "float64" for name, text in is_text.items()}
    rows = arrow.ReadOptions(
        use_threads=False,
        block_size=PIECE // 4,  # some forty blocks are read ahead
        skip_rows=table.first - 1,
        column_names=[str(k) for k in range(table.width)],
    )
    cells = arrow.ParseOptions(
        delimiter=table.delimiter or " ",
        quote_char='"' if table.quoted else False,
        ignore_empty_lines=False,
    )
    kinds = arrow.ConvertOptions(
        column_types=types,
        null_values=[],
        include_columns=list(types),
        decimal_point=table.decimal,
    )
    with arrow.open_csv(path_or_file(table.path), rows, cells, kinds) as file:
        for batch in file:
            pairs = zip(chosen, batch.columns, strict=True)
            yield [_values(table, k, column) for k, column in pairs]


def _no_values(table: TextTable, column: int) -> Array:
    """No row of a column: (0,), or (0, n) of lists."""
    if table.kinds[column] != "list" or not table.first_cells(column):
        return np.zeros(0)
    return _parse_lists(table, column, table.first_cells(column)[:1])[:0]


def _has_single_blanks(table: TextTable) -> bool:
    """Whether one blank separates the cells of every row that was looked at."""
    number, rows = next(iter_rows(table.path))
    lines = rows[table.first - number : table.first - number + len(table.sample)]
    return all(len(line.rstrip("\r").split(" ")) == table.width for line in lines)


def _values(table: TextTable, column: int, values: object) -> Array:
    """A column of Arrow's as numbers."""
    if table.kinds[column] == "stamp":
        return seconds_of(values.to_pylist())  # type: ignore[attr-defined]
    if table.kinds[column] == "list":
        return _parse_lists(table, column, values.to_pylist())  # type: ignore[attr-defined]
    # By to_numpy() pandas would be imported.
    return np.asarray(np.from_dlpack(values).view(np.float64))  # type: ignore[arg-type]


def _parse_lists(table: TextTable, column: int, cells: Sequence[str]) -> Array:
    """(N, n) numbers of cells like "[0.1, 0.2]"; InputError for one of another length."""
    words = [
        re.findall(r"[-+]?(?:\d+\.?\d*(?:[eE][-+]?\d+)?|\.\d+|nan|inf)", cell)
        for cell in cells
    ]
    lengths = {len(row) for row in words}
    if len(lengths) > 1:
        what = f"column {table.names[column]} holds lists of different lengths"
        shown = ", ".join(map(str, sorted(lengths)[:4]))
        raise InputError(
            f"{what} ({shown})", "give each row as many values", table.path
        )
    return np.array(words, float).reshape(len(cells), *lengths or (0,))


def _read_carefully(
    table: TextTable, chosen: Sequence[int], first: int
) -> Iterator[list[Array]]:
    """The same from row ``first`` on, which names the row and column that is wrong.

    Only at the end rows may be empty.
    """
    path = table.path
    empty = None
    for row, rows in iter_rows(path):
        rows = rows[max(first - row, 0) :]
        row = max(row, first)
        if empty is not None and any(line.strip() for line in rows):
            raise InputError(f"row {empty} is empty", "delete it", path)
        while rows and not rows[-1].strip():
            empty = row + len(rows) - 1
            rows.pop()
        if not rows:
            continue
        yield _parse_rows(table, chosen, row, rows)


def _parse_rows(
    table: TextTable, chosen: Sequence[int], first: int, rows: Sequence[str]
) -> list[Array]:
    """The chosen columns of some rows; InputError naming the one that is wrong."""
    delimiter = table.delimiter
    is_plain = (
        all(table.kinds[k] in ("number", "empty") for k in chosen)
        and table.decimal == "."
        and not table.quoted
        and not table.nested
    )
    if is_plain:
        separators = [
            len(line.split()) - 1 if delimiter is None else line.count(delimiter)
            for line in rows
        ]
        try:
            if set(separators) == {table.width - 1}:
                values = np.loadtxt(
                    rows, delimiter=delimiter, ndmin=2, comments=None, usecols=chosen
                )
                return list(np.ascontiguousarray(values.T))
        except ValueError:
            pass  # the cells are looked at one by one
    cells = [split_cells(line, delimiter) for line in rows]
    _refuse_widths(table, first, rows, cells)
    return [_parse_column(table, k, first, [row[k] for row in cells]) for k in chosen]


def _parse_column(
    table: TextTable, column: int, first: int, cells: Sequence[str]
) -> Array:
    """One column of some rows as numbers; InputError naming the cell that is none."""
    if table.kinds[column] == "list":
        return _parse_lists(table, column, cells)
    if table.kinds[column] == "stamp":
        return seconds_of(cells)
    for number, cell in enumerate(cells, start=first):
        if not cell:
            what = f"row {number}, column {column + 1} holds '', not a number"
            raise _EmptyCellError(what, "correct it or delete the row", table.path)
        if not is_number(cell, table.decimal):
            what = (
                f"row {number}, column {column + 1} holds {cell[:40]!r}, not a number"
            )
            raise InputError(what, "correct it or delete the row", table.path)
    if table.decimal == ",":
        cells = [cell.replace(",", ".") for cell in cells]
    return np.array(cells, float)


def _refuse_widths(
    table: TextTable, first: int, rows: Sequence[str], cells: Sequence[Sequence[str]]
) -> None:
    """InputError naming a row that is empty, or has more or fewer cells than others."""
    for number, (line, row) in enumerate(zip(rows, cells, strict=True), start=first):
        if not line.strip():
            raise InputError(f"row {number} is empty", "delete it", table.path)
        if len(row) != table.width:
            than = "the header has" if table.has_header else "row 1 has"
            what = f"row {number} has {len(row)} cells, {than} {table.width}"
            raise InputError(what, "complete the row or delete it", table.path)


def _sparse_columns(
    table: TextTable, header: Header, chosen: Sequence[int], called: Sequence[str]
) -> dict[str, Array] | None:
    """The columns of a table in which some have rows of their own, as topics of
    different times have: what is nearest in time comes together. None where no more
    than a few rows lack a cell, which is a fault."""
    columns = _cells_of_columns(table, chosen)
    n_incomplete = sum(not all(row) for row in zip(*columns, strict=True))
    if n_incomplete < _SPARSE_ROWS:
        return None
    values = {
        name: _with_gaps(table, k, cells)
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


def _cells_of_columns(table: TextTable, chosen: Sequence[int]) -> list[list[str]]:
    """The cells of the chosen columns in all rows that are not empty."""
    columns = list[list[str]]([[] for _ in chosen])
    for number, rows in iter_rows(table.path):
        first = max(number, table.first)
        lines = [line for line in rows[first - number :] if line.strip()]
        cells = [split_cells(line, table.delimiter) for line in lines]
        _refuse_widths(table, first, lines, cells)
        for column, k in zip(columns, chosen, strict=True):
            column += [row[k] for row in cells]
    return columns


def _say_rows_left_out(table: TextTable, n_rows: int) -> None:
    """A remark about rows that have not all channels."""
    if n_rows == 0:
        return
    rows = formatting.count(n_rows, "row")
    warning = f"{table.path}: {rows} without all channels left out or joined to the"
    warnings.warn(f"{warning} nearest in time", Remark, stacklevel=3)


def _with_gaps(table: TextTable, column: int, cells: Sequence[str]) -> Array:
    """A column as numbers, NaN where a cell is empty."""
    filled = [k for k, cell in enumerate(cells) if cell]
    part = _parse_column(table, column, table.first, [cells[k] for k in filled])
    out = np.full((len(cells), *part.shape[1:]), np.nan)
    out[filled] = part
    return out
