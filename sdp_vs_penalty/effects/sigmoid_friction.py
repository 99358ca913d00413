"""Coulomb friction that sets in gradually."""

from __future__ import annotations

import numpy as np

from sdp_vs_penalty.effects.effect import Array, JointEffect, Motion, velocity_unit


class SigmoidFriction(JointEffect):
    name = "sigmoid_friction"
    equation = "f_sg (tanh(dq / v0) - sign(dq))"
    explanation = (
        "Of the Coulomb friction, f_sg rises over a range v0 of velocities instead of jumping: the "
        "sigmoid form phi_1 / (1 + exp(-phi_2 (dq + phi_3))) of the paper's Table I, whose phi_3 is an "
        "offset. Near standstill there is less friction than Coulomb's law says."
    )
    reference = "Gaz et al., RA-L 2019, eq. 9 and Table I"
    symbol = "f_sg"
    units = ("N*m", "N")
    lower = 0.0
    refines = ("coulomb_friction",)
    shape_defaults = {"v0": 0.1}
    shape_grid = {"v0": (0.02, 0.04, 0.08, 0.16, 0.32)}
    shape_bounds = {"v0": (0.012, 2.0)}

    def column(self, motion: Motion, joint: int) -> Array:
        dq = motion.dq[:, joint]
        return np.tanh(dq / self.shape["v0"]) - motion.sign(joint)

    def shape_unit(self, key: str, joint: int) -> str:
        return velocity_unit(self.robot, joint)
