"""Play in the gear."""

import numpy as np

from sdp_vs_penalty.effects.effect import Array, LinkDeviation, Motion


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

    def deviated(self, motion: Motion, joint: int) -> Array:
        by_q, _, _ = motion.derivatives
        return -by_q[:, :, joint] * np.sign(motion.link_torque[:, joint, None])
