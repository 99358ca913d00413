"""A zero that moves with time."""

from __future__ import annotations

from collections.abc import Iterable

from sdp_vs_penalty.effects.drift import Drift
from sdp_vs_penalty.effects.effect import Array, Motion, Parameter
from sdp_vs_penalty.robot.robot import Robot


class DriftOffset(Drift):
    name = "drift_offset"
    equation = "f_do times t | exp(-t / T), for form = 1 | 2 (t from t0)"
    explanation = (
        "The zero of the torque channel drifts: a strain gauge or a current sensor that warms up. "
        "It depends on the time, not on the motion."
    )
    reference = "Doebelin, Measurement Systems, ch. 3 (zero drift)"
    symbol = "f_do"
    units = ("N*m", "N")
    refines = ("torque_offset",)

    @classmethod
    def shapes(cls, robot: Robot, joint: int) -> Iterable[dict[str, float]]:
        return [{"form": 1.0}, *({"form": 2.0, "T": T} for T in (10.0, 30.0, 100.0))]

    shape_bounds = {"T": (3.0, 3000.0)}

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return tuple(
            Parameter(
                f"{self.symbol}{j + 1}", unit + ("" if self.exponential else "/s"), self.name, j + 1
            )
            for j in self.joints
            for unit in (self.robot.torque_units[j],)
        )

    def column(self, motion: Motion, joint: int) -> Array:
        return self.course(motion)
