"""An encoder whose zero is off."""

from sdp_vs_penalty.effects.effect import Array, LinkDeviation, Motion


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

    def deviated(self, motion: Motion, joint: int) -> Array:
        by_q, _, _ = motion.derivatives
        return by_q[:, :, joint]
