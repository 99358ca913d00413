"""Friction that falls as grease warms up, by its temperature or by the clock."""

from collections.abc import Iterable, Sequence

import numpy as np

from sdp_vs_penalty.effects.drift import Drift
from sdp_vs_penalty.effects.effect import Array, JointEffect, Motion
from sdp_vs_penalty.effects.shape import Shape
from sdp_vs_penalty.robot.robot import Robot

#: Where the exponential is 1 [degrees Celsius]; elsewhere the amplitude would only read differently.
_ROOM = 20.0


class WarmingFriction(JointEffect):
    name = "warming_friction"
    equation = (
        "f_w exp(-(temp - 20) / warm) or f_w exp(-(t - t0) / T), for by = temperature | clock, times "
        "sign(dq) | dq, for law = coulomb | viscous"
    )
    explanation = (
        "Grease thins as it warms, and friction falls exponentially with the gear's temperature "
        "(columns temp1..tempn of the log). By the clock it settles with T, counted over all runs by "
        "their own time stamps, pauses included: that is drift_friction with form 2 or 4, its special "
        "case, which a search names where no temperature was logged. For f_w >= 0 it never feeds energy."
    )
    reference = "Simoni, Beschi, Legnani, Visioli, IROS 2015; Carlson et al., Mech. Mach. Theory 2015"
    symbol = "f_w"
    lower = 0.0
    refines: tuple[str, ...] = ("coulomb_friction", "viscous_friction")  # each law its own
    shapes = {
        "law": Shape(1.0, choices=(1.0, 2.0), words=("coulomb", "viscous")),
        "by": Shape(1.0, choices=(1.0, 2.0), words=("temperature", "clock")),
        "warm": Shape(20.0, "K", grid=(8.0, 20.0, 50.0), bounds=(3.0, 200.0)),
        "T": Drift.time_constant,
        "t0": Drift.clock,
    }

    def __init__(self, robot: Robot, joints: Sequence[int] | None = None, **shape: float) -> None:
        super().__init__(robot, joints, **shape)
        self.refines = ("viscous_friction" if self.law == "viscous" else "coulomb_friction",)
        self.follows_clock = self.shape["by"] == 2.0
        self.needs_temperature = not self.follows_clock

    @property
    def searched(self) -> tuple[str, ...]:
        return ("law", "by", "T" if self.follows_clock else "warm")

    @property
    def law(self) -> str:
        return self.shapes["law"].written(self.shape["law"])

    @classmethod
    def starts(cls, robot: Robot, joint: int) -> Iterable[dict[str, float]]:
        """By temperature: by the clock it is drift_friction, which a search knows already."""
        scales = list(zip(cls.shapes["warm"].grid, cls.shapes["T"].grid, strict=True))
        laws = cls.shapes["law"].choices
        return [{"law": law, "warm": warm, "T": T} for law in laws for warm, T in scales]

    def unit_on(self, joint: int) -> str:
        torque = super().unit_on(joint)
        viscous = self.law == "viscous"
        return f"{torque}*s/{self.robot.position_units[joint]}" if viscous else torque

    def column(self, motion: Motion, joint: int) -> Array:
        if self.follows_clock:
            x = np.abs(motion.t - self.shape["t0"]) / self.shape["T"]  # of older runs: as in drift.py
        else:
            x = (motion.joint_temperature[:, joint] - _ROOM) / self.shape["warm"]
        rubbing = motion.dq[:, joint] if self.law == "viscous" else motion.sign(joint)
        return np.asarray(np.exp(-x) * rubbing)
