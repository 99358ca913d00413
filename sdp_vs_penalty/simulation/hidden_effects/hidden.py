"""What is hidden in a simulated run, and the robot as it truly is."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.effects.effect import Motion
from sdp_vs_penalty.robot.robot import Robot

Array = NDArray[np.float64]

#: Root mean square of the hidden torque over the raw noise of the joint that it moves most.
LEVELS = {"strong": 2.0, "medium": 0.5, "weak": 0.125}


@dataclass(frozen=True)
class World:
    """The robot as it truly is without hidden effects: links (n, 10); friction viscous, coulomb and
    offset (n,) each."""

    robot: Robot
    links: Array
    viscous: Array
    coulomb: Array
    offset: Array
    #: Velocity [rad/s, m/s] over which dry friction turns round.
    dry_width: float = 0.01

    def dry(self, velocity: Array) -> Array:
        """Dry friction over its Coulomb torque."""
        return np.tanh(velocity / self.dry_width)

    def rigid(self, motion: Motion) -> Array:
        return self.robot.inverse_dynamics(self.links.ravel(), motion.q, motion.dq, motion.ddq)

    def friction(self, motion: Motion) -> Array:
        return self.viscous * motion.dq + self.coulomb * self.dry(motion.dq) + self.offset

    def torque(self, motion: Motion) -> Array:
        return self.rigid(motion) + self.friction(motion)


#: (world, motion, size) -> torque (N, n) to add.
TorqueChange = Callable[[World, Motion, float], Array]
#: (world, motion, size) -> what the encoder shows beyond the truth (N, n).
EncoderChange = Callable[[World, Motion, float], Array]


@dataclass(frozen=True)
class Hidden:
    """One hidden effect on joints (from 0; empty: the whole robot), with what a scorer wants to know.

    torque : the torque that it adds; encoder : what it does to the measured positions; late : seconds
    by which torque channels lag per unit of size (n,). ``size`` multiplies all of them; unit : what a
    size of 1 is in the library's unit of this effect.
    """

    effect: str
    joints: tuple[int, ...]
    torque: TorqueChange | None = None
    encoder: EncoderChange | None = None
    late: Array | None = None
    details: Mapping[str, Any] = field(default_factory=dict)
    #: Removed from the simulated base friction: the effect is one of the usual ones.
    replaces: str | None = None
    size: float = 1.0
    unit: float = 1.0

    @property
    def amplitude(self) -> float:
        """The size in the library's unit."""
        return self.size * self.unit

    def to_dict(self) -> dict[str, Any]:
        """What a scorer reads."""
        joints = [j + 1 for j in self.joints]
        return {"effect": self.effect, "joints": joints, "size": self.amplitude, **self.details}

    def sized(self, factor: float) -> Hidden:
        return replace(self, size=self.size * factor)


def on_joint(joint: int, n: int, values: Array) -> Array:
    out = np.zeros((len(values), n))
    out[:, joint] = values
    return out


#: From (joint, world, random numbers) to a hidden effect of size 1.
Maker = Callable[[int, World, np.random.Generator], Hidden]


def one_column(effect: str, column: Callable[[Motion, int], Array], replaces: bool = False) -> Maker:
    def make(joint: int, world: World, rng: np.random.Generator) -> Hidden:
        n = world.robot.n
        free = effect in ("joint_spring", "torque_offset")
        sign = float(rng.choice([-1.0, 1.0])) if free else 1.0
        return Hidden(
            effect,
            (joint,),
            lambda w, m, a: sign * a * on_joint(joint, n, column(m, joint)),
            replaces=effect if replaces else None,
        )

    return make
