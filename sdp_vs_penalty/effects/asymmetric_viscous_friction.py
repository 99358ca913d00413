"""Viscous friction that differs by direction."""

import numpy as np

from sdp_vs_penalty.effects.effect import Array, JointEffect, Motion


class AsymmetricViscousFriction(JointEffect):
    name = "asymmetric_viscous_friction"
    equation = "f_va |dq|"
    explanation = (
        "Viscous friction with different slopes in the two directions: f_v + f_va forwards, f_v - "
        "f_va backwards. Typical of seals and preloaded gears."
    )
    reference = "Armstrong-Helouvry, Dupont, Canudas de Wit, Automatica 1994, sec. 2"
    symbol = "f_va"
    units = ("N*m*s/rad", "N*s/m")
    refines = ("viscous_friction",)

    def column(self, motion: Motion, joint: int) -> Array:
        return np.abs(motion.dq[:, joint])
