"""A constant torque."""

from __future__ import annotations

import numpy as np

from sdp_vs_penalty.effects.effect import Array, JointEffect, Motion
from sdp_vs_penalty.effects.hidden import HiddenEffect, TrueRobot, either_sign, one_joint


class TorqueOffset(JointEffect):
    name = "torque_offset"
    equation = "f_o"
    explanation = "The zero of a torque or current sensor, or a friction that differs by direction."
    reference = "Gaz et al., RA-L 2019, eq. 9"
    signless = True
    symbol = "f_o"
    units = ("N*m", "N")

    def column(self, motion: Motion, joint: int) -> Array:
        return np.ones(len(motion.t))


def hidden(joint: int, true: TrueRobot, rng: np.random.Generator) -> HiddenEffect:
    return one_joint("torque_offset", joint, lambda w, m: np.ones_like(m.t), either_sign(rng))
