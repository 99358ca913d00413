"""A base that is not level."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sdp_vs_penalty.effects.effect import Array, Block, Effect, Motion, Parameter
from sdp_vs_penalty.effects.hidden import Hidden, World


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

    def remark(self, size: float) -> str:
        return f"Here: {np.degrees(size / 9.81):.2g} degrees."


def hidden(joint: int, world: World, rng: np.random.Generator) -> Hidden:
    angle = rng.uniform(0.0, 2.0 * np.pi)
    g = world.robot.gravity
    along = int(np.argmax(np.abs(g)))
    across = [axis for axis in range(3) if axis != along]

    def torque(w: World, m: Motion, a: float) -> Array:
        tilted = np.array(g)
        tilted[across] += 0.01 * a * np.array([np.cos(angle), np.sin(angle)])
        robot = replace(w.robot, gravity=(tilted[0], tilted[1], tilted[2]))
        return replace(w, robot=robot).rigid(m) - w.rigid(m)

    theta = (0.01 * float(np.cos(angle)), 0.01 * float(np.sin(angle)))
    return Hidden("base_tilt", (), torque, unit=0.01, theta=theta)
