"""CSV: RUN.csv with the header t,q1..qn,dq1..dqn,tau1..taun, one row a sample; read
piece by piece: memory for the numbers and for one piece, however long the file."""

import re
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from sdp_vs_penalty.data.catalogue import DATASETS
from sdp_vs_penalty.data.formats.columns import HEADER, Choice, Header, columns_of
from sdp_vs_penalty.data.measurements import Measurements, gathered
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.files import reading, writing
from sdp_vs_penalty.robot.arrays import Array

SUFFIXES = (".csv",)
#: What messages call a sample.
SAMPLE = "row"
#: Characters that are worked on at a time; a file with a longer line is no table.
PIECE = 1 << 20
_FORMATS = "give measurements as CSV text or .npz"


def read(path: Path, choice: Choice) -> Measurements:
    """The run of a table; InputError naming the row and column that cannot be used."""
    names = _header(path)
    header = Header.of(path, names, choice)
    pieces = _columns(path, len(names), 2)
    return gathered(
        header.run(dict(zip(names, piece, strict=True))) for piece in pieces
    )


def write(measurements: Measurements, path: Path) -> None:
    """Write one run as RUN.csv, whole or not at all."""
    with writing(path) as file:
        file.write((",".join(columns_of(measurements)) + "\n").encode())
        for part in measurements.parts():
            rows = np.column_stack(list(columns_of(part).values())).tolist()
            file.write(
                "".join(",".join(map(repr, row)) + "\n" for row in rows).encode()
            )


def read_headerless(path: str | Path, rate: float) -> Measurements:
    """A run of 3 n columns without header and clock, as research code writes them:
    positions, velocities and torques, ``rate`` rows a second.

    Raises InputError where the rate is none, or the file no such table.
    """
    path = Path(path)
    if not 0.0 < rate < np.inf:
        what = f"rate {rate!r} is not a frequency above 0 Hz"
        raise InputError(what, "give the samples a second, like --rate 1000")
    with reading(path):
        width = len(_first_line(path).split(","))
        if width % 3:
            remedy = "keep q, dq and tau of each joint"
            raise InputError(f"{width} columns are not three a joint", remedy, path)
        rows = numbers(path, width)
    q, dq, tau = (np.ascontiguousarray(part) for part in np.hsplit(rows, 3))
    return Measurements(np.arange(len(rows)) / rate, q, tau, dq, None, (path.name,))


def numbers(path: Path, width: int) -> Array:
    """The rows (N, width) of a file without a header; InputError naming the row that is
    wrong."""
    columns = [
        np.concatenate(pieces) for pieces in zip(*_columns(path, width, 1), strict=True)
    ]
    return columns[0][:, None] if width == 1 else np.stack(columns, axis=1)


def _pieces(path: Path) -> Iterator[tuple[int, list[str]]]:
    """Consecutive rows of a text file without their ends, and the number of the first
    one, from 1; InputError for what is not text."""
    row = 1
    try:
        with path.open(encoding="utf-8-sig") as file:
            while text := file.read(PIECE):
                text += file.readline(PIECE)
                rows = text.removesuffix("\n").split("\n")
                if "\0" in text:
                    raise InputError("a binary file", _FORMATS, path)
                long = next(
                    (k for k, line in enumerate(rows) if len(line) >= PIECE), None
                )
                if long is not None:
                    raise InputError(
                        f"row {row + long} is too long for a table", _FORMATS, path
                    )
                yield row, rows
                row += len(rows)
    except UnicodeDecodeError as error:
        raise InputError(f"not UTF-8 text (near row {row})", _FORMATS, path) from error


def _first_line(path: Path) -> str:
    return next(_pieces(path), (1, [""]))[1][0]


def _header(path: Path) -> list[str]:
    """The names in row 1; InputError where it is empty, holds numbers, or has other
    separators."""
    line = _first_line(path)
    if not line.strip():
        raise InputError("row 1 is empty", f"write the header {HEADER}", path)
    names = [name.strip() for name in line.split(",")]
    cells = [cell for cell in re.split(r"[;,\s]+", line) if cell]
    if cells and all(_is_number(cell) for cell in cells):
        known = [
            d.name
            for d in DATASETS.values()
            for f in d.files
            if path.name == Path(f.path).name
        ]
        remedy = (
            f"put {HEADER} above them and separate cells by commas, or use any column"
            " names and `sdp-vs-penalty convert --rename`"
        )
        if known:
            remedy = (
                f"take what `sdp-vs-penalty fetch {known[0]}` makes of this raw file"
            )
        raise InputError("row 1 holds numbers instead of a header", remedy, path)
    what, others = (
        ("semicolons", line.split(";"))
        if ";" in line
        else ("white space", line.split())
    )
    if len(others) > len(names) and (";" in line or len(names) == 1):
        what = f"row 1 separates its {len(others)} names by {what}"
        raise InputError(
            what, "separate all cells by commas, and write decimal points", path
        )
    return names


def _is_number(text: str) -> bool:
    """Whether NumPy reads it: unlike Python neither 1_000 nor the digits of other
    scripts."""
    try:
        float(text)
    except ValueError:
        return False
    return "_" not in text and text.strip().isascii()


def _columns(path: Path, width: int, first: int) -> Iterator[Array | list[Array]]:
    """The columns (width, N) of consecutive pieces, at least one, of the rows from
    ``first`` on."""
    from pyarrow import ArrowException
    from pyarrow import csv as arrow

    names = [str(k) for k in range(width)]
    # Some forty blocks are read ahead.
    how = {"use_threads": False, "block_size": PIECE // 4}
    found = arrow.ReadOptions(**how, skip_rows=first - 1, column_names=names)
    cells = arrow.ParseOptions(quote_char=False, ignore_empty_lines=False)
    kinds = arrow.ConvertOptions(
        column_types=dict.fromkeys(names, "float64"), null_values=[]
    )
    yield np.zeros((width, 0))
    try:
        with arrow.open_csv(path, found, cells, kinds) as file:
            for batch in file:
                # By to_numpy() pandas would be imported.
                yield [
                    np.from_dlpack(column).view(np.float64) for column in batch.columns
                ]
                first += len(batch)
    except ArrowException:  # what it does not take, the careful reader names or reads
        yield from (table.T for table in _tables(path, width, first))


def _tables(path: Path, width: int, first: int) -> Iterator[Array]:
    """The rows (N, width) from row ``first`` on in consecutive pieces. Only at the end
    rows may be empty."""
    empty = None
    for row, rows in _pieces(path):
        rows, row = rows[max(first - row, 0) :], max(row, first)
        if empty is not None and any(line.strip() for line in rows):
            raise InputError(f"row {empty} is empty", "delete it", path)
        while rows and not rows[-1].strip():
            empty = row + len(rows) - 1
            rows.pop()
        try:
            with warnings.catch_warnings(action="ignore"):  # no row at all
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
            what = (
                f"row {number}, column {k + 1} holds {cells[k].strip()[:40]!r}, not a"
                " number"
            )
            return InputError(what, "correct it or delete the row", path)
    return InputError(
        "the rows cannot be read as numbers", "write numbers in all cells", path
    )
