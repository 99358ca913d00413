"""A true robot under conditions, and the runs that are logged of it."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.simulation.worlds.arm import Arm, inverse_dynamics, load_arm, misplaced
from sdp_vs_penalty.simulation.worlds.conditions import Conditions
from sdp_vs_penalty.simulation.worlds.friction import DryFriction
from sdp_vs_penalty.simulation.worlds.motion import Motion, plan

Array = NDArray[np.float64]

#: Rate of the simulation [Hz]; of the log's rates each divides it.
FINE = 1000.0
#: Before and after what is logged [s]: filters and bristles have settled by then.
LEAD = 1.0
PAUSE = 30.0  # s between runs


@dataclass(frozen=True)
class World:
    """arm : as the URDF says; built : Pinocchio's model as it is; coulomb, viscous, offset, lopsided,
    lopsided_viscous (n,) : friction and its part that has the same sign in both directions."""

    conditions: Conditions
    arm: Arm
    built: Any
    dry: DryFriction
    coulomb: Array
    viscous: Array
    offset: Array
    lopsided: Array
    lopsided_viscous: Array
    warm_up: float

    def torque(self, m: Motion) -> Array:
        """(N, n) of the motors, or of sensors that friction also loads."""
        return inverse_dynamics(self.built, m.q, m.dq, m.ddq) + self.friction(m)

    def friction(self, m: Motion) -> Array:
        """(N, n) dry, viscous, and what stays the same in both directions."""
        share = self.dry.share(m.t, m.dq)
        cold = 1.0 - self.conditions.warming * (1.0 - np.exp(-m.t / self.warm_up))
        viscous = self.viscous * m.dq + self.lopsided_viscous * np.abs(m.dq)
        dry = self.coulomb * share + self.lopsided * np.abs(share)
        return np.asarray(dry + cold[:, None] * viscous + self.offset)

    def describe(self) -> dict[str, Any]:
        """What a scorer may read."""
        return asdict(self.conditions) | {"dry": self.dry.to_dict()}


def draw_world(c: Conditions, rng: np.random.Generator) -> World:
    """Friction around what the URDF says, links as it says, joints where the conditions put them."""
    arm = load_arm(c.arm)
    n = arm.n

    def spread(low: float, high: float) -> Array:
        return np.asarray(np.exp(rng.uniform(np.log(low), np.log(high), n)))

    coulomb, viscous = arm.coulomb * spread(0.5, 1.5), arm.viscous * spread(0.5, 1.5)
    offset = 0.2 * arm.coulomb * rng.uniform(-1.0, 1.0, n)
    unit = arm.unit_speed
    width = spread(*c.width) if c.width[0] == c.width[1] else unit * spread(*c.width)
    dry = DryFriction(
        c.law, width, unit * spread(0.001, 0.01), rng.uniform(0.0, 0.4, n), unit * spread(0.02, 0.1)
    )
    sides = rng.choice([-1.0, 1.0], (2, n)) * c.asymmetry
    return World(
        c,
        arm,
        misplaced(arm.model, *c.misplacement, rng),
        dry,
        coulomb,
        viscous,
        offset,
        sides[0] * coulomb,
        sides[1] * viscous,
        float(rng.uniform(30.0, 120.0)),
    )


@dataclass(frozen=True)
class Logged:
    """run : as logged; ideal : what perfect sensors would have logged at the same instants."""

    run: Measurements
    ideal: Measurements


def log_run(world: World, k: int, rng: np.random.Generator) -> Logged:
    """Run k of the sitting, of a motion of its own."""
    c = world.conditions
    start = k * (c.duration + 2.0 * LEAD + PAUSE)
    local = np.arange(round((c.duration + 2.0 * LEAD) * FINE)) / FINE
    states = plan(world.arm, c.motion, c.duration + 2.0 * LEAD, rng)
    motion = Motion(start + local, *states(local))
    tau = c.channel.torque(motion.t, world.torque(motion))
    every = round(FINE / c.channel.rate)
    inside = slice(round(LEAD * FINE), round((LEAD + c.duration) * FINE), every)
    t, q, dq, tau = motion.t[inside], motion.q[inside], motion.dq[inside], tau[inside]
    noisy = tau + c.noise.draw(len(t), world.arm.noise, rng)
    speed = None
    if c.channel.speed_noise is not None:
        speed = dq + c.channel.speed_noise * world.arm.unit_speed * rng.normal(size=dq.shape)
    counted = c.channel.position(q, world.arm.unit_speed)
    name = (f"run{k + 1}",)
    return Logged(
        Measurements(t, counted, noisy, speed, names=name), Measurements(t, q, tau, names=name)
    )
