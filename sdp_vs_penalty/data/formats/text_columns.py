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
    """Read chosen columns of a text table, piece by piece.

    Parameters
    ----------
    table : TextTable
        What the file is made of.
    chosen : Sequence[int]
        Places of the columns, from 0.

    Yields
    ------
    list[Array]
        At least one piece, the first an empty one: (N,) numbers a column, or (N, n)
        where cells hold lists.

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


def _parse_lists(
    table: TextTable,
    column: int,
    cells: Sequence[str],
) -> Array:
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
            f"{what} ({shown})",
            "give each row as many values",
            table.path,
        )
    return np.array(words, float).reshape(len(cells), *lengths or (0,))


def _read_carefully(
    table: TextTable,
    chosen: Sequence[int],
    first: int,
) -> Iterator[list[Array]]:
    """The same from row ``first`` on, which names the row and column that is wrong.

    Empty rows and repetitions of the header are left out, and counted.
    """
    n_empty = 0
    n_headers = 0
    n_trailing = 0
    for number, rows in iter_rows(table.path):
        numbered = [(k, row) for k, row in enumerate(rows, number) if k >= first]
        full = [(k, row) for k, row in numbered if row.strip()]
        values = [(k, row) for k, row in full if row.strip() != table.header_row]
        n_headers += len(full) - len(values)
        if full:
            n_at_the_end = numbered[-1][0] - full[-1][0]
            n_empty += n_trailing + len(numbered) - len(full) - n_at_the_end
            n_trailing = n_at_the_end
        else:
            n_trailing += len(numbered)
        if values:
            numbers, lines = zip(*values, strict=True)
            yield _parse_rows(table, chosen, numbers, lines)
    _say_rows_skipped(table.path, n_empty, n_headers)


def _say_rows_skipped(path: Path, n_empty: int, n_headers: int) -> None:
    """A remark about empty rows, and headers between values."""
    kinds = {"empty row": n_empty, "repeated header": n_headers}
    shown = [formatting.count(n, noun) for noun, n in kinds.items() if n]
    if shown:
        warning = f"{path}: {' and '.join(shown)} left out"
        warnings.warn(warning, Remark, stacklevel=3)


def _parse_rows(
    table: TextTable,
    chosen: Sequence[int],
    numbers: Sequence[int],
    rows: Sequence[str],
) -> list[Array]:
    """The chosen columns of some rows; InputError naming the one that is wrong.

    numbers : of the rows in the file, from 1.
    """
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
                    rows,
                    delimiter=delimiter,
                    ndmin=2,
                    comments=None,
                    usecols=chosen,
                )
                return list(np.ascontiguousarray(values.T))
        except ValueError:
            pass  # the cells are looked at one by one
    cells = [split_cells(line, delimiter) for line in rows]
    _refuse_widths(table, numbers, cells)
    return [
        _parse_column(
            table,
            k,
            numbers,
            [row[k] for row in cells],
        )
        for k in chosen
    ]


def _parse_column(
    table: TextTable,
    column: int,
    numbers: Sequence[int],
    cells: Sequence[str],
) -> Array:
    """One column of some rows as numbers; InputError naming the cell that is none.

    numbers : of the rows in the file, from 1.
    """
    if table.kinds[column] == "list":
        return _parse_lists(table, column, cells)
    if table.kinds[column] == "stamp":
        return seconds_of(cells)
    unit = table.cell_units.get(column, "")
    cells = [cell.removesuffix(unit).strip() for cell in cells] if unit else cells
    for number, cell in zip(numbers, cells, strict=True):
        if not cell:
            what = f"row {number}, column {column + 1} holds '', not a number"
            raise EmptyCellError(what, "correct it or delete the row", table.path)
        if not is_number(cell, table.decimal):
            what = (
                f"row {number}, column {column + 1} holds {cell[:40]!r}, not a number"
            )
            raise InputError(what, "correct it or delete the row", table.path)
    return np.array([plain_number(cell, table.decimal) for cell in cells], float)


def _refuse_widths(
    table: TextTable,
    numbers: Sequence[int],
    cells: Sequence[Sequence[str]],
) -> None:
    """InputError naming a row that has more or fewer cells than others."""
    for number, row in zip(numbers, cells, strict=True):
        if len(row) != table.width:
            than = "the header has" if table.has_header else "row 1 has"
            what = f"row {number} has {len(row)} cells, {than} {table.width}"
            raise InputError(what, "complete the row or delete it", table.path)


def iter_cells(table: TextTable, column: int) -> Iterator[list[str]]:
    """Go through the cells of one column, piece by piece.

    Parameters
    ----------
    table : TextTable
        What the file is made of.
    column : int
        Its place, from 0.

    Yields
    ------
    list[str]
        Its texts, of rows that are as long as the header.
    """
    for first, rows in iter_rows(table.path):
        values = rows[max(table.first - first, 0) :]
        cells = [split_cells(row, table.delimiter) for row in values]
        yield [row[column] for row in cells if len(row) == table.width]


def read_cells(
    table: TextTable, chosen: Sequence[int]
) -> tuple[list[int], list[list[str]]]:
    """Read the cells of chosen columns as texts.

    Parameters
    ----------
    table : TextTable
        What the file is made of.
    chosen : Sequence[int]
        Places of the columns, from 0.

    Returns
    -------
    tuple[list[int], list[list[str]]]
        The numbers of all rows of values in the file, from 1, and their cells, a list a
        column.

    Raises
    ------
    InputError
        A row has more or fewer cells than others.
    """
    numbers = list[int]()
    columns = list[list[str]]([[] for _ in chosen])
    for first, rows in iter_rows(table.path):
        for number, line in enumerate(rows, start=first):
            is_value = line.strip() and line.strip() != table.header_row
            if number < table.first or not is_value:
                continue
            row = split_cells(line, table.delimiter)
            _refuse_widths(table, [number], [row])
            numbers.append(number)
            for column, k in zip(columns, chosen, strict=True):
                column.append(row[k])
    return numbers, columns


def parse_with_gaps(
    table: TextTable,
    column: int,
    numbers: Sequence[int],
    cells: Sequence[str],
) -> Array:
    """Parse a column of which cells are empty.

    Parameters
    ----------
    table : TextTable
        What the file is made of.
    column : int
        Its place, from 0.
    numbers : Sequence[int]
        Of the rows in the file, from 1.
    cells : Sequence[str]
        Its texts, one a row.

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
    rows = [numbers[k] for k in filled]
    values = _parse_column(
        table,
        column,
        rows,
        [cells[k] for k in filled],
    )
    out = np.full((len(cells), *values.shape[1:]), np.nan)
    out[filled] = values
    return out
