"""What LabVIEW and TwinCAT write above the columns of their tables: settings, names and
units in rows of their own.

LabVIEW's .lvm begins with "LabVIEW Measurement"; its names stand behind the second
"***End_of_Header***", its units in the row "Y_Unit_Label". A channel may have a clock
column "X_Value" of its own, or none: then the row "Delta_X" says the step. A further
header between the values begins another segment: such a file is refused.

An export of TwinCAT Scope has a row "Starttime of export". Then the row "Name" holds the
channels' names, and "Name" again above each column of stamps, which are in milliseconds
or count since 1601 in steps of 100 ns. Rows about the channels follow, one of them
"Unit".
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from sdp_vs_penalty.errors import InputError

#: A row of a text with its number in the file, from 1.
Row = tuple[int, str]

_LABVIEW = "LabVIEW Measurement"
_END_OF_HEADER = "***End_of_Header***"
#: The headers of a file of LabVIEW with one segment: the file's, and the segment's.
_MOST_HEADERS = 2
_TWINCAT = "Starttime of export"
#: Rows among which the marks of TwinCAT are looked for.
_FIRST_ROWS = 10
#: Stamps that are larger count since 1601, and no milliseconds of a recording.
_LARGEST_MILLISECONDS = 1e12


@dataclass(frozen=True)
class ProgramHeader:
    """A table of LabVIEW or TwinCAT, as a plain one: one row of names, and values."""

    #: The row of names, with units in brackets, and the rows of values.
    rows: list[Row]
    #: Separator between cells.
    delimiter: str
    #: Places, from 0, of the columns of stamps.
    clocks: tuple[int, ...]
    #: Sampling rate [Hz] of a table without stamps, which its header says; None with
    #: stamps.
    rate: float | None = None


def find_program_header(path: Path, rows: Sequence[Row]) -> ProgramHeader | None:
    """Find the names and units that LabVIEW or TwinCAT has written into a text.

    Parameters
    ----------
    path : Path
        Path of the text, for messages.
    rows : Sequence[Row]
        The first rows of the text.

    Returns
    -------
    ProgramHeader | None
        None for a text of another program.

    Raises
    ------
    InputError
        A file of LabVIEW with several segments.
    """
    if rows and rows[0][1].startswith(_LABVIEW):
        return _of_labview(path, rows)
    if any(line.startswith(_TWINCAT) for _, line in rows[:_FIRST_ROWS]):
        return _of_twincat(rows)
    return None


def _of_labview(path: Path, rows: Sequence[Row]) -> ProgramHeader | None:
    """Return the table of a LabVIEW file; None where its header has no end, or no row
    of names behind it. Raises InputError for several segments."""
    ends = [k for k, (_, line) in enumerate(rows) if line.startswith(_END_OF_HEADER)]
    if not ends or ends[-1] + 1 >= len(rows):
        return None
    if len(ends) > _MOST_HEADERS:
        what = f"row {rows[ends[-1]][0]} ends the header of another segment of LabVIEW"
        raise InputError(what, "write each segment into a file of its own", path)
    settings = {
        re.split("[\t,]", line)[0].strip(): line for _, line in rows[: ends[-1]]
    }
    delimiter = "," if "Comma" in settings.get("Separator", "") else "\t"
    number, line = rows[ends[-1] + 1]
    names = [name.strip() for name in line.split(delimiter)]
    values = [row for row in rows[ends[-1] + 2 :] if row[1].strip()]
    cells = [[cell.strip() for cell in line.split(delimiter)] for _, line in values]
    widest = max(map(len, cells), default=len(names))
    if names[-1] == "Comment" and widest < len(names):
        names.pop()  # of cells that no row has
    clocks = tuple(k for k, name in enumerate(names) if name == "X_Value")
    units = settings.get("Y_Unit_Label", "").split(delimiter)[: len(names)]
    units = ["s" if k in clocks else _bare(x) for k, x in enumerate(units)]
    units += [""] * (len(names) - len(units))
    rate = None
    if cells and not cells[0][0]:
        rate = _rate_of_step(settings.get("Delta_X", "").split(delimiter))
        names = ["" if k in clocks else name for k, name in enumerate(names)]
        units = ["" if k in clocks else unit for k, unit in enumerate(units)]
        clocks = ()
    head = (number, delimiter.join(_with_units(names, clocks, units)))
    return ProgramHeader([head, *values], delimiter, clocks, rate)


def _rate_of_step(cells: Sequence[str]) -> float | None:
    """Return the rate [Hz] of the first step in LabVIEW's row "Delta_X", whose decimal
    mark may be a comma; None where it holds no step above zero."""
    try:
        step = float(cells[1].replace(",", "."))
    except (IndexError, ValueError):
        return None
    return float(f"{1.0 / step:.12g}") if step > 0.0 else None


def _of_twincat(rows: Sequence[Row]) -> ProgramHeader | None:
    """Return the table of an export of TwinCAT Scope; None where the row of names or the
    values are missing."""
    start = next(k for k, (_, line) in enumerate(rows) if line.startswith(_TWINCAT))
    delimiter = rows[start][1][len(_TWINCAT) :][:1]
    if not delimiter:
        return None
    split = [[cell.strip() for cell in line.split(delimiter)] for _, line in rows]
    first = next((k for k in range(start, len(rows)) if split[k][0] == "Name"), None)
    if first is None:
        return None
    names = split[first]
    last = first
    while last + 1 < len(rows) and not _is_stamp(split[last + 1][0]):
        last += 1
    values = list(rows[last + 1 :])
    if not values:
        return None
    # A column of stamps has the row's own key in each row of the header.
    clocks = tuple(k for k, name in enumerate(names) if name == "Name")
    names = ["Time" if k in clocks else name for k, name in enumerate(names)]
    units = [""] * len(names)
    for cells in split[first : last + 1]:
        if cells[0] == "Unit" and len(cells) == len(names):
            units = [_bare(cell) for cell in cells]
    stamp = float(split[last + 1][0].replace(",", "."))
    unit = "ms" if stamp < _LARGEST_MILLISECONDS else ""
    units = [unit if k in clocks else x for k, x in enumerate(units)]
    head = (rows[first][0], delimiter.join(_with_units(names, clocks, units)))
    return ProgramHeader([head, *values], delimiter, clocks)


def _is_stamp(cell: str) -> bool:
    """Return whether a cell holds a stamp of TwinCAT, a number of any decimal mark."""
    try:
        float(cell.replace(",", "."))
    except ValueError:
        return False
    return True


def _bare(unit: str) -> str:
    """Return a unit without the words behind it: "deg" for "deg (Angle)", and "" for
    "(None)"."""
    return unit.strip().split(" (")[0].replace("(None)", "")


def _with_units(
    names: Sequence[str], clocks: Sequence[int], units: Sequence[str]
) -> list[str]:
    """Return the names with their units in brackets, and a number behind each further
    column of stamps."""
    out = list(names)
    for number, k in enumerate(clocks, start=1):
        out[k] = names[k] if number == 1 else f"{names[k]} {number}"
    return [
        f"{name} [{unit}]" if unit else name
        for name, unit in zip(out, units, strict=True)
    ]
