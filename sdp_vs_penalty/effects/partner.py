"""Effects by which one joint acts on another."""

from collections.abc import Iterable

from sdp_vs_penalty.effects.effect import JointEffect
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.robot.robot import Robot


class WithPartner(JointEffect):
    """An effect on joint j by another joint, its partner: the shape constant i.

    i counts from 1; 0 means the previous joint (the next one for joint 1).
    """

    def settle(self) -> None:
        """Check that each joint is coupled to another one.

        The shape constant i is the joint (from 1) whose motion acts; 0 stands for each
        joint's neighbour. Without joints the effect acts on all joints but joint i.
        """
        i, n = self.shape["i"], self.robot.n
        if i != int(i) or not 0 <= i <= n:
            raise InputError(
                f"effect {self.name}: i is a joint from 1 to {n}, not {i:g}",
                "name another joint",
            )
        if self.asked_joints is None:
            self.joints = tuple(j for j in self.joints if j + 1 != i and n > 1)
        elif any(j + 1 == i for j in self.joints) or n < 2:
            raise InputError(
                f"effect {self.name}: a joint cannot be coupled to itself",
                "name another joint as i",
            )

    @classmethod
    def starts(cls, robot: Robot, joint: int) -> Iterable[dict[str, float]]:
        """List the shape constants with which a search begins: both neighbours of the
        joint, each with all values of the other constants."""
        neighbours = (i for i in (joint - 1, joint + 1) if 0 <= i < robot.n)
        others = super().starts(robot, joint)
        return [{"i": i + 1.0, **other} for i in neighbours for other in others]

    def parameter_name(self, joint: int) -> str:
        """Name the parameter after joint and partner: "g_x5_6"."""
        return f"{self.symbol}{joint + 1}_{self.partner(joint) + 1}"

    def partner(self, joint: int) -> int:
        """Return the joint whose motion acts on another joint.

        Parameters
        ----------
        joint
            The joint from 0 that is acted on.
        """
        if self.shape["i"] > 0.0:
            return int(self.shape["i"]) - 1
        return joint - 1 if joint > 0 else 1
