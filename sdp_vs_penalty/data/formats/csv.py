"""CSV and other text tables, one row a sample: a fast reader, and where that one gives up
a careful one that names the row and column that is wrong. Read in pieces: memory for the
numbers of the chosen columns and for one piece, however long the file.

Texts of other forms are known by their first line: messages that `ros2 topic echo` has
printed, JSON, and what KUKA's RSI sends.
"""

import re
import warnings
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from sdp_vs_penalty import formatting
from sdp_vs_penalty.data.formats.text_file import PIECE, iter_rows
from sdp_vs_penalty.data.formats.text_table import (
    MarkupError,
    TextTable,
    inspect_table,
    is_comment,
    is_number,
    plain_number,
    split_cells,
)
from sdp_vs_penalty.data.log import Column, Log, Values
from sdp_vs_penalty.data.measurements import Measurements, columns_of
from sdp_vs_penalty.data.store import AppendableArray
from sdp_vs_penalty.data.words.stamps import seconds_of
from sdp_vs_penalty.errors import InputError, Remark
from sdp_vs_penalty.files import path_or_file, writing
from sdp_vs_penalty.robot.arrays import Array

SUFFIXES: tuple[str, ...] = (".csv",)
SAMPLE = "row"

#: Rows of a table: their numbers in the file, from 1, and their texts.
Rows = tuple[Sequence[int], Sequence[str]]


class EmptyCellError(InputError):
    """A chosen column has no number in a row."""


def read(path: Path) -> Log:
    """Read the columns of a text."""
    try:
        table = inspect_table(path)
    except MarkupError as error:
        from sdp_vs_penalty.data.formats import jsonl, ros_echo, rsi_xml

        if error.what.startswith("YAML"):
            return ros_echo.read(path)
        return (jsonl if error.what.startswith("JSON") else rsi_xml).read_text(
            path, error
        )
    return log_of_table(table)


def log_of_table(table: TextTable) -> Log:
    """Make a log of a text table."""
    columns = dict[str, Column]()
    for k, (name, kind) in enumerate(zip(table.names, table.kinds, strict=True)):
        cells = table.first_cells(k)
        if kind == "number":
            cells = [plain_number(x, table.decimal) for x in cells]
        columns.setdefault(name, Column(kind, cells))
    place = {name: k for k, name in reversed([*enumerate(table.names)])}

    def read_columns(names: Sequence[str]) -> Values:
        return _values(table, {name: place[name] for name in names})

    def texts(names: Sequence[str]) -> list[list[str]]:
        chosen = [place[name] for name in names]
        return [[row[k] for k in chosen] for _, row in _iter_cells(table)]

    _require_equal_clocks(table)
    return Log(
        table.path,
        columns,
        read_columns,
        texts,
        rate=table.rate,
        word="row",
        twice=frozenset(x for x, n in Counter(table.names).items() if n > 1 and x),
    )


def _require_equal_clocks(table: TextTable) -> None:
    """Raise InputError where channels have columns of stamps of their own, and these
    differ."""
    for first, *others in _pieces(table, table.clocks) if len(table.clocks) > 1 else ():
        for place, other in zip(table.clocks[1:], others, strict=True):
            if not np.array_equal(first, other):
                what = f"columns {table.clocks[0] + 1} and {place + 1} are clocks that differ"
                remedy = "export all channels with one sample time and one clock"
                raise InputError(what, remedy, table.path)


def _values(table: TextTable, place_of: dict[str, int]) -> Values:
    """Read chosen columns, by name and place; where cells are empty, once more with gaps.

    Raises InputError naming the row and column that is wrong.
    """
    chosen = list(place_of.values())
    joined = [AppendableArray() for _ in chosen]
    numbers = AppendableArray()
    numbers.append(np.zeros(0, np.intp))
    try:
        for piece in _pieces(table, chosen, numbers):
            for array, values in zip(joined, piece, strict=True):
                array.append(values)
    except EmptyCellError:
        return _values_with_gaps(table, place_of)
    columns = {name: x.array() for name, x in zip(place_of, joined, strict=True)}
    rows = numbers.array()
    is_usual = not len(rows) or (rows[0] == 2 and rows[-1] == len(rows) + 1)
    return Values(columns, None if is_usual else rows)


def _values_with_gaps(table: TextTable, place_of: dict[str, int]) -> Values:
    """Read chosen columns in which cells may be empty: NaN there, and where they are."""
    rows = [(n, row) for n, row in _iter_cells(table)]
    numbers = np.array([n for n, _ in rows], np.intp)
    columns, gaps = dict[str, Array](), dict[str, Any]()
    for name, k in place_of.items():
        is_empty = np.array([not row[k] for _, row in rows])
        filled = [row[k] for _, row in rows if row[k]]
        values = _parse_column(table, k, numbers[~is_empty].tolist(), filled)
        columns[name] = np.full((len(rows), *values.shape[1:]), np.nan)
        columns[name][~is_empty] = values
        if is_empty.any():
            gaps[name] = is_empty
    return Values(columns, numbers, gaps)


def _pieces(
    table: TextTable, chosen: Sequence[int], numbers: AppendableArray | None = None
) -> Iterator[list[Array]]:
    """Read the columns at some places, from 0, in pieces of bounded size: an array a
    column, (N,) numbers, or (N, n) where cells hold lists. The first piece has no rows.

    PyArrow reads fast. Where it gives up, or the table is not simple enough for it, a
    slower parser goes on from the same row. ``numbers`` takes the rows' numbers.
    """
    from pyarrow import ArrowException

    numbers = AppendableArray() if numbers is None else numbers
    yield [_no_values(table, k) for k in chosen]
    first = table.first
    is_simple = (
        not table.nested and not table.has_wrapped_cells and table.is_plain_utf_8
    )
    if is_simple and (table.delimiter is not None or _has_single_blanks(table)):
        try:
            for piece in _read_by_arrow(table, chosen):
                yield piece
                numbers.append(np.arange(first, first + len(piece[0])))
                first += len(piece[0])
        except ArrowException:
            pass  # what it does not take, the careful reader names or reads
        else:
            return
    for rows in _value_rows(table, first):
        yield _parse_rows(table, chosen, *rows)
        numbers.append(np.array(rows[0], np.intp))


def _read_by_arrow(table: TextTable, chosen: Sequence[int]) -> Iterator[list[Array]]:
    """Read chosen columns by PyArrow, piece by piece.

    Lists and time stamps come as texts and are parsed here. PyArrow raises
    ArrowException for a cell that is no number, without naming it.
    """
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
            yield [_of_arrow(table, k, column) for k, column in pairs]


def _of_arrow(table: TextTable, column: int, values: Any) -> Array:
    """Convert a column of PyArrow's to numbers (N,), or (N, n) of lists."""
    if table.kinds[column] == "stamp":
        return seconds_of(values.to_pylist())
    if table.kinds[column] == "list":
        return _parse_lists(table, column, values.to_pylist())
    # By to_numpy() pandas would be imported.
    return np.asarray(np.from_dlpack(values).view(np.float64))


def _no_values(table: TextTable, column: int) -> Array:
    """Return a column without rows: (0,) numbers, or (0, n) where cells hold lists."""
    if table.kinds[column] != "list" or not table.first_cells(column):
        return np.zeros(0)
    return _parse_lists(table, column, table.first_cells(column)[:1])[:0]


def _has_single_blanks(table: TextTable) -> bool:
    """Return whether the cells of the first rows are separated by exactly one blank, as
    PyArrow needs it."""
    number, rows = next(iter_rows(table.path))
    lines = rows[table.first - number : table.first - number + len(table.sample)]
    return all(len(line.rstrip("\r").split(" ")) == table.width for line in lines)


def _value_rows(table: TextTable, first: int) -> Iterator[Rows]:
    """Iterate over the rows of values from row ``first`` on, piece by piece.

    Empty rows, comments and repeated headers are left out, and a remark counts them;
    empty rows at the end of the file do not count.
    """
    left_out = Counter[str]()
    n_trailing = 0  # empty rows since the last one that is not empty
    for first_of_piece, lines in iter_rows(table.path):
        numbers, texts = list[int](), list[str]()
        for number, line in enumerate(lines, start=first_of_piece):
            text = line.strip()
            if number < first:
                continue
            if not text:
                n_trailing += 1
                continue
            left_out["empty row"] += n_trailing
            n_trailing = 0
            if is_comment(text):
                left_out["comment"] += 1
            elif text == table.header_row:
                left_out["repeated header"] += 1
            else:
                numbers.append(number)
                texts.append(line)
        if numbers:
            yield numbers, texts
    kinds = ("empty row", "repeated header", "comment")
    shown = [formatting.count(left_out[x], x) for x in kinds if left_out[x]]
    if shown:
        said = f"{table.path}: {' and '.join(shown)} left out"
        warnings.warn(said, Remark, stacklevel=3)


def _iter_cells(table: TextTable) -> Iterator[tuple[int, list[str]]]:
    """Iterate over the rows of values as cells, each with its number in the file."""
    for numbers, lines in _value_rows(table, table.first):
        for number, line in zip(numbers, lines, strict=True):
            yield number, _cells_of(table, number, line)


def _cells_of(table: TextTable, number: int, line: str) -> list[str]:
    """Split a row into cells; raise InputError where they are more or fewer than the
    table's."""
    cells = split_cells(line, table.delimiter)
    if len(cells) != table.width:
        than = "the header has" if table.has_header else "row 1 has"
        what = f"row {number} has {len(cells)} cells, {than} {table.width}"
        raise InputError(what, "complete the row or delete it", table.path)
    return cells


def _parse_rows(
    table: TextTable, chosen: Sequence[int], numbers: Sequence[int], rows: Sequence[str]
) -> list[Array]:
    """Parse the chosen columns of some rows: one array a column.

    Plain numbers are parsed by NumPy at once; only where that fails are the cells parsed
    one by one, and InputError names the wrong one by its row's number.
    """
    are_numbers = all(table.kinds[k] in ("number", "empty") for k in chosen)
    if are_numbers and table.decimal == "." and not table.quoted and not table.nested:
        mark = table.delimiter
        widths = {len(x.split()) if mark is None else x.count(mark) + 1 for x in rows}
        if widths == {table.width}:
            try:
                options: Any = {"ndmin": 2, "comments": None, "usecols": chosen}
                values = np.loadtxt(rows, delimiter=mark, **options)
                return list(np.ascontiguousarray(values.T))
            except ValueError:
                pass
    cells = [_cells_of(table, n, line) for n, line in zip(numbers, rows, strict=True)]
    return [_parse_column(table, k, numbers, [row[k] for row in cells]) for k in chosen]


def _parse_lists(table: TextTable, column: int, cells: Sequence[str]) -> Array:
    """Parse N cells that hold lists such as "[0.1, 0.2]" into (N, n) numbers; raise
    InputError where the lists have different lengths."""
    number = r"[-+]?(?:\d+\.?\d*(?:[eE][-+]?\d+)?|\.\d+|nan|inf)"
    words = [re.findall(number, cell) for cell in cells]
    lengths = {len(row) for row in words}
    if len(lengths) > 1:
        shown = ", ".join(map(str, sorted(lengths)[:4]))
        what = (
            f"column {table.names[column]} holds lists of different lengths ({shown})"
        )
        raise InputError(what, "give each row as many values", table.path)
    return np.array(words, float).reshape(len(cells), *lengths or (0,))


def _parse_column(
    table: TextTable, column: int, numbers: Sequence[int], cells: Sequence[str]
) -> Array:
    """Parse the cells of one column: (N,) numbers, or (N, n) of lists.

    Raises InputError naming the row of the cell that is no number, EmptyCellError where
    it is empty.
    """
    if table.kinds[column] == "list" and "" not in cells:
        return _parse_lists(table, column, cells)
    if table.kinds[column] == "stamp" and "" not in cells:
        return seconds_of(cells)
    unit = table.cell_units.get(column, "")
    cells = [cell.removesuffix(unit).strip() for cell in cells] if unit else cells
    for number, cell in zip(numbers, cells, strict=True):
        if not cell or not is_number(cell, table.decimal):
            kind = InputError if cell else EmptyCellError
            what = (
                f"row {number}, column {column + 1} holds {cell[:40]!r}, not a number"
            )
            raise kind(what, "correct it or delete the row", table.path)
    return np.array([plain_number(cell, table.decimal) for cell in cells], float)


def write(measurements: Measurements, path: Path) -> None:
    """Write one run as RUN.csv with the header t,q1..qn,dq1..dqn,tau1..taun; numbers so
    that they are read back to the last bit."""
    with writing(path) as file:
        file.write((",".join(columns_of(measurements)) + "\n").encode())
        for part in measurements.parts():
            rows = np.column_stack(list(columns_of(part).values())).tolist()
            # repr() writes the shortest text that gives back the same number.
            lines = [",".join(map(repr, row)) + "\n" for row in rows]
            file.write("".join(lines).encode())
