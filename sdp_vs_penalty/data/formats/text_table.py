"""What a text file of measurements is made of, read off its first rows.

A cheap first pass finds the separator, the decimal mark, the header and what each
column holds: numbers, texts, lists, stamps or nothing.
"""

import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cache, partial
from itertools import zip_longest
from pathlib import Path

from sdp_vs_penalty.data.formats.named_values import are_named_values
from sdp_vs_penalty.data.formats.text_file import (
    BROKEN,
    PIECE,
    is_plain_utf_8,
    iter_rows,
    open_text,
)
from sdp_vs_penalty.data.words.stamps import is_stamp
from sdp_vs_penalty.data.words.units import units_in_names
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.files import refuse_stand_in

#: The separators that are tried, in this order; None: any number of blanks.
DELIMITERS = (";", "\t", "|", ",", None, "^", ":")
#: How the first line of a text begins that is no table, the module that may read it, what it
#: is, and what to do.
_MARKUPS = {
    r"(---|[A-Za-z_]+:)$": (
        "ros_echo",
        "YAML text, as `ros2 topic echo` prints it",
        "print it with `ros2 topic echo --csv`, or record a bag",
    ),
    r"<[A-Za-z?!]": ("rsi_xml", "XML text", "write one row a sample as CSV"),
    r"[{](?!')|\[ *([{\[]|$)": (
        "jsonl",
        "JSON text",
        "write one object a line into a .jsonl file, or save with"
        " numpy.savez(path, t=..., q=..., tau=...)",
    ),
}
#: How comments begin.
_COMMENTS = ("#", "//", "% ", "%%")
#: A title has at most so many lines.
_LONGEST_TITLE = 40
#: The line that ends a header, as OpenSim, LabVIEW and others write it.
END_OF_TITLES = re.compile(r"(?i)\W*end_?(of_?)?header\W*")
#: The line that begins and ends the front matter of Markdown.
_FRONT_MATTER = "---"
#: Lines of so many words are titles where a mark separates what is below.
_FEW_WORDS = 3
#: A header has at most so many rows.
_MOST_HEAD_ROWS = 5
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
#: ... by the mark that separates them.
_GROUPS = {".": _POINT_GROUPS, ",": _COMMA_GROUPS}
#: A number and its unit in one cell, "0.005 sec".
_WITH_UNIT = re.compile(r"([-+]?[\d.,]+(?:[eE][-+]?\d+)?)\s*([A-Za-z°µ%/]{1,6})")
_LIST = re.compile(r"(array\s*)?[\[(].*[\])]", re.DOTALL)
#: A name and the unit in brackets that it ends with.
_BRACKETS_AT_THE_END = re.compile(r"(.*?)\s*([\[(][^\[\]()]*[\])])\s*")

#: Tells whether a cell is a number.
IsNumber = Callable[[str], bool]
Cells = Sequence[Sequence[str]]


class MarkupError(InputError):
    """A text is no table, but YAML, XML, JSON or the like.

    ``form`` is the module of this folder whose ``read_text`` may read it.
    """

    def __init__(self, form: str, what: str, remedy: str, path: Path) -> None:
        """Make the error of a text of a form."""
        super().__init__(what, remedy, path)
        self.form = form


@dataclass(frozen=True)
class TextTable:
    """Layout of a text file: separator, decimal marks, header and columns, by its first
    rows.
    """

    #: Path of the file.
    path: Path
    #: Separator between cells; None for any number of blanks.
    delimiter: str | None = ","
    #: Decimal mark, "." or ",", one a column.
    decimals: tuple[str, ...] = ()
    #: Whether cells stand in quotes.
    quoted: bool = False
    #: Whether lists in cells hold the separator, without quotes around the list.
    nested: bool = False
    #: Names of the columns; "#1", "#2" ... without a header.
    names: tuple[str, ...] = ()
    #: Whether a row names the columns.
    has_header: bool = False
    #: Number of the first row of values, from 1.
    first: int = 1
    #: "number", "text", "list", "stamp" or "empty", one a column.
    kinds: tuple[str, ...] = ()
    #: Cells of the first rows.
    sample: tuple[tuple[str, ...], ...] = ()
    #: Whether a quoted cell goes on in the next line.
    has_wrapped_cells: bool = False
    #: The row of names as the file writes it.
    header_row: str = ""
    #: Whether the file is UTF-8 and not packed.
    is_plain_utf_8: bool = True
    #: Unit that follows the numbers in the cells, by the column's place.
    cell_units: Mapping[int, str] = field(default_factory=dict)
    #: Lines above the names: comments and titles.
    heading: tuple[str, ...] = ()

    @property
    def width(self) -> int:
        """Number of columns."""
        return len(self.names)

    def first_cells(self, column: int) -> list[str]:
        """List the cells of a column, from 0, in the first rows that are not empty."""
        cells = (row[column] for row in self.sample if len(row) > column)
        return [cell for cell in cells if cell]


def plain_number(text: str, decimal: str = ".") -> str:
    """Write a number with a decimal point, without separators of thousands, and with the
    minus sign and the exponent of computers; another text as it is.

    >>> plain_number("1.007,5", decimal=","), plain_number("1,007.5")
    ('1007.5', '1007.5')
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
    aside: not 1_000 and digits of other scripts, which Python's float accepts."""
    plain = plain_number(text, decimal)
    try:
        float(plain)
    except ValueError:
        return False
    return "_" not in plain and plain.strip().isascii()


def _is_any_number(text: str) -> bool:
    """Return whether a cell holds a number of either decimal mark."""
    return is_number(text) or is_number(text, ",")


def _decimals_of(columns: Cells) -> list[str]:
    """Return the decimal mark of each column's numbers.

    Cells whose mark cannot separate thousands decide ("1.5", but not "1.500"). A column
    without such cells has the one of its own marks for which those of other columns
    decide; without any mark it has that of the nearest column that has such cells, which
    serves later rows. Where no cell decides, the most frequent mark does.
    """
    counts = [_count_marks(cells) for cells in columns]
    n_marks = [of_all for of_all, _ in counts]
    n_certain = [of_certain for _, of_certain in counts]
    n_marks_of_all, n_certain_of_all = (sum(x, Counter()) for x in (n_marks, n_certain))
    certain_columns = [k for k, votes in enumerate(n_certain) if votes.total()]
    decimals = list[str]()
    for column, votes in enumerate(n_certain):
        if not votes.total() and n_marks[column].total():
            of_others = {
                x: n for x, n in n_certain_of_all.items() if n_marks[column][x]
            }
            votes = Counter(of_others) or n_certain_of_all or n_marks_of_all
        elif not votes.total() and certain_columns:
            nearest = min(certain_columns, key=lambda x: abs(x - column))
            votes = n_certain[nearest]
        decimals.append("," if votes[","] > votes["."] else ".")
    return decimals


def _count_marks(cells: Sequence[str]) -> tuple[Counter[str], Counter[str]]:
    """Count the numbers among a column's cells by their mark, "." or ",": all of them, and
    those whose mark cannot separate thousands."""
    numbers = {
        ".": [cell for cell in cells if "." in cell and is_number(cell)],
        ",": [cell for cell in cells if _COMMA_NUMBER.fullmatch(cell)],
    }
    n_marks, n_certain = Counter[str](), Counter[str]()
    for mark, texts in numbers.items():
        n_marks[mark] = len(texts)
        n_certain[mark] = sum(not _GROUPS[mark].fullmatch(text) for text in texts)
    return n_marks, n_certain


def split_cells(line: str, delimiter: str | None) -> list[str]:
    """Split a row into cells without quotes and blanks around them; separators within
    quotes or brackets do not count. ``delimiter`` None stands for any number of blanks.

    Where a bracket or quote is never closed it is a stray mark in a name: then the row is
    split at every separator.
    """
    if not {'"', "[", "("} & {*line}:
        return [cell.strip() for cell in line.split(delimiter)]
    cells, cell, depth, in_quotes = list[str](), "", 0, False
    for character in line:
        if character == '"':
            in_quotes = not in_quotes
        elif not in_quotes:
            depth += (character in "[(") - (character in "])")
        is_separator = (
            character.isspace() if delimiter is None else character == delimiter
        )
        if is_separator and not in_quotes and depth <= 0:
            cells.append(cell)
            cell = ""
        else:
            cell += character
    cells = line.split(delimiter) if in_quotes or depth else [*cells, cell]
    if delimiter is None:
        cells = [x for x in cells if x.strip()]
    return [x.strip().strip('"').strip() for x in cells]


def inspect_table(path: Path) -> TextTable:
    """Find the layout of a text file from its first hundred rows.

    Raises InputError where the first rows are empty, or the file is no text; MarkupError
    where it is YAML, XML or JSON.
    """
    numbered = _first_rows(path)
    if not numbered:
        raise InputError("row 1 is empty", "write the header t,q1..qn,tau1..taun", path)
    # What stands above the table: comments and lines of a title.
    n_comments = 0
    while n_comments < len(numbered) and is_comment(numbered[n_comments][1].lstrip()):
        n_comments += 1
    comments = [x.lstrip().lstrip("#/%").strip() for _, x in numbered[:n_comments]]
    rows = [(n, line) for n, line in numbered[n_comments:] if line.strip()]
    rows = _without_titles(rows)
    lines = [line for _, line in rows]
    # The marks between and within the numbers.
    delimiter = _find_delimiter(lines or comments[-1:])
    cells = [split_cells(line, delimiter) for line in lines]
    # The header, which can stand in the last comment, and the columns.
    comment = split_cells(comments[-1], delimiter) if comments else []
    names, n_head = _find_header(comment, cells, _is_any_number)
    has_header, body = bool(names), cells[n_head:]
    if has_header and _has_names_of_rows(body, len(names)):
        names = ["row", *names]
    elif has_header:
        names = names + [""] * _n_separators_at_the_end(body, len(names))
        names = names[: max(map(len, body), default=len(names))]
    heading = tuple(line for n, line in numbered if rows and n < rows[0][0])
    names = _with_keyed_units(
        names, [*(split_cells(x, delimiter) for x in heading), *cells[1:n_head]]
    )
    width = len(names) if has_header else len(cells[0])
    sample = tuple(tuple(row) for row in body if any(row))
    full = [row for row in sample if len(row) == width]
    columns = [[row[k] for row in full if row[k]] for k in range(width)]
    # A program may write one block with decimal commas and another with marks of thousands.
    decimals = _decimals_of(columns)
    numbers = [partial(is_number, decimal=x) for x in decimals]
    kinds = list(map(_kind_of, columns, numbers))
    cell_units = _units_in_cells(sample, kinds, numbers)
    kinds = ["number" if k in cell_units else kind for k, kind in enumerate(kinds)]
    names = names if has_header else _unnamed(kinds)
    is_quoted = any('"' in line for line in lines[n_head:])
    first = rows[-1][0] + 1 if rows else 2  # the row below, if there are no values
    if len(rows) > n_head:
        first = rows[n_head][0]
    return TextTable(
        path,
        delimiter=delimiter,
        decimals=tuple(decimals),
        quoted=is_quoted,
        nested="list" in kinds and not is_quoted and delimiter in (",", None),
        names=tuple(_with_unit(x, cell_units.get(k, "")) for k, x in enumerate(names)),
        has_header=has_header,
        first=first,
        kinds=tuple(kinds),
        sample=sample,
        has_wrapped_cells=any("\n" in line for line in lines[n_head:]),
        header_row=lines[0].strip() if n_head else "",
        is_plain_utf_8=is_plain_utf_8(path),
        cell_units=cell_units,
        heading=heading,
    )


def _refuse_markup(path: Path, lines: Sequence[str]) -> None:
    """Raise MarkupError where a text's first line shows that it is YAML, XML or JSON and no
    table of numbers stands below, InputError where it is what a download leaves in place of
    a file."""
    refuse_stand_in(path, lines[0].encode())
    if lines[0].startswith("# Created by Octave"):
        remedy = "save matrices with save('run.mat', '-v7', ...)"
        raise MarkupError("matlab", "Octave's text", remedy, path)
    for pattern, markup in _MARKUPS.items():
        if re.match(pattern, lines[0].strip()) and not _end_in_a_table(lines):
            raise MarkupError(*markup, path)
    if are_named_values(lines):
        what = "names and values in each line"
        raise MarkupError("named_values", what, "write a table as CSV", path)


def _end_in_a_table(lines: Sequence[str]) -> bool:
    """Return whether the last of some lines are rows of one table: as many cells, mostly
    numbers, under one mark."""
    last = [line for line in lines if line.strip()][-2:]
    rows = [split_cells(line, _find_delimiter(last)) for line in last]
    width = len(rows[0])
    return width > 2 and all(
        len(row) == width
        and (_is_any_number(row[0]) or is_stamp(row[0]))
        and 2 * sum(map(_is_any_number, row)) > width
        for row in rows
    )


def _find_header(
    comment: list[str], cells: Cells, number: IsNumber
) -> tuple[list[str], int]:
    """Find the columns' names, and count the rows that they take.

    The names stand in the last comment (no row), in the first row (1), or in up to five
    rows: names, units, and names in two levels, as pandas and spreadsheets write them.
    No names where the first row holds values: it has numbers, and no text where the
    second row has one.
    """
    if not cells:
        return comment, 0
    head, following = cells[0], cells[1] if len(cells) > 1 else []
    has_numbers = any(map(number, filter(None, head)))
    if len(comment) == len(head) and has_numbers:
        return comment, 0
    if len(comment) == len(head) and all(_is_unit(x) or not x for x in head):
        return _names_of_rows([comment, head]), 1
    pairs = zip(head, following, strict=False)
    has_names = len(following) == len(head) and any(
        a and not number(a) and number(b) for a, b in pairs
    )
    if has_numbers and not has_names:
        return [], 0
    n_rows = _n_head_rows(cells, number)
    return _names_of_rows(cells[:n_rows]), n_rows


def _n_head_rows(cells: Cells, number: IsNumber) -> int:
    """Count the rows of the header: those above the first row that is mostly numbers.

    A row of whole numbers belongs to the header where these tell apart names that repeat
    above them, as in "q q tau tau" above "0 1 0 1". One row where no values follow.
    """
    width = len(cells[0])
    for n_rows in range(1, min(_MOST_HEAD_ROWS, len(cells) - 1) + 1):
        row = cells[n_rows]
        if len(row) != width:
            return 1
        n_names, n_with_row = (
            len({*_names_of_rows(cells[:n])}) for n in (n_rows, n_rows + 1)
        )
        has_no_values = all(x.isdigit() or not number(x) for x in row if x)
        is_level = has_no_values and n_names < n_with_row == width
        if is_level and n_rows + 1 < len(cells):
            continue
        if 2 * sum(map(number, row)) > width:
            return n_rows
        if any(number(cell) and not cell.isdigit() for cell in row):
            return 1
    return 1


def _names_of_rows(rows: Cells) -> list[str]:
    """Put the names of columns together from the rows of a header.

    Cells with a unit become the unit of the name; others are joined, "q" above "1" to
    "q_1". An empty cell stands for the one before it where a name stands below it, as a
    spreadsheet leaves cells that it has merged. A row of other words below names that
    differ holds units that nobody knows.
    """
    rows = [rows[0], *(row for row in rows[1:] if not _is_keyed(row))]
    filled = [list(row) for row in rows]
    for n, row in enumerate(filled[:-1], start=1):
        for k in range(1, len(row)):
            if not row[k] and any(x[k] and not _is_unit(x[k]) for x in filled[n:]):
                row[k] = row[k - 1]
    names = [""] * len(filled[0])
    for row, as_written in zip(filled, rows, strict=True):
        if any(names) and len(row) > 2 and _n_filled(as_written) == 1:
            continue  # a remark below the names
        is_units = all(_is_unit(cell) or not cell for cell in row)
        are_names = all(name and not name.startswith(" [") for name in names)
        has_names = are_names and len({*names}) == len(names)
        for k, cell in enumerate(row):
            if is_units or has_names or (_is_unit(cell) and names[k]):
                names[k] = _with_unit(names[k], cell)
            else:  # two levels of a name; a unit in brackets stays at the end
                match = _BRACKETS_AT_THE_END.fullmatch(names[k])
                stem, unit = (match[1], f" {match[2]}") if match else (names[k], "")
                names[k] = "_".join(filter(None, (stem.strip(), cell))) + unit
    return [name.strip() for name in names]


def _is_keyed(row: Sequence[str]) -> bool:
    """Return whether a row of a header says one thing of each column, units or numbers,
    behind a key, as LabVIEW and TwinCAT write them; the key may stand beside each."""
    key, *of_columns = row
    is_key = len(of_columns) > 1 and key not in ("", *of_columns[:1])
    return (
        is_key
        and not _is_unit(key)
        and all(x in ("", key) or _is_unit(x) or _is_any_number(x) for x in of_columns)
    )


def _with_keyed_units(names: list[str], rows: Cells) -> list[str]:
    """Append the units that a row of the header says behind its key."""
    for key, *units in filter(_is_keyed, rows):
        if any(map(_is_unit, units)) and not any(map(_is_any_number, units)):
            units = ["" if x == key else x for x in units]
            pairs = zip_longest(names, ["", *units][: len(names)], fillvalue="")
            return [_with_unit(name, unit) for name, unit in pairs]
    return names


def _is_unit(cell: str) -> bool:
    """Return whether a cell of a header holds a unit alone, "[deg]", perhaps with what it is
    of, "deg (Angle)", or the mark of a number without one."""
    return cell.split(" (")[0].strip("[](){} ").casefold() in _known_units()


@cache
def _known_units() -> frozenset[str]:
    """Return the units of all quantities, and the mark of a number without one."""
    units = units_in_names().values()
    return frozenset({"-", *(unit.casefold() for row in units for unit in row)})


def _n_separators_at_the_end(body: Cells, width: int) -> int:
    """Count the empty cells that every row has behind the header's last name, because
    each row ends with separators."""
    widths = {len(row) for row in body}
    if len(widths) != 1 or any(any(row[width:]) for row in body):
        return 0
    return max(widths.pop() - width, 0)


def _has_names_of_rows(body: Cells, width: int) -> bool:
    """Return whether each row begins with its name, which the header leaves out, as R writes
    tables: a text, or a number that counts the rows."""
    first = [row[0] for row in body if any(row)]
    if len(first) < 2 or {len(row) for row in body if any(row)} != {width + 1}:
        return False
    counts = [int(x) for x in first if x.isdecimal()]
    is_counted = (
        counts == [*range(counts[0], counts[0] + len(first))] if counts else False
    )
    return is_counted or not any(map(_is_any_number, first))


def _units_in_cells(
    sample: Cells, kinds: Sequence[str], numbers: Sequence[IsNumber]
) -> dict[int, str]:
    """Find units that stand behind the numbers in the cells, "0.005 sec", by the place
    of columns in which all cells have the same unit."""
    units = dict[int, str]()
    for k, (kind, number) in enumerate(zip(kinds, numbers, strict=True)):
        cells = [row[k] for row in sample if len(row) > k and row[k]]
        matches = [_WITH_UNIT.fullmatch(cell) for cell in cells]
        found = {match[2] for match in matches if match and number(match[1])}
        if kind == "text" and None not in matches and len(found) == 1:
            units[k] = found.pop()
    return units


def _first_rows(path: Path) -> list[tuple[int, str]]:
    """Read the first hundred rows of a text with their numbers, without line ends and
    without empty rows at the beginning and the end.

    Markup is known by its first line: programs write a whole run on one, which no table
    does.
    """
    with suppress(UnicodeDecodeError, *BROKEN), open_text(path) as file:
        lines = file.read(PIECE // 16).lstrip().split("\n")
        _refuse_markup(path, lines[: max(len(lines) - 1, 1)][:100])
    _, rows = next(iter_rows(path, PIECE // 16), (1, []))
    numbered = list(enumerate(rows[:100], start=1))
    filled = [k for k, (_, row) in enumerate(numbered) if row.strip()]
    return numbered[filled[0] : filled[-1] + 1] if filled else []


def is_comment(line: str) -> bool:
    """Return whether a line without blanks before it is a comment, or "sep=;", by which
    a spreadsheet names its separator, or TwinCAT's mark of the end, "EOF"."""
    is_mark = line.lower().startswith("sep=") or line.strip() == "EOF"
    return is_mark or line.startswith(_COMMENTS)


def _without_titles(rows: list[tuple[int, str]]) -> list[tuple[int, str]]:
    """Leave out the title lines above a table.

    The table begins where most of the following rows have as many cells. Lines above it
    are a title if each has less than half as many cells that are not empty. A line may say
    that the header ends.
    """
    ends = [
        k
        for k, (_, line) in enumerate(rows[:_LONGEST_TITLE])
        if END_OF_TITLES.fullmatch(line.strip())
        or (k and line.strip() == rows[0][1].strip() == _FRONT_MATTER)
    ]
    # LabVIEW ends two headers; one below begins another segment, which is refused.
    rows = rows[ends[:2][-1] + 1 : (*ends, None, None)[2]] if ends else rows
    for k in range(min(_LONGEST_TITLE, len(rows) - 2)):
        lines = [line for _, line in rows[k:]]
        delimiter = _find_delimiter(lines)
        width = len(split_cells(lines[0], delimiter))
        if _is_padded_title(lines, delimiter) or _is_words(lines, delimiter, width):
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
    first = split_cells(lines[0], delimiter)
    n_filled = _n_filled(first)
    below = lines[1:_LONGEST_TITLE] if delimiter else ()
    is_full = any(all(split_cells(line, delimiter)) for line in below)
    return is_full and all(first[:n_filled]) and 2 * n_filled <= len(first)


def _is_words(lines: Sequence[str], delimiter: str | None, width: int) -> bool:
    """Return whether blanks split the first of some lines into words, where a mark splits
    the last into many more cells: "Trend Export,X" above "2026-03-05 14:07,0.1,0.2,0.3"."""
    if delimiter is not None or width > _FEW_WORDS:
        return False
    marks = (x for x in DELIMITERS if x not in (None, ":"))
    return any(len(split_cells(lines[-1], x)) > 2 * width for x in marks)


def _share_of_width(lines: Sequence[str], delimiter: str | None, width: int) -> float:
    """Return the fraction of the lines behind the first that split into ``width``
    cells, or into one more, as rows with a separator at the end do."""
    widths = [len(split_cells(line, delimiter)) for line in lines[1:]]
    return sum(w in (width, width + 1) for w in widths) / max(len(widths), 1)


def _find_delimiter(lines: Sequence[str]) -> str | None:
    """Find the separator by which the first row has as many cells as half of the
    others; without one, the first that splits the row at all; a comma if none does. None
    stands for any number of blanks."""
    widths = {x: len(split_cells(lines[0], x)) for x in DELIMITERS}
    several = [x for x in DELIMITERS if widths[x] > 1]
    good = (
        x
        for x in several
        if len(lines) == 1 or _share_of_width(lines, x, widths[x]) >= 0.5
    )
    return next(good, several[0] if several else ",")


def _with_unit(name: str, unit: str) -> str:
    """Append a unit to a column's name, "q1 [deg]"; no unit leaves it as it is."""
    bare = unit.split(" (")[0].strip("[](){} ")
    return f"{name} [{bare}]" if bare else name


def _kind_of(cells: Sequence[str], number: IsNumber) -> str:
    """Find what the cells of a column hold: "number" where half of them are numbers,
    else "list", "stamp" or "text"; "empty" without cells."""
    if not cells:
        return "empty"
    if sum(map(number, cells)) >= 0.5 * len(cells):
        return "number"
    if all(_LIST.fullmatch(cell) for cell in cells[:20]):
        return "list"
    return "stamp" if all(map(is_stamp, cells[:20])) else "text"


def _unnamed(kinds: Sequence[str]) -> list[str]:
    """Name columns without a header.

    `ros2 topic echo --csv` writes JointState messages without one: seconds,
    nanoseconds, frame, n names, then n positions, velocities and efforts. The texts
    give it away. Other columns are called by their numbers, "#1", "#2" ....
    """
    header = ["header.stamp.sec", "header.stamp.nanosec", "frame_id"]
    channels = ("name", "position", "velocity", "effort")
    # Place 2 is the frame's name; texts at the places behind it are joints' names.
    name_places = [k for k, kind in enumerate(kinds) if kind == "text" and k != 2]
    n = len(name_places)
    is_echo = name_places == list(range(3, 3 + n)) and len(kinds) == 3 + 4 * n
    if n > 0 and is_echo and [*kinds[:2]] == ["number", "number"]:
        return header + [f"{channel}{k}" for channel in channels for k in range(n)]
    return [f"#{k}" for k in range(1, len(kinds) + 1)]
