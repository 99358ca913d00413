"""Exciting trajectories: finite Fourier series in velocity, blended in and out of rest.

With harmonics l = 1..L of the base frequency w and the clock s = t - t_b of the series,

    dq_j(s) = sum_l a_jl cos(w l s) + b_jl sin(w l s)
    q_j(s)  = q_0j + sum_l a_jl / (w l) sin(w l s) - b_jl / (w l) cos(w l s)

(Swevers et al. 1997; Gaz et al. 2019, supplementary material, sec. II). A robot starts
and ends at rest: over the first t_b seconds the velocity rises to dq(s = 0) as a raised
cosine, and over the last t_b it falls to zero likewise. q_0 is the centre of the series
(the last row of the paper's Table II), not where the robot starts: that is q(s = 0) -
dq(s = 0) t_b / 2.

From point to point, with rests (:class:`PointTrajectory`): between two points all
joints follow the smooth step s(x) = 35 x^4 - 84 x^5 + 70 x^6 - 20 x^7, x = t / T, whose
first three derivatives vanish at both ends. For a move by d in T its extremes are 35/16
|d| / T (velocity), 7.5132 |d| / T^2 (acceleration) and 52.5 |d| / T^3 (jerk).
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.robot import Robot, joint_limits


@dataclass(frozen=True)
class FourierTrajectory:
    """A Fourier series of each joint, with blends from and to rest."""

    #: (n, L) amplitudes of the velocity's cosines [rad/s].
    a: Array
    #: (n, L) amplitudes of the velocity's sines [rad/s].
    b: Array
    #: (n,) centre of the series [rad].
    q_0: Array
    #: Fundamental frequency w [rad/s].
    frequency: float
    #: Duration t_b of each blend [s].
    blend: float
    #: Duration of the whole motion, both blends included [s].
    duration: float

    def __post_init__(self) -> None:
        """Raise InputError unless frequency and blend are positive and the duration
        exceeds both blends, 2 blend [s]."""
        if (
            self.blend <= 0.0
            or self.duration <= 2.0 * self.blend
            or self.frequency <= 0.0
        ):
            settings = f"blend {self.blend:g} s, duration {self.duration:g} s"
            what = f"trajectory: {settings} and frequency {self.frequency:g} rad/s do not fit"
            raise InputError(
                what, "make all positive, and the duration above twice the blend"
            )

    def states(self, t: ArrayLike) -> tuple[Array, Array, Array]:
        """Return positions, velocities and accelerations at instants t (N,) [s].

        The first ``blend`` seconds speed up from rest to the first velocity v of the
        series, dq = v (1 - cos(w t)) / 2 with w = pi / blend; the last ones slow down
        likewise. The Fourier series runs in between. Before and after, the robot is at
        rest. The acceleration jumps where a blend meets the series, as in the authors'
        generator.

        Returns
        -------
        tuple of (N, n) arrays
            q [rad, m], dq, ddq.
        """
        t = np.asarray(t, float)[:, None]
        end = self.duration - self.blend
        w = np.pi / self.blend
        in_series = self._series(np.clip(t[:, 0], self.blend, end) - self.blend)
        # Position and velocity at the beginning and at the end of the series.
        q1, v1, _ = self._series(np.array([0.0]))
        q2, v2, _ = self._series(np.array([end - self.blend]))
        # Time within the first and within the last blend, and q, dq, ddq there.
        rising = np.clip(t, 0.0, self.blend)
        falling = np.clip(t - end, 0.0, self.blend)
        first = (
            q1 - 0.5 * v1 * (self.blend - rising + np.sin(w * rising) / w),
            0.5 * v1 * (1.0 - np.cos(w * rising)),
            0.5 * v1 * w * np.sin(w * rising),
        )
        last = (
            q2 + 0.5 * v2 * (falling + np.sin(w * falling) / w),
            0.5 * v2 * (1.0 + np.cos(w * falling)),
            -0.5 * v2 * w * np.sin(w * falling),
        )
        conditions = [t < self.blend, t > end]
        parts = zip(first, last, in_series, strict=True)
        states = [
            np.select(conditions, [begin, finish], middle)
            for begin, finish, middle in parts
        ]
        q, dq, ddq = states
        is_moving = (t > 0.0) & (t < self.duration)
        return q, np.where(is_moving, dq, 0.0), np.where(is_moving, ddq, 0.0)

    def _series(self, s: Array) -> tuple[Array, Array, Array]:
        """Return q, dq, ddq (K, n) of the Fourier series at instants s (K,) [s] after
        the blend.

        q = q_0 + sum_k a_k sin(w_k s) / w_k - b_k cos(w_k s) / w_k, with w_k = k
        frequency.
        """
        w = self.frequency * np.arange(1, self.a.shape[1] + 1)
        cos = np.cos(np.outer(s, w))
        sin = np.sin(np.outer(s, w))
        q = self.q_0 + sin @ (self.a / w).T - cos @ (self.b / w).T
        return (
            q,
            cos @ self.a.T + sin @ self.b.T,
            cos @ (self.b * w).T - sin @ (self.a * w).T,
        )


def random_trajectory(
    robot: Robot,
    seed: int,
    duration: float = 10.0,
    harmonics: int = 5,
    frequency: float = 0.15 * np.pi,
    blend: float = 0.5,
) -> FourierTrajectory:
    """Return a random Fourier trajectory within the limits of a robot.

    Amplitudes are uniform in [-1, 1] and then scaled joint by joint to fill at most 80 % of
    the range and 60 % of the velocity limit. The centre is random where the motion fits.
    ``duration`` is in [s], the fundamental ``frequency`` in [rad/s].

    Parameters
    ----------
    seed : int
        Seed of the random numbers.
    blend : float
        Duration of the blends from and to rest [s].
    """
    rng = np.random.default_rng(seed)
    a, b = rng.uniform(-1.0, 1.0, (2, robot.n, harmonics))
    lower, upper, velocity = joint_limits(robot)
    unit = FourierTrajectory(
        a, b, q_0=np.zeros(robot.n), frequency=frequency, blend=blend, duration=duration
    )
    q, dq, _ = unit.states(np.linspace(0.0, duration, 1001))
    scale = np.minimum(
        0.6 * velocity / np.abs(dq).max(axis=0),
        0.8 * (upper - lower) / np.ptp(q, axis=0),
    )
    low = scale * q.min(axis=0)
    high = scale * q.max(axis=0)
    q_0 = rng.uniform(lower - low, upper - high)
    return FourierTrajectory(
        a * scale[:, None],
        b=b * scale[:, None],
        q_0=q_0,
        frequency=frequency,
        blend=blend,
        duration=duration,
    )


@dataclass(frozen=True)
class PointTrajectory:
    """Moves between points, with a pause at each."""

    #: (W, n) positions of the points [rad or m].
    points: Array
    #: (W - 1,) durations of the moves between them [s].
    moves: Array
    #: (W,) durations of the pauses at the points [s].
    pauses: Array

    @cached_property
    def _starts(self) -> Array:
        """(W - 1,) instants at which the moves begin [s]."""
        previous_moves = np.concatenate([[0.0], self.moves[:-1]])
        return np.cumsum(self.pauses[:-1] + previous_moves)

    @property
    def duration(self) -> float:
        """Length of the whole motion, pauses included [s]."""
        return float(self.moves.sum() + self.pauses.sum())

    def states(self, t: ArrayLike) -> tuple[Array, Array, Array]:
        """Return positions, velocities and accelerations at instants t (N,) [s].

        A move from p over d in T seconds is q = p + d (35 x^4 - 84 x^5 + 70 x^6 - 20
        x^7), with x = t / T from 0 to 1: velocity, acceleration and jerk are zero at
        both ends. Between moves (pauses) the robot stands still.

        Returns
        -------
        tuple of (N, n) arrays
            q [rad, m], dq [rad/s, m/s], ddq [rad/s^2, m/s^2].
        """
        instants = np.asarray(t, float)
        # Number of the move that each instant belongs to.
        move = np.clip(
            np.searchsorted(self._starts, instants, side="right") - 1,
            0,
            len(self.moves) - 1,
        )
        T = self.moves[move][:, None]
        x = np.clip((instants - self._starts[move])[:, None] / T, 0.0, 1.0)
        d = self.points[move + 1] - self.points[move]
        q = self.points[move] + d * (35 * x**4 - 84 * x**5 + 70 * x**6 - 20 * x**7)
        dq = d / T * 140 * x**3 * (1 - x) ** 3
        return q, dq, d / T**2 * 420 * x**2 * (1 - x) ** 2 * (1 - 2 * x)


def shortest_moves(
    points: Array, velocity: Array, acceleration: Array, jerk: Array
) -> Array:
    """Return the shortest durations (W - 1,) [s] of moves between points (W, n) [rad,
    m], within the limits (n,) of velocity, acceleration and jerk."""
    d = np.abs(np.diff(points, axis=0))
    # Largest velocity c_1 d / T, acceleration c_2 d / T^2 and jerk c_3 d / T^3 of a move
    # over d in T seconds, by the smooth step of PointTrajectory: c_k and the limit.
    extremes = (35.0 / 16.0, velocity), (7.5132, acceleration), (52.5, jerk)
    durations = [
        (c * d / limit) ** (1.0 / k) for k, (c, limit) in enumerate(extremes, start=1)
    ]
    shortest_s = 1e-2  # of a move over no distance
    return np.maximum(np.max(durations, axis=(0, 2)), shortest_s)
