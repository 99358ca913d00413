"""The comparison tables, one file each: a file with NAME, and build(study) is its registration.

A module defines NAME ("III"), build(study) -> Table, and where it applies only to some problems
PROBLEMS, a tuple of their names.
"""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from types import ModuleType

from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimators.estimator import Progress, no_progress
from sdp_vs_penalty.problem import Problem, load_problem
from sdp_vs_penalty.tables.study import Study
from sdp_vs_penalty.tables.table import Table

#: What `tables` without names makes.
DEFAULT_TABLES = ("III", "IV", "VIII", "IX")
DEFAULT_PROBLEM = "panda"


@cache
def table_modules() -> dict[str, ModuleType]:
    """Every table of the package by its name."""
    found = {}
    for module in pkgutil.iter_modules(__path__):
        home = importlib.import_module(f"{__name__}.{module.name}")
        if hasattr(home, "NAME"):
            found[home.NAME] = home
    return dict(sorted(found.items()))


def build_tables(names: Sequence[str] | None, study: Study) -> list[Table]:
    """The tables as data. Raises InputError for a table that does not exist for the problem."""
    modules = table_modules()
    known = {name.lower(): name for name in modules}
    chosen: list[ModuleType] = []
    for name in names if names else DEFAULT_TABLES:
        if name.lower() not in known:
            raise InputError(f"table {name!r} is unknown; there are: {', '.join(modules)}.")
        module = modules[known[name.lower()]]
        where = getattr(module, "PROBLEMS", None)
        if where is not None and study.problem.name not in where:
            raise InputError(
                f"table {module.NAME} belongs to {' and '.join(where)}: choose it with --problem, or "
                "leave the table out."
            )
        if module not in chosen:
            chosen.append(module)
    out = []
    for module in chosen:
        study.progress(f"table {module.NAME}")
        out.append(module.build(study))
    return out


def make_tables(
    names: Sequence[str] | None = None,
    problem: str | Path | Problem | None = None,
    budget: str = "quick",
    out: str | Path = "results",
    progress: Progress = no_progress,
    seed: int = 0,
) -> list[Path]:
    """Build tables and write each as CSV, Markdown and LaTeX; the paths written.

    names : of the tables, in any case; None for III, IV, VIII and IX. problem : default the Panda.
    budget : "quick", or "paper" for as many loss evaluations of the paper's method as its authors
    allow. Raises InputError for names that do not exist, before anything is computed or written.
    """
    chosen = problem if isinstance(problem, Problem) else load_problem(problem or DEFAULT_PROBLEM)
    tables = build_tables(names, Study(chosen, budget, seed, progress))
    return [path for table in tables for path in table.write(out)]
