"""Friction laws on a fine grid of time, all joints at once, as shares of the Coulomb torque.

Sources: Dahl, AIAA Journal 1976; Canudas de Wit, Olsson, Astrom, Lischinsky, IEEE TAC 1995 (LuGre).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


LAWS = ("sign", "tanh", "dahl", "lugre")


@dataclass(frozen=True)
class DryFriction:
    """law : of LAWS; width (n,) : of tanh [rad/s or m/s]; travel (n,) : of the bristles [rad or m];
    rise, speed (n,) : by how much LuGre's friction is larger at rest, and up to which speed."""

    law: str
    width: Array
    travel: Array = field(default_factory=lambda: np.ones(0))
    rise: Array = field(default_factory=lambda: np.zeros(0))
    speed: Array = field(default_factory=lambda: np.ones(0))

    def share(self, t: Array, dq: Array) -> Array:
        """(N, n) the dry friction over the Coulomb torque; t (N,) s, evenly spaced at >= 1 kHz."""
        if self.law == "sign":
            return np.sign(dq)
        if self.law == "tanh":
            return np.tanh(dq / self.width)
        if self.law == "dahl":
            return bristles(t, dq, self.travel, lambda v: np.ones_like(v))
        return bristles(
            t,
            dq,
            self.travel,
            lambda v: 1.0 + self.rise * np.exp(-((v / self.speed) ** 2)),
            damping=0.02,
        )

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON."""
        shape = {"width": self.width} if self.law == "tanh" else {}
        if self.law in ("dahl", "lugre"):
            shape = {"travel": self.travel}
        if self.law == "lugre":
            shape |= {"rise": self.rise, "speed": self.speed}
        return {"law": self.law} | {name: value.tolist() for name, value in shape.items()}


def bristles(
    t: Array, dq: Array, travel: Array, level: Callable[[Array], Array], damping: float = 0.0
) -> Array:
    """(N, n) z + damping times dz/dt (over the steady rate), dz/dt = dq / d - |dq| z / (d g(dq)).

    Between two samples dq is taken as constant, for which the equation is solved exactly: the step is
    stable however stiff d is. At a reversal the step is split at the instant of rest.
    """
    step = float(t[1] - t[0])
    a, b = dq[:-1], dq[1:]
    turns = a * b < 0.0
    rest = np.where(turns, a / np.where(turns, a - b, 1.0), 1.0)  # share of the step before rest
    parts = []
    for v, length in ((np.where(turns, 0.5 * a, 0.5 * (a + b)), rest), (0.5 * b, 1.0 - rest)):
        goal = np.sign(v) * level(v)
        parts.append((np.exp(-np.abs(v) * length * step / (travel * level(v))), goal))
    z = np.zeros_like(dq)
    now = np.zeros(dq.shape[1])
    (decay, goal), (decay_2, goal_2) = parts
    for k in range(len(a)):
        now = goal[k] + (now - goal[k]) * decay[k]
        now = goal_2[k] + (now - goal_2[k]) * decay_2[k]
        z[k + 1] = now
    if damping:
        z = z + damping * np.sign(dq) * (1.0 - np.sign(dq) * z / level(dq))
    return z
