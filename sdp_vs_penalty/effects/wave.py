"""The base class of torques that repeat along a joint's travel."""

from collections.abc import Iterable
from typing import ClassVar

import numpy as np

from sdp_vs_penalty.effects.effect import Effect, JointCoverage
from sdp_vs_penalty.effects.shape import ShapeConstant, six_digits
from sdp_vs_penalty.robot.robot import Robot

#: Waves that a joint has to travel until a torque is seen to repeat.
WAVES_TO_REPEAT = 2.0
#: Travel of a prismatic joint for which the robot states none [m].
_TRAVEL = 0.5
#: Largest wave number that is tried [rad/m]: that of a screw with a lead of 5 mm.
_FINEST = 2.0 * np.pi / 0.005
#: Most wave numbers that are tried.
_MOST = 200


class Wave(Effect):
    """A torque cos(k q), k of which are the effect's shape constant ``k``: waves per turn
    of a revolute joint [-], rad/m on a prismatic one."""

    #: Prefixes of the cosine's and the sine's amplitude.
    symbols: ClassVar[tuple[str, str]]

    def parameter_names_and_units(self, joint: int) -> Iterable[tuple[str, str]]:
        """Name the cosine's and the sine's amplitude after joint and wave number:
        "a_r3_2", "b_r3_2"."""
        ending = f"{joint + 1}_{self.shape['k']:.6g}"
        return [(f"{symbol}{ending}", self.unit_on(joint)) for symbol in self.symbols]

    @classmethod
    def starts(cls, robot: Robot, joint: int) -> Iterable[dict[str, float]]:
        """List the wave numbers with which a search begins: the grid's per turn; on a
        prismatic joint those that its travel can hold, down to a screw of 5 mm."""
        return [{"k": k} for k in wave_numbers(cls.shapes["k"], robot, joint)]

    def n_waves(self, coverage: JointCoverage) -> float:
        """Return how many waves the effect's joint travelled."""
        return self.shape["k"] * coverage.travel / (2.0 * np.pi)

    def looks_like(self, size: float, coverage: JointCoverage) -> str:
        """Doubt a wave where the joint travelled less than one of it.

        A wave that was fitted (``size`` is not 0) is doubted below two waves too; before
        a fit such a wave is still worth a try.
        """
        n_waves = self.n_waves(coverage)
        is_fitted = size != 0.0
        if n_waves < 1.0:
            return (
                "less than one wave was travelled: all that changes slowly along it"
                " looks so"
            )
        if is_fitted and n_waves < WAVES_TO_REPEAT:
            return (
                "fewer than two waves were travelled, so nothing shows that it repeats: a"
                " spring, a balancer or a cable looks so"
            )
        return ""


def wave_numbers(
    k: ShapeConstant, robot: Robot, joint: int, finest: float = _FINEST
) -> list[float]:
    """List the wave numbers k of cos(k q) that a search tries on a joint (from 0).

    On a revolute joint these are the grid's, waves per turn. On a prismatic joint they
    are spaced by half a wave over its travel (_TRAVEL [m] if it has no limits), from
    one wave over the travel up to ``finest`` [rad/m], _MOST at most.
    """
    moved = robot.joints[joint]
    if moved.kind != "prismatic":
        return list(k.grid)
    travel = moved.upper - moved.lower
    step = np.pi / (travel if 0.0 < travel < np.inf else _TRAVEL)
    numbers = np.arange(2.0 * step, finest, step)[:_MOST].tolist()
    return [six_digits(x) for x in numbers]
