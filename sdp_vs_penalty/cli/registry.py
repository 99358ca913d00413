"""What there is to choose from, read from the folders that hold it: for `list` and the README."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from sdp_vs_penalty.errors import unknown

Rows = list[tuple[str, ...]]
Listing = tuple[tuple[str, ...], Rows]


def listing(kind: str) -> Listing:
    """Headings and rows of one kind of thing that can be chosen; names come first."""
    return _KINDS[kind]()


#: Which columns of a long listing are shown beside each other; all of them are of a single name.
_SHORT = {"effects": (0, 1), "solvers": (0, 1, 3), "engines": (0, 1, 3), "datasets": (0, 2, 3)}


def short(kind: str, whole: Listing) -> Listing:
    """Of a listing the columns to choose by: a line or two a name in 80 columns."""
    headings, rows = whole
    columns = _SHORT.get(kind, range(len(headings)))
    return tuple(headings[k] for k in columns), [tuple(row[k] for k in columns) for row in rows]


def details(kind: str, name: str) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Headings and the whole row of one name; InputError where there is none."""
    headings, rows = listing(kind)
    for row in rows:
        if row[0] == name:
            return headings, row
    raise unknown("", name, (row[0] for row in rows), where=kind)


def _problems() -> Listing:
    from sdp_vs_penalty.problem.load import load_problem, problem_names

    rows: Rows = []
    for name in problem_names():
        problem = load_problem(name)
        rows.append((name, str(problem.robot.n), problem.torque_side, problem.title))
    return ("name", "joints", "torque side", "what it is"), rows


def _effects() -> Listing:
    from sdp_vs_penalty.effects import effect_types

    rows: Rows = []
    for name, kind in effect_types().items():
        shape = ", ".join(f"{key}={s.default:g}" for key, s in kind.shapes.items())
        acts = "whole robot" if kind.whole_robot else "joint by joint"
        if kind.frozen_only:
            acts += "; seen with --frozen only"
        rows.append((name, kind.equation, shape, acts, kind.explanation, kind.reference))
    return ("name", "torque", "shape constants", "acts on", "what it is", "reference"), rows


def _methods() -> Listing:
    """Read from the files' text: naming the methods needs nothing that they compute with."""
    from sdp_vs_penalty.registration import written

    here = Path(__file__).parents[1]
    rows = [
        *written([here / "estimators"], "name", "description"),
        *written([here / "estimation"], "OUTPUT_ERROR", "DESCRIPTION"),
    ]
    return ("name", "what it is"), sorted(rows)


def _solvers() -> Listing:
    from sdp_vs_penalty.solvers import absent, installed_by, solver_modules

    rows: Rows = []
    for name, module in solver_modules().items():
        here = "yes" if absent(module) is None else "absent"
        rows.append((name, here, installed_by(module), (module.__doc__ or "").strip().splitlines()[0]))
    return ("name", "here", "installed by", "what it is"), rows


def _tables() -> Listing:
    from sdp_vs_penalty.paper.tables import table_modules

    rows: Rows = [
        (name, ", ".join(getattr(home, "PROBLEMS", ())), (home.__doc__ or "").strip().splitlines()[0])
        for name, home in table_modules().items()
    ]
    return ("name", "only for", "what it is"), rows


def _datasets() -> Listing:
    from sdp_vs_penalty.data.datasets import DATASETS

    rows: Rows = [(d.name, d.problem, d.licence, d.title) for d in DATASETS.values()]
    return ("name", "problem", "licence", "what it is"), rows


def _engines() -> Listing:
    from sdp_vs_penalty.simulation.engines import engine_types

    rows: Rows = [
        (name, kind.version() or "absent", kind.install, kind.formulation)
        for name, kind in engine_types().items()
    ]
    return ("name", "version here", "installed by", "formulation"), rows


_KINDS: dict[str, Callable[[], Listing]] = {
    "problems": _problems,
    "effects": _effects,
    "methods": _methods,
    "solvers": _solvers,
    "tables": _tables,
    "datasets": _datasets,
    "engines": _engines,
}
