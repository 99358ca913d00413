"""What no effect of the library is: torques of the state, and what happens beside the motion."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.robot._pinocchio import pin
from sdp_vs_penalty.simulation.worlds.hidden import Hidden, at_joint
from sdp_vs_penalty.simulation.worlds.motion import Motion
from sdp_vs_penalty.simulation.worlds.world import LEAD, World, start_of

Array = NDArray[np.float64]
Generator = np.random.Generator


def unknown(w: World, j: int, rng: Generator) -> Hidden:
    """A function of the state that is not in the library."""
    i = int(rng.choice([k for k in range(w.arm.n) if k != j]))
    c = float(rng.uniform(-0.5, 0.5))
    # On a prismatic joint a wave of q would be a straight line: as many waves as on a turning one.
    s = 1.0 / w.arm.unit_speed if w.arm.rotary[j] else 8.0 * np.ones(w.arm.n)

    laws: Mapping[str, Callable[[Motion], Array]] = {
        "q dq": lambda m: m.q[:, j] * m.dq[:, j],
        "cos(2 q_i) sign(dq_j)": lambda m: np.cos(2.0 * s[i] * m.q[:, i] + c) * np.sign(m.dq[:, j]),
        "sin(2 q_j + 3 q_i)": lambda m: np.sin(2.0 * s[j] * m.q[:, j] + 3.0 * m.q[:, i] + c),
        "q_i dq_j": lambda m: m.q[:, i] * m.dq[:, j],
        "dq_i |dq_j|": lambda m: m.dq[:, i] * np.abs(m.dq[:, j]),
        "bumps of q": lambda m: np.exp(20.0 * (np.cos(2.0 * s[j] * m.q[:, j] - c) - 1.0)),
        "dq ddq": lambda m: m.dq[:, j] * m.ddq[:, j],
    }
    name = str(rng.choice(sorted(laws)))
    law = laws[name]
    return at_joint(f"unknown: {name}", j, lambda _, m: law(m))


def disturbance(w: World, j: int, rng: Generator) -> Hidden:
    """A contact, a knock, or a hum that the motion does not follow."""
    kind = str(rng.choice(["contact", "knock", "hum"]))
    c = w.conditions
    run = int(rng.integers(c.runs))
    begin = start_of(c, run) + LEAD + float(rng.uniform(0.15, 0.85)) * c.duration
    length = float(
        {"contact": rng.uniform(0.3, 2.0), "knock": rng.uniform(0.05, 0.15), "hum": 0.0}[kind]
    )
    frequency, phase = float(rng.uniform(1.0, 7.0)), float(rng.uniform(0.0, 2.0 * np.pi))
    force = np.concatenate([rng.normal(size=3), 0.1 * rng.normal(size=3)])

    def change(w: World, m: Motion, size: float) -> Array:
        out = np.zeros_like(m.q)
        if kind == "hum":
            out[:, j] = size * np.sin(2.0 * np.pi * frequency * m.t + phase)
        inside = np.flatnonzero((m.t >= begin) & (m.t < begin + length))
        if kind == "knock":
            out[inside, j] = size * np.exp(-3.0 * (m.t[inside] - begin) / length)
        if kind == "contact":
            data, last = w.built.createData(), w.built.njoints - 1
            for k in inside:
                pin.computeJointJacobians(w.built, data, m.q[k])
                J = pin.getJointJacobian(w.built, data, last, pin.LOCAL_WORLD_ALIGNED)
                out[k] = size * np.sin(np.pi * (m.t[k] - begin) / length) * (J.T @ force)
        return out

    details = {"kind": kind, "t_start": begin, "t_end": begin + length}
    return Hidden(f"disturbance: {kind}", (j,), change, None, details=details)
