"""Dry friction."""

from sdp_vs_penalty.effects.effect import SIGN_WIDTH, Array, JointEffect, Motion
from sdp_vs_penalty.effects.shape import VELOCITY, Shape


class CoulombFriction(JointEffect):
    name = "coulomb_friction"
    equation = "f_c tanh(dq / v_s)"
    explanation = (
        "Dry contact: a torque of fixed size against the direction of motion. It turns round over v_s, "
        "which is estimated joint by joint where it is not given. Together with "
        "torque_offset it also covers a Coulomb friction that differs by direction."
    )
    reference = "Armstrong-Helouvry, Dupont, Canudas de Wit, Automatica 1994, sec. 2"
    symbol = "f_c"
    lower = 0.0
    turns = "Coulomb turns over"
    shapes = {
        "v_s": Shape(
            SIGN_WIDTH,
            VELOCITY,
            # Wider transitions are another law (a sigmoid, a hysteresis): they have to earn their name.
            grid=(0.00002, 0.0001, 0.00025, 0.0005, 0.001, 0.002, 0.004, 0.008, 0.016, 0.032),
            bounds=(0.00002, 0.032),
            earned=0.64,
            metres=0.1,
            role="estimated",
        )
    }

    def column(self, motion: Motion, joint: int) -> Array:
        return motion.sign(joint, self.shape["v_s"])
