"""The comparison tables, one file each: a file with a :class:`TableSpec` is its
registration."""

from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import pandas

from sdp_vs_penalty.errors import InputError, require_known
from sdp_vs_penalty.estimators.estimator import Progress, no_progress
from sdp_vs_penalty.parallel import ALONE, Workers
from sdp_vs_penalty.plugins import by_word, modules
from sdp_vs_penalty.problem.load import as_problem
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.research.tables.study import Study
from sdp_vs_penalty.research.tables.table import Table, TableSpec

#: What `tables` without names makes.
DEFAULT_TABLES = ("III", "IV", "VIII", "IX")


@cache
def makers() -> dict[str, TableSpec]:
    """Every table of the package by its name."""
    specs = (
        value for home in modules(__name__, __path__) for value in vars(home).values()
    )
    return by_word(
        (maker.name, maker) for maker in specs if isinstance(maker, TableSpec)
    )


def build_tables(names: Sequence[str] | None, study: Study) -> list[Table]:
    """The tables as data. Raises InputError for a table that does not exist for the
    problem."""
    return list(_tables_in_turn(_chosen(names), study))


def _tables_in_turn(specs: Sequence[TableSpec], study: Study) -> Iterator[Table]:
    """Each table when it is done; errors as of :func:`build_tables`, before the first."""
    for spec in specs:
        if spec.problems and study.problem.name not in spec.problems:
            what = f"table {spec.name} belongs to {' and '.join(spec.problems)}"
            raise InputError(what, "choose it with --problem, or leave the table out")
    for spec in specs:
        yield spec.made(study)


def _chosen(names: Sequence[str] | None) -> list[TableSpec]:
    known = {name.lower(): maker for name, maker in makers().items()}
    for name in names or ():
        if name.lower() not in known:  # however it is written
            require_known("table", name, makers())
    return list(dict.fromkeys(known[name.lower()] for name in names or DEFAULT_TABLES))


def make_tables(
    names: Sequence[str] | None = None,
    problem: str | Path | Problem | None = None,
    budget: str = "quick",
    out: str | Path = "results",
    progress: Progress = no_progress,
    workers: Workers = ALONE,
) -> list[tuple[Table, list[Path]]]:
    """Build tables and write each as CSV, Markdown and LaTeX; each with its paths, CSV
    first.

    Without the real run, a folder's measured tables are not overwritten: those without
    it are written to its subfolder ``simulated``.

    names : of the tables, in any case; None for III, IV, VIII and IX. problem : default
    the Panda, and the 2R for the tables that are about it only. budget : "quick", or
    "paper" for as many loss evaluations of the paper's method as its authors allow;
    workers : who estimates, a method on a data set each. Raises InputError for names
    that do not exist, before anything is computed or written.
    """
    groups: dict[Any, list[str]] = {}
    for maker in _chosen(names):
        problem_name, *_ = maker.problems or ("panda",)
        groups.setdefault(problem_name if problem is None else "", []).append(
            maker.name
        )
    tables_made = []
    for name, group in groups.items():
        study = Study(as_problem(problem or name), budget, progress, workers)
        for table in _tables_in_turn(_chosen(group), study):
            paths = table.write(_folder(table, Path(out)))
            tables_made.append((table, paths))
    return tables_made


def _folder(table: Table, out: Path) -> Path:
    """Where to write a table so that it takes no measured one's place without being
    measured itself."""
    there = out / f"table_{table.name}.csv"
    if table.measured or not there.is_file():
        return out
    held = Table("", pandas.read_csv(there, dtype=str, keep_default_na=False))
    return out / "simulated" if held.measured else out
