"""Viscous friction that differs by direction."""

from __future__ import annotations

import numpy as np

from sdp_vs_penalty.effects.effect import Array, JointEffect, Motion


class AsymmetricViscousFriction(JointEffect):
    name = "asymmetric_viscous_friction"
    equation = "f_va |dq|"
    explanation = (
        "Viscous friction with another slope forwards than backwards: f_v + f_va one way, f_v - f_va "
        "the other. Seals and preloaded gears do this. (Coulomb friction that differs by direction is "
        "exactly Coulomb plus offset and needs no effect of its own.)"
    )
    reference = "Armstrong-Helouvry, Dupont, Canudas de Wit, Automatica 1994, sec. 2"
    symbol = "f_va"
    units = ("N*m*s/rad", "N*s/m")
    refines = ("viscous_friction",)

    def column(self, motion: Motion, joint: int) -> Array:
        return np.abs(motion.dq[:, joint])
