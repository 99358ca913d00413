"""Friction of many asperities that give way one after the other."""

from collections.abc import Iterable

import numpy as np

from sdp_vs_penalty.effects.bristles import Bristles, Remembering, stop
from sdp_vs_penalty.effects.effect import Array, Block, JointEffect, Motion
from sdp_vs_penalty.effects.shape import POSITION, Shape

#: Elements side by side, and how many times farther the next one bends before it slips.
_ELEMENTS, _SPACING = 3, 4.0


class MaxwellSlip(Remembering, JointEffect):
    name = "maxwell_slip"
    equation = "sum_i f_m,i z_i, dz_i/dq = 1 / d_i while |z_i| < 1, d_i = d, 4 d, 16 d"
    explanation = (
        "Springs side by side, each with a slider that gives way at its own distance: after a reversal "
        "the friction turns round over several scales, where Dahl's curve has one. Every element is "
        "passive for f_m,i >= 0. What depends on speed once all slip is stribeck_friction's."
    )
    reference = "Al-Bender, Lampaert, Swevers, IEEE TAC 2005 (generalized Maxwell-slip), sec. III"
    symbol = "f_m"
    refines = ("presliding_hysteresis", "coulomb_friction")
    at_rest = "turns"
    shapes = {
        "d": Shape(
            0.002, POSITION, grid=(0.0001, 0.0005, 0.001, 0.002, 0.004, 0.008), bounds=(0.00005, 0.05)
        )
    }

    lower = 0.0

    def named(self, joint: int) -> Iterable[tuple[str, str]]:
        own, unit = self.parameter_name(joint), self.unit_on(joint)
        return [(f"{own}_{i + 1}", unit) for i in range(_ELEMENTS)]

    @property
    def bristles(self) -> Bristles:
        directions = np.repeat(np.eye(self.robot.n)[list(self.joints)], _ELEMENTS, axis=0)
        distances = self.shape["d"] * _SPACING ** np.arange(_ELEMENTS)
        return Bristles(directions, np.tile(distances, len(self.joints)), stop)

    def blocks_at(self, motion: Motion, z: Array) -> list[Block]:
        return self.apart(np.split(z, len(self.joints), axis=1))
