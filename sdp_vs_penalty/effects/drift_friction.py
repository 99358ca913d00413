"""Friction that changes as the robot warms up."""

from collections.abc import Sequence

from sdp_vs_penalty.effects.drift import Drift
from sdp_vs_penalty.effects.effect import Array, Motion
from sdp_vs_penalty.effects.shape import Shape
from sdp_vs_penalty.robot.robot import Robot


class DriftFriction(Drift):
    name = "drift_friction"
    equation = (
        "f_df times sign(dq) t | sign(dq) exp(-t / T) | dq t | dq exp(-t / T), for form = 1 | 2 | 3 | 4"
    )
    explanation = (
        "Friction falls (or rises) with the time since the start: grease warms up and thins. Coulomb "
        "(form 1, 2) or viscous (form 3, 4) friction follows the clock, linearly or settling with T. "
        "Settling is warming_friction without a thermometer: where logged temperatures explain as much, "
        "that is named."
    )
    reference = "Simoni, Beschi, Legnani, Visioli, IROS 2015"
    symbol = "f_df"
    # Where temperatures are logged they are the cause, for which the clock can only stand.
    refines: tuple[str, ...] = ("coulomb_friction", "viscous_friction", "warming_friction")
    shapes = {**Drift.shapes, "form": Shape(1.0, choices=(1.0, 2.0, 3.0, 4.0))}

    def __init__(self, robot: Robot, joints: Sequence[int] | None = None, **shape: float) -> None:
        super().__init__(robot, joints, **shape)
        plain = "viscous_friction" if self.viscous else "coulomb_friction"
        self.refines = (plain, "warming_friction")

    @property
    def viscous(self) -> bool:
        return self.shape["form"] > 2.0

    def unit_on(self, joint: int) -> str:
        torque, position = super().unit_on(joint), self.robot.position_units[joint]
        unit = f"{torque}*s/{position}" if self.viscous else torque
        return unit if self.exponential else f"{unit}/s"

    def column(self, motion: Motion, joint: int) -> Array:
        dq = motion.dq[:, joint]
        return self.course(motion) * (dq if self.viscous else motion.sign(joint))
