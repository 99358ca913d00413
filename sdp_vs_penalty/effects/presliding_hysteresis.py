"""Coulomb friction with memory: at a reversal it turns round over a distance."""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np

from sdp_vs_penalty.effects.bristles import Bristles, Remembering, dahl
from sdp_vs_penalty.effects.effect import Array, Block, Motion, OneAJoint
from sdp_vs_penalty.effects.hidden import HiddenEffect, TrueRobot, log_uniform, one_joint
from sdp_vs_penalty.effects.shape import POSITION, Shape


class PreslidingHysteresis(Remembering, OneAJoint):
    name = "presliding_hysteresis"
    equation = "f_h (z - sign(dq)), dz/dq = (1 - z sign(dq)) / d"
    explanation = (
        "Before surfaces slide their asperities bend like springs: after a reversal the friction "
        "needs a travel of about d to change sign. The way back differs from the way there "
        "(hysteresis), which no function of velocity can imitate."
    )
    reference = "Dahl, Aerospace Corp. TR-0158 (1968); AIAA Journal 1976, eq. 5"
    symbol = "f_h"
    units = ("N*m", "N")
    lower = 0.0
    refines: ClassVar[tuple[str, ...]] = ("coulomb_friction",)
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
        return [
            Block(j, np.array([k]), (z[:, k] - motion.sign(j))[:, None])
            for k, j in enumerate(self.joints)
        ]


def hidden(joint: int, true: TrueRobot, rng: np.random.Generator) -> HiddenEffect:
    d = log_uniform(rng, 0.001, 0.02)

    def law(w: TrueRobot, m: Motion) -> Array:
        return bristle(m.t, m.dq[:, joint], d) - w.dry(m.dq[:, joint])

    return one_joint("presliding_hysteresis", joint, law, shape={"d": d})


def bristle(t: Array, v: Array, d: float, stribeck: float = 0.0, vs: float = 1.0) -> Array:
    """Mean bristle torque (N,) over Coulomb's: d z' = v - |v| z / g(v), g = 1 + stribeck exp(-(v/vs)^2).

    Integrated sample by sample with v held between samples (exponential Euler). The start is the
    sliding state, as if the run had begun before the record. For the hidden world alone.
    """
    dt = np.diff(t)
    g = 1.0 + stribeck * np.exp(-((v / vs) ** 2))
    decay = np.exp(-np.abs(v[:-1]) * dt / (d * g[:-1])).tolist()
    target = (np.sign(v[:-1]) * g[:-1]).tolist()
    z = float(np.sign(v[0]) * g[0])
    out = [z]
    for a, goal in zip(decay, target, strict=True):
        z = goal + (z - goal) * a
        out.append(z)
    return np.array(out)
