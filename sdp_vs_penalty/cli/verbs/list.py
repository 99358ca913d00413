"""List problems, effects, methods, solvers, tables and more."""

from enum import StrEnum

from sdp_vs_penalty.errors import unknown

Rows = list[tuple[str, ...]]
Listing = tuple[tuple[str, ...], Rows]
#: What can be listed.
Kind = StrEnum("Kind", "problems effects methods solvers tables datasets engines exports")


def verb(what: Kind, name: str | None = None) -> None:
    """List the names that the other verbs take, or say all about one of them.

    Example: sdp-vs-penalty list effects presliding_hysteresis

    what: Kind of names to list.
    name: One name, for all about it.
    """
    from sdp_vs_penalty.cli import console

    headings, rows = listing(what)
    if name is not None:
        console.details(headings, details(what, name))
        return
    columns = [headings.index(heading) for heading in _SHORT.get(what, headings)]
    console.listing([headings[k] for k in columns], [[row[k] for k in columns] for row in rows])
    if len(columns) < len(headings):
        console.say(f"All about one of them: sdp-vs-penalty list {what.value} {rows[0][0]}")


#: Which columns of a long listing are shown beside each other; all of them are of a single name.
_SHORT = {
    "effects": ("name", "torque"),
    "solvers": ("name", "here", "what it is"),
    "engines": ("name", "version here", "formulation"),
    "datasets": ("name", "licence", "what it is"),
}


def listing(kind: str) -> Listing:
    """Headings and rows of one kind of thing that can be chosen; names come first."""
    return _KINDS[kind]()


def details(kind: str, name: str) -> tuple[str, ...]:
    """The whole row of one name; InputError where there is none."""
    rows = {row[0]: row for row in listing(kind)[1]}
    if name not in rows:
        raise unknown("", name, rows, where=kind)
    return rows[name]


def problems() -> Listing:
    from sdp_vs_penalty.problem.load import load_problem, problem_names

    found = map(load_problem, problem_names())
    rows: Rows = [(p.name, str(p.robot.n), p.torque_side, p.title) for p in found]
    return ("name", "joints", "torque side", "what it is"), rows


def effects() -> Listing:
    from sdp_vs_penalty.effects import effect_types

    rows: Rows = []
    for name, kind in effect_types().items():
        shape = ", ".join(f"{key}={s.default:g}" for key, s in kind.shapes.items())
        acts = "whole robot" if kind.whole_robot else "joint by joint"
        if kind.frozen_only:
            acts += "; seen with --frozen only"
        rows.append((name, kind.equation, shape, acts, kind.explanation, kind.reference))
    return ("name", "torque", "shape constants", "acts on", "what it is", "reference"), rows


def methods() -> Listing:
    from sdp_vs_penalty.estimation.output_error import DESCRIPTION, OUTPUT_ERROR
    from sdp_vs_penalty.estimators import estimator_types

    rows: Rows = [(name, kind.description) for name, kind in estimator_types().items()]
    return ("name", "what it is"), sorted([*rows, (OUTPUT_ERROR, DESCRIPTION)])


def solvers() -> Listing:
    from sdp_vs_penalty.solvers import solver_types

    rows: Rows = []
    for name, kind in solver_types().items():
        found = kind()
        rows.append((name, "absent" if found.absent else "yes", found.source, found.description))
    return ("name", "here", "installed by", "what it is"), rows


def tables() -> Listing:
    from sdp_vs_penalty.paper.tables import makers

    rows: Rows = [(name, ", ".join(x.problems), x.about) for name, x in makers().items()]
    return ("name", "only for", "what it is"), rows


def datasets() -> Listing:
    from sdp_vs_penalty.data.datasets import DATASETS

    rows: Rows = [(d.name, d.problem, d.licence, d.title) for d in DATASETS.values()]
    return ("name", "problem", "licence", "what it is"), rows


def engines() -> Listing:
    from sdp_vs_penalty.simulation.engines import engine_types

    rows: Rows = [
        (name, kind.version() or "absent", kind.install, kind.formulation)
        for name, kind in engine_types().items()
    ]
    return ("name", "version here", "installed by", "formulation"), rows


def exports() -> Listing:
    from sdp_vs_penalty.exporters.export import formats

    return ("file ends in", "what it is"), [(ending, home.ABOUT) for ending, home in formats().items()]


_KINDS = {
    made.__name__: made
    for made in (problems, effects, methods, solvers, tables, datasets, engines, exports)
}
