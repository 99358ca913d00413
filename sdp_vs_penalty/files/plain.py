"""Frozen dataclasses as plain JSON, there and back, by the types of their fields."""

import collections.abc
import types
from collections.abc import Mapping
from dataclasses import MISSING, fields
from functools import cache
from typing import Any, Literal, Self, get_args, get_origin, get_type_hints

import numpy as np


class Plain:
    """A dataclass of numbers, texts, arrays, other ``Plain`` ones, and tuples and mappings of these."""

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON; null where a number is not finite."""
        return {f.name: _plain(getattr(self, f.name)) for f in fields(self)}  # type: ignore[arg-type]

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Self:
        """What :meth:`to_dict` wrote; null stands for the field's default, where it has one. Raises
        KeyError, TypeError or ValueError for a field that is missing or of another kind."""
        kinds = _kinds(cls)  # type: ignore[arg-type]
        required = [f for f in fields(cls) if f.default is MISSING and f.default_factory is MISSING]  # type: ignore[arg-type]
        there = {f.name for f in required} | {k for k in kinds if data.get(k) is not None}
        return cls(**{name: _restored(kinds[name], data[name]) for name in there})


@cache
def _kinds(cls: type) -> dict[str, Any]:
    """The types of a class's fields, which cost more to look up than a field to read."""
    return get_type_hints(cls)


def _plain(value: Any) -> Any:
    if hasattr(value, "to_dict"):
        return value.to_dict()
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, Mapping):
        return dict(value)
    if isinstance(value, float) and not np.isfinite(value):
        return None
    return [_plain(x) for x in value] if isinstance(value, tuple) else value


def _restored(kind: Any, value: Any) -> Any:
    """A value of a type hint; an absent one may be None."""
    origin, args = get_origin(kind), get_args(kind)
    if origin is types.UnionType:
        return None if value is None else _restored(args[0], value)
    if origin is np.ndarray:
        return np.array(value, float)
    if origin is collections.abc.Mapping:
        return {str(key): _restored(args[1], x) for key, x in value.items()}
    if origin is tuple:
        if isinstance(value, str):
            raise TypeError(f"{value!r} is no list")
        every = args[:1] * len(value) if args[-1] is Ellipsis else args
        return tuple(_restored(a, x) for a, x in zip(every, value, strict=True))
    if origin is Literal:
        if value not in args:
            raise ValueError(f"{value!r} is none of {', '.join(args)}")
        return value
    if kind in (str, bool) and not isinstance(value, kind):
        raise TypeError(f"{value!r} is no {kind.__name__}")
    return kind.from_dict(value) if hasattr(kind, "from_dict") else kind(value)
