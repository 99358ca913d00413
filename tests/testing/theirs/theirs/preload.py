"""A spring under preload: an effect with columns, C, MJCF, world and words in one
file."""

import numpy as np

from sdp_vs_penalty.effects.effect import Array, JointEffect, Motion, SimulatorTerm
from sdp_vs_penalty.effects.shape import POSITION, ShapeConstant


class PreloadedSpring(JointEffect):
    equation = "k_p (q - q_0)"
    explanation = "A spring that is relaxed at q_0, such as a counterbalance."
    on_the_arm = "{joint} is {sign:pulled back|pushed away} by {size}{per_degree}"
    seen_against = "position"
    reference = "Shigley, Mechanical Engineering Design, ch. 10"
    symbol = "k_p"
    units = ("N*m/rad", "N/m")
    signless = True
    shapes = {
        "q_0": ShapeConstant(
            0.3, POSITION, (-0.4, 0.3), (-3.0, 3.0), scale="linear", signed=True
        )
    }

    def column(self, motion: Motion, joint: int) -> Array:
        """Return q - q_0 (N,) [rad, m]."""
        return motion.q[:, joint] - self.shape["q_0"]

    def simulator_terms(self, theta):
        """MuJoCo's spring with its rest, and attributes of each kind of element that
        make no torque: the distance at which limits act, a gear of 1, contacts."""
        for joint, stiffness in zip(self.joints, theta.tolist(), strict=True):
            rest = self.shape["q_0"]
            yield SimulatorTerm("stiffness", joint, stiffness)
            yield SimulatorTerm("offset", joint, -stiffness * rest)
            yield SimulatorTerm("mjcf", joint, 0.02, ("joint", "margin"))
            yield SimulatorTerm("mjcf", joint, 1.0, ("actuator", "gear"))
        yield SimulatorTerm("mjcf", -1, 2.0, ("option", "impratio"))

    @staticmethod
    def hidden_torque(motion, joint, sign, q_0):
        """Return the pull (N,) of a spring of stiffness 1 that is relaxed at q_0."""
        return np.array([q - q_0 for q in motion.q[:, joint]])
