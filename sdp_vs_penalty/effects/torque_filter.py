"""Torque channels that pass a low-pass filter, or were smoothed afterwards."""

from collections.abc import Iterable

import numpy as np
from scipy.linalg import solve_banded

from sdp_vs_penalty.effects.effect import STANDS, Array, Effect, Motion, Seen
from sdp_vs_penalty.effects.shape import Shape
from sdp_vs_penalty.robot.robot import Robot


class TorqueFilter(Effect):
    name = "torque_filter"
    equation = "T_f (H(T) tau_hat - tau_hat) / T on every joint, H = 1 / (1 + T s) or H(T) H(-T)"
    explanation = (
        "All torques are logged behind one low-pass filter of the time constant T, of which the "
        "positions know nothing: a drive's current filter, which also delays (phase late), or one that "
        "looks both ways, as a mean of samples does (phase zero: tau_hat without the links' torque). "
        "T is T_f: all of the torque passes."
    )
    reference = "Hollerbach, Khalil, Gautier, Springer Handbook of Robotics, Model Identification"
    needs_torque = True
    forward = "left out"  # no instant's torque is known from that instant's reading
    has_memory = True
    whole_robot = True
    shapes = {
        "T": Shape(0.005, "s"),
        "phase": Shape(1.0, grid=(1.0, 2.0), choices=(1.0, 2.0), words=("late", "zero")),
    }
    sized_shape = "T"

    lower = 0.0

    def named(self, joint: int) -> Iterable[tuple[str, str]]:
        return [("T_f", "s")]

    @classmethod
    def starts(cls, robot: Robot, joint: int) -> Iterable[dict[str, float]]:
        # On a single joint friction and inertia are one torque: what is filtered of it is not told.
        return super().starts(robot, joint) if robot.n > 1 else []

    @property
    def needs_links(self) -> bool:  # type: ignore[override]
        return self.shape["phase"] == 2.0

    def torques(self, motion: Motion) -> Array:
        T, torque = self.shape["T"], motion.model_torque
        if self.needs_links:
            # The links' torque is smooth, but for the noise of its accelerations, which the measured
            # torque has none of: to smooth it away would always help.
            torque = torque - motion.link_torque
        passed = lagging(torque, motion.t, T)
        if self.needs_links:
            passed = lagging(passed[::-1], motion.t, T)[::-1]
        return np.asarray((passed - torque) / T)[:, :, None]

    def looks_like(self, size: float, seen: Seen) -> str:
        if self.needs_links and seen.stands > STANDS:
            return "joints stand still at reversals, where friction turns round as slowly by itself"
        return ""

    def as_sized(self, size: float) -> float:
        # What looks both ways has no first order: T_f goes as the square of the true constant over T.
        return size if self.shape["phase"] == 1.0 else float(np.sqrt(self.shape["T"] * max(size, 0.0)))


def lagging(x: Array, t: Array, T: float) -> Array:
    """(N, n) y with T dy/dt + y = x, at rest at the start; exact where x is linear between samples."""
    if len(t) < 2:
        return x
    step = (t[-1] - t[0]) / (len(t) - 1)
    decay = np.exp(-step / T)
    mean = (1.0 - decay) * T / step
    driven = (1.0 - mean) * x
    driven[1:] += (mean - decay) * x[:-1]
    driven[0] += mean * x[0]
    bands = np.repeat([[1.0], [-decay]], len(t), axis=1)
    return np.asarray(solve_banded((1, 0), bands, driven, overwrite_b=True, check_finite=False))
