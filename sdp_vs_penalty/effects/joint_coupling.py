"""A torque that another joint's motion makes."""

from collections.abc import Iterable, Sequence

import numpy as np

from sdp_vs_penalty.effects.effect import Array, JointEffect, Motion, smooth_sign
from sdp_vs_penalty.effects.shape import Shape
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.robot.robot import Robot


class JointCoupling(JointEffect):
    name = "joint_coupling"
    equation = (
        "f_c times dq_i | sign(dq_i) | sign(dq_j + dq_i) | sign(dq_j - dq_i), for form = 1 | 2 | 3 | 4"
    )
    explanation = (
        "The motion of joint i causes a torque on joint j, like friction in wrists whose motors sit "
        "one link further back and drive through each other's gears. i counts from 1; 0 means the "
        "previous joint (the next one for joint 1)."
    )
    reference = "Janot, Vandanjon, Gautier, IEEE TCST 2014 (Staubli TX40: joints 5 and 6)"
    symbol = "f_c"
    several = True
    shapes = {"i": Shape(0.0, signed=True), "form": Shape(1.0, choices=(1.0, 2.0, 3.0, 4.0))}

    def __init__(self, robot: Robot, joints: Sequence[int] | None = None, **shape: float) -> None:
        super().__init__(robot, joints, **shape)
        i = self.shape["i"]
        if i != int(i) or not 0 <= i <= robot.n:
            raise InputError(
                f"effect {self.name}: i is a joint from 1 to {robot.n}, not {i:g}", "name another joint"
            )
        if joints is None:
            self.joints = tuple(j for j in self.joints if j + 1 != i and robot.n > 1)
        elif any(j + 1 == i for j in self.joints) or robot.n < 2:
            raise InputError(
                f"effect {self.name}: a joint cannot be coupled to itself", "name another joint as i"
            )

    def partner(self, joint: int) -> int:
        """The joint i (from 0) whose motion acts on ``joint``."""
        if self.shape["i"] > 0.0:
            return int(self.shape["i"]) - 1
        return joint - 1 if joint > 0 else 1

    @classmethod
    def starts(cls, robot: Robot, joint: int) -> Iterable[dict[str, float]]:
        neighbours = [i for i in (joint - 1, joint + 1) if 0 <= i < robot.n]
        forms = cls.shapes["form"].choices
        return [{"i": float(i + 1), "form": form} for i in neighbours for form in forms]

    def parameter_name(self, joint: int) -> str:
        return f"{self.symbol}{joint + 1}_{self.partner(joint) + 1}_{self.shape['form']:g}"

    def unit_on(self, joint: int) -> str:
        torque = super().unit_on(joint)
        if self.shape["form"] != 1.0:
            return torque
        return f"{torque}*s/{self.robot.position_units[self.partner(joint)]}"

    def column(self, motion: Motion, joint: int) -> Array:
        partner, form = self.partner(joint), int(self.shape["form"])
        if form == 1:
            return np.array(motion.dq[:, partner])
        if form == 2:
            return motion.sign(partner)
        other = 1.0 if form == 3 else -1.0
        velocity, rate = (x[:, joint] + other * x[:, partner] for x in (motion.dq, motion.ddq))
        return smooth_sign(velocity, motion.width(joint), rate, motion.within)
