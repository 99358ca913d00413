"""One pass over a log: what rules about its rows and clock look at, each worked out once."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.robot import Robot
from sdp_vs_penalty.signals.runs import Movement, movement, moving_joints, spans


@dataclass(frozen=True)
class Glance:
    """A run, the robot it is of, and the share of its speed below which the robot stands still."""

    run: Measurements
    robot: Robot
    standstill: float

    @cached_property
    def steps(self) -> Array:
        """(N - 1,) time steps [s]."""
        return np.diff(self.run.t)

    @cached_property
    def step(self) -> float:
        """The usual one, 0 where time does not advance."""
        forward = self.steps[self.steps > 0.0]
        return float(np.median(forward)) if len(forward) else 0.0

    @cached_property
    def moving(self) -> NDArray[np.bool_]:
        return moving_joints(self.run)

    @cached_property
    def movement(self) -> Movement:
        return movement(self.run, self.standstill)

    @cached_property
    def inside(self) -> NDArray[np.bool_]:
        """(N,) rows in which the arm moves, half a second off every start and stop."""
        m, t = self.movement, self.run.t
        return np.asarray(m.at(t - 0.5) & m.moves & m.at(t + 0.5))

    @cached_property
    def row_numbers(self) -> NDArray[np.int64]:
        """(N,) equal numbers for rows that are the same, bit by bit, in every column but t."""
        rows = np.ascontiguousarray(np.column_stack([*self.run.groups.values()]))
        packed = rows.view(np.dtype((np.void, rows.dtype.itemsize * rows.shape[1]))).ravel()
        return np.unique(packed, return_inverse=True)[1].ravel()

    @cached_property
    def held(self) -> NDArray[np.bool_]:
        """(N,) rows that are copies of the one before."""
        return np.concatenate([[False], np.diff(self.row_numbers) == 0])

    @property
    def channels(self) -> list[tuple[str, int, Array]]:
        """Name, joint and values of each position and torque."""
        pairs = (("q", self.run.q), *([("tau", self.run.tau)] if self.run.torque_logged else []))
        return [(f"{name}{j + 1}", j, x[:, j]) for name, x in pairs for j in range(self.run.n)]


def constant_parts(x: Array) -> NDArray[np.intp]:
    """(K, 2) first and last row of each stretch in which a channel (N,) keeps its value."""
    return spans(np.diff(x) == 0.0)


def lattice_step(values: Array) -> float:
    """The smallest step between different values of a channel, rounding errors of the file apart."""
    levels = np.unique(values)
    steps = np.diff(levels)
    steps = steps[steps > 1e-9 * (levels[-1] - levels[0])]
    return float(steps.min()) if len(steps) else 0.0


def with_steps(run: Measurements, steps: Array) -> Measurements:
    """The same rows, so far apart (N - 1,)."""
    return replace(run, t=run.t[0] + np.concatenate([[0.0], np.cumsum(steps)]))
