"""What else a machine does to its torque: gears, springs, sensors, mounting, loads."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.random import Generator

from sdp_vs_penalty.robot._pinocchio import pin
from sdp_vs_penalty.simulation.worlds.arm import Array, misplaced
from sdp_vs_penalty.simulation.worlds.hidden import (
    Hidden,
    Maker,
    at_joint,
    displaced,
    first_order,
    log_uniform,
    plain,
    shifted,
)
from sdp_vs_penalty.simulation.worlds.hidden_friction import dahl
from sdp_vs_penalty.simulation.worlds.world import TrueMotion, World


def _drift(w: World, j: int, rng: Generator) -> Hidden:
    """A sensor's zero that creeps as it warms."""
    T = float(rng.uniform(40.0, 150.0))
    return at_joint(j, lambda _, m: np.exp(-m.t / T), None, form=2.0, T=T)


def _ripple(w: World, j: int, rng: Generator) -> Hidden:
    """Teeth and poles: 2 to 40 waves a turn; a prismatic joint's screw has a lead of 8 to 70 mm."""
    phase = float(rng.uniform(0.0, 2.0 * np.pi))
    turns = float(rng.integers(2, 41))
    k = turns if w.arm.rotary[j] else 2.0 * np.pi / float(rng.uniform(0.008, 0.07))
    return at_joint(j, lambda _, m: np.cos(k * m.q[:, j] + phase), k=k)


def _late(channels: list[int], joints: tuple[int, ...]) -> Hidden:
    """Torques logged late."""

    def change(w: World, m: TrueMotion, size: float) -> Array:
        tau = w.torque(m)
        out = np.zeros_like(tau)
        for j in channels:
            out[:, j] = np.interp(m.t - size, m.t, tau[:, j]) - tau[:, j]
        return out

    return Hidden(joints, change, size=1e-3)


def _filter(w: World, j: int, rng: Generator) -> Hidden:
    """All channels behind one low-pass, 1 / (1 + T s): the size is T."""

    def change(w: World, m: TrueMotion, T: float) -> Array:
        # Effects are sized on a coarse grid, where a filter is read from a finer one.
        t = np.arange(m.t[0], m.t[-1], min(float(m.t[1] - m.t[0]), 0.25e-3))
        tau = w.torque(m)
        fine = np.column_stack([np.interp(t, m.t, x) for x in tau.T])
        passed = first_order(fine, float(t[1] - t[0]), T)
        return np.column_stack([np.interp(m.t, t, x) for x in passed.T]) - tau

    return Hidden((), change, size=1e-3)


def _zero_error(w: World, j: int, rng: Generator) -> Hidden:
    side = float(rng.choice([-1.0, 1.0]))
    hidden = shifted(j, lambda _, m, a: np.full(len(m.t), a * side), side)
    return replace(hidden, size=1e-3)


def _elasticity(w: World, j: int, rng: Generator) -> Hidden:
    """Spong 1987, the link at rest on its spring: it lags by c times the torque that it needs."""

    def shift(w: World, m: TrueMotion, c: float) -> Array:
        lag = np.zeros(len(m.t))
        for _ in range(2):
            lag = -c * w.rigid(displaced(m, j, lag))[:, j]
        return lag

    return replace(shifted(j, shift, 1.0), size=1e-5)


def _backlash(w: World, j: int, rng: Generator) -> Hidden:
    """Nordin, Gutman 2002: between impacts the link rests on the flank that its torque presses it to.

    Flanks that yield a little let it change over within a fiftieth of the largest torque; what the
    impact itself does is left out."""

    def shift(w: World, m: TrueMotion, b: float) -> Array:
        tau = w.rigid(m)[:, j]
        return np.asarray(-b * np.tanh(50.0 * tau / max(np.abs(tau).max(), 1e-9)))

    def change(w: World, m: TrueMotion, b: float) -> Array:
        q = m.q.copy()
        q[:, j] += shift(w, m, b)
        return w.rigid(replace(m, q=q)) - w.rigid(m)

    return Hidden((j,), change, 1.0, size=1e-4, shift=shift)


def _tilt(w: World, j: int, rng: Generator) -> Hidden:
    angle = float(rng.uniform(0.0, 2.0 * np.pi))

    def change(w: World, m: TrueMotion, size: float) -> Array:
        tilted = pin.Model(w.built)
        across = size * np.array([np.cos(angle), np.sin(angle), 0.0])
        tilted.gravity.linear = w.built.gravity.linear + across
        return w.rigid(m, tilted) - w.rigid(m)

    return Hidden((), change, 1.0, size=0.1)


def _wrench(w: World, j: int, rng: Generator) -> Hidden:
    """A constant force and moment on the last link, at its joint: motors carry -J^T (F, M)."""
    force = np.concatenate([rng.normal(size=3), 0.1 * rng.normal(size=3)])

    def change(w: World, m: TrueMotion, size: float) -> Array:
        data = w.built.createData()
        return np.array([-size * (w.arm.last_jacobian(w.built, data, q).T @ force) for q in m.q])

    return Hidden((), change, None)


def _payload(w: World, j: int, rng: Generator) -> Hidden:
    """A ball that the last link carries: its size is its mass [kg]."""
    reach = float(np.linalg.norm(w.arm.model.jointPlacements[-1].translation)) + 0.05
    centre = rng.uniform(-0.5, 0.5, 3) * reach

    def change(w: World, m: TrueMotion, mass: float) -> Array:
        loaded = pin.Model(w.built)
        ball = pin.Inertia(mass, centre, 0.4 * mass * 0.05**2 * np.eye(3))
        loaded.inertias[w.arm.last] = w.built.inertias[w.arm.last] + ball
        return w.rigid(m, loaded) - w.rigid(m)

    return Hidden((), change, 1.0, size=0.1, details={"com": centre.tolist()})


def _stiction(w: World, j: int, rng: Generator) -> Hidden:
    """Dahl's friction over a travel that hardly shows."""
    return dahl(w, j, log_uniform(rng, 0.0005, 0.001))


def _misplaced(w: World, j: int, rng: Generator) -> Hidden:
    """Joints beside where the kinematics have them, by some .1 mm and .2 mrad an axis at size 1."""
    seed = int(rng.integers(2**32))

    def change(w: World, m: TrueMotion, size: float) -> Array:
        slip, turn = 1e-4 * size, np.rad2deg(2e-4 * size)
        beside = misplaced(w.built, slip, turn, np.random.default_rng(seed))
        return w.rigid(m, beside) - w.rigid(m)

    return Hidden((), change, None)


#: What shows only against a model that is kept as it is.
FROZEN: Mapping[str, Maker] = {"payload": _payload}
#: What a diagnosis meets as a nuisance.
NUISANCE: Mapping[str, Maker] = {"kinematic_error": _misplaced, "stiction": _stiction}
MACHINE: Mapping[str, Maker] = {
    "joint_spring": plain(lambda w, j, m: m.q[:, j]),
    "torque_offset": plain(lambda w, j, m: np.ones(len(m.t)), signed=True),
    "drift_offset": _drift,
    "torque_ripple": _ripple,
    "rotor_inertia": plain(lambda w, j, m: m.ddq[:, j]),
    "torque_gain": plain(lambda w, j, m: w.torque(m)[:, j], signed=True),
    "torque_delay": lambda w, j, rng: _late([j], (j,)),
    "global_delay": lambda w, j, rng: _late(list(range(w.arm.n)), ()),
    "torque_filter": _filter,
    "joint_zero_error": _zero_error,
    "joint_elasticity": _elasticity,
    "backlash": _backlash,
    "base_tilt": _tilt,
    "external_wrench": _wrench,
}
