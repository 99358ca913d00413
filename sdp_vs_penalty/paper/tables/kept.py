"""Tables that were made before, read from the disk: a run that was stopped makes again
only what it had not finished."""

import sys
from collections.abc import Iterable
from dataclasses import fields
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas

from sdp_vs_penalty.paper.memo import program_version, remembered
from sdp_vs_penalty.paper.tables.study import Study
from sdp_vs_penalty.paper.tables.table import StudyTable, TableSpec
from sdp_vs_penalty.problem.problem import ProblemFields
from sdp_vs_penalty.problem.published import real_data_folder
from sdp_vs_penalty.simulation.engines import engine_types


def table_once(spec: TableSpec, study: Study) -> StudyTable:
    """Return a table of a study, read from the disk if nothing that it depends on has
    changed.

    That is this program, the installed packages, the problem, the files of the real
    run, the budget and the seed.

    Returns
    -------
    StudyTable
        With the same cells and words, but without an index of rows.
    """
    problem = study.problem
    folder, data = problem.folder, real_data_folder()
    content = (
        program_version(),
        _installed_packages(),
        {name: kind.version() for name, kind in engine_types().items()},
        type(study).__qualname__,
        spec.name,
        study.budget,
        study.seed,
        ProblemFields.from_problem(problem).to_dict(),
        problem.robot.to_dict(),
        _files([*folder.glob("*.toml"), *folder.glob("published/*")] if folder else ()),
        _files((data / problem.name).glob("*") if data else ()),
    )
    held = remembered("table", content, partial(_made, spec, study))
    frames = {
        name: pandas.DataFrame(x["data"], columns=x["columns"], dtype=object)
        for name, x in held.items()
        if isinstance(x, dict)
    }
    return StudyTable(**held | frames)


def _made(spec: TableSpec, study: Study) -> dict[str, Any]:
    """Build a table, and return its fields as JSON."""
    table = spec.made(study)
    held = {field.name: getattr(table, field.name) for field in fields(table)}
    held["rows"] = table.frame
    return {
        name: x.to_dict("split") if isinstance(x, pandas.DataFrame) else x
        for name, x in held.items()
    }


@cache
def _installed_packages() -> list[str]:
    """Return names and versions of the installed packages."""
    folders = {path for path in map(Path, sys.path) if path.is_dir()}
    return sorted({entry.name for x in folders for entry in x.glob("*.dist-info")})


def _files(paths: Iterable[Path]) -> list[tuple[str, Any]]:
    """Return names and contents of files, for a key."""
    chosen = [path for path in sorted(paths) if path.is_file()]
    return [(path.name, np.fromfile(path, np.uint8)) for path in chosen]
