"""The verb list: the names that the other verbs take."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated

import typer


class Kind(StrEnum):
    """What can be listed."""

    problems = "problems"
    effects = "effects"
    methods = "methods"
    solvers = "solvers"
    tables = "tables"
    datasets = "datasets"
    engines = "engines"


def verb(
    what: Annotated[Kind, typer.Argument(help="Kind of names to list.")],
    name: Annotated[str | None, typer.Argument(help="One name, for all about it.")] = None,
) -> None:
    """List the names that the other verbs take, or say all about one of them.

    Example: sdp-vs-penalty list effects presliding_hysteresis
    """
    from sdp_vs_penalty.cli import console, registry

    if name is not None:
        console.details(*registry.details(what.value, name))
        return
    whole = registry.listing(what.value)
    headings, rows = registry.short(what.value, whole)
    console.listing(headings, rows)
    if len(headings) < len(whole[0]):
        console.say(f"All about one of them: sdp-vs-penalty list {what.value} {rows[0][0]}")
