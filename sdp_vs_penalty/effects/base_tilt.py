"""A base that is not level."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sdp_vs_penalty.effects.effect import Block, Effect, Motion, Parameter


class BaseTilt(Effect):
    name = "base_tilt"
    equation = "g_x dID/dg_x + g_y dID/dg_y"
    explanation = (
        "The base is not level: gravity has components along the base's other two axes. 0.17 m/s^2 is "
        "one degree."
    )
    reference = "Luh, Walker, Paul, ASME J. Dynamic Systems 1980 (gravity as the base's acceleration)"
    needs_links = True
    whole_robot = True

    @property
    def axes(self) -> tuple[int, int]:
        """The two base axes across gravity (x and y of an upright base)."""
        along = int(np.argmax(np.abs(self.robot.gravity))) if any(self.robot.gravity) else 2
        first, second = (a for a in range(3) if a != along)
        return first, second

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return tuple(Parameter(f"g_{'xyz'[a]}", "m/s^2", self.name, 0) for a in self.axes)

    def blocks(self, motion: Motion) -> list[Block]:
        rest = np.zeros_like(motion.q)
        columns = []
        for axis in self.axes:
            gravity = np.eye(3)[axis]
            robot = replace(self.robot, gravity=(gravity[0], gravity[1], gravity[2]))
            columns.append(robot.inverse_dynamics(motion.model_links, motion.q, rest, rest))
        return [
            Block(j, np.arange(2), np.column_stack([c[:, j] for c in columns]))
            for j in range(self.robot.n)
        ]
