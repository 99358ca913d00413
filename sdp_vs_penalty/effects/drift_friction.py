"""Friction that changes as the robot warms up."""

from __future__ import annotations

from collections.abc import Iterable

from sdp_vs_penalty.effects.drift import Drift
from sdp_vs_penalty.effects.effect import Array, Motion, Parameter
from sdp_vs_penalty.robot.robot import Robot


class DriftFriction(Drift):
    name = "drift_friction"
    equation = (
        "f_df times sign(dq) t | sign(dq) exp(-t / T) | dq t | dq exp(-t / T), for form = 1 | 2 | 3 | 4"
    )
    explanation = (
        "Friction falls (or rises) with the time since the start: grease warms up and thins. Coulomb "
        "(form 1, 2) or viscous (form 3, 4) friction follows the clock, linearly or settling with T."
    )
    reference = "Simoni, Beschi, Legnani, Visioli, IROS 2015"
    symbol = "f_df"
    units = ("N*m", "N")
    refines = ("coulomb_friction", "viscous_friction")
    forms = 4
    shape_bounds = {"T": (3.0, 3000.0)}

    @classmethod
    def shapes(cls, robot: Robot, joint: int) -> Iterable[dict[str, float]]:
        settling = [{"form": f, "T": T} for f in (2.0, 4.0) for T in (10.0, 30.0, 100.0)]
        return [{"form": 1.0}, {"form": 3.0}, *settling]

    @property
    def viscous(self) -> bool:
        return self.shape["form"] > 2.0

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return tuple(
            Parameter(f"{self.symbol}{j + 1}", self._unit(j), self.name, j + 1) for j in self.joints
        )

    def _unit(self, joint: int) -> str:
        torque, position = self.robot.torque_units[joint], self.robot.position_units[joint]
        unit = f"{torque}*s/{position}" if self.viscous else torque
        return unit if self.exponential else f"{unit}/s"

    def column(self, motion: Motion, joint: int) -> Array:
        dq = motion.dq[:, joint]
        return self.course(motion) * (dq if self.viscous else motion.sign(joint))
