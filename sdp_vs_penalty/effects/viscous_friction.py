"""Friction proportional to velocity."""

from sdp_vs_penalty.effects.effect import Array, JointEffect, Motion


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
