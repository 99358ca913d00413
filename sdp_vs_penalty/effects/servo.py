"""What the laws of servos share: their torque, moved to the load's side of tau = Y theta.

Where no torque is logged the drive's own law stands for it. With tau_drive = k (q_cmd - q) - d dq the
equation of motion reads 0 = Y theta - k (q_cmd - q) + d dq: linear in the links, the friction and the
gains together, up to one common factor.
"""

from collections.abc import Iterable

from sdp_vs_penalty.effects.effect import JointEffect
from sdp_vs_penalty.effects.shape import Shape
from sdp_vs_penalty.robot.robot import Robot

#: The longest delay of a command [s]: a tenth of a second more makes any loop of use unstable.
LATEST = 0.1


class Servo(JointEffect):
    """A part of the drive's law: a torque of the drive counts negative here, as a load's would.

    T : how much later than it is logged the command acts [s]; one for all joints.
    """

    forward = "drive"
    needs_command = True
    signless = True
    lower = 0.0
    range = 1e8
    shapes = {"T": Shape(0.0, "s", grid=(0.0,), bounds=(0.0, LATEST), scale="linear", signed=True)}

    @classmethod
    def starts(cls, robot: Robot, joint: int) -> Iterable[dict[str, float]]:
        """None: it drives the joint, and is nothing that a search for a missing load may find."""
        return ()


class ServoGain(Servo):
    """A part with one gain a joint."""

    shape_of = "servo_position"

    @property
    def searched(self) -> tuple[str, ...]:
        """None of its own: the delay is servo_position's."""
        return ()
