"""What LabVIEW and TwinCAT write above the columns of their tables: settings, names and
units in rows of their own, each with its key in the first cell.

A column of stamps has the program's word for a clock as its name, and each channel may
have one of its own. LabVIEW's .lvm has its names behind the second "***End_of_Header***",
and a row "Delta_X" that says the step where it has no clock; a further header between the
values begins another segment: such a file is refused. TwinCAT's stamps are in
milliseconds or count since 1601 in steps of 100 ns.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from sdp_vs_penalty.errors import InputError

#: A row of a text with its number in the file, from 1.
Row = tuple[int, str]

#: The end of a header of LabVIEW, and how many a file with one segment has.
_END_OF_HEADER, _MOST_HEADERS = "***End_of_Header***", 2
#: Rows among which the marks of a program are looked for.
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


@dataclass(frozen=True)
class _Program:
    """How a program writes its header."""

    #: How a row of the header begins.
    mark: str
    #: What columns of stamps are called, as is the key of the row of names.
    clock: str
    #: Key of the row of units.
    units: str
    #: Name of the clock in a plain table.
    name: str


_PROGRAMS = (
    _Program("LabVIEW Measurement", "X_Value", "Y_Unit_Label", "X_Value"),
    _Program("Starttime of export", "Name", "Unit", "Time"),
)


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
        None for a text of another program, or without names or values.

    Raises
    ------
    InputError
        A file of LabVIEW with several segments.
    """
    marked = (
        (program, line[len(program.mark) :][:1])
        for _, line in rows[:_FIRST_ROWS]
        for program in _PROGRAMS
        if line.startswith(program.mark)
    )
    program, delimiter = next(marked, (None, ""))
    if program is None or not delimiter:
        return None
    ends = [number for number, line in rows if line.startswith(_END_OF_HEADER)]
    if len(ends) > _MOST_HEADERS:
        what = f"row {ends[-1]} ends the header of another segment of LabVIEW"
        raise InputError(what, "write each segment into a file of its own", path)
    cells = [[cell.strip() for cell in line.split(delimiter)] for _, line in rows]
    heads = [k for k, row in enumerate(cells) if row[0] == program.clock]
    first = (
        next((k for k in range(heads[-1] + 1, len(rows)) if _is_sample(cells[k])), 0)
        if heads
        else 0
    )
    if not first:
        return None
    keyed = {row[0]: row for row in cells[:first]}
    names, values = cells[heads[-1]], [x for x in rows[first:] if x[1].strip()]
    if names[-1] == "Comment" and max(map(len, cells[first:])) < len(names):
        names.pop()  # of cells that no row has
    units = [
        x.split(" (")[0].replace("(None)", "") for x in keyed.get(program.units, ())
    ]
    units = (units + [""] * len(names))[: len(names)]
    clocks = tuple(k for k, name in enumerate(names) if name == program.clock)
    stamp, rate = _number(cells[first][0]), None
    if stamp is None:
        step = _number("".join(keyed.get("Delta_X", [])[1:2]))
        rate = float(f"{1.0 / step:.12g}") if step else None
    in_seconds = program.mark.startswith("LabVIEW")
    unit = "s" if in_seconds else "ms" if (stamp or 0.0) < _LARGEST_MILLISECONDS else ""
    for number, k in enumerate(clocks, start=1):
        names[k] = program.name if number == 1 else f"{program.name} {number}"
        units[k] = unit
        if stamp is None:
            names[k] = units[k] = ""
    named = [f"{x} [{y}]" if y else x for x, y in zip(names, units, strict=True)]
    head = (rows[heads[-1]][0], delimiter.join(named))
    clocks = clocks if stamp is not None else ()
    return ProgramHeader([head, *values], delimiter, clocks, rate)


def _number(cell: str) -> float | None:
    """Return the number in a cell, of any decimal mark; None for another text."""
    match = re.fullmatch(r"[-+]?\d+(?:[.,]\d*)?(?:[eE][-+]?\d+)?", cell)
    return float(cell.replace(",", ".")) if match else None


def _is_sample(cells: Sequence[str]) -> bool:
    """Return whether a row holds numbers, perhaps without a stamp."""
    return _number(cells[0]) is not None or (
        not cells[0] and any(_number(x) is not None for x in cells)
    )
