"""Physics engines, one file each; :func:`engine_types` finds them, present or absent."""

from functools import cache

from sdp_vs_penalty.plugins import classes
from sdp_vs_penalty.simulation.engines.engine import Engine


@cache
def engine_types() -> dict[str, type[Engine]]:
    """Return the class of every physics engine by name; ``version()`` tells whether it
    is installed.
    """
    return classes(__name__, __path__, Engine)
