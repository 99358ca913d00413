from enum import StrEnum
from pathlib import Path

from sdp_vs_penalty.cli import console
from sdp_vs_penalty.errors import require_known

Rows = list[tuple[str, ...]]
#: Headings, and a row for each name.
Listing = tuple[tuple[str, ...], Rows]
#: What can be listed.
Kind = StrEnum(
    "Kind", "problems effects methods solvers tables datasets engines formats exports"
)


def verb(what: Kind, name: str | None = None, json_: Path | None = None) -> None:
    """List the names that the other verbs take, or say all about one of them.

    Example: sdp-vs-penalty list effects presliding_hysteresis

    what: Kind of names to list.
    name: One name, for all about it.
    --json out.json: JSON file for all that is known of each name.
    """
    from sdp_vs_penalty.results.table import Table

    headings, rows = listing(what)
    if name is not None:
        rows = [details(what, name)]
    entries = [dict(zip(headings, row, strict=True)) for row in rows]
    console.save_json(json_, entries)
    if name is not None:
        console.details(list(entries[0].items()))
        return
    # The terminal shows the most important columns; all of them hold words.
    columns = [headings.index(heading) for heading in _SHORT.get(what, headings)]
    cells = [[row[k] for k in columns] for row in rows]
    shown_headings = [headings[k] for k in columns]
    console.table(Table(shown_headings, cells, words=range(len(columns))))
    if len(columns) < len(headings):
        console.say(
            f"All about one of them: sdp-vs-penalty list {what.value} {rows[0][0]}"
        )


#: Which columns of a long listing are shown beside each other; all of them are of a
#: single name.
_SHORT = {
    "effects": ("name", "torque"),
    "solvers": ("name", "here", "what it is"),
    "engines": ("name", "version here", "formulation"),
    "datasets": ("name", "licence", "what it is"),
}


def details(kind: str, name: str) -> tuple[str, ...]:
    """Return the full row of one name. Raises InputError if there is none."""
    rows = {row[0]: row for row in listing(kind)[1]}
    require_known("", name, rows, where=kind)
    return rows[name]


def listing(kind: str) -> Listing:
    """Return headings and rows of one kind of names, such as "effects"."""
    return _LISTINGS[kind]()


def _problems() -> Listing:
    """Return headings and rows of the built-in problems."""
    from sdp_vs_penalty.problem.load import load_problem, problem_names

    problems = map(load_problem, problem_names())
    rows: Rows = [(p.name, str(p.robot.n), p.torque_side, p.title) for p in problems]
    return ("name", "joints", "torque side", "what it is"), rows


def _effects() -> Listing:
    """Return headings and rows of the library's effects."""
    from sdp_vs_penalty.effects import effect_types

    rows: Rows = []
    for name, effect in effect_types().items():
        shapes = effect.shapes.items()
        constants = ", ".join(f"{key}={shape.default:g}" for key, shape in shapes)
        acts = "whole robot" if effect.whole_robot else "joint by joint"
        if effect.frozen_only:
            acts += "; seen with --frozen only"
        about = (effect.explanation, effect.reference)
        rows.append((name, effect.equation, constants, acts, *about))
    heads = ("name", "torque", "shape constants", "acts on", "what it is", "reference")
    return heads, rows


def _methods() -> Listing:
    """Return headings and rows of the identification methods."""
    from sdp_vs_penalty.estimation.output_error import DESCRIPTION, OUTPUT_ERROR
    from sdp_vs_penalty.estimators import estimator_types

    rows: Rows = [(name, m.description) for name, m in estimator_types().items()]
    return ("name", "what it is"), sorted([*rows, (OUTPUT_ERROR, DESCRIPTION)])


def _solvers() -> Listing:
    """Return headings and rows of the SDP solvers, installed or not."""
    from sdp_vs_penalty.solvers import solver_types

    rows: Rows = []
    for name, kind in solver_types().items():
        solver = kind()
        here = "absent" if solver.absent else "yes"
        rows.append((name, here, solver.source, solver.description))
    return ("name", "here", "installed by", "what it is"), rows


def _tables() -> Listing:
    """Return headings and rows of the paper's tables."""
    from sdp_vs_penalty.paper.tables import makers

    rows: Rows = [
        (name, ", ".join(table.problems), table.about)
        for name, table in makers().items()
    ]
    return ("name", "only for", "what it is"), rows


def _datasets() -> Listing:
    """Return headings and rows of the public data sets."""
    from sdp_vs_penalty.data.datasets import DATASETS

    rows: Rows = [(d.name, d.problem, d.licence, d.title) for d in DATASETS.values()]
    return ("name", "problem", "licence", "what it is"), rows


def _engines() -> Listing:
    """Return headings and rows of the physics engines, installed or not."""
    from sdp_vs_penalty.simulation.engines import engine_types

    rows: Rows = [
        (name, engine.version() or "absent", engine.install, engine.formulation)
        for name, engine in engine_types().items()
    ]
    return ("name", "version here", "installed by", "formulation"), rows


def _formats() -> Listing:
    """Return headings and rows of the formats of measurements."""
    from sdp_vs_penalty.data.formats import FORMATS
    from sdp_vs_penalty.plugins import summary_line

    rows: Rows = []
    for name, home in FORMATS.all().items():
        files = home.SUFFIXES or (f"folders with {home.FOLDER}",)
        written = "yes" if hasattr(home, "write") else "no"
        rows.append((name, " ".join(files), written, summary_line(home)))
    return ("name", "files", "can be written", "what it is"), rows


def _exports() -> Listing:
    """Return headings and rows of the export formats, by file suffix."""
    from sdp_vs_penalty.exporters import EXPORTS

    rows: Rows = [(ending, home.ABOUT) for ending, home in EXPORTS.all().items()]
    return ("file ends in", "what it is"), rows


_LISTINGS = {
    "problems": _problems,
    "effects": _effects,
    "methods": _methods,
    "solvers": _solvers,
    "tables": _tables,
    "datasets": _datasets,
    "engines": _engines,
    "formats": _formats,
    "exports": _exports,
}
