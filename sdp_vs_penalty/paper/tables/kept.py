"""Tables that were made before, read from the disk: a run that was stopped makes again
only what it had not finished."""

import hashlib
import sys
from collections.abc import Mapping
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas

from sdp_vs_penalty.paper.memo import program_version, remembered
from sdp_vs_penalty.paper.tables.study import Study
from sdp_vs_penalty.paper.tables.table import Table, TableSpec
from sdp_vs_penalty.problem.problem import ProblemFields
from sdp_vs_penalty.problem.published import real_data_folder
from sdp_vs_penalty.simulation.engines import engine_types

#: The fields of a table that are text or numbers.
_SHORT_FIELDS = ("title", "headline", "digits", "caption", "name")


def table_once(spec: TableSpec, study: Study) -> Table:
    """Return a table of a study, read from the disk if nothing that it depends on has
    changed.

    That is this program, the installed packages, the problem, the files of the real
    run, the budget and the seed.

    Parameters
    ----------
    study : Study
        Its problem, budget and data.

    Returns
    -------
    Table
        With the same cells and words, but without an index of rows.
    """
    content = (
        program_version(),
        _installed_packages(),
        {name: kind.version() for name, kind in engine_types().items()},
        type(study).__qualname__,
        spec.name,
        study.budget,
        study.seed,
        ProblemFields.of(study.problem).to_dict(),
        study.problem.robot.to_dict(),
        _files_of_problem(study.problem.folder),
        _real_files(study.problem.name),
    )
    return _restored(remembered("table", content, partial(_made, spec, study)))


def _made(spec: TableSpec, study: Study) -> dict[str, Any]:
    """Build a table, and return it as JSON."""
    table = spec.made(study)
    return {
        **{name: getattr(table, name) for name in _SHORT_FIELDS},
        "notes": list(table.notes),
        "rows": _frame_to_json(table.frame),
        "everything": _frame_to_json(table.everything),
    }


def _restored(held: Mapping[str, Any]) -> Table:
    """Make a table from the JSON of :func:`_made`."""
    rows = _frame_from_json(held["rows"])
    assert rows is not None
    return Table(
        rows=rows,
        notes=held["notes"],
        everything=_frame_from_json(held["everything"]),
        **{name: held[name] for name in _SHORT_FIELDS},
    )


def _frame_to_json(frame: pandas.DataFrame | None) -> dict[str, Any] | None:
    """Return columns and cells of a data frame as JSON; None for None."""
    if frame is None:
        return None
    cells = [
        [cell.item() if isinstance(cell, np.generic) else cell for cell in row]
        for row in frame.to_numpy(object)
    ]
    return {"columns": list(frame), "cells": cells}


def _frame_from_json(held: Mapping[str, Any] | None) -> pandas.DataFrame | None:
    """Make a data frame from the JSON of :func:`_frame_to_json`."""
    if held is None:
        return None
    return pandas.DataFrame(held["cells"], columns=held["columns"], dtype=object)


@cache
def _installed_packages() -> list[str]:
    """Return names and versions of the installed packages."""
    folders = {path for path in map(Path, sys.path) if path.is_dir()}
    return sorted({entry.name for x in folders for entry in x.glob("*.dist-info")})


def _files_of_problem(folder: Path | None) -> str:
    """Return a hash of the files in a problem's folder, other than problem.toml.

    They are the published tables, their errata, and the simulation's description.
    """
    if folder is None:
        return ""
    names = (folder / "errata.toml", folder / "simulation.toml")
    return _hash_of([*names, *sorted((folder / "published").glob("*.csv"))])


def _real_files(problem: str) -> str:
    """Return a hash of the real measurements of a problem; "" if there are none."""
    folder = real_data_folder()
    return "" if folder is None else _hash_of(sorted((folder / problem).glob("*")))


def _hash_of(paths: list[Path]) -> str:
    """Return a hash of names and contents of files; missing files are left out."""
    hasher = hashlib.sha256()
    for path in paths:
        if path.is_file():
            hasher.update(f"{path.name} {path.stat().st_size} ".encode())
            hasher.update(path.read_bytes())
    return hasher.hexdigest()
