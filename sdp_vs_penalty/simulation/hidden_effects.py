"""What can be hidden in simulated measurements: the effects whose files say how.

What is hidden is kept in a truth that only a scorer reads.
"""

from __future__ import annotations

import sys

import numpy as np

from sdp_vs_penalty.effects import effect_types
from sdp_vs_penalty.effects.hidden import Hidden, Maker, World
from sdp_vs_penalty.errors import InputError

#: Root mean square of the hidden torque over the raw noise of the joint that it moves most.
LEVELS = {"strong": 2.0, "medium": 0.5, "weak": 0.125}


def makers() -> dict[str, Maker]:
    """By the effect's name the function ``hidden`` beside its class, for those that have one."""
    homes = {name: vars(sys.modules[kind.__module__]) for name, kind in effect_types().items()}
    return {name: home["hidden"] for name, home in sorted(homes.items()) if "hidden" in home}


def make_hidden(effect: str, joint: int, world: World, rng: np.random.Generator) -> Hidden:
    """A hidden effect of the library with random shape constants, of size 1 (to be scaled).

    joint : from 0; ignored by effects of the whole robot. Raises InputError for an effect that has
    no simulation, or that cannot act on this joint.
    """
    known = makers()
    if effect not in known:
        raise InputError(f"effect {effect!r} cannot be hidden", f"choose from {', '.join(known)}")
    return known[effect](joint, world, rng)


def hideable() -> tuple[str, ...]:
    """Names of the effects that can be hidden."""
    return tuple(makers())
