"""A position loop with damping: proportional and derivative gain."""

from collections.abc import Iterable

import numpy as np

from sdp_vs_penalty.effects.effect import Block, Motion
from sdp_vs_penalty.effects.servo import Servo
from sdp_vs_penalty.effects.shape import Shape


class ServoPosition(Servo):
    name = "servo_position"
    equation = "-kp (q_cmd(t - T) - q) + kd dq(t - d)"
    explanation = (
        "The drive pulls the joint towards its commanded position and damps it. A cascade kv (w e - dq) "
        "is the same law, with kp = kv w and kd = kv. kd and viscous friction are seen as a sum only: "
        "beside viscous_friction kd is what remains of it, and which of the two it is no motion tells. "
        "A drive that differentiates its encoder feels an older velocity: kd dq(t - d) is kd dq less "
        "kd d ddq, to first order, which no motion without torque tells from a link that is lighter."
    )
    reference = "Siciliano et al., Robotics: Modelling, Planning and Control, sec. 8.5"
    sized_by = slice(0, 1)
    position_gains = slice(0, None, 2)
    shapes = {**Servo.shapes, "d": Shape(0.0, "s", scale="linear", signed=True)}

    @property
    def searched(self) -> tuple[str, ...]:
        """The delay; the age of the velocity is given or zero."""
        return ("T",)

    def named(self, joint: int) -> Iterable[tuple[str, str]]:
        own, per = self.unit_on(joint), self.robot.position_units[joint]
        return [(f"kp{joint + 1}", f"{own}/{per}"), (f"kd{joint + 1}", f"{own}*s/{per}")]

    def blocks(self, motion: Motion) -> list[Block]:
        error = motion.told.position(motion.t - self.shape["T"]) - motion.q
        rate = motion.dq - self.shape["d"] * motion.ddq
        return self.apart([np.column_stack([-error[:, j], rate[:, j]]) for j in self.joints])
