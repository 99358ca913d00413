"""The columns of a text table as numbers, piece by piece: by a fast reader, and where that
one gives up by a careful one that names the row and column that is wrong."""

import re
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from sdp_vs_penalty import formatting
from sdp_vs_penalty.data.formats.stamps import seconds_of
from sdp_vs_penalty.data.formats.text_table import (
    PIECE,
    TextTable,
    is_comment,
    is_number,
    iter_rows,
    plain_number,
    split_cells,
)
from sdp_vs_penalty.errors import InputError, Remark
from sdp_vs_penalty.files import path_or_file
from sdp_vs_penalty.robot.arrays import Array


class EmptyCellError(InputError):
    """A chosen column has no number in a row."""


def read_pieces(table: TextTable, chosen: Sequence[int]) -> Iterator[list[Array]]:
    """Read chosen columns of a text table, in pieces of bounded size.

    PyArrow reads fast. Where it gives up, or the table is not simple enough for it, a
    slower parser goes on from the same row: it reads more forms, and names a cell that
    is wrong.

    Parameters
    ----------
    chosen : Sequence[int]
        Places of the columns, from 0.

    Yields
    ------
    list[Array]
        One array a column: (N,) numbers, or (N, n) where cells hold lists. At least one
        piece; the first has no rows.

    Raises
    ------
    InputError
        Naming the row and column that is wrong.
    """
    from pyarrow import ArrowException

    yield [_no_values(table, k) for k in chosen]
    first = table.first
    has_single_marks = table.delimiter is not None or _has_single_blanks(table)
    is_simple = not table.nested and not table.has_wrapped_cells
    if has_single_marks and is_simple and table.is_plain_utf_8:
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
    """Read chosen columns by PyArrow: one list of arrays, one for each column, for each
    piece of rows.

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
            yield [_values(table, k, column) for k, column in pairs]


def _no_values(table: TextTable, column: int) -> Array:
    """Return a column without rows: (0,) numbers, or (0, n) where cells hold n
    numbers."""
    if table.kinds[column] != "list" or not table.first_cells(column):
        return np.zeros(0)
    return _parse_lists(table, column, table.first_cells(column)[:1])[:0]


def _has_single_blanks(table: TextTable) -> bool:
    """Return whether the cells of the first rows are separated by exactly one blank, as
    PyArrow needs it."""
    number, rows = next(iter_rows(table.path))
    lines = rows[table.first - number : table.first - number + len(table.sample)]
    return all(len(line.rstrip("\r").split(" ")) == table.width for line in lines)


def _values(table: TextTable, column: int, values: object) -> Array:
    """Convert a column of PyArrow's to numbers (N,), or (N, n) of lists."""
    if table.kinds[column] == "stamp":
        return seconds_of(values.to_pylist())  # type: ignore[attr-defined]
    if table.kinds[column] == "list":
        return _parse_lists(table, column, values.to_pylist())  # type: ignore[attr-defined]
    # By to_numpy() pandas would be imported.
    return np.asarray(np.from_dlpack(values).view(np.float64))  # type: ignore[arg-type]


def _parse_lists(table: TextTable, column: int, cells: Sequence[str]) -> Array:
    """Parse N cells that hold lists such as "[0.1, 0.2]" into (N, n) numbers.

    Raises InputError where the lists have different lengths.
    """
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
    """Read chosen columns row by row, from row ``first`` (counted from 1) on.

    Empty rows, comments and repeated headers are left out, and a remark counts them;
    empty rows at the end of the file do not count. A wrong cell raises InputError with its row and
    column.
    """
    n_empty = 0
    n_headers = 0
    n_comments = 0
    n_trailing = 0  # empty rows since the last one that is not empty
    for first_of_piece, rows in iter_rows(table.path):
        numbered = enumerate(rows, start=first_of_piece)
        new_rows = [(k, row) for k, row in numbered if k >= first]
        full = [(k, row) for k, row in new_rows if row.strip()]
        plain = [(k, row) for k, row in full if not is_comment(row.lstrip())]
        values = [(k, row) for k, row in plain if row.strip() != table.header_row]
        n_comments += len(full) - len(plain)
        n_headers += len(plain) - len(values)
        if full:
            last_row, last_full_row = new_rows[-1][0], full[-1][0]
            n_at_the_end = last_row - last_full_row
            n_empty += n_trailing + len(new_rows) - len(full) - n_at_the_end
            n_trailing = n_at_the_end
        else:
            n_trailing += len(new_rows)
        if values:
            numbers, lines = zip(*values, strict=True)
            yield _parse_rows(table, chosen, numbers, lines)
    _say_rows_skipped(table.path, n_empty, n_headers, n_comments)


def _say_rows_skipped(
    path: Path, n_empty: int, n_headers: int, n_comments: int
) -> None:
    """Warn that empty rows, and headers and comments between values, were left out."""
    kinds = {"empty row": n_empty, "repeated header": n_headers, "comment": n_comments}
    shown = [formatting.count(n, noun) for noun, n in kinds.items() if n]
    if shown:
        warning = f"{path}: {' and '.join(shown)} left out"
        warnings.warn(warning, Remark, stacklevel=3)


def _parse_rows(
    table: TextTable, chosen: Sequence[int], numbers: Sequence[int], rows: Sequence[str]
) -> list[Array]:
    """Parse the chosen columns of some rows: one array a column.

    ``numbers`` are the rows' numbers in the file, from 1, for messages. Plain numbers
    are parsed by NumPy at once; only where that fails are the cells parsed one by one,
    and InputError names the wrong one.
    """
    has_numbers_alone = all(table.kinds[k] in ("number", "empty") for k in chosen)
    has_plain_cells = table.decimal == "." and not table.quoted and not table.nested
    if has_numbers_alone and has_plain_cells:
        columns = _parse_plainly(table, chosen, rows)
        if columns is not None:
            return columns
    cells = [split_cells(line, table.delimiter) for line in rows]
    _refuse_widths(table, numbers, cells)
    columns = list[Array]()
    for k in chosen:
        texts = [row[k] for row in cells]
        columns.append(_parse_column(table, k, numbers, texts))
    return columns


def _parse_plainly(
    table: TextTable, chosen: Sequence[int], rows: Sequence[str]
) -> list[Array] | None:
    """Parse chosen columns of rows of plain numbers by NumPy; None where rows have
    different numbers of cells, or a cell is no plain number."""
    delimiter = table.delimiter
    if delimiter is None:
        widths = {len(line.split()) for line in rows}
    else:
        widths = {line.count(delimiter) + 1 for line in rows}
    if widths != {table.width}:
        return None
    try:
        values = np.loadtxt(
            rows, delimiter=delimiter, ndmin=2, comments=None, usecols=chosen
        )
    except ValueError:
        return None
    return list(np.ascontiguousarray(values.T))


def _parse_column(
    table: TextTable, column: int, numbers: Sequence[int], cells: Sequence[str]
) -> Array:
    """Parse the cells of one column: (N,) numbers, or (N, n) of lists.

    ``numbers`` are the rows' numbers in the file, from 1. Raises InputError naming the
    cell that is no number, EmptyCellError where it is empty.
    """
    if table.kinds[column] == "list":
        return _parse_lists(table, column, cells)
    if table.kinds[column] == "stamp":
        return seconds_of(cells)
    unit = table.cell_units.get(column, "")
    cells = [cell.removesuffix(unit).strip() for cell in cells] if unit else cells
    remedy = "correct it or delete the row"
    for number, cell in zip(numbers, cells, strict=True):
        where = f"row {number}, column {column + 1}"
        if not cell:
            raise EmptyCellError(f"{where} holds '', not a number", remedy, table.path)
        if not is_number(cell, table.decimal):
            what = f"{where} holds {cell[:40]!r}, not a number"
            raise InputError(what, remedy, table.path)
    return np.array([plain_number(cell, table.decimal) for cell in cells], float)


def _refuse_widths(
    table: TextTable, numbers: Sequence[int], cells: Sequence[Sequence[str]]
) -> None:
    """Raise InputError naming the first row that has more or fewer cells than the
    table."""
    for number, row in zip(numbers, cells, strict=True):
        if len(row) != table.width:
            than = "the header has" if table.has_header else "row 1 has"
            what = f"row {number} has {len(row)} cells, {than} {table.width}"
            raise InputError(what, "complete the row or delete it", table.path)


def iter_cells(table: TextTable, column: int) -> Iterator[list[str]]:
    """Iterate over the cells of the column at a place, from 0, as texts, in pieces of
    bounded size; rows of another length than the header are left out."""
    for first, rows in iter_rows(table.path):
        values = rows[max(table.first - first, 0) :]
        cells = [split_cells(row, table.delimiter) for row in values]
        yield [row[column] for row in cells if len(row) == table.width]


def read_cells(
    table: TextTable, chosen: Sequence[int]
) -> tuple[list[int], list[list[str]]]:
    """Read the cells of chosen columns as texts; empty rows and repeated headers are
    left out.

    Parameters
    ----------
    chosen : Sequence[int]
        Places of the columns, from 0.

    Returns
    -------
    tuple[list[int], list[list[str]]]
        The rows' numbers in the file, from 1; and a list of cells for each column.

    Raises
    ------
    InputError
        A row has more or fewer cells than the table.
    """
    numbers = list[int]()
    columns = list[list[str]]([[] for _ in chosen])
    for first, rows in iter_rows(table.path):
        for number, line in enumerate(rows, start=first):
            text = line.strip()
            is_value = text and text != table.header_row and not is_comment(text)
            if number < table.first or not is_value:
                continue
            row = split_cells(line, table.delimiter)
            _refuse_widths(table, [number], [row])
            numbers.append(number)
            for column, k in zip(columns, chosen, strict=True):
                column.append(row[k])
    return numbers, columns


def parse_with_gaps(
    table: TextTable, column: int, numbers: Sequence[int], cells: Sequence[str]
) -> Array:
    """Parse a column in which cells may be empty.

    Parameters
    ----------
    column : int
        Place of the column, from 0.
    numbers : Sequence[int]
        The rows' numbers in the file, from 1.
    cells : Sequence[str]
        The column's texts, one a row.

    Returns
    -------
    Array
        (N,) or (N, n) numbers, NaN where a cell is empty.

    Raises
    ------
    InputError
        Naming the row of a cell that is no number.
    """
    filled = [k for k, cell in enumerate(cells) if cell]
    filled_cells = [cells[k] for k in filled]
    row_numbers = [numbers[k] for k in filled]
    values = _parse_column(table, column, row_numbers, filled_cells)
    with_gaps = np.full((len(cells), *values.shape[1:]), np.nan)
    with_gaps[filled] = values
    return with_gaps
