"""Options of the command line as fields of the page: made from its verbs, not listed again."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, get_args

from sdp_vs_penalty.errors import InputError


@dataclass(frozen=True)
class FormField:
    """An option of a verb: its parameter's name, flag, help, an example of a value, and what it is."""

    name: str
    flag: str
    help: str
    example: str
    kind: type


def fields_of(verb: Callable[..., Any], *names: str) -> tuple[FormField, ...]:
    """Options of a verb by the names of its parameters, as typer reads them from its signature."""
    parameters = inspect.signature(verb).parameters
    out = []
    for name in names:
        kind, option = get_args(parameters[name].annotation)[:2]
        flags = [word for word in option.param_decls or () if word.startswith("--")]
        default = parameters[name].default
        told = option.metavar or ("" if default is None or kind is bool else str(default))
        of = next((k for k in (bool, int, float) if kind is k or k in get_args(kind)), str)
        flag = flags[0].partition("/")[0] if flags else f"--{name.replace('_', '-')}"
        said = (option.help or "").replace("`", "")
        out.append(FormField(name, flag, said, told, of))
    return tuple(out)


def words(fields: tuple[FormField, ...], values: Mapping[str, str]) -> list[str]:
    """The same on the command line."""
    out = []
    for f in fields:
        if f.name in values:
            out += [f.flag] if f.kind is bool else [f.flag, values[f.name]]
    return out


def number(values: Mapping[str, str], name: str, default: float) -> float:
    """A number that was written in a field. Raises InputError for another text."""
    try:
        return float(values[name]) if name in values else default
    except ValueError:
        raise InputError(f"{name.replace('_', ' ')} {values[name]!r}", "write a number") from None
