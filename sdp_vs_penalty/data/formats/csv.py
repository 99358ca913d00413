"""CSV and other text tables: RUN.csv with the header t,q1..qn,dq1..dqn,tau1..taun, one
row a sample; read piece by piece: memory for the numbers and for one piece, however
long the file."""

import re
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from sdp_vs_penalty import formatting
from sdp_vs_penalty.data.catalogue import DATASETS
from sdp_vs_penalty.data.formats.columns import HEADER, Choice, Header, columns_of
from sdp_vs_penalty.data.formats.recognition import CellTable
from sdp_vs_penalty.data.formats.stamps import seconds_of
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


def read(path: Path, choice: Choice) -> Measurements:
    """The run of a table; InputError naming the row and column that cannot be used."""
    table = inspect_table(path)
    names = list(table.names)
    if not table.has_header and names[0] == "#1" and not choice.rename:
        if choice.rate is None:
            raise _no_header(table)
        names = _three_groups(path, names)
    header = Header.of(path, names, choice, table=described(table, names))
    chosen = sorted(names.index(name) for name in header.columns)
    _refuse_texts(table, names, chosen)
    called = [names[k] for k in chosen]
    if any(table.is_sparse(k) for k in chosen):
        return _read_sparse(table, header, chosen, called)
    pieces = _read_columns(table, chosen)
    return header.gather(
        header.run(dict(zip(called, piece, strict=True))) for piece in pieces
    )


def described(table: TextTable, names: Sequence[str]) -> CellTable:
    """What the recogniser is told of the columns."""
    kinds = dict(zip(names, table.kinds, strict=True))
    return CellTable(kinds, {n: table.first_cells(k) for k, n in enumerate(names)})


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
    names, kinds = tuple(f"#{k}" for k in range(1, width + 1)), ("number",) * width
    table = TextTable(path, ",", ".", False, False, names, False, 1, kinds, ())
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
    return [f"{group}{k}" for group in ("q", "dq", "tau") for k in joints]


def _no_header(table: TextTable) -> InputError:
    """The error of a table whose first row holds numbers."""
    path = table.path
    width = table.width
    files = [(d.name, Path(f.path).name) for d in DATASETS.values() for f in d.files]
    known = [name for name, file in files if file == path.name]
    remedy = f"put {HEADER} above them"
    if known:
        remedy = f"take what `sdp-vs-penalty fetch {known[0]}` makes of this raw file"
    elif width > 3 and width % 3 == 1:
        joints = range(1, width // 3 + 1)
        groups = enumerate(("q", "dq", "tau"))
        pairs = [
            f"{group}{k}=#{1 + at * len(joints) + k}"
            for at, group in groups
            for k in joints
        ]
        command = formatting.convert_command(
            path, "--rename", ",".join(["t=#1", *pairs])
        )
        remedy += f", or, where its columns are t, q, dq and tau, `{command}`"
    elif width % 3 == 0:
        command = formatting.convert_command(path, "--rate", "HZ")
        remedy += f", or, where its columns are q, dq and tau, `{command}`"
    else:
        remedy += (
            ", or name columns by their numbers with `convert --rename t=#1,q1=#2`"
        )
    return InputError("row 1 holds numbers instead of a header", remedy, path)


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
    first = table.first
    width = table.width
    yield [_no_values(table, k) for k in chosen]
    single_blanks = table.delimiter is not None or _has_single_blanks(table)
    if table.nested or not single_blanks:
        yield from _read_carefully(table, chosen, first)
        return
    from pyarrow import ArrowException
    from pyarrow import csv as arrow

    names = [str(k) for k in range(width)]
    is_text = {str(k): table.kinds[k] in ("list", "stamp") for k in chosen}
    types = {name: "string" if text else "float64" for name, text in is_text.items()}
    # Some forty blocks are read ahead.
    how = {"use_threads": False, "block_size": PIECE // 4}
    rows = arrow.ReadOptions(**how, skip_rows=first - 1, column_names=names)
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
    try:
        with arrow.open_csv(path_or_file(table.path), rows, cells, kinds) as file:
            for batch in file:
                yield [
                    _values(table, k, column)
                    for k, column in zip(chosen, batch.columns, strict=True)
                ]
                first += len(batch)
    except ArrowException:  # what it does not take, the careful reader names or reads
        yield from _read_carefully(table, chosen, first)


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


def _read_sparse(
    table: TextTable, header: Header, chosen: Sequence[int], called: Sequence[str]
) -> Measurements:
    """The run of a table in which columns have rows of their own, as topics of
    different times have: what is nearest in time comes together."""
    columns = list[list[str]]([[] for _ in chosen])
    for row, rows in iter_rows(table.path):
        rows = rows[max(table.first - row, 0) :]
        row = max(row, table.first)
        lines = [line for line in rows if line.strip()]
        cells = [split_cells(line, table.delimiter) for line in lines]
        _refuse_widths(table, row, lines, cells)
        for column, k in zip(columns, chosen, strict=True):
            column += [cells_of_row[k] for cells_of_row in cells]
    values = {
        name: _with_gaps(table, k, column)
        for name, k, column in zip(called, chosen, columns, strict=True)
    }
    clock = header.groups.get("t", ())
    t = np.sum([header.factors.get(n, 1.0) * values[n] for n in clock], axis=0)
    if not clock:
        t = np.arange(len(columns[0]), dtype=float)
    others = {name: x for name, x in values.items() if name not in clock}
    position_names = [name for name in header.groups["q"] if name in others]
    kept_rows, merged = merge_columns(t, others, position_names)
    left_out = len(t) - len(kept_rows)
    if left_out:
        rows_ = formatting.count(left_out, "row")
        warning = (
            f"{table.path}: {rows_} without all channels left out or joined to the"
        )
        warnings.warn(f"{warning} nearest in time", Remark, stacklevel=2)
    return header.run({name: values[name][kept_rows] for name in clock} | merged)


def _with_gaps(table: TextTable, column: int, cells: Sequence[str]) -> Array:
    """A column as numbers, NaN where a cell is empty."""
    filled = [k for k, cell in enumerate(cells) if cell]
    part = _parse_column(table, column, table.first, [cells[k] for k in filled])
    out = np.full((len(cells), *part.shape[1:]), np.nan)
    out[filled] = part
    return out
