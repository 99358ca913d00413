"""A verb as a command: the files that it was given are protected before it runs."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from typer.core import TyperCommand

from sdp_vs_penalty.files import opened

#: Parameters that name what a verb writes.
OUTPUTS = frozenset({"out", "json_file", "fix", "proof"})


class VerbCommand(TyperCommand):
    """Every path among the parsed parameters that is not an output is an input."""

    def invoke(self, ctx: Any) -> Any:
        for name, value in ctx.params.items():
            if name not in OUTPUTS:
                for path in _paths(value):
                    opened(path)
        return super().invoke(ctx)


def _paths(value: Any) -> Iterable[Path]:
    """Paths, and texts that may be one (a problem is a name or a file)."""
    if isinstance(value, Path):
        return [value]
    if isinstance(value, str):
        return [Path(value)] if 0 < len(value) < 4096 and "\0" not in value else []
    return [p for v in value for p in _paths(v)] if isinstance(value, list | tuple) else []
