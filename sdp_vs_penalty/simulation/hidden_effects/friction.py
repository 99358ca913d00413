"""Hidden friction: laws of velocity, of load, with memory, of a neighbour."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.effects.effect import Motion
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.simulation.hidden_effects.hidden import Hidden, Maker, World, on_joint, one_column

Array = NDArray[np.float64]


def _velocity_law(
    effect: str, law: Callable[[Array], Array], joint: int, world: World, **details: float
) -> Hidden:
    n = world.robot.n
    return Hidden(
        effect,
        (joint,),
        lambda w, m, a: a * on_joint(joint, n, law(m.dq[:, joint])),
        details={"shape": details},
    )


def _stribeck(joint: int, world: World, rng: np.random.Generator) -> Hidden:
    vs, delta = float(np.exp(rng.uniform(np.log(0.03), np.log(0.25)))), float(rng.choice([1.0, 2.0]))

    def law(v: Array) -> Array:  # the classical curve: F_c + (F_s - F_c) exp(..), less its F_c
        return np.sign(v) * np.exp(-((np.abs(v) / vs) ** delta))

    return _velocity_law("stribeck_friction", law, joint, world, vs=vs, delta=delta)


def _sigmoid(joint: int, world: World, rng: np.random.Generator) -> Hidden:
    v0 = float(np.exp(rng.uniform(np.log(0.03), np.log(0.25))))

    def law(v: Array) -> Array:  # the paper's logistic form, 2 / (1 + exp(-phi_2 v)) - 1
        return 2.0 / (1.0 + np.exp(np.clip(-2.0 * v / v0, -500, 500))) - 1.0 - world.dry(v)

    return _velocity_law("sigmoid_friction", law, joint, world, v0=v0)


def _power(joint: int, world: World, rng: np.random.Generator) -> Hidden:
    alpha = float(rng.uniform(0.3, 0.7) if rng.random() < 0.5 else rng.uniform(1.5, 3.0))
    sign = float(rng.choice([-1.0, 1.0]))

    def law(v: Array) -> Array:
        return sign * np.sign(v) * np.abs(v) ** alpha

    return _velocity_law("power_law_friction", law, joint, world, alpha=alpha)


def _asymmetric(joint: int, world: World, rng: np.random.Generator) -> Hidden:
    forwards = float(rng.choice([-1.0, 1.0]))

    def law(v: Array) -> Array:  # two slopes, one a direction, less their mean
        return np.where(v > 0.0, forwards * v, -forwards * v)

    return _velocity_law("asymmetric_viscous_friction", law, joint, world)


def _hysteresis(joint: int, world: World, rng: np.random.Generator) -> Hidden:
    d = float(np.exp(rng.uniform(np.log(0.001), np.log(0.02))))
    n = world.robot.n

    def torque(w: World, m: Motion, a: float) -> Array:
        z = bristle(m.t, m.dq[:, joint], d, stribeck=0.0, vs=1.0)
        return a * on_joint(joint, n, z - w.dry(m.dq[:, joint]))

    return Hidden("presliding_hysteresis", (joint,), torque, details={"shape": {"d": d}})


def lugre(joint: int, world: World, rng: np.random.Generator) -> Hidden:
    """LuGre friction (Canudas de Wit et al. 1995) in place of Coulomb: another form of hysteresis."""
    d = float(np.exp(rng.uniform(np.log(0.001), np.log(0.01))))
    stribeck, vs = float(rng.uniform(0.0, 0.3)), float(rng.uniform(0.02, 0.1))
    n = world.robot.n

    def torque(w: World, m: Motion, a: float) -> Array:
        v = m.dq[:, joint]
        z = bristle(m.t, v, d, stribeck, vs)
        return a * on_joint(joint, n, z - w.dry(v))

    shape = {"d": d, "stribeck": stribeck, "vs": vs}
    return Hidden("presliding_hysteresis", (joint,), torque, details={"shape": shape, "form": "LuGre"})


def bristle(t: Array, v: Array, d: float, stribeck: float, vs: float) -> Array:
    """Mean bristle torque (N,) over Coulomb's: d z' = v - |v| z / g(v), g = 1 + stribeck exp(-(v/vs)^2).

    Integrated sample by sample with v held between samples (exponential Euler). The start is the
    sliding state, as if the run had begun before the record.
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


def _load_friction(joint: int, world: World, rng: np.random.Generator) -> Hidden:
    n = world.robot.n

    def torque(w: World, m: Motion, a: float) -> Array:
        v = m.dq[:, joint]
        return a * on_joint(joint, n, np.abs(w.torque(m)[:, joint]) * np.sign(v))

    return Hidden("load_dependent_friction", (joint,), torque)


def _coupling(joint: int, world: World, rng: np.random.Generator) -> Hidden:
    n = world.robot.n
    neighbours = [i for i in (joint - 1, joint + 1) if 0 <= i < n]
    if not neighbours:
        raise InputError("effect joint_coupling needs a robot with two joints or more.")
    i, form = int(rng.choice(neighbours)), int(rng.integers(1, 5))
    sign = float(rng.choice([-1.0, 1.0]))

    def torque(w: World, m: Motion, a: float) -> Array:
        own, other = m.dq[:, joint], m.dq[:, i]
        x = other if form == 1 else np.sign({2: other, 3: own + other, 4: own - other}[form])
        return sign * a * on_joint(joint, n, x)

    return Hidden("joint_coupling", (joint,), torque, details={"shape": {"i": i + 1, "form": form}})


FRICTION: dict[str, Maker] = {
    "viscous_friction": one_column("viscous_friction", lambda m, j: m.dq[:, j], replaces=True),
    "coulomb_friction": one_column("coulomb_friction", lambda m, j: np.sign(m.dq[:, j]), replaces=True),
    "asymmetric_viscous_friction": _asymmetric,
    "stribeck_friction": _stribeck,
    "sigmoid_friction": _sigmoid,
    "power_law_friction": _power,
    "load_dependent_friction": _load_friction,
    "presliding_hysteresis": _hysteresis,
    "joint_coupling": _coupling,
}
