"""Effects by which one joint acts on another."""

from collections.abc import Sequence

from sdp_vs_penalty.effects.effect import JointEffect
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.robot.robot import Robot


def neighbours(robot: Robot, joint: int) -> list[int]:
    """List the joints before and after a joint; all count from 0."""
    return [i for i in (joint - 1, joint + 1) if 0 <= i < robot.n]


class WithPartner(JointEffect):
    """An effect on joint j by another joint, its partner: the shape constant i.

    i counts from 1; 0 means the previous joint (the next one for joint 1).
    """

    def __init__(
        self, robot: Robot, joints: Sequence[int] | None = None, **shape: float
    ) -> None:
        """Check that each joint is coupled to another one.

        The shape constant i is the joint (from 1) whose motion acts; 0 stands for each
        joint's neighbour. Without ``joints`` the effect acts on all joints but joint i.
        """
        super().__init__(robot, joints, **shape)
        i = self.shape["i"]
        if i != int(i) or not 0 <= i <= robot.n:
            raise InputError(
                f"effect {self.name}: i is a joint from 1 to {robot.n}, not {i:g}",
                "name another joint",
            )
        if joints is None:
            self.joints = tuple(j for j in self.joints if j + 1 != i and robot.n > 1)
        elif any(j + 1 == i for j in self.joints) or robot.n < 2:
            raise InputError(
                f"effect {self.name}: a joint cannot be coupled to itself",
                "name another joint as i",
            )

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
