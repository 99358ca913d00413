"""Coulomb friction with memory: at a reversal it turns round over a distance."""

from __future__ import annotations

import numpy as np

from sdp_vs_penalty.effects.effect import Array, JointEffect, Motion, position_unit


class PreslidingHysteresis(JointEffect):
    name = "presliding_hysteresis"
    equation = "f_h (z - sign(dq)), dz/dq = (1 - z sign(dq)) / d"
    explanation = (
        "Before surfaces slide their asperities bend like springs: after a reversal the friction "
        "needs a travel of about d to turn round. The path back differs from the path there "
        "(hysteresis), which no function of velocity can imitate."
    )
    reference = "Dahl, Aerospace Corp. TR-0158 (1968); AIAA Journal 1976, eq. 5"
    symbol = "f_h"
    units = ("N*m", "N")
    lower = 0.0
    refines = ("coulomb_friction",)
    has_memory = True
    shape_defaults = {"d": 0.003}
    shape_grid = {"d": (0.0005, 0.001, 0.002, 0.004, 0.008, 0.016, 0.032)}
    shape_bounds = {"d": (0.0002, 0.05)}

    def column(self, motion: Motion, joint: int) -> Array:
        sign = motion.sign(joint)
        return dahl(motion.q[:, joint], self.shape["d"], float(sign[0])) - sign

    def shape_unit(self, key: str, joint: int) -> str:
        return position_unit(self.robot, joint)


def dahl(q: Array, d: float, start: float = 0.0) -> Array:
    """Dahl's friction state z (N,) in [-1, 1] along positions q (N,), z[0] = start.

    Exact for motion that is monotone between samples: while q runs in direction s,
    z = s + (z_0 - s) exp(-|q - q_0| / d). One step of the loop a reversal, not a sample.
    """
    z = np.empty(len(q))
    z[0] = start
    step = np.diff(q)
    moving = np.flatnonzero(step)
    if not len(moving):
        z[:] = start
        return z
    # The direction of each step; a step of zero goes with the one before it.
    last = np.maximum.accumulate(np.where(step != 0.0, np.arange(len(step)), moving[0]))
    direction = np.sign(step[last])
    turns = np.flatnonzero(np.diff(direction)) + 1
    for first, stop in zip([0, *turns], [*turns, len(step)], strict=True):
        s = direction[first]
        travel = np.abs(q[first + 1 : stop + 1] - q[first])
        z[first + 1 : stop + 1] = s + (z[first] - s) * np.exp(-travel / d)
    return z
