"""Friction that remembers: internal states that follow a path, and the effects that have them."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from sdp_vs_penalty.effects.effect import Array, Block, Effect, Motion

#: From a path (N,), the distance over which its state turns round, and the state at its start, to the
#: state z (N,) along it.
Law = Callable[[Array, float, float], Array]


@dataclass(frozen=True)
class Bristles:
    """k states z in [-1, 1]: z_i turns over the distance d_i along the path s_i = directions_i q.

    directions : (k, n); distances : (k,) [rad, m]; law : :func:`dahl` or :func:`stop`.
    """

    directions: Array
    distances: Array
    law: Law

    def along(self, motion: Motion) -> Array:
        """(N, k) states along a motion, which begins in sliding (or at rest: in the middle)."""
        paths = motion.q @ self.directions.T
        first = motion.part(slice(0, 1))
        starts = [first.sign_along(row)[0] for row in self.directions]
        states = [
            self.law(path, d, float(start))
            for path, d, start in zip(paths.T, self.distances, starts, strict=True)
        ]
        return np.reshape(states, (len(states), len(motion.t))).T

    def advanced(self, z: Array, travel: Array) -> Array:
        """(W, k) states after W joint displacements (W, n) along a straight line, from states (W, k)."""
        step = travel @ self.directions.T / self.distances
        if self.law is stop:
            return np.clip(z + step, -1.0, 1.0)
        direction = np.sign(step)
        return np.asarray(direction + (z - direction) * np.exp(-np.abs(step)))


class Remembering(Effect):
    """An effect some of whose columns depend on states that follow the motion."""

    has_memory = True

    @property
    @abstractmethod
    def bristles(self) -> Bristles:
        """The states, none where the shape constants leave none."""

    @abstractmethod
    def blocks_at(self, motion: Motion, z: Array) -> list[Block]:
        """The columns at instants whose states are z (N, k)."""

    def blocks(self, motion: Motion) -> list[Block]:
        return self.blocks_at(motion, self.bristles.along(motion))


def dahl(q: Array, d: float, start: float = 0.0) -> Array:
    """Dahl's friction state z (N,) in [-1, 1] along positions q (N,), z[0] = start.

    Exact for motion that is monotone between samples: while q runs in direction s,
    z = s + (z_0 - s) exp(-|q - q_0| / d). One step of the loop a reversal, not a sample.
    """
    z = np.empty(len(q))
    z[0] = start
    step = np.diff(q)
    moving = np.flatnonzero(step)
    if not len(moving):
        z[:] = start
        return z
    # The direction of each step; a step of zero goes with the one before it.
    last = np.maximum.accumulate(np.where(step != 0.0, np.arange(len(step)), moving[0]))
    direction = np.sign(step[last])
    turns = np.flatnonzero(np.diff(direction)) + 1
    for first, end in zip([0, *turns], [*turns, len(step)], strict=True):
        s = direction[first]
        travel = np.abs(q[first + 1 : end + 1] - q[first])
        z[first + 1 : end + 1] = s + (z[first] - s) * np.exp(-travel / d)
    return z


def stop(q: Array, d: float, start: float = 0.0) -> Array:
    """Spring and slider in series, z (N,) in [-1, 1] along positions q (N,), z[0] = start.

    Exact for motion that is monotone between samples: from one reversal to the next the state is the
    straight line of its spring, cut off at +-1. One step of the loop a reversal, not a sample.
    """
    z = np.full(len(q), start)
    direction = np.sign(np.diff(q))
    moving = np.flatnonzero(direction)
    turns = moving[np.flatnonzero(np.diff(direction[moving])) + 1]
    for first, last in pairwise([0, *turns.tolist(), len(q) - 1]):
        z[first : last + 1] = np.clip(z[first] + (q[first : last + 1] - q[first]) / d, -1.0, 1.0)
    return z
