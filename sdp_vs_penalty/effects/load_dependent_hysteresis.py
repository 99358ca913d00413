"""Friction with memory that grows with the load."""

import numpy as np

from sdp_vs_penalty.effects.effect import Array, Block, Motion
from sdp_vs_penalty.effects.presliding_hysteresis import PreslidingHysteresis


class LoadDependentHysteresis(PreslidingHysteresis):
    name = "load_dependent_hysteresis"
    equation = "f_lh |tau_l| z, tau_l the links' torque, dz/dq = (1 - z sign(dq)) / d"
    explanation = (
        "Teeth that are pressed harder rub more, and at a reversal their friction turns round over a "
        "travel of about d: load-dependent friction with Dahl's memory. f_lh is the share of the "
        "transmitted torque that is lost once the teeth slide; then it only takes energy. Before, they "
        "are a spring whose stiffness follows the load."
    )
    reference = "Dahl, AIAA Journal 1976, eq. 5; load: Hamon, Gautier, Garrec, IROS 2010"
    symbol = "f_lh"
    units = ("-", "-")
    #: Where the load hardly changes, or is mostly friction itself, the two make the same torque.
    refines = ("presliding_hysteresis", "stiction", "coulomb_friction")
    at_rest = ""
    needs_links = True

    def blocks_at(self, motion: Motion, z: Array) -> list[Block]:
        load = np.abs(motion.link_torque)
        return self.apart([load[:, j] * x for j, x in zip(self.joints, z.T, strict=True)])
