"""Torque that repeats every part of a turn."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from sdp_vs_penalty.effects.effect import Array, Block, Effect, Motion, Parameter
from sdp_vs_penalty.robot.robot import Robot


class TorqueRipple(Effect):
    name = "torque_ripple"
    equation = "a_r cos(k q) + b_r sin(k q)"
    explanation = (
        "A torque that comes back k times a turn (k times 2 pi metres on a prismatic joint): motor "
        "poles, gear teeth, an eccentric gear or a strain wave generator, which turns twice its ratio."
    )
    reference = "Tuttle, Seering, IEEE Trans. Robotics and Automation 1996 (strain wave gears)"
    shape_defaults = {"k": 2.0}
    shape_bounds = {"k": (0.95, 1e4)}
    #: Orders a search looks at; higher ones are visible at full rate only (the order spectrum).
    searched = tuple(float(k) for k in range(1, 41))

    @classmethod
    def shapes(cls, robot: Robot, joint: int) -> Iterable[dict[str, float]]:
        return [{"k": k} for k in cls.searched]

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        k = f"{self.shape['k']:.6g}"
        return tuple(
            Parameter(
                f"{symbol}{j + 1}_{k}",
                self.robot.torque_units[j],
                self.name,
                j + 1,
            )
            for j in self.joints
            for symbol in ("a_r", "b_r")
        )

    def blocks(self, motion: Motion) -> list[Block]:
        return [
            Block(j, np.array([2 * i, 2 * i + 1]), self._pair(motion, j))
            for i, j in enumerate(self.joints)
        ]

    def _pair(self, motion: Motion, joint: int) -> Array:
        phase = self.shape["k"] * motion.q[:, joint]
        return np.column_stack([np.cos(phase), np.sin(phase)])

    def shape_unit(self, key: str, joint: int) -> str:
        return "1/turn" if self.robot.joints[joint].kind == "revolute" else "rad/m"
