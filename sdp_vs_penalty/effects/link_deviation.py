"""Base of the effects that put a link elsewhere than the encoder says."""

from __future__ import annotations

from abc import abstractmethod

import numpy as np

from sdp_vs_penalty.effects.effect import Array, Block, Motion, OneAJoint


class LinkDeviation(OneAJoint):
    """One parameter a joint j; its columns act on every joint whose torque depends on that of j."""

    needs_links = spreads = True

    @abstractmethod
    def torques(self, motion: Motion, joint: int) -> Array:
        """(N, n) torque on all joints from one unit of the deviation of ``joint``."""

    def blocks(self, motion: Motion) -> list[Block]:
        torques = [self.torques(motion, j) for j in self.joints]
        everyone = np.arange(len(self.joints))
        return [
            Block(i, everyone, np.column_stack([t[:, i] for t in torques]))
            for i in range(self.robot.n)
            if torques
        ]
