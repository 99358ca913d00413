"""Hidden effects: what a simulated robot does that a model without the effect does not know.

An effect's file may state its torque a second time: ``hidden(joint, true, rng)``, below the class.
That statement is the truth that searches are judged by and columns are tested against, so it
shares nothing with the columns: it is written on the true motion (t, q, dq, ddq) and the true robot,
where there is one by another route (a channel that truly reads the past, a friction state integrated
in time, a link beside where the encoder says), and it names the parameters that the library should find.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from sdp_vs_penalty.effects.effect import Motion
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.robot import Robot


@dataclass(frozen=True)
class TrueRobot:
    """The robot as it truly is without hidden effects: links (n, 10); friction viscous, coulomb and
    offset (n,) each."""

    robot: Robot
    links: Array
    viscous: Array
    coulomb: Array
    offset: Array
    #: Velocity [rad/s, m/s] over which dry friction turns round.
    dry_width: float = 0.01

    def without(self, effects: Sequence[str]) -> TrueRobot:
        """The robot that lacks these kinds of friction, by the names of their effects."""
        none = np.zeros(self.robot.n)
        return replace(
            self,
            viscous=none if "viscous_friction" in effects else self.viscous,
            coulomb=none if "coulomb_friction" in effects else self.coulomb,
            offset=none if "torque_offset" in effects else self.offset,
        )

    def dry(self, velocity: Array) -> Array:
        """Dry friction over its Coulomb torque."""
        return np.tanh(velocity / self.dry_width)

    def rigid(self, motion: Motion) -> Array:
        return self.robot.inverse_dynamics(self.links.ravel(), motion.q, motion.dq, motion.ddq)

    def friction(self, motion: Motion) -> Array:
        return self.viscous * motion.dq + self.coulomb * self.dry(motion.dq) + self.offset

    def torque(self, motion: Motion) -> Array:
        return self.rigid(motion) + self.friction(motion)

    def temperature(self, t: Array) -> Array:
        """(N, n) of the gears [degrees Celsius], which warm up within minutes, each to its own end."""
        return 20.0 + np.outer(-np.expm1(-t / 120.0), 15.0 + 2.0 * np.arange(self.robot.n))


#: (true, motion, size) -> (N, n) torque to add, or what the encoder shows beyond the truth.
Change = Callable[[TrueRobot, Motion, float], Array]


@dataclass(frozen=True)
class HiddenEffect:
    """One hidden effect on joints (from 0; empty: the whole robot), with what a scorer wants to know.

    torque : the torque that it adds; encoder : what it does to the measured positions; late : seconds
    by which torque channels lag per unit of size (n,). ``size`` multiplies all of them; unit : what a
    size of 1 is in the library's unit of this effect; theta : the effect's parameters at a size of 1,
    with their signs (None for what is no effect of the library); warm : whether the runs log the
    gears' temperatures; deviation : by how much a link stands
    beside where the encoder says at a size of 1 [rad, m], where ``torque`` and not ``encoder`` says it.
    """

    effect: str
    joints: tuple[int, ...]
    torque: Change | None = None
    encoder: Change | None = None
    late: Array | None = None
    details: Mapping[str, Any] = field(default_factory=dict)
    size: float = 1.0
    unit: float = 1.0
    theta: tuple[float, ...] | None = None
    deviation: float = 0.0
    warm: bool = False

    @property
    def amplitude(self) -> float:
        """The size in the library's unit."""
        return self.size * self.unit

    def to_dict(self) -> dict[str, Any]:
        """What a scorer reads."""
        joints = [j + 1 for j in self.joints]
        return {"effect": self.effect, "joints": joints, "size": self.amplitude, **self.details}

    def sized(self, factor: float) -> HiddenEffect:
        return replace(self, size=self.size * factor)


#: From (joint, true, random numbers) to a hidden effect of size 1.
Maker = Callable[[int, TrueRobot, np.random.Generator], HiddenEffect]


def on_joint(joint: int, n: int, values: Array) -> Array:
    """(N, n) torque that is ``values`` (N,) on one joint and zero on the others."""
    out = np.zeros((len(values), n))
    out[:, joint] = values
    return out


def one_joint(
    effect: str,
    joint: int,
    law: Callable[[TrueRobot, Motion], Array],
    factor: float = 1.0,
    shape: Mapping[str, float] | None = None,
) -> HiddenEffect:
    """A hidden torque on one joint: size times factor times law (N,), which has one parameter."""
    return HiddenEffect(
        effect,
        (joint,),
        lambda w, m, size: factor * size * on_joint(joint, w.robot.n, law(w, m)),
        details={} if shape is None else {"shape": dict(shape)},
        theta=(factor,),
    )


def either_sign(rng: np.random.Generator) -> float:
    return float(rng.choice([-1.0, 1.0]))


def log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))
