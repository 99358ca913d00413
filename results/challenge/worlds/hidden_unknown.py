"""What no effect of the library is: torques of the state, and what happens beside the
motion."""

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
from numpy.random import Generator

from challenge.worlds.conditions import Site
from challenge.worlds.runs import LEAD, start_of
from sdp_vs_penalty.simulation.worlds.hidden import Hidden, at_joint
from sdp_vs_penalty.simulation.worlds.world import Array, TrueMotion, World

#: The torque at size 1, and its variables as findings.json writes them.
Law = tuple[Callable[[TrueMotion], Array], tuple[str, ...]]


def _of_states(w: World, j: int, i: int, c: float, k: float) -> dict[str, Law]:
    """Of joint j, and of another one i with it; k waves in a turn."""
    s = w.arm.unit_speed
    ti = 1.0 if w.arm.rotary[i] else 5.0
    (q, dq, ddq), (qi, dqi) = (
        (f"{x}{j + 1}" for x in ("q", "dq", "ddq")),
        (f"q{i + 1}", f"dq{i + 1}"),
    )
    return {
        "bumps of q": (
            lambda m: np.exp(20.0 * (np.cos(k * m.q[:, j] - c) - 1.0)),
            (q,),
        ),
        "cos(2 q_i) sign(dq_j)": (
            lambda m: np.cos(2.0 * m.q[:, i] / s[i] + c) * np.sign(m.dq[:, j]),
            (qi, f"sign(dq{j + 1})"),
        ),
        "dq ddq": (lambda m: m.dq[:, j] * m.ddq[:, j], (dq, ddq)),
        "dq_i |dq_j|": (lambda m: m.dq[:, i] * np.abs(m.dq[:, j]), (dqi, dq)),
        "q dq": (lambda m: m.q[:, j] * m.dq[:, j], (q, dq)),
        "q_i dq_j": (lambda m: m.q[:, i] * m.dq[:, j], (qi, dq)),
        "sin(k q_j + 3 q_i)": (
            lambda m: np.sin(k * m.q[:, j] + 3.0 * ti * m.q[:, i] + c),
            (q, qi),
        ),
    }


def _other(w: World, j: int, rng: Generator) -> tuple[int, float]:
    """Another joint, and a phase."""
    return int(rng.choice([k for k in range(w.arm.n) if k != j])), float(
        rng.uniform(-0.5, 0.5)
    )


def unknown(w: World, j: int, rng: Generator) -> Hidden:
    """A function of the state that is not in the library."""
    laws = _of_states(w, j, *_other(w, j, rng), 2.0 if w.arm.rotary[j] else 16.0)
    name = str(rng.choice(sorted(laws)))
    return replace(
        at_joint(j, lambda _, m: laws[name][0](m)), effect=f"unknown: {name}"
    )


def nameless(w: Site, j: int, rng: Generator) -> Hidden:
    """A torque that no effect of the library is, over what a curve can show: position,
    load, velocity, acceleration, a combination of joints, or a pair of them, periodic
    or not.

    details : "of", its variables as findings.json writes them.
    """
    i, c = _other(w, j, rng)
    s = w.arm.unit_speed
    k = float(rng.uniform(2.0, 4.0)) * (1.0 if w.arm.rotary[j] else 8.0)
    v = float(rng.uniform(0.2, 0.5)) * s[j]
    q, dq, ddq, tau = (f"{name}{j + 1}" for name in ("q", "dq", "ddq", "tau"))
    load = 1e-2 / max(w.arm.noise[j], 1e-9)
    laws: Mapping[str, Law] = {
        **_of_states(w, j, i, c, k),
        "q^3": (lambda m: (m.q[:, j] / s[j]) ** 3, (q,)),
        "tanh of q": (lambda m: np.tanh(5.0 * m.q[:, j] / s[j]), (q,)),
        "load squared": (lambda m: (t := load * w.torque(m)[:, j]) * np.abs(t), (tau,)),
        "bump of dq": (lambda m: np.exp(-(((m.dq[:, j] - v) / (0.5 * v)) ** 2)), (dq,)),
        "|ddq|": (lambda m: np.abs(m.ddq[:, j]), (ddq,)),
        "tau dq": (lambda m: load * w.torque(m)[:, j] * m.dq[:, j], (tau, dq)),
        **_of_turns(w, j, rng),
    }
    name = str(rng.choice(sorted(laws)))
    law, of = laws[name]
    hidden = at_joint(j, lambda _, m: law(m))
    return replace(hidden, effect=f"nameless: {name}", details={"of": list(of)})


def _of_turns(w: World, j: int, rng: Generator) -> Mapping[str, Law]:
    """Of a combination of neighbours, as behind a differential; of the teeth of a
    wheel."""
    a = max(j - 1, 0)
    if not w.arm.rotary[a : a + 2].all():
        return {}
    ratio = float(rng.choice([-2.0, -1.0, 1.0, 2.0]))
    k = float(rng.integers(5, 13))
    c = float(rng.uniform(-3.0, 3.0))
    wide = 0.2 * float(w.arm.unit_speed[a : a + 2].sum())
    sign = "-" if ratio < 0.0 else "+"
    size = "" if abs(ratio) == 1.0 else f"{abs(ratio):g}"
    both = f"q{a + 1}{sign}{size}q{a + 2}"
    return {
        "tanh of q_i + c q_j": (
            lambda m: np.tanh((m.q[:, a] + ratio * m.q[:, a + 1]) / wide),
            (both,),
        ),
        "teeth": (
            lambda m: np.exp(3.0 * (np.cos(k * m.q[:, j] - c) - 1.0)),
            (f"q{j + 1}",),
        ),
    }


def disturbance(w: Site, j: int, rng: Generator) -> Hidden:
    """A contact, a knock, or a hum that the motion does not follow."""
    kind = str(rng.choice(["contact", "knock", "hum"]))
    c = w.conditions
    run = int(rng.integers(c.runs))
    begin = start_of(c, run) + LEAD + float(rng.uniform(0.15, 0.85)) * c.duration
    lengths = {
        "contact": rng.uniform(0.3, 2.0),
        "knock": rng.uniform(0.05, 0.15),
        "hum": 0.0,
    }
    length = float(lengths[kind])
    frequency = float(rng.uniform(1.0, 7.0))
    phase = float(rng.uniform(0.0, 2.0 * np.pi))
    force = np.concatenate([rng.normal(size=3), 0.1 * rng.normal(size=3)])

    def change(w: World, m: TrueMotion, size: float) -> Array:
        out = np.zeros_like(m.q)
        if kind == "hum":
            out[:, j] = size * np.sin(2.0 * np.pi * frequency * m.t + phase)
        inside = np.flatnonzero((m.t >= begin) & (m.t < begin + length))
        if kind == "knock":
            out[inside, j] = size * np.exp(-3.0 * (m.t[inside] - begin) / length)
        if kind == "contact":
            data = w.built.createData()
            for k in inside:
                J = w.arm.last_jacobian(w.built, data, m.q[k])
                out[k] = (
                    size * np.sin(np.pi * (m.t[k] - begin) / length) * (J.T @ force)
                )
        return out

    details = {"kind": kind, "t_start": begin, "t_end": begin + length}
    return Hidden((j,), change, None, details=details, effect=f"disturbance: {kind}")
