"""Friction of many asperities that give way one after the other."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from sdp_vs_penalty.effects.effect import Array, Block, Effect, Motion, Parameter
from sdp_vs_penalty.effects.hidden import Hidden, World, log_uniform, on_joint
from sdp_vs_penalty.effects.shape import POSITION, Shape

#: Elements side by side, and how many times farther the next one bends before it slips.
_ELEMENTS, _SPACING = 3, 4.0


class MaxwellSlip(Effect):
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
    has_memory = True
    shapes = {
        "d": Shape(0.002, POSITION, grid=(0.0005, 0.001, 0.002, 0.004, 0.008), bounds=(0.0002, 0.05))
    }

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return tuple(
            Parameter(f"{self.symbol}{j + 1}_{i + 1}", self.robot.torque_units[j], self.name, j + 1, 0.0)
            for j in self.joints
            for i in range(_ELEMENTS)
        )

    def blocks(self, motion: Motion) -> list[Block]:
        distances = self.shape["d"] * _SPACING ** np.arange(_ELEMENTS)
        out = []
        for k, j in enumerate(self.joints):
            q, start = motion.q[:, j], float(motion.sign(j)[0])
            columns = np.column_stack([stop(q, d, start) for d in distances])
            out.append(Block(j, _ELEMENTS * k + np.arange(_ELEMENTS), columns))
        return out


def stop(q: Array, d: float, start: float = 0.0) -> Array:
    """Spring and slider in series, z (N,) in [-1, 1] along positions q (N,), z[0] = start.

    Exact for motion that is monotone between samples: from one reversal to the next the state is the
    straight line of its spring, cut off at +-1. One step of the loop a reversal, not a sample.
    """
    z = np.full(len(q), start)
    direction = np.sign(np.diff(q))
    moving = np.flatnonzero(direction)
    turns = moving[np.flatnonzero(np.diff(direction[moving])) + 1]
    for first, last in pairwise([0, *turns.tolist(), len(q) - 1]):
        z[first : last + 1] = np.clip(z[first] + (q[first : last + 1] - q[first]) / d, -1.0, 1.0)
    return z


def hidden(joint: int, world: World, rng: np.random.Generator) -> Hidden:
    d, share = log_uniform(rng, 0.001, 0.01), rng.dirichlet(np.ones(_ELEMENTS))

    def torque(w: World, m: Motion, size: float) -> Array:
        travel = np.diff(m.q[:, joint]).tolist()
        total = np.zeros(len(m.t))
        for i, weight in enumerate(share):  # sample by sample, as a slider is dragged along
            reach = d * _SPACING**i
            force = reach * float(np.sign(m.dq[0, joint]))
            course = [force]
            for step in travel:
                force = max(-reach, min(reach, force + step))
                course.append(force)
            total += weight * np.array(course) / reach
        return size * on_joint(joint, w.robot.n, total)

    size = float(np.linalg.norm(share))
    return Hidden(
        "maxwell_slip",
        (joint,),
        torque,
        details={"shape": {"d": d}},
        unit=size,
        theta=tuple(float(x) for x in share),
    )
