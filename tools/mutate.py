"""Mutation testing: change one operator or number of some files at a time and see which tests notice.

    python tools/mutate.py sdp_vs_penalty/effects/drift.py --tests tests/effects --sample 40 --seed 1

The tree is left alone: a mutant lives in the memory of a forked process, whose import of the module
compiles the changed syntax tree. Each mutant meets only the tests that ran its line before (of these,
with ``--most``, the cheapest for so many seconds); what none of them notices is printed as a survivor.
Tests that start programs of their own do not see it.
"""

from __future__ import annotations

import argparse
import ast
import copy
import importlib
import importlib.abc
import importlib.util
import itertools
import json
import math
import os
import random
import resource
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
SWAPS: dict[type, type] = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.Pow: ast.Mult,
    ast.FloorDiv: ast.Mult, ast.Mod: ast.Mult, ast.And: ast.Or, ast.Or: ast.And, ast.BitAnd: ast.BitOr,
    ast.BitOr: ast.BitAnd, ast.Lt: ast.GtE, ast.GtE: ast.Lt, ast.Gt: ast.LtE, ast.LtE: ast.Gt,
    ast.Eq: ast.NotEq, ast.NotEq: ast.Eq, ast.In: ast.NotIn, ast.NotIn: ast.In, ast.Is: ast.IsNot,
    ast.IsNot: ast.Is,
}  # fmt: skip
#: Fields of the syntax tree in which a change means nothing at run time.
IDLE = {"annotation", "returns", "decorator_list", "type_comment"}
#: Processor seconds beyond ten times what its tests took; a mutant that takes more counts as noticed.
PATIENCE = 20.0


@dataclass(frozen=True)
class Mutant:
    """The tree of the changed module, and where and how it differs."""

    line: int
    word: str
    tree: ast.Module


def mutants(source: str) -> Iterator[Mutant]:
    """Every mutant of a module, in the order of its text."""
    tree = ast.parse(source)
    for k, (_, _, node) in enumerate(_places(tree)):
        for word, new in _changes(node):
            changed = copy.deepcopy(tree)
            holder, key, old = next(p for i, p in enumerate(_places(changed)) if i == k)
            holder[key] = ast.fix_missing_locations(ast.copy_location(new, old))
            yield Mutant(node.lineno, word, changed)  # type: ignore[attr-defined]


def _places(node: ast.AST) -> Iterator[tuple[Any, Any, ast.AST]]:
    """Every node that runs: what holds it, under which key, and the node itself."""
    if isinstance(node, ast.JoinedStr) or (isinstance(node, ast.keyword) and node.arg == "strict"):
        return
    if isinstance(node, ast.If) and getattr(node.test, "id", "") == "TYPE_CHECKING":
        return
    for field, value in ast.iter_fields(node):
        if field in IDLE:
            continue
        holder = value if isinstance(value, list) else node.__dict__
        for key, child in enumerate(value) if isinstance(value, list) else [(field, value)]:
            if isinstance(child, ast.AST):
                yield holder, key, child
                yield from _places(child)


def _changes(node: ast.AST) -> Iterator[tuple[str, ast.AST]]:
    """What may stand instead of a node, with a word for the change."""
    if isinstance(node, ast.BinOp | ast.BoolOp | ast.AugAssign) and type(node.op) in SWAPS:
        new, now = copy.deepcopy(node), SWAPS[type(node.op)]
        new.op = now()
        yield f"{type(node.op).__name__} -> {now.__name__}", new
    elif isinstance(node, ast.Compare) and type(node.ops[0]) in SWAPS:
        compare, now = copy.deepcopy(node), SWAPS[type(node.ops[0])]
        compare.ops[0] = now()
        yield f"{type(node.ops[0]).__name__} -> {now.__name__}", compare
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.Not):
        yield f"{type(node.op).__name__} left out", copy.deepcopy(node.operand)
    elif isinstance(node, ast.IfExp):
        yield "if and else swapped", ast.IfExp(node.test, node.orelse, node.body)
    elif isinstance(node, ast.If):
        inverse = copy.deepcopy(node)
        inverse.test = ast.UnaryOp(ast.Not(), inverse.test)
        yield "if inverted", inverse
    elif isinstance(node, ast.Raise):
        yield "raise left out", ast.Pass()
    elif isinstance(node, ast.Constant) and isinstance(node.value, bool):
        yield f"{node.value} -> {not node.value}", ast.Constant(not node.value)
    elif isinstance(node, ast.Constant) and isinstance(node.value, int | float):
        value = node.value + 1 if isinstance(node.value, int) else 2.0 * node.value or 1.0
        yield f"{node.value} -> {value}", ast.Constant(value)


class _Import(importlib.abc.MetaPathFinder, importlib.abc.SourceLoader):
    """Imports one module from a changed tree."""

    def __init__(self, path: Path, tree: ast.Module) -> None:
        self.path, self.tree = path, tree
        words = path.relative_to(ROOT).with_suffix("").parts
        self.name = ".".join(words[:-1] if words[-1] == "__init__" else words)

    def find_spec(self, name: str, path: Any = None, target: Any = None) -> Any:
        if name != self.name:
            return None
        return importlib.util.spec_from_file_location(name, self.path, loader=self)

    def get_filename(self, fullname: str) -> str:
        return str(self.path)

    def get_data(self, path: Any) -> bytes:
        return Path(path).read_bytes()

    def get_code(self, fullname: str) -> Any:
        return compile(self.tree, str(self.path), "exec")


class _Seen:
    """A pytest plugin: which test ran which lines of which file."""

    def __init__(self, paths: list[Path]) -> None:
        self.paths, self.lines, self.seconds = set(map(str, paths)), {}, {}
        self.now: set[tuple[str, int]] = set()

    def trace(self, frame: FrameType, event: str, _: Any) -> Any:
        if frame.f_code.co_filename not in self.paths:
            return None
        self.now.add((frame.f_code.co_filename, frame.f_lineno))
        return self.trace

    def pytest_runtest_logstart(self, nodeid: str) -> None:
        self.now, self.start = set(), time.process_time()
        sys.settrace(self.trace)

    def pytest_runtest_logfinish(self, nodeid: str) -> None:
        sys.settrace(None)
        self.lines[nodeid] = sorted(self.now)
        self.seconds[nodeid] = time.process_time() - self.start


def _pytest(words: list[str], plugins: list[object] | None = None) -> int:
    import pytest

    quiet = ["-q", "-x", "-n", "0", "-p", "no:cacheprovider", "--no-header", "--tb=no"]
    quiet += ["-o", "python_files=test_*.py"]  # what is called *_test.py pytest would import by itself
    return int(pytest.main([*quiet, *words], plugins=plugins))


def _forked(work: Callable[[], int], seconds: float) -> int:
    """The exit code of work done in a forked process, negative where it used up its processor time."""
    child = os.fork()
    if child == 0:
        code = 3
        try:
            resource.setrlimit(resource.RLIMIT_CPU, (math.ceil(time.process_time() + seconds),) * 2)
            null = os.open(os.devnull, os.O_WRONLY)
            os.dup2(null, 1)
            os.dup2(null, 2)
            code = work()
        finally:
            os._exit(code)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def baseline(paths: list[Path], tests: list[str]) -> dict[str, Any]:
    """Lines and seconds of each test, and the modules that they import; the tests must be green."""
    with tempfile.NamedTemporaryFile("r", suffix=".json") as file:

        def work() -> int:
            seen = _Seen(paths)
            code = _pytest(tests, [seen])
            found = {"lines": seen.lines, "seconds": seen.seconds, "modules": sorted(sys.modules)}
            Path(file.name).write_text(json.dumps(found))
            return code

        if _forked(work, 3600.0) != 0:
            sys.exit(f"the tests fail before anything is changed: pytest {' '.join(tests)}")
        found: dict[str, Any] = json.load(file)
    return found


def tests_for(path: Path, mutant: Mutant, known: dict[str, Any], most: float) -> tuple[list[str], bool]:
    """The tests that ran the mutant's line (all tests, for lines run on import), the cheapest first, of
    at most ``most`` seconds together, one at least; and whether these are all."""
    seconds = known["seconds"]
    ran = [t for t, lines in known["lines"].items() if [str(path), mutant.line] in lines]
    tests = sorted(ran or seconds, key=lambda t: seconds[t])
    total = list(itertools.accumulate(seconds[t] for t in tests))
    few = max(sum(x <= most for x in total), 1)
    return tests[:few], few >= len(tests)


def survives(path: Path, mutant: Mutant, tests: list[str], seconds: dict[str, float]) -> bool:
    """Whether none of the tests notices a mutant."""

    def work() -> int:
        sys.meta_path.insert(0, _Import(path, mutant.tree))
        return _pytest(tests)

    return _forked(work, PATIENCE + 10.0 * sum(seconds[t] for t in tests)) == 0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("files", nargs="+", type=Path, help="modules to change")
    parser.add_argument("--tests", nargs="+", required=True, help="what must notice")
    parser.add_argument("--sample", type=int, default=0, help="mutants of all files together (0: all)")
    parser.add_argument("--seed", type=int, default=0, help="seed of the sample")
    parser.add_argument("--most", type=float, default=math.inf, help="seconds of tests for a mutant")
    options = parser.parse_args()
    os.chdir(ROOT)
    sys.path.insert(0, str(ROOT))
    paths = [p.resolve() for p in options.files]
    made = [(path, m) for path in paths for m in mutants(path.read_text())]
    if 0 < options.sample < len(made):
        chosen = random.Random(options.seed).sample(range(len(made)), options.sample)
        made = [made[k] for k in sorted(chosen)]
    known = baseline(paths, options.tests)
    for name in known["modules"]:  # what all share is imported once, before the forks
        if name.partition(".")[0] in ("numpy", "scipy", "pinocchio", "hypothesis", "clarabel"):
            with suppress(Exception):
                importlib.import_module(name)
    left: Counter[Path] = Counter()
    for path, m in made:
        tests, whole = tests_for(path, m, known, options.most)
        if survives(path, m, tests, known["seconds"]):
            left[path] += 1
            text = path.read_text().splitlines()[m.line - 1].strip()
            met = "" if whole else f"  [met {len(tests)} tests only]"
            print(f"  {path.name} {m.line}: {m.word}: {text}{met}", flush=True)
    for path, count in Counter(path for path, _ in made).items():
        print(f"{path.relative_to(ROOT)}: {left[path]} of {count} survive")
    print(f"{left.total()} of {len(made)} survive")


if __name__ == "__main__":
    main()
