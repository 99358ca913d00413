"""Hidden errors of the torque channels, and torques of their own: offset, gain, delay, ripple."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.simulation.hidden_effects.hidden import Hidden, Maker, World, on_joint, one_column

Array = NDArray[np.float64]


def _gain(joint: int, world: World, rng: np.random.Generator) -> Hidden:
    n = world.robot.n
    sign = float(rng.choice([-1.0, 1.0]))
    return Hidden(
        "torque_gain", (joint,), lambda w, m, a: sign * a * on_joint(joint, n, w.torque(m)[:, joint])
    )


def _delay(joint: int, world: World, rng: np.random.Generator) -> Hidden:
    late = np.zeros(world.robot.n)
    late[joint] = 1e-3
    return Hidden("torque_delay", (joint,), late=late, unit=1e-3)


def _global_delay(joint: int, world: World, rng: np.random.Generator) -> Hidden:
    return Hidden("global_delay", (), late=np.full(world.robot.n, 1e-3), unit=1e-3)


def _ripple(joint: int, world: World, rng: np.random.Generator) -> Hidden:
    k, phase = float(rng.integers(2, 31)), float(rng.uniform(0.0, 2.0 * np.pi))
    n = world.robot.n
    return Hidden(
        "torque_ripple",
        (joint,),
        lambda w, m, a: a * on_joint(joint, n, np.sin(k * m.q[:, joint] + phase)),
        details={"shape": {"k": k}},
    )


CHANNELS: dict[str, Maker] = {
    "torque_offset": one_column("torque_offset", lambda m, j: np.ones(len(m.t)), replaces=True),
    "torque_gain": _gain,
    "torque_delay": _delay,
    "global_delay": _global_delay,
    "torque_ripple": _ripple,
}
