"""Base of the effects that put a link elsewhere than the encoder says."""

from __future__ import annotations

from abc import abstractmethod

import numpy as np

from sdp_vs_penalty.effects.effect import Array, Block, Effect, Motion, Parameter


class LinkDeviation(Effect):
    """One parameter a joint j; its columns act on every joint whose torque depends on that of j."""

    symbol: str
    units: tuple[str, str]
    lower: float = -np.inf
    needs_links = True

    @abstractmethod
    def torques(self, motion: Motion, joint: int) -> Array:
        """(N, n) torque on all joints from one unit of the deviation of ``joint``."""

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return tuple(
            Parameter(
                f"{self.symbol}{j + 1}",
                self.units[self.robot.joints[j].kind == "prismatic"],
                self.name,
                j + 1,
                self.lower,
            )
            for j in self.joints
        )

    def blocks(self, motion: Motion) -> list[Block]:
        torques = [self.torques(motion, j) for j in self.joints]
        everyone = np.arange(len(self.joints))
        return [
            Block(i, everyone, np.column_stack([t[:, i] for t in torques]))
            for i in range(self.robot.n)
            if torques
        ]
