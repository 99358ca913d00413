"""The house: rooms in the order of the data, no import runs back, no circle, a small
hall.

Read from the imports themselves, lazy ones and those for types included: what a reader
has to follow.
"""

import ast
import importlib
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

import sdp_vs_penalty

ROOT = Path(sdp_vs_penalty.__file__).parent
PACKAGE = ROOT.name
#: From what knows nothing to what may use everything; the files at the package's root
#: count as rooms.
ORDER = (
    "version",
    "errors",
    "arguments",
    "formatting",
    "colours",
    "files",
    "records",
    "memory",
    "parallel",
    "plugins",
    "results",
    "robot",
    "data",
    "effects",
    "signals",
    "problem",
    "regression",
    "race",
    "solvers",
    "estimators",
    "estimation",
    "ranges",
    "online",
    "exporters",
    "diagnosis",
    "simulation",
    "checks",
    "api",
    "testing",
    "render",
    "reports",
    "page",
    "shootout",
    "paper",
    "cli",
    "__main__",
)
#: The front door: re-exports for users, and nothing inside goes through it.
DOOR = PACKAGE


@cache
def nodes(path):
    """The calls and imports of a file, which is parsed once for all tests."""
    return [
        node
        for node in ast.walk(ast.parse(path.read_text("utf-8")))
        if isinstance(node, ast.Call | ast.Import | ast.ImportFrom)
    ]


def modules():
    """Every module by its dotted name; a package by its own."""
    found = {}
    for path in sorted(ROOT.rglob("*.py")):
        parts = (PACKAGE, *path.relative_to(ROOT).with_suffix("").parts)
        found[".".join(parts).removesuffix(".__init__")] = path
    return found


def imports(path, known):
    """The package's own modules that a file imports, wherever in the file."""
    found = set()
    for node in nodes(path):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: a relative import hides where it goes"
            for alias in node.names:
                full = f"{node.module}.{alias.name}"
                found.add(full if full in known else str(node.module))
    return {name for name in found if name in known}


KNOWN = modules()


@pytest.fixture(scope="module")
def graph():
    """Of each module the others that it imports."""
    return {name: imports(path, KNOWN) for name, path in KNOWN.items()}


def room(name):
    return name.split(".")[1]


def test_every_room_has_its_place_in_the_order():
    assert {room(name) for name in KNOWN if name != DOOR} == set(ORDER)


def test_no_room_imports_a_higher_one(graph):
    back = [
        f"{name} imports {other}"
        for name, others in graph.items()
        for other in others
        if DOOR not in (name, other)
        and ORDER.index(room(other)) > ORDER.index(room(name))
    ]
    assert not back


def test_nothing_inside_goes_through_the_front_door(graph):
    assert not [
        name for name, others in graph.items() if DOOR in others and name != DOOR
    ]


BENCHMARKS = sorted((ROOT.parent / "results").rglob("*.py"))


@pytest.mark.parametrize("path", BENCHMARKS, ids=lambda path: path.stem)
def test_what_a_benchmark_imports_of_the_package_is_there(path):
    for node in nodes(path):
        if isinstance(node, ast.ImportFrom) and str(node.module).startswith(PACKAGE):
            home = importlib.import_module(str(node.module))
            for name in (alias.name for alias in node.names):
                assert hasattr(home, name) or f"{node.module}.{name}" in KNOWN, (
                    f"{path}: {name}"
                )


def test_there_is_no_circle(graph):
    others_of = {name: others - {name} for name, others in graph.items()}
    try:
        list(TopologicalSorter(others_of).static_order())
    except CycleError as error:
        raise AssertionError(
            f"imports in a circle: {' -> '.join(error.args[1])}"
        ) from None


#: A worker of the page hands its error on as the one sentence that it is.
HANDED_ON = {"page/worker.py"}


def test_every_error_has_a_remedy():
    without = []
    calls = 0
    for path in sorted(ROOT.rglob("*.py")):
        for node in nodes(path):
            if isinstance(node, ast.Call) and getattr(node.func, "id", "") in (
                "InputError",
                "Infeasible",
            ):
                calls += 1
                remedy = [
                    k.value for k in node.keywords if k.arg == "remedy"
                ] + node.args[1:2]
                if not remedy or (
                    isinstance(remedy[0], ast.Constant) and not remedy[0].value
                ):
                    without.append(f"{path.relative_to(ROOT)}:{node.lineno}")
    assert calls > 200
    assert [
        place for place in without if place.partition(":")[0] not in HANDED_ON
    ] == []


def test_every_text_is_read_in_an_encoding():
    """Where the locale is C, Python takes text for ASCII."""
    without = []
    for path in sorted(ROOT.rglob("*.py")):
        for node in nodes(path):
            if not isinstance(node, ast.Call):
                continue
            name = getattr(node.func, "attr", "")
            if name == "read_text" and not (node.args or node.keywords):
                without.append(f"{path.relative_to(ROOT)}:{node.lineno}")
    assert without == []
