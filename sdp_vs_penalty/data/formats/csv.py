"""CSV: RUN.csv with the header t,q1..qn,dq1..dqn,tau1..taun, one row a sample."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from sdp_vs_penalty.data.formats import csv_text
from sdp_vs_penalty.data.formats.columns import Choice, columns_of, from_columns, groups_of, run_of
from sdp_vs_penalty.data.formats.recognition import taken
from sdp_vs_penalty.data.measurements import Measurements, gathered
from sdp_vs_penalty.errors import InputError
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
    header = csv_text.header(path)
    found = None if choice.rename else taken(path, header, choice.joints)
    if choice.rename or found is not None:  # a header of any names
        rename = choice.rename if found is None else found.rename
        if len(set(header)) != len(header):
            raise InputError("row 1 names a column twice", "rename one of them", path)
        for rows in csv_text.tables(path, len(header)):
            columns = dict(zip(header, rows.T, strict=True))
            if found is not None:
                columns = {n: columns[n] * found.scale.get(o, 1.0) for o, n in found.rename.items()}
            yield from_columns(path, columns, rename)
        return
    n, groups = groups_of(path, header)
    at = {group: [header.index(f"{group}{j + 1}") for j in range(n)] for group in groups}
    for rows in csv_text.tables(path, len(header)):
        blocks = {group: rows[:, columns] for group, columns in at.items()}
        yield run_of(path, rows[:, header.index("t")].copy(), blocks)
