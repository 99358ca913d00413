"""Torque logged late on all joints alike."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from sdp_vs_penalty.effects.effect import Array, Block, Effect, Motion, Parameter
from sdp_vs_penalty.effects.hidden import HiddenEffect, TrueRobot
from sdp_vs_penalty.robot.robot import Robot


class GlobalDelay(Effect):
    name = "global_delay"
    equation = "-T_g d tau_hat / dt on every joint"
    explanation = (
        "All torques are logged T_g later than the positions (to first order): two clocks, or one "
        "filter for all channels."
    )
    reference = "Hollerbach, Khalil, Gautier, Springer Handbook of Robotics, Model Identification"
    needs_torque = True
    forward = "channel"
    has_memory = True
    whole_robot = True

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return (Parameter("T_g", "s", self.name, 0),)

    @classmethod
    def starts(cls, robot: Robot, joint: int) -> Iterable[dict[str, float]]:
        return [{}] if robot.n > 1 else []  # on a single joint it is that joint's own delay

    def blocks(self, motion: Motion) -> list[Block]:
        return [Block(j, np.array([0]), -motion.torque_rate[:, [j]]) for j in range(self.robot.n)]

    def undone(self, theta: Array, t: Array, torque: Array) -> Array:
        return np.column_stack([np.interp(t + theta[0], t, channel) for channel in torque.T])


def hidden(joint: int, true: TrueRobot, rng: np.random.Generator) -> HiddenEffect:
    return HiddenEffect("global_delay", (), late=np.full(true.robot.n, 1e-3), unit=1e-3, theta=(1e-3,))
