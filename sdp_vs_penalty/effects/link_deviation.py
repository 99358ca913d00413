"""Base of the effects that put a link elsewhere than the encoder says."""

from abc import abstractmethod

import numpy as np

from sdp_vs_penalty.effects.effect import Array, Motion, OneAJoint


class LinkDeviation(OneAJoint):
    """One parameter a joint j; its columns act on every joint whose torque depends on that of j."""

    needs_links = spreads = True

    @abstractmethod
    def deviated(self, motion: Motion, joint: int) -> Array:
        """(N, n) torque on all joints from one unit of the deviation of ``joint``."""

    def torques(self, motion: Motion) -> Array:
        return np.stack([self.deviated(motion, j) for j in self.joints], axis=2)
