"""Torque logged late on all joints alike."""

from collections.abc import Iterable

import numpy as np

from sdp_vs_penalty.effects.effect import Array, Effect, Motion, Seen
from sdp_vs_penalty.effects.shape import Shape
from sdp_vs_penalty.robot.robot import Robot

#: Friction turns round before a joint that sticks or bends does: its torque comes early.
EARLY = "a joint that sticks or bends before it moves looks as early"


class GlobalDelay(Effect):
    name = "global_delay"
    equation = "T_g (tau_hat(t - T) - tau_hat(t)) / T on every joint"
    explanation = (
        "All torques are logged T_g later than the positions: two clocks, or one filter for all "
        "channels. T is T_g."
    )
    reference = "Hollerbach, Khalil, Gautier, Springer Handbook of Robotics, Model Identification"
    needs_torque = True
    forward = "channel"
    has_memory = True
    whole_robot = True
    shapes = {"T": Shape(0.001, "s", signed=True)}
    sized_shape = "T"

    def named(self, joint: int) -> Iterable[tuple[str, str]]:
        return [("T_g", "s")]

    @classmethod
    def starts(cls, robot: Robot, joint: int) -> Iterable[dict[str, float]]:
        return [{}] if robot.n > 1 else []  # on a single joint it is that joint's own delay

    def torques(self, motion: Motion) -> Array:
        return -motion.late_torque_rate(self.shape["T"])[:, :, None]

    def looks_like(self, size: float, seen: Seen) -> str:
        return EARLY if size < 0.0 else ""

    def undone(self, theta: Array, t: Array, torque: Array) -> Array:
        return np.column_stack([np.interp(t + theta[0], t, channel) for channel in torque.T])
