"""Hidden drift: an offset or a friction that follows the clock."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.effects.effect import Motion
from sdp_vs_penalty.simulation.hidden_effects.hidden import Hidden, Maker, World, on_joint

Array = NDArray[np.float64]


def _drift(effect: str) -> Maker:
    def make(joint: int, world: World, rng: np.random.Generator) -> Hidden:
        n = world.robot.n
        settles, viscous = bool(rng.random() < 0.5), bool(rng.random() < 0.5)
        T = float(np.exp(rng.uniform(np.log(20.0), np.log(120.0))))
        sign = float(rng.choice([-1.0, 1.0]))

        def torque(w: World, m: Motion, a: float) -> Array:
            course = np.expm1(-m.t / T) if settles else m.t / 100.0
            v = m.dq[:, joint]
            with_motion = v if viscous else np.sign(v)
            return sign * a * on_joint(joint, n, course * (with_motion if "friction" in effect else 1.0))

        form = 1 + settles + (2 * viscous if "friction" in effect else 0)
        return Hidden(effect, (joint,), torque, details={"shape": {"form": form, "T": T}})

    return make


DRIFT: dict[str, Maker] = {name: _drift(name) for name in ("drift_offset", "drift_friction")}
