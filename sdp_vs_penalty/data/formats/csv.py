"""CSV: RUN.csv with the header t,q1..qn,dq1..dqn,tau1..taun, one row a sample."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.data.formats import csv_text
from sdp_vs_penalty.data.formats.columns import Choice, columns_of, from_columns, groups_of, run_of
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.files import write_text

Array = NDArray[np.float64]

SUFFIXES = (".csv",)
#: What messages call a sample, and the number of the first one: below the header.
SAMPLE = ("row", 2)


def read(path: Path, choice: Choice) -> Measurements:
    """The run of a table; InputError naming the row and column that cannot be used."""
    if choice.rename:
        return from_columns(path, _csv_columns(path), choice.rename)
    return _read_csv(path)


def write(measurements: Measurements, path: Path) -> None:
    """Write one run as RUN.csv, whole or not at all."""
    m = measurements
    columns = columns_of(m)
    rows = np.column_stack(list(columns.values()))
    lines = [",".join(columns), *(",".join(map(repr, row)) for row in rows.tolist())]
    write_text(path, "\n".join(lines) + "\n")


def _read_csv(path: Path) -> Measurements:
    header = csv_text.header(path)
    n, groups = groups_of(path, header)
    rows = csv_text.numbers(path, len(header))
    column = {name: k for k, name in enumerate(header)}

    def group(prefix: str) -> Array:
        return np.ascontiguousarray(rows[:, [column[f"{prefix}{j + 1}"] for j in range(n)]])

    return run_of(path, rows[:, column["t"]].copy(), {name: group(name) for name in groups})


def _csv_columns(path: Path) -> dict[str, Array]:
    """All columns of a CSV file with a header of any names."""
    header = csv_text.header(path)
    if len(set(header)) != len(header):
        raise InputError("row 1 names a column twice", "rename one of them", path)
    rows = csv_text.numbers(path, len(header))
    return {name: rows[:, k] for k, name in enumerate(header)}
