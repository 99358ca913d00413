"""A late torque channel."""

import numpy as np

from sdp_vs_penalty.effects.effect import Array, JointEffect, Motion
from sdp_vs_penalty.effects.shape import Shape


class TorqueDelay(JointEffect):
    name = "torque_delay"
    equation = "T_d (tau_hat(t - T) - tau_hat(t)) / T"
    explanation = (
        "This joint's torque is logged T_d later than its position: a filter in the drive, a slower "
        "bus. No one channel is early: what a late position brings about, all joints feel. T is T_d."
    )
    reference = "Hollerbach, Khalil, Gautier, Springer Handbook of Robotics, Model Identification"
    symbol = "T_d"
    units = ("s", "s")
    lower = 0.0
    needs_torque = True
    forward = "channel"
    has_memory = True  # the time derivative looks at neighbouring samples
    shapes = {"T": Shape(0.001, "s", signed=True)}
    sized_shape = "T"

    def column(self, motion: Motion, joint: int) -> Array:
        return -motion.late_torque_rate(self.shape["T"])[:, joint]

    def undone(self, theta: Array, t: Array, torque: Array) -> Array:
        out = torque.copy()
        for late, j in zip(theta, self.joints, strict=True):
            out[:, j] = np.interp(t + late, t, torque[:, j])
        return out
