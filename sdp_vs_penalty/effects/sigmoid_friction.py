"""Coulomb friction that sets in gradually."""

import numpy as np

from sdp_vs_penalty.effects.effect import Array, JointEffect, Motion
from sdp_vs_penalty.effects.shape import VELOCITY, Shape


class SigmoidFriction(JointEffect):
    name = "sigmoid_friction"
    equation = "f_sg (tanh(dq / v0) - sign(dq))"
    explanation = (
        "A part f_sg of the Coulomb friction rises over a velocity range v0 instead of jumping: the "
        "sigmoid form phi_1 / (1 + exp(-phi_2 (dq + phi_3))) of the paper's Table I, whose phi_3 is "
        "an offset. Near standstill there is less friction than Coulomb's law says."
    )
    reference = "Gaz et al., RA-L 2019, eq. 9 and Table I"
    symbol = "f_sg"
    lower = 0.0
    refines = ("coulomb_friction",)
    shapes = {"v0": Shape(0.1, VELOCITY, grid=(0.02, 0.04, 0.08, 0.16, 0.32), bounds=(0.012, 2.0))}

    def column(self, motion: Motion, joint: int) -> Array:
        dq = motion.dq[:, joint]
        return np.tanh(dq / self.shape["v0"]) - motion.sign(joint)
