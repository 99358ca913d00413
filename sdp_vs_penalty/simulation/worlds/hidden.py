"""What can be hidden in a world: a change of its torque, what the library should call it, and how large.

Names, symbols and signs are those that ``sdp-vs-penalty list effects`` prints; the equations are stated
here a second time, on the true motion and the true robot.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy.signal import lfilter

from sdp_vs_penalty.simulation.worlds.arm import Array
from sdp_vs_penalty.simulation.worlds.world import TrueMotion, World

Change = Callable[[World, TrueMotion, float], Array]
Maker = Callable[[World, int, np.random.Generator], "Hidden"]

#: Root mean square of the hidden torque over the raw noise of the joint that it moves most.
LEVELS = {"strong": 2.0, "medium": 0.5, "weak": 0.125}


@dataclass(frozen=True)
class Hidden:
    """change : (N, n) torque that an effect of a size adds; joints : from 0, none for the whole robot;
    number : the library's parameter at size 1, None where it has no single one; shift : (N,) by how
    much the joint's link stands elsewhere than its encoder says, where that is how it acts; effect : the
    library's name of it, which the tables of makers say."""

    joints: tuple[int, ...]
    change: Change
    number: float | None = 1.0
    shape: Mapping[str, float] = field(default_factory=dict)
    size: float = 1.0
    shift: Change | None = None
    details: Mapping[str, Any] = field(default_factory=dict)
    effect: str = ""

    def torque(self, world: World, m: TrueMotion) -> Array:
        """(N, n) what it adds at its size."""
        return self.change(world, m, self.size)

    def sized(self, world: World, motions: Sequence[TrueMotion], factor: float) -> Hidden:
        """With a root mean square of ``factor`` times the raw noise on the joint that it moves most;
        three rounds, as some effects are not linear. As it is, where it moves nothing."""
        out = self
        for _ in range(3):
            added = np.concatenate([out.torque(world, m) for m in motions])
            ratio = float((np.sqrt(np.mean(added**2, axis=0)) / world.noise).max())
            if ratio < 1e-9:
                return self
            out = replace(out, size=out.size * factor / ratio)
        return out

    def deviation(self, world: World, m: TrueMotion) -> float:
        """Root mean square of the shift [rad or m]."""
        if self.shift is None:
            return 0.0
        return float(np.sqrt(np.mean(self.shift(world, m, self.size) ** 2)))

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON; joints count from 1."""
        size = None if self.number is None else self.number * self.size
        joints = [j + 1 for j in self.joints]
        return {"effect": self.effect, "joints": joints, "size": size} | {
            "shape": dict(self.shape),
            **self.details,
        }


def at_joint(
    joint: int, law: Callable[[World, TrueMotion], Array], number: float | None = 1.0, /, **shape: float
) -> Hidden:
    """A torque of one joint, law(world, motion) (N,) times the size."""

    def change(world: World, m: TrueMotion, size: float) -> Array:
        out = np.zeros_like(m.q)
        out[:, joint] = size * law(world, m)
        return out

    return Hidden((joint,), change, number, shape)


def plain(law: Callable[[World, int, TrueMotion], Array], signed: bool = False) -> Maker:
    """The maker of a torque of one joint without constants, law(world, joint, motion) (N,) times the
    size; signed : either way round."""

    def make(w: World, j: int, rng: np.random.Generator) -> Hidden:
        side = float(rng.choice([-1.0, 1.0])) if signed else 1.0
        return at_joint(j, lambda w, m: side * law(w, j, m), side)

    return make


def shifted(joint: int, shift: Change, number: float | None) -> Hidden:
    """The link of a joint stands at q + shift, where q is what motor and encoder do."""

    def change(world: World, m: TrueMotion, size: float) -> Array:
        moved = displaced(m, joint, shift(world, m, size))
        return world.rigid(moved) - world.rigid(m)

    return Hidden((joint,), change, number, shift=shift)


def displaced(m: TrueMotion, joint: int, shift: Array) -> TrueMotion:
    """The motion of the links, rates by central differences on the fine grid."""
    rate = np.gradient(shift, m.t)
    acceleration = np.gradient(rate, m.t)
    q, dq, ddq = m.q.copy(), m.dq.copy(), m.ddq.copy()
    q[:, joint] += shift
    dq[:, joint] += rate
    ddq[:, joint] += acceleration
    return TrueMotion(m.t, q, dq, ddq)


def sign(world: World, joint: int, m: TrueMotion) -> Array:
    """(N,) the direction in which a joint rubs, as sharp as its own dry friction is."""
    return world.share(m)[:, joint]


def log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    """A number whose logarithm is uniform."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def first_order(x: Array, step: float, lag: float) -> Array:
    """y + lag dy/dt = x, from rest at the first sample."""
    decay = float(np.exp(-step / lag))
    half = 0.5 * (1.0 - decay)
    y, _ = lfilter([half, half], [1.0, -decay], x, axis=0, zi=(1.0 - half) * x[:1])
    return np.asarray(y)
