"""A constant torque."""

import numpy as np

from sdp_vs_penalty.effects.effect import Array, JointEffect, Motion


class TorqueOffset(JointEffect):
    name = "torque_offset"
    equation = "f_o"
    explanation = "The zero of a torque or current sensor, or a friction that differs by direction."
    reference = "Gaz et al., RA-L 2019, eq. 9"
    signless = True
    symbol = "f_o"

    def column(self, motion: Motion, joint: int) -> Array:
        return np.ones(len(motion.t))
