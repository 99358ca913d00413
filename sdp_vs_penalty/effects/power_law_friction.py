"""Friction that bends with speed."""

import numpy as np

from sdp_vs_penalty.effects.effect import Array, JointEffect, Motion
from sdp_vs_penalty.effects.shape import Shape


class PowerLawFriction(JointEffect):
    name = "power_law_friction"
    equation = "f_p sign(dq) |dq|^alpha"
    explanation = (
        "Friction that is not linear in speed: alpha < 1 where the lubricant thins with shear and "
        "warms, alpha > 1 where it is churned (2: like drag)."
    )
    reference = "Waiboer, Aarts, Jonker, ECCOMAS Multibody Dynamics 2005"
    symbol = "f_p"
    units = ("N*m*(s/rad)^alpha", "N*(s/m)^alpha")
    refines = ("viscous_friction", "coulomb_friction")
    shapes = {"alpha": Shape(2.0, grid=(0.3, 0.5, 0.7, 1.5, 2.0, 3.0), bounds=(0.15, 4.0))}

    def column(self, motion: Motion, joint: int) -> Array:
        dq = motion.dq[:, joint]
        return motion.sign(joint) * np.abs(dq) ** self.shape["alpha"]
