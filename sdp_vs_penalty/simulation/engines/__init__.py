"""Physics engines, one file each; :func:`engine_types` finds them, present or absent."""

from sdp_vs_penalty.plugins import Registry
from sdp_vs_penalty.simulation.engines.engine import Engine

#: The class of every physics engine by name; ``version()`` tells whether it is installed.
engine_types = Registry[type[Engine]]("engine", __name__, Engine).all
