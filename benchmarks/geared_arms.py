"""Geared arms moved by MuJoCo under a controller: rotors behind gears, bristles, encoder steps.

Nothing here is shared with the library: forward dynamics in steps of 0.25 ms, torque by a controller
that tracks a reference, friction by bristles (Canudas de Wit et al. 1995) with Stribeck's dip, inertials
that differ from the URDF's. Most of the torque of the wrists is friction.
"""

from __future__ import annotations

from functools import partial

import numpy as np
from corruption_arms import Arm, arm_of, urdf
from numpy.typing import NDArray
from unseen_arms import drawn, mixture

from sdp_vs_penalty.data.measurements import Measurements

Array = NDArray[np.float64]

_STEP, _EVERY, _BEFORE = 2.5e-4, 16, 1.0


def geared(seed: int) -> Arm:
    """The arm of this number: four to seven joints, 250 Hz, 20 s, two runs."""
    axes = drawn(seed).axes
    return arm_of(f"geared{seed}", axes, seed, partial(_simulate, axes, seed))


def _simulate(axes: tuple, seed: int, rng: np.random.Generator) -> Measurements:  # type: ignore[type-arg]
    import mujoco

    model = mujoco.MjModel.from_xml_string(urdf("true", axes))
    data, n = mujoco.MjData(model), model.nv
    machine = np.random.default_rng([seed, 5])
    model.opt.timestep = _STEP
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_LIMIT
    model.body_mass[1:] *= machine.uniform(0.85, 1.15, model.nbody - 1)
    model.body_ipos[1:] += 0.01 * machine.normal(size=(model.nbody - 1, 3))
    mujoco.mj_setConst(model, data)
    slides = np.array([axis[0] == "prismatic" for axis in axes])
    mujoco.mj_forward(model, data)
    full = np.zeros((n, n))
    mujoco.mj_fullM(model, data, full)
    own = np.diag(full).copy()
    rotor = own * machine.uniform(0.1, 2.0, n)
    model.dof_armature[:] = rotor
    size = 9.0 * 0.72 ** np.arange(n) * machine.uniform(0.6, 1.4, n)
    size, viscous = size * np.where(slides, 4.0, 1.0), size * machine.uniform(0.4, 1.2, n)
    static, travel = size * machine.uniform(1.0, 1.25, n), machine.choice([2e-4, 6e-4])
    stiff = size / travel
    damp = 2.0 * 0.4 * np.sqrt(stiff * (own + rotor))
    t, q, dq, ddq = _reference(slides, rng)
    data.qpos, data.qvel = q[0], dq[0]
    gain = (own + rotor) * 60.0**2
    z, rows = np.zeros(n), []
    for k in range(len(t)):
        v = data.qvel.copy()
        slip = size + (static - size) * np.exp(-((v / 0.05) ** 2))
        bent = slip / stiff * np.sign(v)  # where the bristles settle at this speed
        after = np.where(v == 0.0, z, bent + (z - bent) * np.exp(-np.abs(v) * _STEP * stiff / slip))
        friction = stiff * after + damp * (after - z) / _STEP * np.exp(-((v / 0.02) ** 2)) + viscous * v
        z = after
        error, slower = q[k] - data.qpos, dq[k] - v
        torque = gain * error + 2.0 * 0.7 * 60.0 * (own + rotor) * slower + data.qfrc_bias
        torque += (own + rotor) * ddq[k] + size * np.tanh(dq[k] / 0.02) + viscous * dq[k]
        if k % _EVERY == 0 and t[k] >= 0.0:
            rows.append((t[k], *data.qpos, *torque))
        data.qfrc_applied = torque - friction
        mujoco.mj_step(model, data)
    log = np.array(rows)
    tau, at = log[:, 1 + n :], log[:, 1 : 1 + n]
    tau = tau + 0.008 * tau.std(axis=0) * rng.normal(size=tau.shape)
    at = np.round((at + 5e-6 * rng.normal(size=at.shape)) / 1e-5) * 1e-5
    return Measurements(log[:, 0], at, tau, None, None, ("geared",))


def _reference(slides: Array, rng: np.random.Generator) -> tuple[Array, Array, Array, Array]:
    """Five harmonics of 0.1 Hz; 1 s before the log begins."""
    t = np.arange(-_BEFORE, 20.0, _STEP)
    return t, *mixture(t, np.where(slides, 0.08, 0.6), 5, 0.1, 0.3, rng)
