"""Hidden effects: measurements in which a physical effect is at work that the model does not know.

Each effect is simulated by another route than the library's columns where there is one: tilted
gravity and loads in Newton-Euler, a channel that truly reads the past, a friction state integrated
in time, a link beside where the encoder says, an encoder whose zero is off. What is hidden is kept
in a truth that only a scorer reads.
"""

from __future__ import annotations

import numpy as np

from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.simulation.hidden_effects.channels import CHANNELS
from sdp_vs_penalty.simulation.hidden_effects.drift import DRIFT
from sdp_vs_penalty.simulation.hidden_effects.friction import FRICTION, lugre
from sdp_vs_penalty.simulation.hidden_effects.geometry import GEOMETRY, wrench_torque
from sdp_vs_penalty.simulation.hidden_effects.hidden import LEVELS, Hidden, Maker, World, on_joint

__all__ = [
    "LEVELS",
    "Hidden",
    "World",
    "hideable",
    "lugre",
    "make_hidden",
    "on_joint",
    "wrench_torque",
]

_MAKERS: dict[str, Maker] = {**FRICTION, **CHANNELS, **DRIFT, **GEOMETRY}


def make_hidden(effect: str, joint: int, world: World, rng: np.random.Generator) -> Hidden:
    """A hidden effect of the library with random shape constants, of size 1 (to be scaled).

    joint : from 0; ignored by effects of the whole robot. Raises InputError for an effect that has
    no simulation, or that cannot act on this joint.
    """
    if effect not in _MAKERS:
        known = ", ".join(sorted(_MAKERS))
        raise InputError(f"effect {effect!r} cannot be hidden; there are: {known}.")
    return _MAKERS[effect](joint, world, rng)


def hideable() -> tuple[str, ...]:
    """Names of the effects that can be hidden."""
    return tuple(sorted(_MAKERS))
