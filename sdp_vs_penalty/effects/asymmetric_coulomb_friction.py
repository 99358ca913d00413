"""Dry friction that differs by direction."""

import numpy as np

from sdp_vs_penalty.effects.effect import Array, JointEffect, Motion


class AsymmetricCoulombFriction(JointEffect):
    name = "asymmetric_coulomb_friction"
    equation = "f_ca |tanh(dq / v_s)|"
    explanation = (
        "Dry friction of different size in the two directions: f_c + f_ca forwards, f_c - f_ca "
        "backwards. Where it turns round at once that is Coulomb friction and an offset; over a wide "
        "velocity v_s both vanish together near standstill, where an offset does not."
    )
    reference = "Armstrong-Helouvry, Dupont, Canudas de Wit, Automatica 1994, sec. 2"
    symbol = "f_ca"
    #: Beside an offset it shows only where friction turns round, which is what laws with a memory bend.
    refines = ("coulomb_friction", "presliding_hysteresis", "stiction")

    def column(self, motion: Motion, joint: int) -> Array:
        return np.abs(motion.sign(joint))
