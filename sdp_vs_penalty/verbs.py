"""The verbs of the API as a person meets them: misspelt keywords are named, defaults shown by name."""

from __future__ import annotations

import difflib
import functools
import inspect
from collections.abc import Callable
from typing import Any


class _Shown:
    """A default value as help() shows it: by its name, not its address."""

    def __init__(self, value: Any) -> None:
        self.name = getattr(value, "__name__", type(value).__name__)

    def __repr__(self) -> str:
        return str(self.name)


def with_suggestions(verb: Callable[..., Any]) -> Callable[..., Any]:
    """The same function, whose TypeError for an unknown keyword names the nearest one, and whose
    signature shows defaults by their names."""
    known = inspect.signature(verb)

    @functools.wraps(verb)
    def call(*given: Any, **named: Any) -> Any:
        for word in named.keys() - known.parameters.keys():
            near = difflib.get_close_matches(word, known.parameters, 1, 0.5)
            there = f"did you mean {near[0]!r}?" if near else f"it has {', '.join(known.parameters)}"
            raise TypeError(f"{verb.__name__}() has no argument {word!r}: {there}")
        return verb(*given, **named)

    shown = (
        p.replace(default=_Shown(p.default)) if " at 0x" in repr(p.default) else p
        for p in known.parameters.values()
    )
    call.__signature__ = known.replace(parameters=list(shown))  # type: ignore[attr-defined]
    return call
