"""Coulomb friction with memory: at a reversal it turns round over a distance."""

from typing import ClassVar, Literal

import numpy as np

from sdp_vs_penalty.effects.bristles import Bristles, Remembering, dahl
from sdp_vs_penalty.effects.effect import Array, Block, JointEffect, Motion
from sdp_vs_penalty.effects.shape import POSITION, Shape


class PreslidingHysteresis(Remembering, JointEffect):
    name = "presliding_hysteresis"
    equation = "f_h (z - sign(dq)), dz/dq = (1 - z sign(dq)) / d"
    explanation = (
        "Before surfaces slide their asperities bend like springs: after a reversal the friction "
        "needs a travel of about d to change sign. The way back differs from the way there "
        "(hysteresis), which no function of velocity can imitate."
    )
    reference = "Dahl, Aerospace Corp. TR-0158 (1968); AIAA Journal 1976, eq. 5"
    symbol = "f_h"
    lower = 0.0
    refines: tuple[str, ...] = ("coulomb_friction",)
    at_rest: ClassVar[Literal["", "holds", "turns"]] = "turns"
    shapes = {
        "d": Shape(
            0.003,
            POSITION,
            grid=(0.0001, 0.0005, 0.001, 0.002, 0.004, 0.008, 0.016, 0.032),
            bounds=(0.00005, 0.05),
        )
    }

    @property
    def bristles(self) -> Bristles:
        joints = list(self.joints)
        return Bristles(np.eye(self.robot.n)[joints], np.full(len(joints), self.shape["d"]), dahl)

    def blocks_at(self, motion: Motion, z: Array) -> list[Block]:
        return self.apart([x - motion.sign(j) for j, x in zip(self.joints, z.T, strict=True)])
