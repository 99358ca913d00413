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
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from sdp_vs_penalty import formatting
from sdp_vs_penalty.data.formats.text_file import PIECE, iter_rows
from sdp_vs_penalty.data.formats.text_table import (
    END_OF_TITLES,
    MarkupError,
    TextTable,
    inspect_table,
    is_comment,
    is_number,
    plain_number,
    split_cells,
)
from sdp_vs_penalty.data.log import Column, Log, Values, log_of_arrays
from sdp_vs_penalty.data.measurements import Measurements, columns_of
from sdp_vs_penalty.data.store import AppendableArray
from sdp_vs_penalty.data.words.stamps import is_stamp, seconds_of
from sdp_vs_penalty.errors import InputError, Remark
from sdp_vs_penalty.files import path_or_file, writing
from sdp_vs_penalty.robot.arrays import Array, Mask

SUFFIXES: tuple[str, ...] = (".csv",)
SAMPLE = "row"

#: How programs write an empty cell.
EMPTY = (
    "null",
    "NULL",
    "NA",
    "N/A",
    "n/a",
    "#N/A",
    "-",
    "--",
    "---",
    "\u2013",
    "\u2014",
    "None",
    "none",
    "NaT",
    "#DIV/0!",
    "#VALUE!",
    "#REF!",
    "#NUM!",
)
#: More rows than this below the samples are no footer.
_LONGEST_FOOTER = 20
#: Share of rows with more or fewer cells than the table's that are left out.
_MOST_DAMAGED = 0.01
#: Rows of a table: their numbers in the file, from 1, and their cells.
Rows = tuple[list[int], list[list[str]]]
#: Values (N,) or (N, n) of a column, and (N,) whether its cell is empty; None without
#: empty cells.
Cut = tuple[Array, Mask | None]


def read(path: Path) -> Log:
    """Read the columns of a text."""
    try:
        table = inspect_table(path)
    except MarkupError as error:
        form = import_module(f"sdp_vs_penalty.data.formats.{error.form}")
        log: Log = form.read_text(path, error)
        return log
    return log_of_table(table)


def log_of_table(table: TextTable) -> Log:
    """Make a log of a text table, of one with a row a channel too."""
    if _has_a_row_a_channel(table):
        return _log_of_channel_rows(table)
    columns = dict[str, Column]()
    for k, (name, kind) in enumerate(zip(table.names, table.kinds, strict=True)):
        cells = table.first_cells(k)
        if kind == "number":
            cells = [plain_number(x, table.decimals[k]) for x in cells]
        columns.setdefault(name, Column(kind, cells))
    place = {name: k for k, name in reversed([*enumerate(table.names)])}

    def read_columns(names: Sequence[str]) -> Values:
        return _values(table, {name: place[name] for name in names})

    def texts(names: Sequence[str]) -> list[list[str]]:
        chosen = [place[name] for name in names]
        pieces = _value_rows(table, table.first)
        return [[row[k] for k in chosen] for _, rows in pieces for row in rows]

    counts = Counter(table.names)
    _require_equal_clocks(table)
    log = Log(
        table.path,
        columns,
        read_columns,
        texts,
        rate=_rate_above(table),
        heading=table.heading,
        word="row",
        twice=frozenset(x for x in counts if counts[x] > 1 and x != table.names[0]),
    )
    for name, column in columns.items():
        # Vectors as NumPy prints them, without a header: a column a number.
        if column.kind == "list" and name.startswith("#"):
            log = log.with_columns_of(name)
    return log


def _has_a_row_a_channel(table: TextTable) -> bool:
    """Return whether a table lies on its side: few rows, each of a name and many numbers."""
    labels = [row[0] for row in table.sample]
    return (
        not table.has_header
        and table.kinds[0] == "text"
        and {*table.kinds[1:]} == {"number"}
        and 2 < len(labels) == len({*labels})
        and table.width > 2 * len(labels)
    )


def _log_of_channel_rows(table: TextTable) -> Log:
    """Make a log of a table that lies on its side."""
    arrays = dict[str, Array]()
    for rows in _value_rows(table, table.first):
        for number, (name, *cells) in zip(*rows, strict=True):
            numbers = [number] * len(cells)
            arrays[name], _ = _parse_column(table, 1, numbers, cells)
    return log_of_arrays(table.path, arrays)


def _rate_above(table: TextTable) -> float | None:
    """Return the sampling rate [Hz] that the lines above a table say; None without."""
    if not table.heading:
        return None
    from sdp_vs_penalty.data.words.names import rate_of_heading

    has_commas = "," in table.decimals and table.delimiter != ","
    lines = (x.replace(",", ".") if has_commas else x for x in table.heading)
    return rate_of_heading([*lines])


def _require_equal_clocks(table: TextTable) -> None:
    """Raise InputError where each channel has a clock beside it, called as the first column
    is, and these differ."""
    places = [k for k, name in enumerate(table.names) if name == table.names[0]]
    if len(places) < 2 or not table.names[0]:
        return
    clocks = _values(table, {str(k + 1): k for k in places}).columns
    first, *others = clocks
    for other in others:
        if not np.array_equal(clocks[first], clocks[other]):
            what = f"columns {first} and {other} are clocks that differ"
            remedy = "export all channels with one sample time and one clock"
            raise InputError(what, remedy, table.path)


def _values(table: TextTable, place_of: dict[str, int]) -> Values:
    """Read chosen columns, by name and place from 0: NaN where a cell is empty.

    Raises InputError naming the row and column that is wrong.
    """
    chosen = list(place_of.values())
    numbers = AppendableArray()
    values = [AppendableArray() for _ in chosen]
    empty = [list[tuple[int, Mask]]() for _ in chosen]  # by first row
    n_rows = 0
    for rows, piece in _pieces(table, chosen):
        numbers.append(rows)
        for array, found, (column, is_empty) in zip(values, empty, piece, strict=True):
            array.append(column)
            if is_empty is not None:
                found.append((n_rows, is_empty))
        n_rows += len(rows)
    rows = numbers.array()
    is_usual = not len(rows) or (rows[0] == 2 and rows[-1] == len(rows) + 1)
    gaps = dict[str, Mask]()
    for name, found in zip(place_of, empty, strict=True):
        for first, is_empty in found:
            gap = gaps.setdefault(name, np.zeros(n_rows, bool))
            gap[first : first + len(is_empty)] = is_empty
    columns = {x: y.array() for x, y in zip(place_of, values, strict=True)}
    return Values(columns, None if is_usual else rows, gaps)


def _pieces(table: TextTable, chosen: Sequence[int]) -> Iterator[tuple[Any, list[Cut]]]:
    """Read the columns at some places, from 0, in pieces of bounded size: the numbers of
    the rows, and the values and gaps of each column.

    PyArrow reads fast. Where it gives up, or the table is not simple enough for it, a
    slower parser goes on from the same row.
    """
    from pyarrow import ArrowException

    first = table.first
    is_simple = table.is_plain_utf_8 and table.delimiter is not None
    is_simple &= len({table.decimals[k] for k in chosen}) == 1
    if is_simple and not (table.nested or table.has_wrapped_cells):
        try:
            for piece in _read_by_arrow(table, chosen):
                last = first + len(piece[0][0])
                yield np.arange(first, last), piece
                first = last
        except ArrowException:
            pass  # what it does not take, the careful reader names or reads
        else:
            return
    for numbers, cells in _value_rows(table, first):
        columns = ([row[k] for row in cells] for k in chosen)
        pairs = zip(chosen, columns, strict=True)
        parsed = [_parse_column(table, k, numbers, x) for k, x in pairs]
        yield np.array(numbers), parsed


def _read_by_arrow(table: TextTable, chosen: Sequence[int]) -> Iterator[list[Cut]]:
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
        delimiter=table.delimiter,
        quote_char='"' if table.quoted else False,
        ignore_empty_lines=False,
    )
    kinds = arrow.ConvertOptions(
        column_types=types,
        null_values=["", *EMPTY],
        include_columns=list(types),
        decimal_point=table.decimals[chosen[0]],
    )
    with arrow.open_csv(path_or_file(table.path), rows, cells, kinds) as file:
        for batch in file:
            pairs = zip(chosen, batch.columns, strict=True)
            yield [_of_arrow(table, k, column) for k, column in pairs]


def _of_arrow(table: TextTable, column: int, values: Any) -> Cut:
    """Convert a column of PyArrow's to numbers (N,), or (N, n) of lists."""
    if table.kinds[column] in ("list", "stamp"):
        cells = [x or "" for x in values.to_pylist()]
        return _parse_column(table, column, range(len(cells)), cells)
    is_empty = None
    if values.null_count:
        is_empty = np.array(values.is_null().to_pylist())
        values = values.fill_null(np.nan)
    # By to_numpy() pandas would be imported.
    return np.asarray(np.from_dlpack(values).view(np.float64)), is_empty


def _value_rows(table: TextTable, first: int) -> Iterator[Rows]:
    """Iterate over the rows of values from row ``first`` on, piece by piece.

    Empty rows, comments and repeated headers are left out, and a remark counts them; so
    are the last rows where they are no samples: what a program writes below a table, and
    a row in which it was stopped. Empty rows at the end of the file do not count. Rows
    between others with more or fewer cells than the table has are left out where one in a
    hundred has at most; else InputError is raised for the first.
    """
    left_out = Counter[str]()
    n_samples, damaged = 0, list[tuple[int, list[str]]]()
    # A header that comes again may have the columns in another order.
    header = split_cells(table.header_row, table.delimiter)
    is_clear = len({*header}) == len(header)
    in_order, order = sorted(header), list[int]()
    n_trailing = 0  # empty rows since the last one that is not empty
    has_samples = first > table.first
    last = list[tuple[int, list[str]]]()  # rows since the last sample
    for first_of_piece, lines in iter_rows(table.path):
        found = list[tuple[int, list[str]]]()
        for number, line in enumerate(lines, start=first_of_piece):
            text = line.strip()
            if number < first:
                continue
            if not text:
                n_trailing += 1
                continue
            left_out["empty row"] += n_trailing
            n_trailing = 0
            if END_OF_TITLES.fullmatch(text):
                what = f"row {number} ends the header of another segment"
                remedy = "write each segment into a file of its own"
                raise InputError(what, remedy, table.path)
            if is_comment(text):
                left_out["comment"] += 1
                continue
            cells = split_cells(line, table.delimiter)
            if cells[0] in header and sorted(cells) == in_order:
                left_out["repeated header"] += 1
                order = [cells.index(x) for x in header] if is_clear else []
            else:
                is_moved = len(cells) == len(order) != 0 and order != sorted(order)
                last.append((number, [cells[k] for k in order] if is_moved else cells))
                if _is_sample(table, last[-1][1]):
                    found += last
                    last = []
        has_samples = has_samples or bool(found)
        damaged += [x for x in found if len(x[1]) != table.width]
        found = [x for x in found if len(x[1]) == table.width]
        n_samples += len(found)
        yield from _rows_of_width(table, found)
    if len(damaged) > _MOST_DAMAGED * n_samples:
        yield from _rows_of_width(table, damaged)
    left_out["damaged row"] = len(damaged)
    if has_samples and len(last) <= _LONGEST_FOOTER:
        left_out["incomplete last row"] = len(last)
    else:
        yield from _rows_of_width(table, last)
    kinds = (
        *("empty row", "repeated header", "comment"),
        *("damaged row", "incomplete last row"),
    )
    shown = [formatting.count(left_out[x], x) for x in kinds if left_out[x]]
    if shown:
        said = f"{table.path}: {' and '.join(shown)} left out"
        warnings.warn(said, Remark, stacklevel=3)


def _is_sample(table: TextTable, cells: Sequence[str]) -> bool:
    """Return whether a row has as many cells as the table, and a number or a time where
    the first column has them."""
    if len(cells) != table.width:
        return False
    first = cells[0].removesuffix(table.cell_units.get(0, "")).strip()
    if first in ("", "nan", "NaN", *EMPTY):
        return True
    if table.kinds[0] == "stamp":
        return is_stamp(first)
    return table.kinds[0] != "number" or is_number(first, table.decimals[0])


def _rows_of_width(
    table: TextTable, rows: Sequence[tuple[int, list[str]]]
) -> Iterator[Rows]:
    """Return rows apart from their numbers; raise InputError where one has more or fewer
    cells than the table."""
    for number, cells in rows:
        if len(cells) != table.width:
            than = "the header has" if table.has_header else "row 1 has"
            what = f"row {number} has {len(cells)} cells, {than} {table.width}"
            raise InputError(what, "complete the row or delete it", table.path)
    if rows:
        yield [number for number, _ in rows], [cells for _, cells in rows]


def _parse_lists(table: TextTable, column: int, cells: Sequence[str]) -> Array:
    """Parse N cells that hold lists such as "[0.1, 0.2]" into (N, n) numbers; raise
    InputError where the lists have different lengths."""
    number = r"[-+]?(?:\d+\.?\d*(?:[eE][-+]?\d+)?|\.\d+|nan|inf)"
    words = [re.findall(number, cell) for cell in cells or table.first_cells(column)]
    lengths = {len(row) for row in words}
    if len(lengths) > 1:
        shown = ", ".join(map(str, sorted(lengths)[:4]))
        what = (
            f"column {table.names[column]} holds lists of different lengths ({shown})"
        )
        raise InputError(what, "give each row as many values", table.path)
    return np.array(words, float).reshape(len(words), *lengths)[: len(cells)]


def _parse_column(
    table: TextTable, column: int, numbers: Sequence[int], cells: Sequence[str]
) -> Cut:
    """Parse the cells of one column: (N,) numbers, or (N, n) of lists, and which cells
    are empty. Raises InputError naming the row of the cell that is no number."""
    unit = table.cell_units.get(column, "")
    cells = [cell.removesuffix(unit).strip() for cell in cells] if unit else cells
    are_times = table.kinds[column] == "stamp"  # a time that is NaN is no time
    no_values = {"", *EMPTY, *(("nan", "NaN") if are_times else ())}
    is_empty = np.array([cell in no_values for cell in cells], bool)
    filled = [x for x, is_gap in zip(cells, is_empty, strict=True) if not is_gap]
    if table.kinds[column] == "list":
        values = _parse_lists(table, column, filled)
    elif are_times:
        values = seconds_of(filled)
    else:
        values = _parse_numbers(table, column, numbers, cells, is_empty)
    out = np.full((len(cells), *values.shape[1:]), np.nan)
    out[~is_empty] = values
    return out, is_empty if is_empty.any() else None


def _parse_numbers(
    table: TextTable,
    column: int,
    numbers: Sequence[int],
    cells: Sequence[str],
    is_empty: Mask,
) -> Array:
    """Parse the cells of a column that are not empty: at once, and where that fails one
    by one, so that InputError names the row of the wrong one."""
    filled = [x for x, is_gap in zip(cells, is_empty, strict=True) if not is_gap]
    text, decimal = "".join(filled), table.decimals[column]
    if decimal == "." and text.isascii() and "_" not in text:
        with suppress(ValueError):
            return np.array(filled, float)
    for number, cell, is_gap in zip(numbers, cells, is_empty, strict=True):
        if not is_gap and not is_number(cell, decimal):
            what = (
                f"row {number}, column {column + 1} holds {cell[:40]!r}, not a number"
            )
            raise InputError(what, "correct it or delete the row", table.path)
    return np.array([plain_number(x, decimal) for x in filled], float)


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
