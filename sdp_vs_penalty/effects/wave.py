"""What torques share that repeat along a joint's way."""

import numpy as np

from sdp_vs_penalty.effects.effect import Effect, JointCoverage

#: Waves that a joint has to travel until a torque is seen to repeat.
WAVES_TO_REPEAT = 2.0


class Wave(Effect):
    """A torque cos(k q), k of which are the effect's shape constant ``k``: waves per turn
    of a revolute joint [-], rad/m on a prismatic one."""

    def n_waves(self, coverage: JointCoverage) -> float:
        """Return how many waves the effect's joint travelled."""
        return self.shape["k"] * coverage.travel / (2.0 * np.pi)

    def looks_like(self, size: float, coverage: JointCoverage) -> str:
        """Doubt a wave where the joint travelled less than one of it, and one with a
        size where it travelled fewer than two: without a size it is still worth a try.
        """
        n_waves = self.n_waves(coverage)
        if n_waves < 1.0:
            return (
                "less than one wave was travelled: all that changes slowly along it"
                " looks so"
            )
        if size != 0.0 and n_waves < WAVES_TO_REPEAT:
            return (
                "fewer than two waves were travelled, so nothing shows that it repeats: a"
                " spring, a balancer or a cable looks so"
            )
        return ""
