"""Physics engines, one file each; :func:`engine_types` finds them, present or absent."""

from __future__ import annotations

from functools import cache

from sdp_vs_penalty.errors import InputError, unknown
from sdp_vs_penalty.registration import classes
from sdp_vs_penalty.simulation.engines.engine import Engine


@cache
def engine_types() -> dict[str, type[Engine]]:
    """Every engine that this package knows, by name; ``version()`` says whether it is at hand."""
    return classes(__name__, __path__, Engine)


def engine(name: str) -> type[Engine]:
    """An engine that is at hand. Raises InputError where it is unknown or absent."""
    kinds = engine_types()
    if name not in kinds:
        raise unknown("engine", name, kinds)
    if kinds[name].version() is None:
        raise InputError(f"engine {name} is absent", kinds[name].install)
    return kinds[name]
