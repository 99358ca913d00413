"""Torque that repeats every part of a turn."""

from collections.abc import Iterable, Sequence

import numpy as np

from sdp_vs_penalty.effects.effect import Array, JointEffect, Motion
from sdp_vs_penalty.effects.shape import Shape
from sdp_vs_penalty.robot.robot import Robot

#: Metres of travel where a robot states none; waves per metre times 2 pi of a screw of 5 mm; and how
#: many orders are tried at most.
_TRAVEL, _FINEST, _MOST = 0.5, 2.0 * np.pi / 0.005, 200


class TorqueRipple(JointEffect):
    name = "torque_ripple"
    equation = "a_r cos(k q) + b_r sin(k q)"
    explanation = (
        "A torque that repeats k times per turn (k times 2 pi metres on a prismatic joint): motor "
        "poles, gear teeth, an eccentric gear or a strain wave generator, which turns twice its "
        "ratio."
    )
    reference = "Tuttle, Seering, IEEE Trans. Robotics and Automation 1996 (strain wave gears)"
    several = True
    shapes = {
        "k": Shape(
            2.0,
            ("1/turn", "rad/m"),
            # Once a turn is geometry: a link's weight, a joint beside where it is believed. Higher
            # orders are visible at full rate only (the order spectrum).
            grid=tuple(float(k) for k in range(2, 41)),
            bounds=(1.9, 1e4),
            # Waves: neighbours are a fixed distance apart, whatever their order.
            scale="linear",
        )
    }

    signless = True

    def named(self, joint: int) -> Iterable[tuple[str, str]]:
        k = f"{self.shape['k']:.6g}"
        return [(f"{symbol}{joint + 1}_{k}", self.unit_on(joint)) for symbol in ("a_r", "b_r")]

    @property
    def waves(self) -> float | None:
        return self.shape["k"]

    @classmethod
    def starts(cls, robot: Robot, joint: int) -> Iterable[dict[str, float]]:
        """Waves per turn; on a prismatic joint screws of 1 to 100 mm, and what the travel may hold."""
        grid: Sequence[float] = cls.shapes["k"].grid
        if robot.joints[joint].kind == "prismatic":
            travel = robot.joints[joint].upper - robot.joints[joint].lower
            # Neighbours half a wave apart over the travel; without one, that of a common axis.
            step = np.pi / (travel if 0.0 < travel < np.inf else _TRAVEL)
            grid = np.arange(2.0 * step, _FINEST, step)[:_MOST].tolist()
        return [{"k": float(f"{k:.6g}")} for k in grid]  # as many digits as a written effect has

    def column(self, motion: Motion, joint: int) -> Array:
        phase = self.shape["k"] * motion.q[:, joint]
        return np.column_stack([np.cos(phase), np.sin(phase)])
