"""Base of the effects that change with time."""

from collections.abc import Iterable

import numpy as np

from sdp_vs_penalty.effects.effect import Array, JointEffect, Motion
from sdp_vs_penalty.effects.shape import Shape
from sdp_vs_penalty.robot.robot import Robot


class Drift(JointEffect):
    """Odd forms are linear in time, even ones settle with the time constant T; t0 is the clock's reading
    from which time counts: the measurements' first instant."""

    follows_clock = True
    time_constant = Shape(300.0, "s", grid=(10.0, 30.0, 100.0), bounds=(3.0, 3000.0))
    clock = Shape(0.0, "s", signed=True, role="clock")
    shapes = {"form": Shape(1.0, choices=(1.0, 2.0)), "T": time_constant, "t0": clock}

    @classmethod
    def starts(cls, robot: Robot, joint: int) -> Iterable[dict[str, float]]:
        forms, grid = cls.shapes["form"].choices, cls.shapes["T"].grid
        linear = [{"form": form} for form in forms if form % 2]
        return linear + [{"form": form, "T": T} for form in forms if not form % 2 for T in grid]

    @property
    def exponential(self) -> bool:
        return self.shape["form"] % 2 == 0

    @property
    def searched(self) -> tuple[str, ...]:
        return ("form", "T") if self.exponential else ("form",)

    def course(self, motion: Motion) -> Array:
        """How the effect follows time: minutes-long trends, linear [s] or saturating [-]. What settles
        fades before t0 as after it: in an older run exp(-t / T) would grow without end."""
        t = motion.t - self.shape["t0"]
        return np.exp(-np.abs(t) / self.shape["T"]) if self.exponential else t
