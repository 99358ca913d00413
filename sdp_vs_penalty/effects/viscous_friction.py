"""Friction proportional to velocity."""

from __future__ import annotations

import numpy as np

from sdp_vs_penalty.effects.effect import Array, JointEffect, Motion
from sdp_vs_penalty.effects.hidden import HiddenEffect, TrueRobot, one_joint


class ViscousFriction(JointEffect):
    name = "viscous_friction"
    equation = "f_v dq"
    explanation = "Lubricant shear and damping: a torque against the motion that grows with speed."
    reference = "Armstrong-Helouvry, Dupont, Canudas de Wit, Automatica 1994, sec. 2"
    symbol = "f_v"
    units = ("N*m*s/rad", "N*s/m")
    lower = 0.0
    signless = True

    def column(self, motion: Motion, joint: int) -> Array:
        return motion.dq[:, joint]


def hidden(joint: int, true: TrueRobot, rng: np.random.Generator) -> HiddenEffect:
    return one_joint("viscous_friction", joint, lambda w, m: m.dq[:, joint])
