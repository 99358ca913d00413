"""Hidden mechanics: links that stand elsewhere than the encoders say, loads, a tilted base."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.effects.effect import Motion
from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.robot._pinocchio import pin
from sdp_vs_penalty.simulation.hidden_effects.hidden import Hidden, Maker, World, on_joint, one_column

Array = NDArray[np.float64]


def _elasticity(joint: int, world: World, rng: np.random.Generator) -> Hidden:
    n = world.robot.n
    return Hidden(
        "joint_elasticity",
        (joint,),
        encoder=lambda w, m, a: 1e-4 * a * on_joint(joint, n, w.rigid(m)[:, joint]),
        unit=1e-4,
    )


def _backlash(joint: int, world: World, rng: np.random.Generator) -> Hidden:
    def torque(w: World, m: Motion, a: float) -> Array:
        tau = w.rigid(m)
        link = m.q.copy()
        link[:, joint] -= 1e-3 * a * np.sign(tau[:, joint])
        return w.rigid(replace(m, q=link)) - w.rigid(m)

    return Hidden("backlash", (joint,), torque, unit=1e-3)


def _zero_error(joint: int, world: World, rng: np.random.Generator) -> Hidden:
    n = world.robot.n
    sign = float(rng.choice([-1.0, 1.0]))
    return Hidden(
        "joint_zero_error",
        (joint,),
        encoder=lambda w, m, a: -1e-3 * sign * a * on_joint(joint, n, np.ones(len(m.t))),
        unit=1e-3,
    )


def _tilt(joint: int, world: World, rng: np.random.Generator) -> Hidden:
    angle = rng.uniform(0.0, 2.0 * np.pi)
    g = world.robot.gravity
    along = int(np.argmax(np.abs(g)))
    across = [axis for axis in range(3) if axis != along]

    def torque(w: World, m: Motion, a: float) -> Array:
        tilted = np.array(g)
        tilted[across] += 0.01 * a * np.array([np.cos(angle), np.sin(angle)])
        robot = replace(w.robot, gravity=(tilted[0], tilted[1], tilted[2]))
        return replace(w, robot=robot).rigid(m) - w.rigid(m)

    return Hidden("base_tilt", (), torque, unit=0.01)


def _wrench(joint: int, world: World, rng: np.random.Generator) -> Hidden:
    force, moment = rng.normal(size=3), 0.2 * rng.normal(size=3)
    return Hidden("external_wrench", (), lambda w, m, a: a * wrench_torque(w, m, force, moment))


def wrench_torque(world: World, motion: Motion, force: Array, moment: Array) -> Array:
    """Joint torque (N, n) against a wrench on the last link, by recursive Newton-Euler."""
    robot = world.robot
    model = robot._with_inertias(world.links.ravel())
    data = model.createData()
    external = pin.StdVec_Force([pin.Force.Zero() for _ in range(robot.n + 1)])
    out = np.empty_like(motion.q)
    for k, (q, dq, ddq) in enumerate(zip(motion.q, motion.dq, motion.ddq, strict=True)):
        plain = pin.rnea(model, data, q, dq, ddq).copy()
        pin.forwardKinematics(model, data, q)
        turn = data.oMi[robot.n].rotation
        external[robot.n] = pin.Force(turn.T @ force, turn.T @ moment)
        out[k] = pin.rnea(model, data, q, dq, ddq, external) - plain
    return out


def _payload(joint: int, world: World, rng: np.random.Generator) -> Hidden:
    com = rng.uniform(-0.05, 0.05, 3) + np.array([0.0, 0.0, 0.05])
    gyration = rng.uniform(0.02, 0.06, 3) ** 2
    moments = gyration.sum() - gyration
    load = inertia.standard_from_barycentric([1.0, *com, moments[0], 0, moments[1], 0, 0, moments[2]])

    def torque(w: World, m: Motion, a: float) -> Array:
        links = w.links.copy()
        links[-1] += a * load
        return replace(w, links=links).rigid(m) - w.rigid(m)

    return Hidden("payload", (), torque, details={"com": com.tolist()})


GEOMETRY: dict[str, Maker] = {
    "rotor_inertia": one_column("rotor_inertia", lambda m, j: m.ddq[:, j]),
    "joint_spring": one_column("joint_spring", lambda m, j: m.q[:, j]),
    "joint_elasticity": _elasticity,
    "backlash": _backlash,
    "joint_zero_error": _zero_error,
    "base_tilt": _tilt,
    "external_wrench": _wrench,
    "payload": _payload,
}
