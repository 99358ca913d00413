"""Friction that remembers: internal states that follow a path, and the effects that have them."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.effects.effect import Array, Block, Effect, Motion, Seen


@dataclass(frozen=True)
class Legs:
    """A path (N,) as legs in one direction each: corners (L + 1,) where it is at their ends, direction
    (L,); of each step (N - 1,) its leg, one without motion being part of that before it, and how far
    from the leg's beginning it ends."""

    corners: Array
    direction: Array
    leg: NDArray[np.intp]
    travel: Array

    @classmethod
    def of(cls, q: Array) -> Legs:
        sign = np.sign(np.diff(q))
        moving = np.flatnonzero(sign)
        turns = moving[np.flatnonzero(np.diff(sign[moving])) + 1]
        corners = q[np.array([0, *turns, len(q) - 1])]
        begins = np.zeros(len(sign), np.intp)
        begins[turns] = 1
        leg = np.cumsum(begins)
        direction = sign[np.r_[moving[:1], turns]] if len(moving) else np.zeros(1)
        return cls(corners, direction, leg, q[1:] - corners[leg])


#: From a path, the distance over which its state turns round, and the state at its start, to the
#: state z (N,) along it.
Law = Callable[[Array | Legs, float, float], Array]


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
        states = np.empty((len(self.distances), len(motion.t)))
        for z, row, d in zip(states, self.directions, self.distances, strict=True):
            key = "legs", row.tobytes()
            if key not in motion.kept:
                motion.kept[key] = Legs.of(motion.q @ row)
            z[:] = self.law(motion.kept[key], d, float(motion.sign_along(row)[0]))
        return states.T

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

    def looks_like(self, size: float, seen: Seen) -> str:
        hidden = max(self.bristles.distances, default=np.inf) < 2.0 * seen.resolution
        if self.at_rest == "turns" and hidden:
            return "it turns round within what the positions tell apart: any sharp friction looks so"
        return super().looks_like(size, seen)


def dahl(q: Array | Legs, d: float, start: float = 0.0) -> Array:
    """Dahl's friction state z (N,) in [-1, 1] along positions q (N,), z[0] = start.

    Exact for motion that is monotone between samples: while q runs in direction s,
    z = s + (z_0 - s) exp(-|q - q_0| / d). One step of the loop a reversal, not a sample.
    """
    legs = q if isinstance(q, Legs) else Legs.of(q)
    decay = np.exp(np.abs(np.diff(legs.corners)) / -d)
    z = [start]
    for s, e in zip(legs.direction.tolist(), decay.tolist(), strict=True):
        z.append(s + (z[-1] - s) * e)
    s, begin = legs.direction, np.array(z[:-1])
    moved = s[legs.leg] + (begin - s)[legs.leg] * np.exp(np.abs(legs.travel) / -d)
    return np.append(start, moved if s.all() else np.where(s[legs.leg] == 0.0, start, moved))


def stop(q: Array | Legs, d: float, start: float = 0.0) -> Array:
    """Spring and slider in series, z (N,) in [-1, 1] along positions q (N,), z[0] = start.

    Exact for motion that is monotone between samples: from one reversal to the next the state is the
    straight line of its spring, cut off at +-1. One step of the loop a reversal, not a sample.
    """
    legs = q if isinstance(q, Legs) else Legs.of(q)
    z = [start]
    for step in (np.diff(legs.corners) / d).tolist():
        z.append(min(max(z[-1] + step, -1.0), 1.0))
    moved = np.array(z[:-1])[legs.leg] + legs.travel / d
    return np.append(start, np.clip(moved, -1.0, 1.0))
