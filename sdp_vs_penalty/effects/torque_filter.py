"""A torque channel that is smoothed without a lag."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from sdp_vs_penalty.effects.effect import Array, Block, Effect, Motion, Parameter
from sdp_vs_penalty.robot.robot import Robot


class TorqueFilter(Effect):
    name = "torque_filter"
    equation = "w_f d^2 tau_hat / dt^2 on every joint"
    explanation = (
        "All torques were smoothed without a lag before they were logged: to second order a symmetric "
        "kernel adds half its variance, w_f, times the curvature (L^2 / 24 for a moving average of "
        "length L). Reversals of friction look rounded on every joint alike."
    )
    reference = "Oppenheim, Schafer, Discrete-Time Signal Processing, sec. 5 (zero-phase filters)"
    needs_torque = True
    has_memory = True  # the derivatives look at neighbouring samples
    whole_robot = True

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return (Parameter("w_f", "s^2", self.name, 0, 0.0),)

    @classmethod
    def starts(cls, robot: Robot, joint: int) -> Iterable[dict[str, float]]:
        return [{}] if robot.n > 1 else []  # on a single joint it is any rounding of its friction

    def blocks(self, motion: Motion) -> list[Block]:
        return [Block(j, np.array([0]), column[:, None]) for j, column in enumerate(_bend(motion).T)]

    def remark(self, size: float) -> str:
        return f"Here: like a moving average over {1e3 * np.sqrt(24.0 * max(size, 0.0)):.2g} ms."


def _bend(motion: Motion) -> Array:
    """(N, n) second time derivative of the current model's torque, by differences."""
    if len(motion.t) < 2:
        return np.zeros_like(motion.q)
    return np.asarray(np.gradient(motion.torque_rate, motion.t, axis=0))
