"""Friction that falls as motion sets in."""

import numpy as np

from sdp_vs_penalty.effects.effect import Array, JointEffect, Motion
from sdp_vs_penalty.effects.shape import VELOCITY, Shape


class StribeckFriction(JointEffect):
    name = "stribeck_friction"
    equation = "f_st sign(dq) exp(-(|dq| / vs)^delta)"
    explanation = (
        "At low speed the surfaces touch; as speed rises a lubricant film lifts them apart and the "
        "friction falls by f_st towards its Coulomb level, within about the Stribeck velocity vs."
    )
    reference = "Armstrong-Helouvry, Dupont, Canudas de Wit, Automatica 1994, eq. 7"
    symbol = "f_st"
    lower = 0.0
    refines = ("coulomb_friction",)
    beyond_turning = "vs"
    shapes = {
        "vs": Shape(0.1, VELOCITY, grid=(0.02, 0.04, 0.08, 0.16, 0.32), bounds=(0.012, 1.0)),
        "delta": Shape(2.0, grid=(1.0, 2.0)),
    }

    def column(self, motion: Motion, joint: int) -> Array:
        dq = motion.dq[:, joint]
        return motion.sign(joint) * np.exp(-((np.abs(dq) / self.shape["vs"]) ** self.shape["delta"]))
