"""Friction that can be hidden on a joint; equations and signs as in the sources that are named."""

from collections.abc import Mapping

import numpy as np
from numpy.random import Generator

from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.simulation.worlds.arm import Array
from sdp_vs_penalty.simulation.worlds.hidden import Hidden, Maker, at_joint, log_uniform, plain, sign
from sdp_vs_penalty.simulation.worlds.world import TrueMotion, World, bristles


def _unit(world: World, joint: int) -> float:
    return float(world.arm.unit_speed[joint])


def _stribeck(w: World, j: int, rng: Generator) -> Hidden:
    """Armstrong-Helouvry et al., Automatica 1994, eq. 7."""
    vs = _unit(w, j) * log_uniform(rng, 0.04, 0.3)

    def law(w: World, m: TrueMotion) -> Array:
        return sign(w, j, m) * np.exp(-((m.dq[:, j] / vs) ** 2))

    return at_joint(j, law, vs=vs, delta=2.0)


def _presliding(w: World, j: int, rng: Generator) -> Hidden:
    return dahl(w, j, log_uniform(rng, 0.001, 0.01))


def dahl(w: World, j: int, travel: float) -> Hidden:
    """Dahl 1968: friction follows the travel since the reversal instead of jumping."""
    d = _unit(w, j) * travel
    return at_joint(j, lambda w, m: _behind(m.t, m.dq[:, j], d) - sign(w, j, m), d=d)


def _behind(t: Array, speed: Array, d: float) -> Array:
    """(N,) Dahl's state along a motion of this speed."""
    return bristles(t, speed[:, None], np.array([d]), np.ones_like)[:, 0]


def _sigmoid(w: World, j: int, rng: Generator) -> Hidden:
    """Gaz et al., RA-L 2019, eq. 9: part of the Coulomb friction rises slowly."""
    v0 = _unit(w, j) * log_uniform(rng, 0.05, 0.3)
    return at_joint(j, lambda w, m: np.tanh(m.dq[:, j] / v0) - sign(w, j, m), v0=v0)


def _power(w: World, j: int, rng: Generator) -> Hidden:
    alpha = float(rng.uniform(0.3, 0.7) if rng.random() < 0.5 else rng.uniform(1.5, 2.5))
    return at_joint(j, lambda w, m: np.sign(m.dq[:, j]) * np.abs(m.dq[:, j]) ** alpha, alpha=alpha)


def _coupling(w: World, j: int, rng: Generator) -> Hidden:
    """Janot et al., IEEE TCST 2014; between turning joints, as wrists are."""
    if w.arm.n < 2:
        raise InputError("effect joint_coupling needs a robot with two joints or more", "leave it out")
    i = j - 1 if j > 0 else 1
    form, side = int(rng.integers(1, 5)), float(rng.choice([-1.0, 1.0]))
    width = float(np.median(w.dry.width))

    def law(w: World, m: TrueMotion) -> Array:
        own, other = m.dq[:, j], m.dq[:, i]
        speed = {3: own + other, 4: own - other}.get(form, other)
        return np.asarray(side * (speed if form == 1 else np.tanh(speed / width)))

    return at_joint(j, law, side, i=float(i + 1), form=float(form))


def _warming(w: World, j: int, rng: Generator) -> Hidden:
    """Simoni et al., IROS 2015: friction that falls with time."""
    T, form = float(rng.uniform(40.0, 150.0)), int(rng.choice([2, 4]))

    def law(w: World, m: TrueMotion) -> Array:
        return np.exp(-m.t / T) * (sign(w, j, m) if form == 2 else m.dq[:, j])

    return at_joint(j, law, None, form=float(form), T=T)


def _by_temperature(w: World, j: int, rng: Generator) -> Hidden:
    """Carlson, Robertsson, Johansson, 2015: grease thins exponentially with its temperature."""
    warm, viscous = float(rng.uniform(8.0, 40.0)), bool(rng.random() < 0.5)

    def law(w: World, m: TrueMotion) -> Array:
        thick = np.exp((20.0 - w.temperature(m.t)[:, j]) / warm)
        return np.asarray(thick * (m.dq[:, j] if viscous else sign(w, j, m)))

    return at_joint(j, law, law=1.0 + viscous, by=1.0, warm=warm)


def _transmission(w: World, j: int, rng: Generator) -> Hidden:
    """A motor of a differential wrist turns with a combination of two neighbours (Wang et al. 2019).

    Dry friction only: of the viscous kind the joints' own friction absorbs all but a cross term, from
    which no ratio can be told."""
    pairs = [i for i in range(w.arm.n - 1) if w.arm.rotary[i : i + 2].all()]
    if not pairs:
        raise InputError("effect transmission_friction needs neighbours that turn", "leave it out")
    first = min(pairs, key=lambda i: abs(i - j))
    law, ratio = int(rng.choice([2, 3, 4])), float(rng.choice([-2.0, -1.0, -0.5, 0.5, 1.0, 2.0]))
    d, vs = log_uniform(rng, 0.002, 0.01), log_uniform(rng, 0.05, 0.25)
    width, c = float(np.median(w.dry.width)), np.zeros(w.arm.n)
    c[first], c[first + 1] = 1.0, ratio

    def change(w: World, m: TrueMotion, size: float) -> Array:
        v = m.dq @ c
        rubs = np.tanh(v / width) * (np.exp(-((v / vs) ** 2)) if law == 4 else 1.0)
        return np.outer(size * (_behind(m.t, v, d) if law == 3 else rubs), c)

    own = {3: {"d": d}, 4: {"vs": vs}}.get(law, {})
    shape = {f"c{first + 1}": 1.0, f"c{first + 2}": ratio, "law": float(law), **own}
    return Hidden((first, first + 1), change, 1.0, shape)


def _load_hysteresis(w: World, j: int, rng: Generator) -> Hidden:
    """Friction of loaded teeth with Dahl's memory."""
    d = _unit(w, j) * log_uniform(rng, 0.002, 0.01)
    return at_joint(j, lambda w, m: np.abs(w.rigid(m)[:, j]) * _behind(m.t, m.dq[:, j], d), d=d)


def _slip(w: World, j: int, rng: Generator) -> Hidden:
    """Al-Bender et al., IEEE TAC 2005: springs in parallel, each with a slider of its own travel."""
    d = _unit(w, j) * log_uniform(rng, 0.001, 0.004)
    travel, weight = d * np.array([1.0, 4.0, 16.0]), rng.dirichlet(np.ones(3))

    def law(w: World, m: TrueMotion) -> Array:
        out, z = np.zeros(len(m.t)), np.zeros(3)
        for k, step in enumerate(np.diff(m.q[:, j]), start=1):
            z = np.clip(z + step / travel, -1.0, 1.0)
            out[k] = weight @ z
        return out

    return at_joint(j, law, None, d=d)


def _position(w: World, j: int, rng: Generator) -> Hidden:
    """Popovic, Goldenberg 1998: dry friction that varies along the range."""
    phase = float(rng.uniform(0.0, 2.0 * np.pi))
    k = float(rng.integers(1, 4)) if w.arm.rotary[j] else 2.0 * np.pi / float(rng.uniform(0.05, 0.15))
    return at_joint(j, lambda w, m: np.cos(k * m.q[:, j] + phase) * sign(w, j, m), None, k=k)


#: By the library's name of each.
FRICTION: Mapping[str, Maker] = {
    "viscous_friction": plain(lambda w, j, m: m.dq[:, j]),
    "coulomb_friction": plain(sign),
    # A size for each direction: Armstrong-Helouvry et al., Automatica 1994, sec. 2.
    "asymmetric_viscous_friction": plain(lambda w, j, m: np.abs(m.dq[:, j]), signed=True),
    "asymmetric_coulomb_friction": plain(lambda w, j, m: np.abs(sign(w, j, m)), signed=True),
    "stribeck_friction": _stribeck,
    "presliding_hysteresis": _presliding,
    "sigmoid_friction": _sigmoid,
    "power_law_friction": _power,
    # In proportion to the torque that the gear transmits: Hamon, Gautier, Garrec, IROS 2010.
    "load_dependent_friction": plain(lambda w, j, m: np.abs(w.rigid(m)[:, j]) * sign(w, j, m)),
    "joint_coupling": _coupling,
    "drift_friction": _warming,
    "warming_friction": _by_temperature,
    "transmission_friction": _transmission,
    "load_dependent_hysteresis": _load_hysteresis,
    "maxwell_slip": _slip,
    "position_dependent_friction": _position,
}
