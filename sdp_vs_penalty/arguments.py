"""Arguments of the public verbs, checked by the types that their signatures state."""

import ast
import inspect
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import wraps
from math import isnan
from numbers import Integral, Real
from typing import Any, ParamSpec, TypeVar

from sdp_vs_penalty.errors import InputError, quote_value

P = ParamSpec("P")
T = TypeVar("T")

#: Arrays count with 63 bits: no whole number of ours is larger.
_LARGEST = 2**63
#: Names in signatures that stand for types which the verb itself checks.
_ALIASES = {"Any", "Estimate", "Models", "Problem", "Progress", "Source"}
_ALIASES |= {"_empty"}
_IN_WORDS = {
    "int": "a whole number",
    "float": "a number",
    "bool": "True or False",
    "str": "a text",
    "Drive": "a text",
    "Array": "an array of numbers",
    "Path": "a path",
    "Sequence": "a list",
    "Mapping": "a mapping",
}


def require_in_range(where: str, value: float, low: float, high: float) -> None:
    """Raise InputError unless a number of a verb is from ``low`` to ``high``."""
    if not low <= value <= high:
        what = f"{where.rstrip(')')}={value:g})"
        raise InputError(what, f"give a number from {low:g} to {high:g}")


def checked_arguments(verb: Callable[P, T]) -> Callable[P, T]:
    """Decorate a verb: an argument that is not of the type that its signature states
    raises InputError, and is no error of Python's behind it.

    NaN is no number, and a seed is not below 0. What lists and mappings may hold the
    verb itself says.
    """
    signature = inspect.signature(verb)
    types = {
        name: _parsed(parameter.annotation)
        for name, parameter in signature.parameters.items()
    }

    @wraps(verb)
    def checked(*args: P.args, **kwargs: P.kwargs) -> T:
        bound = signature.bind(*args, **kwargs)
        for name, value in bound.arguments.items():
            parameter = signature.parameters[name]
            is_several = parameter.kind is inspect.Parameter.VAR_POSITIONAL
            for one in value if is_several else [value]:
                if one is parameter.default:
                    continue
                is_nan = isinstance(one, float) and isnan(one)
                remedy = None
                if is_nan or not _is_of(types[name], one):
                    remedy = f"give {_in_words(types[name])}"
                elif name == "seed" and one < 0:
                    remedy = "give a whole number from 0"
                if remedy is not None:
                    where = f"{verb.__name__}({name}={quote_value(one)})"
                    raise InputError(where, remedy)
        return verb(*args, **kwargs)

    return checked


def _parsed(annotation: Any) -> ast.expr:
    """Return the syntax of an annotation, whether it is a text or a type."""
    text = annotation.__name__ if isinstance(annotation, type) else str(annotation)
    return ast.parse(text, mode="eval").body


def _name(kind: ast.expr) -> str:
    """Return the bare name of a type, without its module."""
    return ast.unparse(kind).split(".")[-1]


def _is_of(kind: ast.expr, value: Any) -> bool:
    """Return whether a value is of a type, given as syntax."""
    match kind:
        case ast.BinOp(left=left, op=ast.BitOr(), right=right):
            return _is_of(left, value) or _is_of(right, value)
        case ast.Constant(value=None):
            return value is None
        case ast.Subscript(value=outer, slice=ast.Tuple(elts=inner)):
            return _is_container_of(_name(outer), inner, value)
        case ast.Subscript(value=outer, slice=inner):
            return _is_container_of(_name(outer), [inner], value)
    return _is_single(_name(kind), value)


def _is_container_of(name: str, inner: Sequence[ast.expr], value: Any) -> bool:
    """Return whether a value is a Sequence, Mapping or tuple whose items are of the inner
    types; a callable is taken as it is."""
    if name == "Sequence":
        is_text = isinstance(value, str | bytes | Mapping)
        is_list = isinstance(value, Iterable) and not is_text
        return is_list and all(_is_of(inner[0], x) for x in value)
    if name == "Mapping":
        key, item = inner
        return isinstance(value, Mapping) and all(
            _is_of(key, k) and _is_of(item, x) for k, x in value.items()
        )
    if name == "tuple":
        is_tuple = isinstance(value, tuple | list) and len(value) == len(inner)
        return is_tuple and all(map(_is_of, inner, value))
    return True


def _is_single(name: str, value: Any) -> bool:
    """Return whether a value is of a type without items, given by its name."""
    if name == "Drive":  # texts
        return isinstance(value, str)
    if name == "Array":
        return getattr(getattr(value, "dtype", None), "kind", "") in tuple("fiu")
    if name == "float":
        return _is_number(value)
    if name == "int":
        is_whole = isinstance(value, Integral) and not isinstance(value, bool)
        return is_whole and abs(int(value)) < _LARGEST
    if name == "bool":
        return isinstance(value, bool) or type(value).__name__ == "bool_"
    return name in _ALIASES or any(x.__name__ == name for x in type(value).__mro__)


def _is_number(value: Any) -> bool:
    """Return whether a value is a number that a double holds."""
    if not isinstance(value, Real) or isinstance(value, bool):
        return False
    try:
        float(value)
    except OverflowError:  # a whole number beyond the doubles
        return False
    return True


def _in_words(kind: ast.expr) -> str:
    """Write a type in words, "Sequence[str] | None" as "a list of text or None"."""
    match kind:
        case ast.BinOp(left=left, op=ast.BitOr(), right=right):
            return f"{_in_words(left)} or {_in_words(right)}"
        case ast.Subscript(value=outer):
            return _IN_WORDS.get(_name(outer), ast.unparse(kind))
    name = _name(kind)
    return name if name == "None" else _IN_WORDS.get(name, f"a {name}")
