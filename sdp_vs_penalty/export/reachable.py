"""What of some source code its end can reach, written without the words for readers."""

from __future__ import annotations

import ast
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

#: Methods that Python itself calls where there is an object.
_SPECIAL = frozenset({"__call__", "__getattr__", "__eq__", "__hash__"})


def needed(sources: Sequence[str], end: str, known: Collection[str] = ()) -> tuple[str, set[str]]:
    """Those definitions of ``sources`` that the code ``end`` may use, and every name that they load.

    A definition stays where code that stays loads its name; a method or constant of a class where that
    code loads the attribute, of ``self`` in a class of the same family or of anything else; ``__init__``
    where its class is called. known : "Class.member", or ".member" of all classes, of what is given from
    outside or not asked for.
    """
    tree = _Bare().visit(ast.parse("\n".join(sources)))
    kinds = {part.name: part for part in tree.body if isinstance(part, ast.ClassDef)}
    family = {name: _family(name, kinds) for name in kinds}
    for kind in kinds.values():
        kind.body = [m for m in kind.body if not _member(kind, m) & {*known, "abstract"}]
    parts = [part for statement in tree.body for part in _parts(statement)]
    for part in parts:
        part.loads = set(_loaded(part.code, part.kind, family))
    reached, new = set[str](), set(_loaded([ast.parse(end)], "", family))
    while new - reached:
        reached |= new
        new = {name for part in parts if part.names & reached for name in part.loads}
    kept = [s for s in tree.body if next(iter(_parts(s))).names & reached]
    for kind in (s for s in kept if isinstance(s, ast.ClassDef)):
        kind.body = [m for m in kind.body if _member(kind, m) & reached] or [ast.Pass()]
    text = ""
    for statement in kept:
        gap = "\n" if isinstance(statement, ast.Assign) else "\n\n\n"
        text += gap + ast.unparse(ast.fix_missing_locations(statement))
    return text.strip(), reached


def names(source: str) -> list[str]:
    """Names that code loads when it runs; not those of annotations."""
    walked = ast.walk(_Bare().visit(ast.parse(source)))
    found = (n.id for n in walked if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Load))
    return list(dict.fromkeys(found))


@dataclass
class _Part:
    """Some code, the names by which it is reached, and the class that it is in."""

    names: set[str]
    code: list[ast.AST]
    kind: str = ""
    loads: set[str] = field(default_factory=set)


def _parts(statement: ast.stmt) -> Iterator[_Part]:
    """A definition of the file, and the members of a class."""
    if isinstance(statement, ast.ClassDef):
        yield _Part({statement.name}, [*statement.bases, *statement.decorator_list])
        for member in statement.body:
            yield _Part(_member(statement, member), [member], statement.name)
    elif isinstance(statement, ast.Assign):
        (target,) = statement.targets
        name = f".{target.attr}" if isinstance(target, ast.Attribute) else ast.unparse(target)
        yield _Part({name}, [statement.value])
    else:
        yield _Part({getattr(statement, "name", "")}, [statement])


def _member(kind: ast.ClassDef, member: ast.stmt) -> set[str]:
    """Names by which a member of a class is reached; a dataclass's fields with their class."""
    names = [ast.unparse(t) for t in member.targets] if isinstance(member, ast.Assign) else []
    if isinstance(member, ast.FunctionDef):
        if "abstractmethod" in map(ast.unparse, member.decorator_list):
            return {"abstract"}
        names = [member.name]
    elif isinstance(member, ast.AnnAssign):
        names = [ast.unparse(member.target)]
        if any("dataclass" in ast.unparse(d) for d in kind.decorator_list):
            return {kind.name}
        if member.value is None:
            return set()
    return (
        {kind.name}
        if set(names) & _SPECIAL
        else {f"{x}{n}" for n in names for x in (".", kind.name + ".")}
    )


def _loaded(code: Iterable[ast.AST], kind: str, family: Mapping[str, set[str]]) -> Iterator[str]:
    """Names that code of a class loads: "name", ".attribute", "Class.attribute"; calls as __init__."""
    nodes = [node for whole in code for node in ast.walk(whole)]
    local = {n.arg for n in nodes if isinstance(n, ast.arg)}
    local |= {n.id for n in nodes if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store)}
    for node in nodes:
        if isinstance(node, ast.Name) and (not kind or node.id not in local):
            yield node.id
        elif isinstance(node, ast.Attribute):
            own = kind and ast.unparse(node.value) in ("self", "cls", "super()")
            yield from (f"{x}.{node.attr}" for x in (family[kind] if own else ("",)))
        if isinstance(node, ast.Call):
            made = ast.unparse(node.func)
            of = family.get(kind if made in ("cls", "type(self)") else made, ())
            yield from (f"{x}.__init__" for x in of)


def _family(name: str, kinds: Mapping[str, ast.ClassDef]) -> set[str]:
    """A class, those that it is made of, and those made of it."""

    def above(kind: str) -> set[str]:
        bases = [ast.unparse(b) for b in kinds[kind].bases] if kind in kinds else []
        return {kind}.union(*map(above, bases))

    return above(name) | {k for k in kinds if name in above(k)}


class _Bare(ast.NodeTransformer):
    """Takes docstrings away, and annotations; those of a class's fields become texts."""

    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.AST:
        node.returns = None
        every = node.args
        for argument in (*every.posonlyargs, *every.args, *every.kwonlyargs, every.vararg, every.kwarg):
            if argument is not None:
                argument.annotation = None
        self.generic_visit(node)
        node.body = [_assigned(s) for s in node.body if not _is_text(s)] or [ast.Pass()]
        return node

    def visit_ClassDef(self, node: ast.ClassDef) -> ast.AST:
        self.generic_visit(node)
        node.body = [s for s in node.body if not _is_text(s)]
        for part in (s for s in node.body if isinstance(s, ast.AnnAssign)):
            part.annotation = ast.Constant(ast.unparse(part.annotation))
        return node


def _is_text(statement: ast.stmt) -> bool:
    return isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Constant)


def _assigned(statement: ast.stmt) -> ast.stmt:
    if isinstance(statement, ast.AnnAssign) and statement.value is not None:
        return ast.Assign([statement.target], statement.value)
    return statement
