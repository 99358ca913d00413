"""A spring across the joint."""

from sdp_vs_penalty.effects.effect import Array, JointEffect, Motion


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
