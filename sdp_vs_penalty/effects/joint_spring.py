"""A spring across the joint."""

from __future__ import annotations

import numpy as np

from sdp_vs_penalty.effects.effect import Array, JointEffect, Motion
from sdp_vs_penalty.effects.hidden import HiddenEffect, TrueRobot, either_sign, one_joint


class JointSpring(JointEffect):
    name = "joint_spring"
    equation = "k_s q"
    explanation = (
        "A torque that grows with the joint's position: cables and hoses that are wound up, a balance "
        "spring. Its rest position appears as part of the offset."
    )
    reference = "Khalil, Dombre, Modeling, Identification and Control of Robots, ch. 9"
    signless = True
    symbol = "k_s"
    units = ("N*m/rad", "N/m")

    def column(self, motion: Motion, joint: int) -> Array:
        return motion.q[:, joint]


def hidden(joint: int, true: TrueRobot, rng: np.random.Generator) -> HiddenEffect:
    return one_joint("joint_spring", joint, lambda w, m: m.q[:, joint], either_sign(rng))
