"""Play in the gear."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sdp_vs_penalty.effects.effect import Array, Motion
from sdp_vs_penalty.effects.hidden import HiddenEffect, TrueRobot
from sdp_vs_penalty.effects.link_deviation import LinkDeviation


class Backlash(LinkDeviation):
    name = "backlash"
    equation = "-b dID/dq_j sign(tau_j)"
    explanation = (
        "The gear of joint j has play: the link rests against one flank or the other, b away from "
        "the position that the motor-side encoder shows, on the side that the transmitted torque "
        "tau_j determines."
    )
    reference = "Nordin, Gutman, Automatica 2002"
    symbol = "b"
    units = ("rad", "m")
    lower = 0.0
    forward = "left out"  # a link that moves by itself within the play

    def torques(self, motion: Motion, joint: int) -> Array:
        by_q, _, _ = motion.derivatives
        return -by_q[:, :, joint] * np.sign(motion.link_torque[:, joint, None])


def hidden(joint: int, true: TrueRobot, rng: np.random.Generator) -> HiddenEffect:
    def torque(w: TrueRobot, m: Motion, a: float) -> Array:
        tau = w.rigid(m)
        link = m.q.copy()
        link[:, joint] -= 1e-3 * a * np.sign(tau[:, joint])
        return w.rigid(replace(m, q=link)) - w.rigid(m)

    return HiddenEffect("backlash", (joint,), torque, unit=1e-3, theta=(1e-3,), deviation=1e-3)
