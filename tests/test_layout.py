"""The house: rooms in the order of the data, no import runs back, no circle, a small
hall; no other room knows an effect by its name; a name means one thing, and each field of a
record says what it is.

Read from the imports themselves, lazy ones and those for types included: what a reader
has to follow.
"""

import ast
import importlib
import re
from collections import Counter, defaultdict
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from types import SimpleNamespace

import pytest

import sdp_vs_penalty
from sdp_vs_penalty.effects import effect_types

ROOT = Path(sdp_vs_penalty.__file__).parent
PACKAGE = ROOT.name
#: From what knows nothing to what may use everything; the files at the package's root
#: count as rooms.
ORDER = (
    "version",
    "errors",
    "arguments",
    "threads",
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
def source(path):
    """What tests ask of a file, which is parsed once for all: its imports; names of its
    classes, functions and variables; how many errors it makes, and in which lines without a
    remedy or a text's encoding; effects that it names; fields that say nothing."""
    text = path.read_text("utf-8")
    nodes, rows, kinds = (
        [*ast.walk(ast.parse(text))],
        text.splitlines(),
        defaultdict(list),
    )
    for node in nodes:
        kinds[type(node)].append(node)
    errors = [
        call
        for call in kinds[ast.Call]
        if getattr(call.func, "id", "") in ("InputError", "Infeasible")
    ]
    bodies = [x for record in kinds[ast.ClassDef] for x in record.body]
    fields = {x.target for x in bodies if isinstance(x, ast.AnnAssign)}
    stored = [x for x in kinds[ast.Name] if isinstance(x.ctx, ast.Store)]
    variables = {x.id for x in stored if x not in fields}
    return SimpleNamespace(
        imports=kinds[ast.Import] + kinds[ast.ImportFrom],
        n_errors=len(errors),
        without_remedy=[e.lineno for e in errors if not has_remedy(e)],
        without_encoding=[
            call.lineno
            for call in kinds[ast.Call]
            if getattr(call.func, "attr", "") == "read_text"
            and not (call.args or call.keywords)
        ],
        effects=names_of_effects(nodes) if ANY.search(text) else set(),
        classes=[x.name for x in kinds[ast.ClassDef]],
        functions={x.name for x in kinds[ast.FunctionDef]},
        variables=variables | {x.arg for x in kinds[ast.arg]},
        bare_fields=[
            x.lineno
            for record in kinds[ast.ClassDef]
            for x in bare_fields(record, rows)
        ],
    )


#: A smaller record says its fields in its docstring's sentence.
SMALL = 4


def bare_fields(record, lines):
    """Fields of a record without a comment of their own or an entry under Parameters."""
    fields = [
        x
        for x in record.body
        if isinstance(x, ast.AnnAssign) and "ClassVar" not in ast.unparse(x.annotation)
    ]
    marks = ast.unparse(ast.List(record.decorator_list + record.bases))
    if len(fields) <= SMALL or not re.search("dataclass|NamedTuple", marks):
        return []
    entries = re.findall(r"^(\w+) : ", ast.get_docstring(record) or "", re.MULTILINE)
    return [
        field
        for field in fields
        if ast.unparse(field.target) not in entries
        and not any("#:" in x for x in lines[field.lineno - 1 : field.end_lineno])
        and not lines[field.lineno - 2].strip().startswith("#:")
    ]


def has_remedy(error):
    """Whether a call of an error says what to do."""
    named = [k.value for k in error.keywords if k.arg == "remedy"]
    remedy = (named + error.args[1:2])[:1]
    return bool(remedy) and bool(getattr(remedy[0], "value", True))


def lines(attribute):
    """FILE:LINE of what a list of every file's source holds."""
    return [
        f"{path.relative_to(ROOT)}:{line}"
        for path in sorted(ROOT.rglob("*.py"))
        for line in getattr(source(path), attribute)
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
    for node in source(path).imports:
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        else:
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


def test_an_adapter_of_files_knows_nothing_of_robots(graph):
    """Nor what a column is: it makes named columns of bytes, in a process of its own where
    one wrong byte can end it."""
    known = {f"{PACKAGE}.robot.{x}" for x in ("arrays", "isolated")}
    modules = ("hypotheses", "columns", "draft", "values", "reading")
    deciding = tuple(f"{PACKAGE}.data.{x}" for x in modules)
    assert not [
        f"{name} imports {other}"
        for name, others in graph.items()
        if name.startswith(f"{PACKAGE}.data.formats")
        for other in others - known
        if room(other) == "robot" or other.startswith(deciding)
    ]


def test_nothing_inside_goes_through_the_front_door(graph):
    assert not [
        name for name, others in graph.items() if DOOR in others and name != DOOR
    ]


def names_of_modules(path):
    """Modules by the names that a file gives them; "c" is the constants of any folder."""
    named = {}
    for node in source(path).imports:
        for alias in node.names:
            whole = alias.name
            if isinstance(node, ast.ImportFrom):
                whole = f"{node.module}.{alias.name}"
            if isinstance(node, ast.Import) or whole in KNOWN:
                home = f"{PACKAGE}.{path.relative_to(ROOT).parts[0]}"
                named[alias.asname or alias.name] = whole.removeprefix(
                    f"{home}.constants"
                )
    return named


def test_a_name_of_a_module_means_one():
    meanings = defaultdict(set)
    for path in KNOWN.values():
        for name, module in names_of_modules(path).items():
            meanings[name].add(module)
    assert not {name: found for name, found in meanings.items() if len(found) > 1}


def test_no_variable_hides_a_module():
    assert not {
        (str(path), name)
        for path in KNOWN.values()
        for name in source(path).variables & names_of_modules(path).keys()
    }


def test_no_two_classes_have_one_name():
    classes = Counter(name for path in KNOWN.values() for name in source(path).classes)
    assert not {name for name, count in classes.items() if count > 1}


def test_no_method_is_named_by_a_preposition():
    assert not [path for path in KNOWN.values() if "of" in source(path).functions]


def test_each_field_of_a_record_says_what_it_is():
    assert lines("bare_fields") == []


BENCHMARKS = sorted((Path(__file__).parents[1] / "results").rglob("*.py"))


def test_what_a_benchmark_imports_of_the_package_is_there():
    imports = [(path, node) for path in BENCHMARKS for node in source(path).imports]
    for path, node in imports:
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
HANDED_ON = ("page/worker.py",)


def test_every_error_has_a_remedy():
    assert sum(source(path).n_errors for path in ROOT.rglob("*.py")) > 200
    assert [x for x in lines("without_remedy") if not x.startswith(HANDED_ON)] == []


def test_every_text_is_read_in_an_encoding():
    """Where the locale is C, Python takes text for ASCII."""
    assert lines("without_encoding") == []


#: Who chooses effects as a user does: the paper's models, the demo's hidden effect, and
#: the worlds that state torques a second time, against which columns are tested.
USERS = ("effects", "paper", "simulation/worlds", "reports/demo.py")
#: Names that a sentence may hold as plain words count where a value is compared alone.
NAMES = {name for name in effect_types() if "_" in name}
WORDS = {name for name in effect_types() if "_" not in name}
CLASSES = {kind.__name__ for kind in effect_types().values()}
IN_TEXT = re.compile(rf"(?<![\w}}])({'|'.join(sorted(NAMES))})(?!\w)")
#: What no file without it can know an effect by.
ANY = re.compile("|".join([*NAMES, *WORDS, *CLASSES]))


def names_of_effects(nodes):
    """Names and classes of effects in code; docstrings and comments may name them."""
    docstrings = {
        id(node.body[0].value)
        for node in nodes
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef)
        and isinstance(node.body[0], ast.Expr)
    }
    found = set()
    for node in nodes:
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            if id(node) not in docstrings:
                found |= set(IN_TEXT.findall(node.value))
        elif isinstance(node, ast.Compare):
            found |= _compared_with_names(node)
        elif isinstance(node, ast.Name | ast.Attribute | ast.alias):
            word = (
                getattr(node, "id", "")
                or getattr(node, "attr", "")
                or getattr(node, "name", "")
            )
            found |= {word} & CLASSES
    return found


def _compared_with_names(node):
    """Names without an underscore, as in ``effect.name == "payload"``."""
    sides = [node.left, *node.comparators]
    attributes = {side.attr for side in sides if isinstance(side, ast.Attribute)}
    texts = {side.value for side in sides if isinstance(side, ast.Constant)}
    return texts & WORDS if attributes & {"name", "effect", "text"} else set()


def test_no_other_folder_knows_an_effect_by_its_name():
    assert not {
        str(path): source(path).effects
        for path in ROOT.rglob("*.py")
        if not path.relative_to(ROOT).as_posix().startswith(USERS)
        and source(path).effects
    }


@pytest.mark.parametrize(
    ("code", "found"),
    [
        ("if effect.name == 'stiction': pass", {"stiction"}),
        ("parse('rigid_body,joint_spring:2@k=1')", {"rigid_body", "joint_spring"}),
        ("from x import Payload", {"Payload"}),
        ("links.BaseTilt(robot)", {"BaseTilt"}),
        ("'the torque there is stiction'", set()),
        ("def f():\n    '''Like coulomb_friction.'''", set()),
    ],
)
def test_the_test_sees_names(code, found):
    assert names_of_effects([*ast.walk(ast.parse(code))]) == found
