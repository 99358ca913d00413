"""Words of the command line to plain values, without the validation library that Typer would load.

Typer converts each value by pydantic, whose import takes a tenth of a second, even of options that are
not given. Texts, numbers and paths need none of it; for all else Typer's own way is taken.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, get_args, get_origin

import typer

_NUMBERS: dict[type, str] = {int: "a whole number", float: "a number"}
_PLAIN = (str, Path, *_NUMBERS)


class Plain:
    """What converts one parameter that Typer describes."""

    def __init__(self, described: Any) -> None:
        self.described, kind = described, described.annotation
        self.several = get_origin(kind) is list
        self.kind = get_args(kind)[0] if self.several else kind

    def coerce(self, value: Any, param: Any, ctx: Any) -> Any:
        """The value of a parameter from its words; raises typer.BadParameter."""
        if value is None:
            return () if param.multiple or param.nargs == -1 else None
        if self.kind not in _PLAIN:
            from typer._coercion import build_runtime_param

            return build_runtime_param(self.described).coerce(value, param=param, ctx=ctx)
        try:
            made = [self.kind(x) for x in value] if self.several else self.kind(value)
        except ValueError:
            raise typer.BadParameter(f"{_NUMBERS[self.kind]} is needed", ctx=ctx, param=param) from None
        low, high = self.described.parameter_info.min, self.described.parameter_info.max
        if low is not None and not made >= low:
            raise typer.BadParameter(f"it must be at least {low:g}", ctx=ctx, param=param)
        if high is not None and not made <= high:
            raise typer.BadParameter(f"it must be at most {high:g}", ctx=ctx, param=param)
        return made


def lightened(param: Any) -> Any:
    """The parameter of a command, converted so where this Typer lets it be."""
    described = getattr(param, "type_descriptor", None)
    if described is None or getattr(param, "_runtime_param", described) is not None:
        return param
    if described.parameter_info.parser is None and not described.is_file:
        param._runtime_param = Plain(described)
    return param
