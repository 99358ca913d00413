"""Dry friction."""

from __future__ import annotations

import numpy as np

from sdp_vs_penalty.effects.effect import SIGN_WIDTH, Array, JointEffect, Motion, smooth_sign
from sdp_vs_penalty.effects.hidden import Hidden, World, one_joint
from sdp_vs_penalty.effects.shape import VELOCITY, Shape


class CoulombFriction(JointEffect):
    name = "coulomb_friction"
    equation = "f_c tanh(dq / v_s)"
    explanation = (
        "Dry contact: a torque of fixed size against the direction of motion. The sign is smoothed "
        "over v_s, because the sign of a measured velocity near zero is noise. Together with "
        "torque_offset it also covers a Coulomb friction that differs by direction."
    )
    reference = "Armstrong-Helouvry, Dupont, Canudas de Wit, Automatica 1994, sec. 2"
    symbol = "f_c"
    units = ("N*m", "N")
    lower = 0.0
    dissipates = True
    shapes = {"v_s": Shape(SIGN_WIDTH, VELOCITY, role="convention")}

    def column(self, motion: Motion, joint: int) -> Array:
        return smooth_sign(motion.dq[:, joint], self.shape["v_s"])


def hidden(joint: int, world: World, rng: np.random.Generator) -> Hidden:
    return one_joint("coulomb_friction", joint, lambda w, m: np.sign(m.dq[:, joint]))
