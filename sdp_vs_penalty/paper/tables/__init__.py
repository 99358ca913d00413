"""The comparison tables, one file each: a file with a :class:`TableSpec` is its
registration."""

from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path

import pandas

from sdp_vs_penalty.errors import InputError, require_known
from sdp_vs_penalty.estimators.estimator import Progress, no_progress
from sdp_vs_penalty.paper.tables.study import Study
from sdp_vs_penalty.paper.tables.table import StudyTable, TableSpec
from sdp_vs_penalty.parallel import ALONE, Workers
from sdp_vs_penalty.plugins import by_word, modules
from sdp_vs_penalty.problem.load import as_problem
from sdp_vs_penalty.problem.problem import Problem

#: What `tables` without names makes.
DEFAULT_TABLES = ("III", "IV", "VIII", "IX")


@cache
def makers() -> dict[str, TableSpec]:
    """Return the registration of every table, by name."""
    specs = (value for home in modules(__name__) for value in vars(home).values())
    return by_word(
        (maker.name, maker) for maker in specs if isinstance(maker, TableSpec)
    )


def build_tables(names: Sequence[str] | None, study: Study) -> list[StudyTable]:
    """Build tables as data, without writing them.

    Parameters
    ----------
    names : sequence of str or None
        Names of the tables, in any case; None for III, IV, VIII and IX.
    study : Study
        Problem, data, budget and workers.

    Returns
    -------
    list of StudyTable
        In the order of the names.

    Raises
    ------
    InputError
        For a table that does not exist, or not for this problem.
    """
    specs = _chosen(names)
    _check_problem(specs, study)
    return [spec.made(study) for spec in specs]


def _check_problem(specs: Sequence[TableSpec], study: Study) -> None:
    """Raise InputError if a table does not exist for the study's problem."""
    for spec in specs:
        if spec.problems and study.problem.name not in spec.problems:
            what = f"table {spec.name} belongs to {' and '.join(spec.problems)}"
            raise InputError(what, "choose it with --problem, or leave the table out")


def _chosen(names: Sequence[str] | None) -> list[TableSpec]:
    """Return the registrations of these names, in any case, without repetition."""
    known = {name.lower(): spec for name, spec in makers().items()}
    for name in names or ():
        if name.lower() not in known:
            require_known("table", name, makers())
    chosen = [known[name.lower()] for name in names or DEFAULT_TABLES]
    return list(dict.fromkeys(chosen))


def make_tables(
    names: Sequence[str] | None = None,
    problem: str | Path | Problem | None = None,
    budget: str = "quick",
    out: str | Path = "results",
    progress: Progress = no_progress,
    workers: Workers = ALONE,
    report: Callable[[StudyTable, list[Path]], None] = lambda *_: None,
) -> list[tuple[StudyTable, list[Path]]]:
    """Build tables and write each, as soon as it is made, as CSV, Markdown and LaTeX.

    Without the real run, a folder's measured tables are not overwritten: tables without
    measured figures are written to its subfolder ``simulated``. Estimates, searches and
    simulations are cached on the disk (:mod:`~sdp_vs_penalty.paper.memo`).

    Parameters
    ----------
    names : sequence of str or None
        Names of the tables, in any case; None for III, IV, VIII and IX.
    problem : str, Path, Problem or None
        The robot; None for the Panda, and for the 2R in the tables that are about it
        only.
    budget : str
        "quick", or "paper" for as many loss evaluations of the paper's method as its
        authors allow.
    progress : callable
        Called with a short text at each step.
    workers : Workers
        Processes that estimate at the same time, one method on one data set each.
    report : callable
        Called with each table and its paths when they are written.

    Returns
    -------
    list of (StudyTable, list of Path)
        Each table with its paths, CSV first.

    Raises
    ------
    InputError
        For names that do not exist, before anything is computed or written.
    """
    studies: dict[str, Study] = {}
    plan = []
    for spec in _chosen(names):
        name = "" if problem else (*spec.problems, "panda")[0]
        if name not in studies:
            posed = as_problem(problem or name)
            studies[name] = Study(posed, budget, progress, workers)
        _check_problem([spec], studies[name])
        plan.append((spec, studies[name]))
    tables_made = []
    for spec, study in plan:
        table = spec.made(study)
        paths = table.write(_folder(table, Path(out)))
        report(table, paths)
        tables_made.append((table, paths))
    return tables_made


def _folder(table: StudyTable, out: Path) -> Path:
    """Return the folder to write a table to.

    A table without measured figures never replaces one with them: it goes to the
    subfolder "simulated".
    """
    existing = out / f"table_{table.name}.csv"
    if table.measured or not existing.is_file():
        return out
    held = StudyTable("", pandas.read_csv(existing, dtype=str, keep_default_na=False))
    return out / "simulated" if held.measured else out
