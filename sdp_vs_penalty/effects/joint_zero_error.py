"""An encoder whose zero is off."""

from __future__ import annotations

import numpy as np

from sdp_vs_penalty.effects.effect import Array, Motion
from sdp_vs_penalty.effects.hidden import HiddenEffect, TrueRobot, either_sign, on_joint
from sdp_vs_penalty.effects.link_deviation import LinkDeviation


class JointZeroError(LinkDeviation):
    name = "joint_zero_error"
    equation = "e_0 dID/dq_j"
    explanation = (
        "The true position of joint j is q_j + e_0: gravity and the coupling between links act at a "
        "different angle than the model assumes. (Rotating both neighbours' frames would do the "
        "same; on some joints the links' parameters absorb it.)"
    )
    reference = "Mooring, Roth, Driels, Fundamentals of Manipulator Calibration, 1991"
    signless = True
    symbol = "e_0"
    units = ("rad", "m")

    def torques(self, motion: Motion, joint: int) -> Array:
        by_q, _, _ = motion.derivatives
        return by_q[:, :, joint]


def hidden(joint: int, true: TrueRobot, rng: np.random.Generator) -> HiddenEffect:
    sign = either_sign(rng)
    return HiddenEffect(
        "joint_zero_error",
        (joint,),
        encoder=lambda w, m, a: -1e-3 * sign * a * on_joint(joint, w.robot.n, np.ones(len(m.t))),
        unit=1e-3,
        theta=(1e-3 * sign,),
    )
