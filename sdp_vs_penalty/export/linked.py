"""Source code of whatever some code needs of this package, as a file that needs nothing but NumPy.

Kept are functions whole, and of a class those members whose name is read as an attribute somewhere in
what is kept. Docstrings and annotations are left out.
"""

from __future__ import annotations

import ast
import inspect
import sys
import textwrap
from collections.abc import Collection, Mapping
from copy import copy
from types import ModuleType
from typing import Any

import numpy as np

from sdp_vs_penalty.errors import InputError

_PACKAGE = "sdp_vs_penalty"
#: Methods that Python itself calls.
_SPECIAL = frozenset({"__call__", "__getattr__", "__eq__", "__hash__"})
#: What the fields of a dataclass are said to be.
_FIELD = ast.Name("object", ast.Load())


def linked(
    end: str, known: Mapping[str, Any], stand_ins: Mapping[Any, Any], without: Collection[str] = ()
) -> tuple[str, str]:
    """Imports and definitions that the code ``end`` needs, whose names mean what they do in ``known``.

    stand_ins : what to write in place of a class of the package; without : methods that nothing asks
    for, though something else of their name is read.

    Raises InputError for what is not plain NumPy, and for a name that means two things.
    """
    found = _Found(stand_ins, without)
    found.follow(ast.parse(end), known)
    size = -1
    while size != (size := len(found.read) + len(found.things)):
        for name, thing in list(found.things.items()):
            found.follow(found.kept(name), vars(sys.modules[thing.__module__]))
    definitions = [ast.unparse(ast.fix_missing_locations(found.kept(name))) for name in found.order()]
    parts = ["\n".join(found.constants), *definitions, "\n".join(found.others)]
    return "\n".join(sorted(found.imports)), "\n\n\n".join(filter(None, parts))


def literal(value: Any) -> str:
    """How a value is written in the file."""
    if isinstance(value, tuple) and any(isinstance(x, np.ndarray) for x in value):
        return f"[{', '.join(map(literal, value))}]"
    if not isinstance(value, np.ndarray):
        return repr(value)
    return f"np.array({value.tolist()!r}, {'int' if value.dtype.kind == 'i' else 'float'})"


class _Found:
    """What is needed so far."""

    def __init__(self, stand_ins: Mapping[Any, Any], without: Collection[str]) -> None:
        self.things: dict[str, Any] = {}  # classes and functions of the package
        self.read: set[str] = set()  # attributes, and "name()" of what is called
        self.imports: set[str] = set()
        self.constants: dict[str, None] = {}  # lines, in the order in which they were found
        self.others: dict[str, None] = {}  # lines that give things a second name
        self._stand_ins, self._without = stand_ins, without
        self._trees: dict[str, ast.stmt] = {}
        self._meanings: dict[str, str] = {}

    def follow(self, tree: ast.AST, home: Mapping[str, Any]) -> None:
        """Find what code needs, whose names mean what they do in ``home``."""
        if isinstance(tree, ast.Module | ast.ClassDef):
            heads = () if isinstance(tree, ast.Module) else (*tree.bases, *tree.decorator_list)
            for part in (*heads, *tree.body):
                self.follow(part, home)
            return
        nodes = list(ast.walk(tree))
        own = {n.arg for n in nodes if isinstance(n, ast.arg)}
        own |= {n.id for n in nodes if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store)}
        for node in nodes:
            if isinstance(node, ast.Call):
                self.read.add(f"{ast.unparse(node.func)}()")
            elif isinstance(node, ast.Name) and node.id in home.keys() - own:
                self._need(node.id, home[node.id])
            elif isinstance(node, ast.Attribute):
                self.read.add(node.attr)
                self._need_of_module(ast.unparse(node.value), node.attr, home)

    def kept(self, name: str) -> ast.stmt:
        """What is needed of a function or class."""
        if name not in self._trees:
            source = textwrap.dedent(inspect.getsource(self.things[name]))
            self._trees[name] = _Bare().visit(ast.parse(source)).body[0]
        tree = copy(self._trees[name])
        if isinstance(tree, ast.ClassDef):
            needed = self.read.difference(self._without) | _SPECIAL
            needed |= {"__init__"} if f"{name}()" in needed else set()
            tree.body = [m for m in tree.body if _names(m) & needed] or [ast.Pass()]
        return tree

    def order(self) -> list[str]:
        """Functions, then classes, each behind those that its own definition reads."""
        trees = {name: self.kept(name) for name in self.things}
        out = [name for name, tree in trees.items() if not isinstance(tree, ast.ClassDef)]

        def place(name: str) -> None:
            for part in ast.iter_child_nodes(trees[name]):
                nodes = () if isinstance(part, ast.FunctionDef) else ast.walk(part)
                for used in dict.fromkeys(n.id for n in nodes if isinstance(n, ast.Name)):
                    if used in trees.keys() - {*out}:
                        place(used)
            out.append(name)

        for name in trees:
            if name not in out:
                place(name)
        return out

    def _need(self, name: str, value: Any) -> None:
        if callable(value):
            value = inspect.unwrap(value)  # a cached one
            value = self._stand_ins.get(value, value)
        own = getattr(value, "__name__", "")
        home = own if isinstance(value, ModuleType) else getattr(value, "__module__", None) or "builtins"
        top = home.partition(".")[0]
        line = f"import {own} as {name}" if home == own else f"from {home} import {own} as {name}"
        if isinstance(value, np.ndarray | bool | int | float | str | tuple | None):
            line = f"{name} = {literal(value)}"
            self.constants[line] = None
        elif own and top in ("numpy", *sys.stdlib_module_names):
            self.imports.add(line)
        elif own and top == _PACKAGE:
            if not isinstance(value, ModuleType):
                self.things[own] = value
                self.others |= {} if own == name else {f"{name} = {own}": None}
        else:
            raise InputError(
                f"{name} ({home}) is needed by an effect of this model, not plain NumPy",
                "export it as .json",
            )
        if self._meanings.setdefault(name, line) != line:
            raise InputError(
                f"{name} is the name of two things: the model cannot be written as one file",
                "rename one of them",
            )

    def _need_of_module(self, module: str, name: str, home: Mapping[str, Any]) -> None:
        """``module.name`` of a module of the package, which becomes a namespace."""
        value = home.get(module)
        if isinstance(value, ModuleType) and value.__name__.startswith(_PACKAGE):
            self._need(name, getattr(value, name))
            self.imports.add("from types import SimpleNamespace as SimpleNamespace")
            self.others |= {f"{module} = SimpleNamespace()": None, f"{module}.{name} = {name}": None}


class _Bare(ast.NodeTransformer):
    """Takes away docstrings, abstract methods and annotations, but that a dataclass has fields."""

    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.AST | None:
        if "abstractmethod" in map(ast.unparse, node.decorator_list):
            return None
        self.generic_visit(node)
        node.returns = None
        node.body = [s for s in node.body if not _is_text(s)] or [ast.Pass()]
        return node

    def visit_arg(self, node: ast.arg) -> ast.AST:
        node.annotation = None
        return node

    def visit_AnnAssign(self, node: ast.AnnAssign) -> ast.AST | None:
        if node.annotation is _FIELD:
            return node
        return node.value and ast.Assign([node.target], node.value)

    def visit_ClassDef(self, node: ast.ClassDef) -> ast.AST:
        if any("dataclass" in ast.unparse(d) for d in node.decorator_list):
            for field in (s for s in node.body if isinstance(s, ast.AnnAssign)):
                if "ClassVar" not in ast.unparse(field.annotation):
                    field.annotation = _FIELD
        self.generic_visit(node)
        node.body = [s for s in node.body if not _is_text(s)]
        return node


def _names(member: ast.stmt) -> set[str]:
    """By which a member of a class is needed; a dataclass's fields always are."""
    if isinstance(member, ast.FunctionDef):
        return {member.name}
    return {ast.unparse(t) for t in member.targets} if isinstance(member, ast.Assign) else {"__call__"}


def _is_text(statement: ast.stmt) -> bool:
    return isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Constant)
