"""CSV files line by line: memory for the numbers and for one line, however long the file."""

from __future__ import annotations

import re
import warnings
from collections.abc import Generator, Iterator
from itertools import islice
from pathlib import Path

import numpy as np

from sdp_vs_penalty.data.catalogue import DATASETS
from sdp_vs_penalty.data.formats.columns import HEADER
from sdp_vs_penalty.data.store import PART
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.robot.arrays import Array

#: Characters of a line above which a file is no table.
_LONGEST = 1_000_000
#: What plain numbers, their separators and ends of lines are made of.
_PLAIN = b"0123456789.-+eE,\n"
_FORMATS = "give measurements as CSV text or .npz"


def lines(path: Path) -> Iterator[str]:
    """The lines of a text file without their ends; InputError for what is not text."""
    number = 0
    binary = InputError("a binary file", _FORMATS, path)
    try:
        with path.open("rb") as start:
            if b"\0" in start.read(1 << 16):
                raise binary
        with path.open(encoding="utf-8-sig") as file:
            while line := file.readline(_LONGEST):
                number += 1
                if "\0" in line:
                    raise binary
                if len(line) == _LONGEST:
                    raise InputError(
                        f"row {number} is too long for a table",
                        _FORMATS,
                        path,
                    )
                yield line.rstrip("\n")
    except UnicodeDecodeError as error:
        raise InputError(f"not UTF-8 text (near row {number + 1})", _FORMATS, path) from error


def header(path: Path) -> list[str]:
    """The names in row 1; InputError where it is empty, holds numbers, or has other separators."""
    line = next(lines(path), "")
    if not line.strip():
        raise InputError("row 1 is empty", f"write the header {HEADER}", path)
    names = [name.strip() for name in line.split(",")]
    cells = [cell for cell in re.split(r"[;,\s]+", line) if cell]
    if cells and all(_is_number(cell) for cell in cells):
        raise InputError("row 1 holds numbers instead of a header", _no_header(path), path)
    if len(names) == 1 and len(cells) > 1:
        what = "semicolons" if ";" in line else "white space"
        raise InputError(
            f"row 1 separates its {len(cells)} names by {what}",
            "separate all cells by commas, and write decimal points",
            path,
        )
    return names


def _no_header(path: Path) -> str:
    """What to do about a file that starts with numbers."""
    known = [d.name for d in DATASETS.values() if path.name in {Path(f.path).name for f in d.files}]
    if known:
        return (
            f"this is a raw file of the data set {known[0]}, which `sdp-vs-penalty fetch {known[0]}` "
            "downloads and writes as RUN.csv"
        )
    return (
        f"put {HEADER} above them and separate cells by commas, or use any column names and "
        "`sdp-vs-penalty convert --rename`"
    )


def _is_number(text: str) -> bool:
    """Whether NumPy reads it: unlike Python neither 1_000 nor the digits of other scripts."""
    try:
        float(text)
    except ValueError:
        return False
    return "_" not in text and text.strip().isascii()


def numbers(path: Path, width: int, first: int = 2) -> Array:
    """The rows (N, width) of a file from row ``first`` on; InputError naming the row that is wrong."""
    return np.concatenate(list(tables(path, width, first)))


def tables(path: Path, width: int, first: int = 2) -> Iterator[Array]:
    """The same in consecutive pieces, at least one."""
    begin = yield from _fast(path, width, first)
    if begin is None:
        return
    rows = _without_gaps(islice(lines(path), begin - 1, None))
    while True:
        table = _table(rows, width)
        if table is None:  # which row it is
            careful = _without_tail(islice(lines(path), begin - 1, None))
            for number, line in enumerate(careful, start=begin):
                _check_row(path, number, line, width)
            raise InputError("the rows cannot be read as numbers", "write numbers in all cells", path)
        if len(table) or begin == first:
            yield table
        if len(table) < PART:
            return
        begin += len(table)


def _table(rows: Iterator[str], width: int) -> Array | None:
    """The next rows, fewer than PART at the end; None for what is no table of this width."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # an empty table is one of no rows
            table = np.loadtxt(islice(rows, PART), delimiter=",", ndmin=2, comments=None)
    except InputError:
        raise
    except ValueError:
        return None
    if table.size == 0:
        return np.zeros((0, width))
    return table if table.shape[1] == width else None


def _fast(path: Path, width: int, first: int) -> Generator[Array, None, int | None]:
    """Yield the rows as plain decimals; return the first row that needs the slow parser, or None."""
    row, found = first, False
    with path.open("rb") as file:
        for _ in range(first - 1):
            file.readline(_LONGEST)
        while text := file.read(1 << 20):
            rest = file.readline(_LONGEST)
            if len(rest) == _LONGEST:
                return row
            text += rest
            count = text.count(b"\n") + (not text.endswith(b"\n"))
            table = _decimals(text, width, count)
            if table is None:
                return row
            yield table
            row, found = row + count, True
    if not found:
        yield np.zeros((0, width))
    return None


def _decimals(text: bytes, width: int, count: int) -> Array | None:
    """So many rows (count, width) of cells that hold plain decimals or exponents; None for any other
    text. The same numbers as Python's, to the last bit."""
    if text.translate(None, _PLAIN):
        return None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # no rows
            rows = text.decode("ascii").splitlines()
            values = np.loadtxt(rows, delimiter=",", ndmin=2, comments=None)
    except (ValueError, UserWarning):
        return None
    return values if values.shape == (count, width) else None


def _without_tail(rows: Iterator[str]) -> Iterator[str]:
    """The lines without the empty ones at the end."""
    empty = 0
    for line in rows:
        if not line.strip():
            empty += 1
            continue
        for _ in range(empty):
            yield ""
        empty = 0
        yield line


def _without_gaps(rows: Iterator[str]) -> Iterator[str]:
    """The same; ValueError at an empty line between others, which NumPy would pass over."""
    for line in _without_tail(rows):
        if not line:
            raise ValueError
        yield line


def _check_row(path: Path, number: int, line: str, width: int) -> None:
    cells = line.split(",")
    if not line.strip():
        raise InputError(f"row {number} is empty", "delete it", path)
    if len(cells) != width:
        raise InputError(
            f"row {number} has {len(cells)} cells, the header has {width}",
            "complete the row or delete it",
            path,
        )
    for k, cell in enumerate(cells):
        if not _is_number(cell):
            raise InputError(
                f"row {number}, column {k + 1} holds {cell.strip()[:40]!r}, not a number",
                "correct it or delete the row",
                path,
            )
