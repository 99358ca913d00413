"""CSV: RUN.csv with the header t,q1..qn,dq1..dqn,tau1..taun, one row a sample."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from sdp_vs_penalty.data.formats import csv_text
from sdp_vs_penalty.data.formats.columns import Choice, Header, columns_of
from sdp_vs_penalty.data.measurements import Measurements, gathered
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.files import reading, writing

SUFFIXES = (".csv",)
#: What messages call a sample, and the number of the first one: below the header.
SAMPLE = ("row", 2)


def read(path: Path, choice: Choice) -> Measurements:
    """The run of a table; InputError naming the row and column that cannot be used."""
    return gathered(_pieces(path, choice))


def write(measurements: Measurements, path: Path) -> None:
    """Write one run as RUN.csv, whole or not at all."""
    with writing(path) as file:
        file.write((",".join(columns_of(measurements)) + "\n").encode())
        for part in measurements.parts():
            rows = np.column_stack(list(columns_of(part).values())).tolist()
            file.write("".join(",".join(map(repr, row)) + "\n" for row in rows).encode())


def _pieces(path: Path, choice: Choice) -> Iterator[Measurements]:
    names = csv_text.header(path)
    header = Header.of(path, names, choice)
    for rows in csv_text.tables(path, len(names)):
        yield header.run(dict(zip(names, rows.T, strict=True)))


def read_headerless(path: str | Path, rate: float) -> Measurements:
    """A run of 3 n columns without header and clock, as research code writes them: positions, velocities
    and torques, ``rate`` rows a second.

    Raises InputError where the rate is none, or the file no such table.
    """
    path = Path(path)
    if not 0.0 < rate < np.inf:
        what = f"rate {rate!r} is not a frequency above 0 Hz"
        raise InputError(what, "give the samples a second, like --rate 1000")
    with reading(path):
        width = len(next(csv_text.pieces(path), (1, [""]))[1][0].split(","))
        if width % 3:
            remedy = "keep q, dq and tau of each joint"
            raise InputError(f"{width} columns are not three a joint", remedy, path)
        rows = csv_text.numbers(path, width, first=1)
    q, dq, tau = (np.ascontiguousarray(part) for part in np.hsplit(rows, 3))
    return Measurements(np.arange(len(rows)) / rate, q, tau, dq, None, (path.name,))
