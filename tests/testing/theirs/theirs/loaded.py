"""Friction of the load that falls with speed: a law of the links' torque, which is next
to nothing in a fast motion."""

import numpy as np

from sdp_vs_penalty.effects.effect import Array, JointEffect, Motion
from sdp_vs_penalty.effects.shape import VELOCITY, ShapeConstant


class LoadStribeck(JointEffect):
    equation = "f_ls |tau_l| sign(dq) exp(-|dq| / v_ls)"
    explanation = "Friction of the loaded gear that falls with speed."
    reference = "Bittencourt, Gunnarsson, ASME J. Dyn. Sys. 2012"
    symbol = "f_ls"
    units = ("-", "-")
    needs_links = True
    shapes = {
        "v_ls": ShapeConstant(0.2, VELOCITY, grid=(0.05, 0.2, 0.5), bounds=(0.01, 2.0))
    }

    def column(self, motion: Motion, joint: int) -> Array:
        """Return |tau_l| sign(dq) exp(-|dq| / v_ls) (N,) [N m, N]."""
        fall = np.exp(-np.abs(motion.dq[:, joint]) / self.shape["v_ls"])
        return np.abs(motion.link_torque[:, joint]) * motion.sign(joint) * fall
