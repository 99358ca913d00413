"""What a text file of measurements is made of, read off its first rows.

A cheap first pass finds the separator, the decimal mark, the header and what each
column holds: numbers, texts, lists, stamps or nothing. Only the columns that are chosen
by their names are parsed afterwards.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import islice
from pathlib import Path

from sdp_vs_penalty.data.formats.program_header import find_program_header
from sdp_vs_penalty.data.formats.stamps import is_stamp
from sdp_vs_penalty.data.formats.text_file import (
    BROKEN,
    FORMATS,
    is_plain_utf_8,
    largest_text,
    open_text,
)
from sdp_vs_penalty.data.formats.units import UNITS_IN_NAMES
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.files import refuse_stand_in

#: Characters that are worked on at a time; a file with a longer line is no table.
PIECE = 1 << 20
#: The separators that are tried, in this order; None: any number of blanks.
DELIMITERS = (";", "\t", "|", ",", None, "^", ":")
#: A quoted cell has at most so many lines.
_LONGEST_CELL = 40
#: How the first line of a text begins that is no table, what it is, and what to do.
_MARKUPS = {
    r"(---|[A-Za-z_]+:)$": (
        "YAML text, as `ros2 topic echo` prints it",
        "print it with `ros2 topic echo --csv`, or record a bag",
    ),
    r"<[A-Za-z?!]": ("XML text", "write one row a sample as CSV"),
    r"[{]|\[ *([{]|$)": (
        "JSON text",
        "write one object a line into a .jsonl file, or save with"
        " numpy.savez(path, t=..., q=..., tau=...)",
    ),
}
#: How leading lines begin that are comments; and a title has at most so many lines.
_COMMENTS = ("#", "//", "% ", "%%")
_LONGEST_TITLE = 40

#: Blanks and apostrophes between thousands: "1 007,5", "1'007.5".
_GROUP_MARKS = " \u00a0\u2009\u202f'\u2019"
_MARKED_GROUPS = re.compile(
    rf"[-+]?\d{{1,3}}([{_GROUP_MARKS}]\d{{3}})+([.,]\d*)?([eE][-+]?\d+)?"
)
#: A minus sign of typography, and an exponent as Fortran writes it, "1.5D-01".
_MINUS = "\u2212"
_FORTRAN = re.compile(r"([-+]?(?:\d+[.,]?\d*|[.,]\d+))[dD]([-+]?\d+)")
_COMMA_NUMBER = re.compile(
    rf"[-+{_MINUS}]?\d+([{_GROUP_MARKS}]\d{{3}})*,\d+([eEdD][-+]?\d+)?"
)
#: Numbers with separators of thousands: "1.007,5" and "1,007.5".
_POINT_GROUPS = re.compile(r"[-+]?[1-9]\d{0,2}(\.\d{3})+(,\d*)?([eE][-+]?\d+)?")
_COMMA_GROUPS = re.compile(r"[-+]?[1-9]\d{0,2}(,\d{3})+(\.\d*)?([eE][-+]?\d+)?")
#: A number and its unit in one cell, "0.005 sec".
_WITH_UNIT = re.compile(r"([-+]?[\d.,]+(?:[eE][-+]?\d+)?)\s*([A-Za-z°µ%/]{1,6})")
_LIST = re.compile(r"(array\s*)?[\[(].*[\])]", re.DOTALL)


#: A header has at most so many rows.
_MOST_HEAD_ROWS = 4
#: A name and the unit in brackets that it ends with.
_BRACKETS_AT_THE_END = re.compile(r"(.*?)\s*([\[(][^\[\]()]*[\])])\s*")
#: Units of all quantities, and the mark of a number without one.
_KNOWN_UNITS = frozenset(
    {"-", *(unit.casefold() for units in UNITS_IN_NAMES.values() for unit in units)}
)


class MarkupError(InputError):
    """A text is no table, but YAML, XML or JSON."""

    @property
    def language(self) -> str:
        """What the text is: "YAML", "XML" or "JSON"."""
        return self.what.split()[0]


@dataclass(frozen=True)
class TextTable:
    """Layout of a text file: separator, decimal mark, header and columns, by its first
    rows.
    """

    #: Path of the file.
    path: Path
    #: Separator between cells; None for any number of blanks.
    delimiter: str | None
    #: Decimal mark, "." or ",".
    decimal: str
    #: Whether cells stand in quotes.
    quoted: bool
    #: Whether lists in cells hold the separator, without quotes around the list.
    nested: bool
    #: Names of the columns; "#1", "#2" ... without a header.
    names: tuple[str, ...]
    #: Whether a row names the columns.
    has_header: bool
    #: Number of the first row of values, from 1.
    first: int
    #: "number", "text", "list", "stamp" or "empty", one a column.
    kinds: tuple[str, ...]
    #: Cells of the first rows.
    sample: tuple[tuple[str, ...], ...]
    #: Whether a quoted cell goes on in the next line.
    has_wrapped_cells: bool = False
    #: The row of names as the file writes it.
    header_row: str = ""
    #: Whether the file is UTF-8 and not packed.
    is_plain_utf_8: bool = True
    #: Unit that follows the numbers in the cells, by the column's place.
    cell_units: Mapping[int, str] = field(default_factory=dict)
    #: Places of the columns of stamps, where a program writes one for each channel.
    clocks: tuple[int, ...] = ()
    #: Sampling rate [Hz] of a table without stamps, which a program's header says.
    rate: float | None = None

    @property
    def width(self) -> int:
        """Number of columns."""
        return len(self.names)

    def first_cells(self, column: int) -> list[str]:
        """List the cells of a column in the first rows that are not empty.

        Parameters
        ----------
        column : int
            Place of the column, from 0.

        Returns
        -------
        list[str]
            Texts as the file writes them.
        """
        cells = (row[column] for row in self.sample if len(row) > column)
        return [cell for cell in cells if cell]


def iter_rows(path: Path) -> Iterator[tuple[int, list[str]]]:
    """Iterate over the rows of a text file, in pieces of about a million characters.

    Parameters
    ----------
    path : Path
        Path of a text file; it may be packed, or in UTF-16.

    Yields
    ------
    tuple of int and list of str
        Number of the piece's first row, from 1, and its rows without line ends.

    Raises
    ------
    InputError
        The file is no text, has a row too long for a table, or unpacks to far more than
        its size allows.
    """
    row = 1
    n_characters_left = largest_text(path)
    try:
        with open_text(path) as file:
            while text := file.read(PIECE):
                text += file.readline(PIECE)
                # With an odd number of quotes the piece may end within a quoted cell:
                # its next lines belong to it.
                for _ in range(_LONGEST_CELL if text.count('"') % 2 else 0):
                    text += file.readline(PIECE)
                n_characters_left -= len(text)
                if n_characters_left < 0:
                    what = "unpacks to more than a file of its size does"
                    raise InputError(what, "unpack it yourself, or split it", path)
                rows = _rows_of(path, text, row)
                yield row, rows
                row += len(rows)
    except UnicodeDecodeError as error:
        raise InputError(f"not UTF-8 text (near row {row})", FORMATS, path) from error
    except BROKEN as error:
        what = f"a packed file that is broken or ends early ({str(error)[:80]})"
        raise InputError(what, "copy it again, or unpack it", path) from error


def _rows_of(path: Path, text: str, first: int) -> list[str]:
    """Split a piece of text into rows; ``first`` is the number of its first row, for
    messages.

    Raises InputError for binary content, and for a row too long for a table.
    """
    lines = text.removesuffix("\n").split("\n")
    rows = _join_wrapped(lines) if '"' in text else lines
    if "\0" in text:
        raise InputError("a binary file", FORMATS, path)
    for k, line in enumerate(rows, start=first):
        if len(line) >= PIECE:
            raise InputError(f"row {k} is too long for a table", FORMATS, path)
    return rows


def _join_wrapped(lines: Sequence[str]) -> list[str]:
    """Join lines to rows where a quoted cell contains line ends.

    A quote that is not closed within 40 lines is a stray mark: then the line is a row
    by itself.
    """
    rows = list[str]()
    k = 0
    while k < len(lines):
        row = lines[k]
        n_lines = 1
        while (
            row.count('"') % 2 and n_lines < _LONGEST_CELL and k + n_lines < len(lines)
        ):
            row += "\n" + lines[k + n_lines]
            n_lines += 1
        is_closed = row.count('"') % 2 == 0
        rows.append(row if is_closed else lines[k])
        k += n_lines if is_closed else 1
    return rows


def plain_number(text: str, decimal: str = ".") -> str:
    """Write a number with a decimal point, without separators of thousands, and with the
    minus sign and the exponent of computers.

    >>> plain_number("1.007,5", decimal=","), plain_number("1,007.5")
    ('1007.5', '1007.5')

    Returns
    -------
    str
        The number; the text as it is where it holds no separators.
    """
    text = text.replace(_MINUS, "-")
    if match := _FORTRAN.fullmatch(text):
        text = f"{match[1]}e{match[2]}"
    if _MARKED_GROUPS.fullmatch(text):
        text = re.sub(f"[{_GROUP_MARKS}]", "", text)
    if decimal == ",":
        text = text.replace(".", "") if _POINT_GROUPS.fullmatch(text) else text
        return text.replace(",", ".")
    return text.replace(",", "") if _COMMA_GROUPS.fullmatch(text) else text


def is_number(text: str, decimal: str = ".") -> bool:
    """Return whether a cell holds a number that NumPy can read, separators of thousands
    aside.

    Returns
    -------
    bool
        False also for 1_000 and for digits of other scripts, which Python's float
        accepts.
    """
    plain = plain_number(text, decimal)
    try:
        float(plain)
    except ValueError:
        return False
    return "_" not in plain and plain.strip().isascii()


def split_cells(line: str, delimiter: str | None) -> list[str]:
    """Split a row into cells; separators within quotes or brackets do not count.

    Parameters
    ----------
    line : str
        The row without its line end.
    delimiter : str | None
        Separator; None for any number of blanks.

    Returns
    -------
    list[str]
        The cells without quotes and blanks around them.
    """
    if '"' not in line and "[" not in line and "(" not in line:
        return [cell.strip() for cell in line.split(delimiter)]
    cells = _split_outside_brackets(line, delimiter)
    if delimiter is None:
        cells = [cell for cell in cells if cell.strip()]
    return [cell.strip().strip('"').strip() for cell in cells]


def _split_outside_brackets(line: str, delimiter: str | None) -> list[str]:
    """Split a row at separators that stand outside of quotes and brackets.

    Where a bracket or quote is never closed it is a stray mark in a name: then the row is
    split at every separator. ``delimiter`` None stands for any blank.
    """
    cells = list[str]()
    cell = ""
    n_open_brackets = 0
    in_quotes = False
    for character in line:
        if character == '"':
            in_quotes = not in_quotes
        elif not in_quotes:
            n_open_brackets += (character in "[(") - (character in "])")
        is_blank = character.isspace()
        is_separator = is_blank if delimiter is None else character == delimiter
        if is_separator and not in_quotes and n_open_brackets <= 0:
            cells.append(cell)
            cell = ""
        else:
            cell += character
    cells.append(cell)
    is_unbalanced = in_quotes or n_open_brackets != 0
    return line.split(delimiter) if is_unbalanced else cells


def inspect_table(path: Path) -> TextTable:
    """Find the layout of a text file from its first hundred rows.

    Returns
    -------
    TextTable
        Separator, decimal mark, names and kinds of the columns.

    Raises
    ------
    InputError
        The first rows are empty, or the file is no text or no table (YAML, XML, JSON).
    """
    numbered = _first_rows(path)
    if not numbered:
        raise InputError("row 1 is empty", "write the header t,q1..qn,tau1..taun", path)
    # What stands above the table: a program's header, or comments and lines of a title.
    program = find_program_header(path, numbered)
    comments, rows = _split_comments(numbered)
    if program is not None:
        rows = program.rows
    else:
        _refuse_markup(path, rows[0][1] if rows else "")
        rows = _without_titles(rows)
    lines = [line for _, line in rows]
    # The marks between and within the numbers.
    delimiter = _find_delimiter(lines or comments[-1:])
    if program is not None:
        delimiter = program.delimiter
    cells = [split_cells(line, delimiter) for line in lines]
    decimal = _find_decimal(cells)
    number = partial(is_number, decimal=decimal)
    # The header, which can stand in the last comment, and the columns.
    comment = split_cells(comments[-1], delimiter) if comments else []
    head, n_head_rows = _find_header(comment, cells, number)
    columns = _columns_of(head, cells, n_head_rows, number)
    body_lines = lines[n_head_rows:]
    is_quoted = any('"' in line for line in body_lines)
    has_lists = "list" in columns.kinds
    return TextTable(
        path,
        delimiter=delimiter,
        decimal=decimal,
        quoted=is_quoted,
        nested=has_lists and not is_quoted and delimiter in (",", None),
        names=tuple(columns.names),
        has_header=bool(head),
        first=_first_row_of_values(rows, n_head_rows),
        kinds=columns.kinds,
        sample=columns.sample,
        has_wrapped_cells=any("\n" in line for line in body_lines),
        header_row=lines[0].strip() if n_head_rows else "",
        is_plain_utf_8=is_plain_utf_8(path),
        cell_units=columns.cell_units,
        clocks=() if program is None else program.clocks,
        rate=None if program is None else program.rate,
    )


@dataclass(frozen=True)
class _Columns:
    """What a table's columns hold."""

    #: Names of the columns.
    names: Sequence[str]
    #: "number", "text", "list", "stamp" or "empty", one a column.
    kinds: tuple[str, ...]
    #: Cells of the first rows.
    sample: tuple[tuple[str, ...], ...]
    #: Unit that follows the numbers in the cells, by the column's place.
    cell_units: Mapping[int, str]


def _columns_of(
    head: Sequence[str],
    cells: Sequence[Sequence[str]],
    n_head_rows: int,
    number: partial[bool],
) -> _Columns:
    """Name the columns of a table, and find what each holds.

    ``cells`` are the first rows, of which ``n_head_rows`` hold the header with the
    names ``head``. ``number`` tells whether a cell is a number.
    """
    body = cells[n_head_rows:]
    names = list(head)
    if names:
        names += [""] * _n_separators_at_the_end(body, len(names))
    width = len(names) if names else len(cells[0])
    sample = tuple(tuple(row) for row in body if any(row))
    kinds = _kinds(sample, width, number)
    cell_units = _units_in_cells(sample, kinds, number)
    kinds = tuple("number" if k in cell_units else x for k, x in enumerate(kinds))
    if not names:
        names = _unnamed(kinds)
    names = [_with_unit(name, cell_units.get(k, "")) for k, name in enumerate(names)]
    return _Columns(names, kinds, sample, cell_units)


def _refuse_markup(path: Path, line: str) -> None:
    """Raise MarkupError where a text's first line shows that it is YAML, XML or JSON,
    InputError where it is what a download leaves in place of a file."""
    refuse_stand_in(path, line.encode())
    for pattern, (what, remedy) in _MARKUPS.items():
        if re.match(pattern, line.strip()):
            raise MarkupError(what, remedy, path)


def _find_header(
    comment: list[str], cells: Sequence[list[str]], number: partial[bool]
) -> tuple[list[str], int]:
    """Find the columns' names, and count the rows that they take.

    The names stand in the last comment (no row), in the first row (1), or in up to four
    rows: names, units, and names in two levels, as pandas and spreadsheets write them.
    No names where the first row holds values.
    """
    if not cells:
        return comment, 0
    if len(comment) == len(cells[0]) and any(map(number, cells[0])):
        return comment, 0
    if not _is_header(cells, number):
        return [], 0
    n_rows = _n_head_rows(cells, number)
    heads = [list(row) for row in cells[:n_rows]]
    names = _names_of_rows(heads)
    return names, n_rows


def _n_head_rows(cells: Sequence[Sequence[str]], number: partial[bool]) -> int:
    """Count the rows of the header: those above the first row that is mostly numbers.

    A row of whole numbers belongs to the header where these tell apart names that repeat
    above them, as in "q q tau tau" above "0 1 0 1". One row where no values follow.
    """
    width = len(cells[0])
    for n_rows in range(1, min(_MOST_HEAD_ROWS, len(cells) - 1) + 1):
        row = cells[n_rows]
        if len(row) != width:
            return 1
        is_last = n_rows + 1 >= len(cells)
        if _is_level(cells[:n_rows], row, number) and not is_last:
            continue
        if 2 * sum(map(number, row)) > width:
            return n_rows
        if any(number(cell) and not cell.isdigit() for cell in row):
            return 1
    return 1


def _is_level(
    above: Sequence[Sequence[str]], row: Sequence[str], number: partial[bool]
) -> bool:
    """Return whether a row of whole numbers, texts and empty cells tells apart names that
    repeat in the rows above it."""
    names = _names_of_rows([list(x) for x in above])
    filled = _names_of_rows([list(x) for x in (*above, row)])
    has_no_measurements = all(x.isdigit() or not number(x) for x in row if x)
    return has_no_measurements and len(set(names)) < len(set(filled)) == len(row)


def _names_of_rows(rows: Sequence[list[str]]) -> list[str]:
    """Put the names of columns together from the rows of a header.

    Cells with a unit become the unit of the name; others are joined, "q" above "1" to
    "q_1". An empty cell stands for the one before it where a name stands below it, as a
    spreadsheet leaves cells that it has merged. A row of other words below names that
    differ holds units that nobody knows.
    """
    rows = [
        _filled(row, rows[k + 1 :]) if k + 1 < len(rows) else row
        for k, row in enumerate(rows)
    ]
    names = [""] * len(rows[0])
    for row in rows:
        known = [_is_known_unit(cell) for cell in row]
        is_units = all(known[k] or not cell for k, cell in enumerate(row))
        are_names = all(name and not name.startswith(" [") for name in names)
        has_names = are_names and len(set(names)) == len(names)
        for k, cell in enumerate(row):
            if is_units or has_names or (known[k] and names[k]):
                names[k] = _with_unit(names[k], cell)
            else:
                names[k] = _joined(names[k], cell)
    return [name.strip() for name in names]


def _filled(row: Sequence[str], below: Sequence[Sequence[str]]) -> list[str]:
    """Write the cell before it into each empty cell of a row above which stands no name,
    and below which one does."""
    out = list(row)
    for k in range(1, len(row)):
        has_name_below = any(x[k] and not _is_known_unit(x[k]) for x in below)
        if not row[k] and has_name_below:
            out[k] = out[k - 1]
    return out


def _joined(name: str, cell: str) -> str:
    """Join two levels of a name; a unit in brackets stays at the end."""
    match = _BRACKETS_AT_THE_END.fullmatch(name)
    head, unit = (match[1], match[2]) if match else (name, "")
    return "_".join(filter(None, (head.strip(), cell))) + (f" {unit}" if unit else "")


def _is_known_unit(cell: str) -> bool:
    """Return whether a cell of a header holds a unit alone, "[deg]"."""
    bare = cell.strip("[](){} ").casefold()
    return bare in _KNOWN_UNITS


def _first_row_of_values(rows: Sequence[tuple[int, str]], n_head_rows: int) -> int:
    """Return the number in the file, from 1, of the first row behind the header."""
    if len(rows) > n_head_rows:
        return rows[n_head_rows][0]
    return rows[-1][0] + 1 if rows else 2


def _n_separators_at_the_end(body: Sequence[Sequence[str]], width: int) -> int:
    """Count the empty cells that every row has behind the header's last name, because
    each row ends with separators."""
    widths = {len(row) for row in body}
    if len(widths) != 1 or any(any(row[width:]) for row in body):
        return 0
    return max(widths.pop() - width, 0)


def _kinds(
    sample: Sequence[tuple[str, ...]], width: int, number: partial[bool]
) -> tuple[str, ...]:
    """Find what each of the columns holds: "number", "text", "list", "stamp" or
    "empty".

    ``sample`` are rows of cells, of which only those with ``width`` cells count;
    ``number`` tells whether a cell is a number.
    """
    full_rows = [row for row in sample if len(row) == width]
    columns = [[row[k] for row in full_rows if row[k]] for k in range(width)]
    return tuple(_kind_of(cells, number) for cells in columns)


def _units_in_cells(
    sample: Sequence[tuple[str, ...]], kinds: Sequence[str], number: partial[bool]
) -> dict[int, str]:
    """Find units that stand behind the numbers in the cells, "0.005 sec".

    Returns the unit by the column's place, for columns in which all cells have the same
    unit.
    """
    units = dict[int, str]()
    for k, kind in enumerate(kinds):
        cells = [row[k] for row in sample if len(row) > k and row[k]]
        matches = [_WITH_UNIT.fullmatch(cell) for cell in cells]
        found = {match[2] for match in matches if match and number(match[1])}
        if kind == "text" and None not in matches and len(found) == 1:
            units[k] = found.pop()
    return units


def _first_rows(path: Path) -> list[tuple[int, str]]:
    """Read the first hundred rows of a text with their numbers, without line ends and
    without empty rows at the beginning and the end."""
    out = list[tuple[int, str]]()
    for number, rows in islice(_small_pieces(path), 1):
        out += enumerate(rows[:100], start=number)
    filled = [k for k, (_, row) in enumerate(out) if row.strip()]
    return out[filled[0] : filled[-1] + 1] if filled else []


def _small_pieces(path: Path) -> Iterator[tuple[int, list[str]]]:
    """Read the beginning of a text: 64 thousand characters up to the end of a line.

    A text that cannot be read so, or has an overlong line, goes through
    :func:`iter_rows`, whose errors say what is wrong. JSON is known by its first line:
    programs write a whole run on one, which no table does.
    """
    size = PIECE // 16
    text = ""
    try:
        with open_text(path) as file:
            text = file.read(size)
            text += file.readline(PIECE)
        is_readable = "\0" not in text and len(text) < PIECE
    except (UnicodeDecodeError, *BROKEN):
        is_readable = False
    if not is_readable:
        if "\0" not in text:
            _refuse_markup(path, text.lstrip().split("\n", 1)[0])
        yield from iter_rows(path)
    elif text:
        lines = text.removesuffix("\n").split("\n")
        first_row = 1
        yield first_row, _join_wrapped(lines) if '"' in text else lines


def _split_comments(
    rows: Sequence[tuple[int, str]],
) -> tuple[list[str], list[tuple[int, str]]]:
    """Split the leading comment lines from the rows.

    Returns the comments without their marks, and the numbered rows that are not empty.
    """
    k = 0
    while k < len(rows) and is_comment(rows[k][1].lstrip()):
        k += 1
    comments = [line.lstrip().lstrip("#/%").strip() for _, line in rows[:k]]
    return comments, [(n, line) for n, line in rows[k:] if line.strip()]


def is_comment(line: str) -> bool:
    """Return whether a line is a comment, or "sep=;", by which a spreadsheet names its
    separator, or TwinCAT's mark of the end, "EOF".

    Parameters
    ----------
    line : str
        Line of a text, without blanks before it.
    """
    is_mark = line.lower().startswith("sep=") or line.strip() == "EOF"
    return is_mark or line.startswith(_COMMENTS)


def _without_titles(rows: list[tuple[int, str]]) -> list[tuple[int, str]]:
    """Leave out the title lines above a table.

    The table begins where most of the following rows have as many cells. Lines above it
    are a title if each has less than half as many cells that are not empty.
    """
    for k in range(min(_LONGEST_TITLE, len(rows) - 2)):
        lines = [line for _, line in rows[k:]]
        delimiter = _find_delimiter(lines)
        width = len(split_cells(lines[0], delimiter))
        if _is_padded_title(lines, delimiter):
            continue
        if width >= 2 and _share_of_width(lines, delimiter, width) >= 0.5:
            titles = [split_cells(line, delimiter) for _, line in rows[:k]]
            is_title = all(2 * _n_filled(title) <= width for title in titles)
            return rows[k:] if is_title else rows
    return rows


def _n_filled(cells: Sequence[str]) -> int:
    """Count the cells of a row up to the last that is not empty."""
    return max((k for k, cell in enumerate(cells, 1) if cell.strip()), default=0)


def _is_padded_title(lines: Sequence[str], delimiter: str | None) -> bool:
    """Return whether the first of some lines is a title that a spreadsheet has filled up
    with separators: cells on the left alone, and below it a row without empty cells."""
    if delimiter is None:
        return False
    first = split_cells(lines[0], delimiter)
    n_filled = _n_filled(first)
    is_full = any(all(split_cells(line, delimiter)) for line in lines[1:_LONGEST_TITLE])
    return is_full and all(first[:n_filled]) and 2 * n_filled <= len(first)


def _share_of_width(lines: Sequence[str], delimiter: str | None, width: int) -> float:
    """Return the fraction of the lines behind the first that split into ``width``
    cells, or into one more, as rows with a separator at the end do."""
    following = lines[1:]
    widths = [len(split_cells(line, delimiter)) for line in following]
    return sum(w in (width, width + 1) for w in widths) / max(len(following), 1)


def _find_delimiter(lines: Sequence[str]) -> str | None:
    """Find the separator by which the first row has as many cells as half of the
    others.

    Without one, the first separator that splits the row at all; a comma if none does.
    None stands for any number of blanks.
    """
    head = lines[0]
    several = list[str | None]()
    for delimiter in DELIMITERS:
        width = len(split_cells(head, delimiter))
        if width < 2:
            continue
        several.append(delimiter)
        if _share_of_width(lines, delimiter, width) >= 0.5 or len(lines) == 1:
            return delimiter
    return several[0] if several else ","


def _find_decimal(cells: Sequence[Sequence[str]]) -> str:
    """Find the decimal mark: a comma where more cells hold numbers like "1,5" than like
    "1.5"."""
    flat = [cell for row in cells[:20] for cell in row]
    commas = sum(bool(_COMMA_NUMBER.fullmatch(cell)) for cell in flat)
    points = sum("." in cell and is_number(cell) for cell in flat)
    return "," if commas > points else "."


def _is_header(cells: Sequence[Sequence[str]], number: partial[bool]) -> bool:
    """Return whether the first row names the columns: it has no numbers, or texts where
    the second row has numbers."""
    head = cells[0]
    if not any(number(cell) for cell in head if cell):
        # Rows of a log without a header can hold texts and empty cells only by chance.
        return True
    following = cells[1] if len(cells) > 1 else []
    if len(following) != len(head):
        return False
    pairs = zip(head, following, strict=True)
    return any(a and not number(a) and number(b) for a, b in pairs)


def _with_unit(name: str, unit: str) -> str:
    """Append a unit to a column's name, "q1 [deg]"; no unit leaves it as it is."""
    bare = unit.strip("[](){} ")
    return f"{name} [{bare}]" if bare else name


def _kind_of(cells: Sequence[str], number: partial[bool]) -> str:
    """Find what the cells of a column hold: "number" where half of them are numbers,
    else "list", "stamp" or "text"; "empty" without cells."""
    if not cells:
        return "empty"
    if sum(map(number, cells)) >= 0.5 * len(cells):
        return "number"
    if all(_LIST.fullmatch(cell) for cell in cells[:20]):
        return "list"
    if all(map(is_stamp, cells[:20])):
        return "stamp"
    return "text"


def _unnamed(kinds: Sequence[str]) -> list[str]:
    """Name columns without a header.

    `ros2 topic echo --csv` writes JointState messages without one: seconds,
    nanoseconds, frame, n names, then n positions, velocities and efforts. The texts
    give it away. Other columns are called by their numbers, "#1", "#2" ....
    """
    header = ["header.stamp.sec", "header.stamp.nanosec", "frame_id"]
    fields = ("name", "position", "velocity", "effort")
    n_header = len(header)
    place_of_frame = 2
    texts = [k for k, kind in enumerate(kinds) if kind == "text"]
    joint_names = [k for k in texts if k != place_of_frame]
    n = len(joint_names)
    are_names_in_place = joint_names == list(range(n_header, n_header + n))
    has_stamp = kinds[:2] == ("number", "number")
    has_all_fields = len(kinds) == n_header + len(fields) * n
    if n > 0 and are_names_in_place and has_stamp and has_all_fields:
        return header + [f"{field}{k}" for field in fields for k in range(n)]
    return [f"#{k}" for k in range(1, len(kinds) + 1)]
