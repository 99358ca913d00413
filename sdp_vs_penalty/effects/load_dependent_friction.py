"""Dry friction that grows with the load."""

import numpy as np

from sdp_vs_penalty.effects.effect import Array, JointEffect, Motion


class LoadDependentFriction(JointEffect):
    name = "load_dependent_friction"
    equation = "f_l |tau_l| sign(dq), tau_l the links' torque"
    explanation = (
        "Gear teeth and bearings are pressed harder by the torque that they transmit and rub more: f_l "
        "is the share of it that is lost, one minus the gear's efficiency. It is the links' torque: "
        "motor friction and rotor do not pass through the gear."
    )
    reference = "Hamon, Gautier, Garrec, IROS 2010; Wahrburg et al., ICRA 2018"
    symbol = "f_l"
    units = ("-", "-")
    lower = 0.0
    refines = ("coulomb_friction",)
    needs_links = True

    def column(self, motion: Motion, joint: int) -> Array:
        return np.abs(motion.link_torque[:, joint]) * motion.sign(joint)
