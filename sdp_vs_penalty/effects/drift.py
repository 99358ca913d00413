"""Base of the effects that change with time."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sdp_vs_penalty.effects.effect import Array, JointEffect, Motion
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.robot.robot import Robot


class Drift(JointEffect):
    """t0 is the clock's reading from which time counts: the measurements' first instant."""

    shape_defaults = {"form": 1.0, "T": 300.0, "t0": 0.0}
    #: How many forms there are; even ones are exponential.
    forms = 2

    def __init__(self, robot: Robot, joints: Sequence[int] | None = None, **shape: float) -> None:
        super().__init__(robot, joints, **shape)
        if self.shape["form"] not in range(1, self.forms + 1):
            raise InputError(
                f"effect {self.name}: form is a whole number from 1 to {self.forms}, not "
                f"{self.shape['form']:g}."
            )
        if self.shape["T"] <= 0.0:
            raise InputError(f"effect {self.name}: T is a time constant above 0 s.")

    @property
    def exponential(self) -> bool:
        return int(self.shape["form"]) % 2 == 0

    def course(self, motion: Motion) -> Array:
        """How the effect follows time: minutes-long trends, linear [s] or saturating [-]."""
        t = motion.t - self.shape["t0"]
        return np.exp(-t / self.shape["T"]) if self.exponential else t

    def shape_unit(self, key: str, joint: int) -> str:
        return "-" if key == "form" else "s"
