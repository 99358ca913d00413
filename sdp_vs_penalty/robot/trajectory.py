"""Exciting trajectories: finite Fourier series in velocity, blended in and out of rest.

With harmonics l = 1..L of the base frequency w and the clock s = t - t_b of the series,

    dq_j(s) = sum_l a_jl cos(w l s) + b_jl sin(w l s)
    q_j(s)  = q_0j + sum_l a_jl / (w l) sin(w l s) - b_jl / (w l) cos(w l s)

(Swevers et al. 1997; Gaz et al. 2019, supplementary material, sec. II). A robot starts and ends at
rest: over the first t_b seconds the velocity rises to dq(s = 0) as a raised cosine, and over the
last t_b it falls to zero likewise. q_0 is the centre of the series (the last row of the paper's
Table II), not where the robot starts: that is :attr:`FourierTrajectory.start`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.robot import Robot


@dataclass(frozen=True)
class FourierTrajectory:
    """a, b : (n, L) amplitudes of velocity [rad/s]; q_0 : (n,) centre of the series [rad].

    frequency : w [rad/s]; blend : t_b [s]; duration : of the whole motion, both blends included [s].
    Raises InputError where the blends do not fit into the duration.
    """

    a: Array
    b: Array
    q_0: Array
    frequency: float
    blend: float
    duration: float

    def __post_init__(self) -> None:
        if self.blend <= 0.0 or self.duration <= 2.0 * self.blend or self.frequency <= 0.0:
            raise InputError(
                f"trajectory: blend {self.blend:g} s, duration {self.duration:g} s and frequency "
                f"{self.frequency:g} rad/s do not fit",
                "make all positive, and the duration above twice the blend",
            )

    @property
    def start(self) -> Array:
        """(n,) where the robot stands before it moves: q(s = 0) - dq(s = 0) t_b / 2."""
        q, dq, _ = self._series(np.zeros(1))
        return q[0] - 0.5 * self.blend * dq[0]

    def states(self, t: ArrayLike) -> tuple[Array, Array, Array]:
        """q, dq, ddq, each (N, n), at the instants t (N,) [s]; at rest outside [0, duration].

        ddq jumps where a blend meets the series, as it does in the authors' generator.
        """
        t = np.asarray(t, float)[:, None]
        end = self.duration - self.blend
        q, dq, ddq = self._series(np.clip(t[:, 0], self.blend, end) - self.blend)
        q1, v1, _ = self._series(np.array([0.0]))
        q2, v2, _ = self._series(np.array([end - self.blend]))
        w = np.pi / self.blend
        rising = np.clip(t, 0.0, self.blend)
        falling = np.clip(t - end, 0.0, self.blend)
        before, after = t < self.blend, t > end
        inside = (t > 0.0) & (t < self.duration)
        first = q1 - 0.5 * v1 * (self.blend - rising + np.sin(w * rising) / w)
        last = q2 + 0.5 * v2 * (falling + np.sin(w * falling) / w)
        q = np.where(before, first, np.where(after, last, q))
        dq = np.where(
            before,
            0.5 * v1 * (1.0 - np.cos(w * rising)),
            np.where(after, 0.5 * v2 * (1.0 + np.cos(w * falling)), dq),
        )
        ddq = np.where(
            before,
            0.5 * v1 * w * np.sin(w * rising),
            np.where(after, -0.5 * v2 * w * np.sin(w * falling), ddq),
        )
        return q, np.where(inside, dq, 0.0), np.where(inside, ddq, 0.0)

    def _series(self, s: Array) -> tuple[Array, Array, Array]:
        w = self.frequency * np.arange(1, self.a.shape[1] + 1)
        cos, sin = np.cos(np.outer(s, w)), np.sin(np.outer(s, w))
        q = self.q_0 + sin @ (self.a / w).T - cos @ (self.b / w).T
        return q, cos @ self.a.T + sin @ self.b.T, cos @ (self.b * w).T - sin @ (self.a * w).T


def random_trajectory(
    robot: Robot,
    seed: int,
    duration: float = 10.0,
    harmonics: int = 5,
    frequency: float = 0.15 * np.pi,
    blend: float = 0.5,
) -> FourierTrajectory:
    """A random Fourier trajectory inside the robot's joint range and velocity limits.

    Amplitudes are uniform in [-1, 1], then scaled joint by joint to fill at most 80 % of the range
    and 60 % of the velocity limit; the centre is placed at random where the motion still fits.
    """
    rng = np.random.default_rng(seed)
    a, b = rng.uniform(-1.0, 1.0, (2, robot.n, harmonics))
    lower, upper, velocity = joint_limits(robot)
    unit = FourierTrajectory(a, b, np.zeros(robot.n), frequency, blend, duration)
    q, dq, _ = unit.states(np.linspace(0.0, duration, 1001))
    # Share of the velocity limit that a random trajectory uses at most.
    # Share of the joint range that it uses at most.
    scale = np.minimum(
        0.6 * velocity / np.abs(dq).max(axis=0),
        0.8 * (upper - lower) / np.ptp(q, axis=0),
    )
    low, high = scale * q.min(axis=0), scale * q.max(axis=0)
    q_0 = rng.uniform(lower - low, upper - high)
    return FourierTrajectory(a * scale[:, None], b * scale[:, None], q_0, frequency, blend, duration)


def joint_limits(robot: Robot) -> tuple[Array, Array, Array]:
    """(n,) lower, upper [rad or m] and velocity limits, with plain assumptions where none is stated."""
    lower, upper, velocity = [], [], []
    for joint in robot.joints:
        # Limits assumed where a robot states none: half a turn [rad] or half a metre [m] to each
        # side.
        span = {"revolute": np.pi, "prismatic": 0.5}[joint.kind]
        lower.append(joint.lower if np.isfinite(joint.lower) else min(-span, joint.upper - 2 * span))
        upper.append(joint.upper if np.isfinite(joint.upper) else max(span, lower[-1] + 2 * span))
        known = np.isfinite(joint.velocity) and joint.velocity > 0.0
        velocity.append(joint.velocity if known else {"revolute": 2.0, "prismatic": 0.5}[joint.kind])
    return np.array(lower), np.array(upper), np.array(velocity)
