"""A spring that stiffens."""

import numpy as np

from sdp_vs_penalty.effects.effect import Array, JointEffect, Motion
from sdp_vs_penalty.effects.shape import POSITION, ShapeConstant


class RubberSpring(JointEffect):
    equation = "k_r q_0 sinh(q / q_0)"
    explanation = "A spring that stiffens with the distance from zero, as rubber does."
    reference = "Ogden, Non-Linear Elastic Deformations, 1984"
    symbol = "k_r"
    units = ("N*m/rad", "N/m")
    shapes = {
        "q_0": ShapeConstant(0.5, POSITION, grid=(0.25, 0.5, 1.0), bounds=(0.1, 4.0))
    }

    def column(self, motion: Motion, joint: int) -> Array:
        """Return q_0 sinh(q / q_0) (N,) [rad, m]."""
        return self.shape["q_0"] * np.sinh(motion.q[:, joint] / self.shape["q_0"])
