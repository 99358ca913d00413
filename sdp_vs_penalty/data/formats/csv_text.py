"""CSV files piece by piece: memory for the numbers and for one piece, however long the file."""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from sdp_vs_penalty.data.catalogue import DATASETS
from sdp_vs_penalty.data.formats.columns import HEADER
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.robot.arrays import Array

#: Bytes that are worked on at a time; a file with a longer line is no table.
PIECE = 1 << 20
_FORMATS = "give measurements as CSV text or .npz"


def pieces(path: Path) -> Iterator[tuple[int, list[str]]]:
    """Consecutive rows of a text file without their ends, and the number of the first one, from 1;
    InputError for what is not text."""
    row = 1
    with path.open("rb") as file:
        while text := file.read(PIECE):
            text += file.readline(PIECE)
            if b"\0" in text:
                raise InputError("a binary file", _FORMATS, path)
            try:
                content = text.decode("utf-8-sig" if row == 1 else "utf-8").replace("\r\n", "\n")
            except UnicodeDecodeError as error:
                raise InputError(f"not UTF-8 text (near row {row})", _FORMATS, path) from error
            rows = content.removesuffix("\n").replace("\r", "\n").split("\n")
            long = next((k for k, line in enumerate(rows) if len(line) >= PIECE), None)
            if long is not None:
                raise InputError(f"row {row + long} is too long for a table", _FORMATS, path)
            yield row, rows
            row += len(rows)


def header(path: Path) -> list[str]:
    """The names in row 1; InputError where it is empty, holds numbers, or has other separators."""
    line = next(pieces(path), (1, [""]))[1][0]
    if not line.strip():
        raise InputError("row 1 is empty", f"write the header {HEADER}", path)
    names = [name.strip() for name in line.split(",")]
    cells = [cell for cell in re.split(r"[;,\s]+", line) if cell]
    if cells and all(_is_number(cell) for cell in cells):
        raise InputError("row 1 holds numbers instead of a header", _no_header(path), path)
    what, others = ("semicolons", line.split(";")) if ";" in line else ("white space", line.split())
    if len(others) > len(names) and (";" in line or len(names) == 1):
        raise InputError(
            f"row 1 separates its {len(others)} names by {what}",
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
    return np.concatenate([np.zeros((0, width)), *tables(path, width, first)])


def tables(path: Path, width: int, first: int = 2) -> Iterator[Array]:
    """The same in consecutive pieces. Only at the end rows may be empty."""
    empty = None
    for row, rows in pieces(path):
        rows, row = rows[max(first - row, 0) :], max(row, first)
        if empty is not None and any(line.strip() for line in rows):
            raise InputError(f"row {empty} is empty", "delete it", path)
        while rows and not rows[-1].strip():
            empty = row + len(rows) - 1
            rows.pop()
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # no row at all
                table = np.loadtxt(rows, delimiter=",", ndmin=2, comments=None)
        except ValueError:
            table = np.zeros((0, 0))
        if rows and table.shape != (len(rows), width):
            raise _wrong(path, row, rows, width)
        yield table.reshape(-1, width)


def _wrong(path: Path, first: int, rows: Sequence[str], width: int) -> InputError:
    """What makes these rows no table of this width."""
    for number, line in enumerate(rows, start=first):
        cells = line.split(",")
        if not line.strip():
            return InputError(f"row {number} is empty", "delete it", path)
        if len(cells) != width:
            what = f"row {number} has {len(cells)} cells, the header has {width}"
            return InputError(what, "complete the row or delete it", path)
        k = next((k for k, cell in enumerate(cells) if not _is_number(cell)), None)
        if k is not None:
            what = f"row {number}, column {k + 1} holds {cells[k].strip()[:40]!r}, not a number"
            return InputError(what, "correct it or delete the row", path)
    return InputError("the rows cannot be read as numbers", "write numbers in all cells", path)
