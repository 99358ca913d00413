"""CSV: RUN.csv with the header t,q1..qn,dq1..dqn,tau1..taun, one row a sample."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from sdp_vs_penalty.data.formats import csv_text
from sdp_vs_penalty.data.formats.columns import Choice, Header, columns_of
from sdp_vs_penalty.data.measurements import Measurements, gathered
from sdp_vs_penalty.files import writing

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
