"""Published parameter values of a problem, in our parameters, and the list of the
paper's errata.

The published tables (problems/<name>/published) are never edited. Where one contradicts
the others, errata.toml beside them says so and, if a number is concerned, what follows
from the other tables. Real measurements, where they are at hand, are never replaced
silently.
"""

import os
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from sdp_vs_penalty.data.catalogue import DATASETS
from sdp_vs_penalty.data.datasets import DATA_VARIABLE as VARIABLE
from sdp_vs_penalty.data.datasets import converted
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.problem.problem import Problem, barycentric_names
from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.trajectory import FourierTrajectory


@dataclass(frozen=True)
class Erratum:
    """One contradiction in the paper."""

    #: Number of the erratum, from 1.
    number: int
    #: Name of the problem that it concerns.
    problem: str
    #: Place in the paper, such as "Table VIII, c6z of p_hat".
    where: str
    #: What is printed there.
    printed: str
    #: What follows from the rest of the paper.
    corrected: str
    #: Table, row, column and value of the corrected number; None where no cell is
    #: concerned.
    cell: Mapping[str, str] | None = None


def errata(problem: Problem) -> list[Erratum]:
    """Return the errata of the paper that concern a problem, by number.

    Returns
    -------
    list of Erratum
        Empty without a file errata.toml.
    """
    if problem.folder is None or not (problem.folder / "errata.toml").is_file():
        return []
    text = (problem.folder / "errata.toml").read_text(encoding="utf-8")
    entries = sorted(_parsed_errata(text), key=lambda entry: entry["number"])
    return [Erratum(problem=problem.name, **entry) for entry in entries]


@lru_cache(maxsize=8)
def _parsed_errata(text: str) -> list[dict[str, Any]]:
    """Return the fields of each erratum in the text of an errata.toml.

    Parsed once: every cell of a published table asks for the errata.
    """
    return list(tomllib.loads(text)["erratum"])


def published_cell(
    problem: Problem, table: str, row: Mapping[str, str], column: str, corrected: bool
) -> str:
    """Return a cell of a published table, as printed or as the errata correct it.

    Parameters
    ----------
    row : mapping
        A row of the table.
    """
    if not corrected:
        return row[column]
    title_of_row = next(iter(row.values()))
    place = (table, title_of_row, column)
    for erratum in errata(problem):
        cell = erratum.cell
        if cell and (cell["table"], cell["row"], cell["column"]) == place:
            return cell["value"]
    return row[column]


def box_tables(problem: Problem) -> list[str]:
    """Return the names of the published tables with bounds and values of links'
    parameters."""
    return [
        name
        for name, rows in problem.published.items()
        if rows and {"parameter", "lower", "upper"} <= set(rows[0])
    ]


def published_values(
    problem: Problem, column: str, corrected: bool = True
) -> dict[str, float]:
    """Return published barycentric values by their printed names.

    Parameters
    ----------
    corrected : bool
        Whether to apply the errata.

    Returns
    -------
    dict of str to float
        Values by name (m1, c1x, I1xx); NaN for an empty cell.
    """
    values = {}
    for name in box_tables(problem):
        for row in problem.published[name]:
            text = ""
            if column in row:
                text = published_cell(
                    problem, table=name, row=row, column=column, corrected=corrected
                )
            values[row["parameter"]] = float(text) if text else np.nan
    return values


def published_links(problem: Problem, column: str, corrected: bool = True) -> Array:
    """Return the standard parameters (n, 10) of a published column: "p_hat", "delta" or
    "p_real".

    A cell that the paper leaves empty, as its value does not matter, becomes the middle of
    its bounds.

    Parameters
    ----------
    corrected : bool
        Whether to apply the errata.

    Raises
    ------
    InputError
        Where the problem has no such column.
    """
    values = published_values(problem, column, corrected)
    if all(np.isnan(v) for v in values.values()):
        what = f"problem {problem.name}: no published parameters {column!r}"
        raise InputError(what, "choose another problem")
    links = range(1, len(problem.box) + 1)
    rows = np.array(
        [[values[name] for name in barycentric_names(link)] for link in links]
    )
    empty = np.isnan(rows)
    rows[empty] = problem.box[empty].mean(axis=1)
    return inertia.standard_from_barycentric(rows)


def published_friction(problem: Problem, table: str) -> Array:
    """Return the published friction constants of each joint.

    Parameters
    ----------
    table : str
        Number of the table, which has a row a constant and a column a joint.

    Returns
    -------
    (n, 3) array
        phi_1, phi_2, phi_3 of each joint.
    """
    rows = {row["parameter"]: row for row in problem.published[table]}
    joints = [f"joint_{j + 1}" for j in range(problem.robot.n)]
    return np.array(
        [[float(rows[f"phi_{k}"][joint]) for k in (1, 2, 3)] for joint in joints]
    )


def published_trajectory(
    problem: Problem, settings: Mapping[str, Any]
) -> FourierTrajectory:
    """Return the exciting trajectory of a published table (rows a_1.., b_1.., q_0).

    Parameters
    ----------
    settings : mapping
        The problem's settings of the trajectory.
    """
    rows = {row["coefficient"]: row for row in problem.published[settings["table"]]}

    def values(name: str) -> list[float]:
        """Return the row of a coefficient, one number a joint."""
        return [float(rows[name][f"joint_{j + 1}"]) for j in range(problem.robot.n)]

    harmonics = range(1, 1 + sum(name.startswith("a_") for name in rows))
    a = np.array([values(f"a_{k}") for k in harmonics]).T
    b = np.array([values(f"b_{k}") for k in harmonics]).T
    frequency = float(settings["frequency_over_pi"])
    blend = float(settings["blend"])
    duration = float(settings["duration"])
    return FourierTrajectory(
        a,
        b,
        q_0=np.array(values("q_0")),
        frequency=np.pi * frequency,
        blend=blend,
        duration=duration,
    )


def real_data_folder() -> Path | None:
    """Return the folder of measured data, None without one.

    It is the folder that the environment variable SDP_VS_PENALTY_DATA names, or else
    shared/data beside a checkout. Raises InputError if the variable names no folder.
    """
    named = os.environ.get(VARIABLE)
    if named:
        folder = Path(named)
        if not folder.is_dir():
            raise InputError(
                f"{VARIABLE} names {named}, which is not a folder",
                "correct or unset it",
            )
        return folder
    checkout = Path(__file__).parents[2]
    folder = checkout.parent / "shared" / "data"
    is_checkout = (checkout / "pyproject.toml").is_file()
    return folder if is_checkout and folder.is_dir() else None


def real_file(problem: str, name: str) -> Path | None:
    """Return the path of a file with published measurements, None if it is missing."""
    folder = real_data_folder()
    return (
        folder / problem / name
        if folder and (folder / problem / name).is_file()
        else None
    )


def measured_runs(problem: str) -> dict[str, Measurements]:
    """Return the published runs of a robot.

    Returns
    -------
    dict of str to Measurements
        Runs by name; empty where a file of the authors is missing.
    """
    names = [f.name for f in DATASETS[problem].files] if problem in DATASETS else []
    files = [real_file(problem, name) for name in names]
    if not files or None in files:
        return {}
    folder = files[0].parent  # type: ignore[union-attr]
    return converted(problem, folder)
