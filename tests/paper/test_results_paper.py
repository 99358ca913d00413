"""The committed Tables I, II, V, VI, of wrenches and of what is not convex, and the figures.

Cheap checks always; everything again, within stated tolerances, under ``pytest -m reproduce``.
"""

import csv
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from sdp_vs_penalty import load_problem
from sdp_vs_penalty.paper.tables import build_tables
from sdp_vs_penalty.paper.tables.study import Study
from sdp_vs_penalty.simulation import engine_types

RESULTS = Path(__file__).parents[2] / "results"
Row = dict[str, str]

#: Problem, columns that name a row, and relative and absolute tolerance of each table's numbers.
MADE: dict[str, tuple[str, tuple[str, ...], float, float]] = {
    # Digits printed; the intervals at the ends of phi_2's range are the least certain.
    "I": ("panda", ("parameter", "what"), 5e-3, 1e-4),
    # An optimiser's path: its condition numbers, not its coefficients.
    "II": ("panda", ("coefficient", "trajectory"), 5e-2, 0.0),
    # N m; versions of engines may differ, their physics may not.
    "V": ("panda", ("engine", "motion"), 5e-2, 5e-3),
    "VI": ("two_link", ("i",), 1e-9, 1e-12),
    # The interval is; where an estimate ends among those of equal loss is no figure to hold on to.
    "wrenches": ("two_link", ("joint", "component"), 2e-2, 1e-3),
}
#: Columns that time, chance or a machine's speed decides.
LOOSE = {"seconds", "inverse_dynamics_error"}

pytestmark = pytest.mark.skipif(not RESULTS.is_dir(), reason="not a checkout: no results/")


@cache
def committed(name: str) -> list[Row]:
    with (RESULTS / f"table_{name}.csv").open(newline="") as file:
        return list(csv.DictReader(file))


def keyed(name: str, rows: list[Row]) -> dict[tuple[str, ...], Row]:
    """Rows by their names; an engine without its version."""
    keys = MADE[name][1]
    names = set(engine_types())

    def clean(key: str, row: Row) -> str:
        text = row[key]
        if key == "engine" and "published" not in row["status"]:
            text = text.split()[0]
            assert text in names
        return text

    return {tuple(clean(k, row) for k in keys): row for row in rows}


def number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return np.nan


@cache
def study(problem: str) -> Study:
    return Study(load_problem(problem))


@pytest.mark.reproduce
@pytest.mark.parametrize("name", MADE)
def test_made_again(name):
    problem, keys, relative, absolute = MADE[name]
    (table,) = build_tables([name], study(problem))
    new = keyed(name, list(csv.DictReader(table.csv().splitlines())))
    old = keyed(name, committed(name))
    missing = [key for key in old if key not in new]
    # Without the real run its rows are missing, and nothing else is.
    assert all("measured" in " ".join(key) for key in missing)
    for key, row in new.items():
        if row.get("status", "run") != "run" or (name == "II" and not key[0].startswith("condition")):
            continue
        for column, text in row.items():
            if column in LOOSE or column in keys:
                continue
            if name == "wrenches" and column != "true" and not column.startswith("interval"):
                continue
            was, now = number(old[key][column]), number(text)
            if np.isnan(was) or np.isnan(now):
                continue
            if key[-1].startswith("measured") and "phi_2" in key[0] and abs(was) > 100.0:
                continue  # a step: nothing determines its slope
            assert abs(now - was) <= absolute + relative * abs(was), f"{key} {column}: {was} {now}"
