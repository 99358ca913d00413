"""Trajectories from point to point with rests: reversals, pauses and slow parts where one wants them.

Between two points all joints follow the smooth step s(x) = 35 x^4 - 84 x^5 + 70 x^6 - 20 x^7, x = t / T,
whose first three derivatives vanish at both ends. For a move by d in T its extremes are 35/16 |d| / T
(velocity), 7.5132 |d| / T^2 (acceleration) and 52.5 |d| / T^3 (jerk).
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from sdp_vs_penalty.robot.arrays import Array


@dataclass(frozen=True)
class PointTrajectory:
    """points (W, n) [rad or m], moves (W - 1,) [s] between them, pauses (W,) [s] at each."""

    points: Array
    moves: Array
    pauses: Array

    @cached_property
    def _starts(self) -> Array:
        """(W - 1,) when each move begins."""
        return np.cumsum(self.pauses[:-1] + np.concatenate([[0.0], self.moves[:-1]]))

    @property
    def duration(self) -> float:
        return float(self.moves.sum() + self.pauses.sum())

    def states(self, t: ArrayLike) -> tuple[Array, Array, Array]:
        """q, dq, ddq, each (N, n), at the instants t (N,) [s]."""
        at = np.asarray(t, float)
        k = np.clip(np.searchsorted(self._starts, at, side="right") - 1, 0, len(self.moves) - 1)
        T = self.moves[k][:, None]
        x = np.clip((at - self._starts[k])[:, None] / T, 0.0, 1.0)
        d = self.points[k + 1] - self.points[k]
        q = self.points[k] + d * (35 * x**4 - 84 * x**5 + 70 * x**6 - 20 * x**7)
        dq = d / T * 140 * x**3 * (1 - x) ** 3
        return q, dq, d / T**2 * 420 * x**2 * (1 - x) ** 2 * (1 - 2 * x)


def shortest_moves(points: Array, velocity: Array, acceleration: Array, jerk: Array) -> Array:
    """(W - 1,) the shortest moves between points (W, n) within limits (n,) [s]."""
    d = np.abs(np.diff(points, axis=0))
    limits = (velocity, acceleration, jerk)
    # Extremes of the smooth step's derivatives, one to three.
    each = [
        (c * d / limit) ** (1.0 / k)
        for k, (c, limit) in enumerate(zip((35.0 / 16.0, 7.5132, 52.5), limits, strict=True), start=1)
    ]
    return np.maximum(np.max(each, axis=(0, 2)), 1e-2)


def joint_trajectory(names: Sequence[str], trajectory: PointTrajectory, rate: float = 50.0) -> str:
    """A ROS trajectory_msgs/JointTrajectory as text: JSON, which YAML readers read as well."""
    t = np.arange(int(np.floor(trajectory.duration * rate + 1e-9)) + 1) / rate
    q, dq, ddq = trajectory.states(t)
    points = [
        {
            "positions": _digits(a),
            "velocities": _digits(b),
            "accelerations": _digits(c),
            "time_from_start": {"sec": int(s), "nanosec": round(1e9 * (s - int(s)))},
        }
        for s, a, b, c in zip(t.tolist(), q, dq, ddq, strict=True)
    ]
    lines = ",\n".join(f"  {json.dumps(p)}" for p in points)
    return f'{{"joint_names": {json.dumps(list(names))},\n "points": [\n{lines}\n ]}}\n'


def _digits(values: Array) -> list[float]:
    return [float(f"{x:.9g}") for x in values]
