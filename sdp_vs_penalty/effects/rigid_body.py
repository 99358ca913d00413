"""The links' inertia and weight."""

from collections.abc import Iterable
from functools import cache

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.effects.effect import Block, Effect, Motion, Parameter
from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.constraint import Constraint
from sdp_vs_penalty.robot.robot import Robot

#: Distance [m] of a centre of mass beyond which rounding would show in a torque divided by the mass.
_FARTHEST = 100.0


class RigidBody(Effect):
    name = "rigid_body"
    equation = "M(q) ddq + C(q, dq) dq + g(q) = Y(q, dq, ddq) theta"
    explanation = (
        "Mass, centre of mass and inertia of every link determine the torque that accelerates the "
        "arm and holds it against gravity."
    )
    reference = "Atkeson, An, Hollerbach, IJRR 1986"
    signless = smooth = True

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return _parameters(self.robot.links)

    def constraints(self, indices: NDArray[np.intp]) -> list[Constraint]:
        """None of its own: the links' bounds are the problem's."""
        return []

    @classmethod
    def starts(cls, robot: Robot, joint: int) -> Iterable[dict[str, float]]:
        return []  # a model without it has no torque to begin with

    def blocks(self, motion: Motion) -> list[Block]:
        regressor = self.robot.regressor(motion.q, motion.dq, motion.ddq)
        blocks = []
        for joint, links in enumerate(self.robot.subtree):
            indices = (10 * np.array(links, np.intp)[:, None] + np.arange(10)).ravel()
            # Of a serial arm they follow each other: no copy.
            serial = len(links) and links == tuple(range(links[0], links[-1] + 1))
            own = slice(10 * links[0], 10 * links[-1] + 10) if serial else indices
            blocks.append(Block(joint, indices, regressor[:, joint, own]))
        return blocks

    def torque(self, theta: Array, motion: Motion) -> Array:
        """By recursive Newton-Euler, half the price of columns; these where a mass is next to nothing,
        by which it divides."""
        links = theta.reshape(-1, 10)
        if np.any(np.linalg.norm(links[:, 1:4], axis=1) > _FARTHEST * np.abs(links[:, 0])):
            return super().torque(theta, motion)
        return self.robot.inverse_dynamics(theta, motion.q, motion.dq, motion.ddq)


@cache
def _parameters(links: int) -> tuple[Parameter, ...]:
    return tuple(
        Parameter(name, unit, RigidBody.name, link)
        for link in range(1, links + 1)
        for name, unit in zip(inertia.parameter_names(link), inertia.UNITS, strict=True)
    )
