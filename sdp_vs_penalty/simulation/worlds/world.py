"""A true robot under conditions, and the runs that are logged of it."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.simulation.worlds.arm import Arm, inverse_dynamics, load_arm, misplaced
from sdp_vs_penalty.simulation.worlds.conditions import Conditions
from sdp_vs_penalty.simulation.worlds.friction import DryFriction
from sdp_vs_penalty.simulation.worlds.motion import TrueMotion, plan

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

    def torque(self, m: TrueMotion) -> Array:
        """(N, n) of the motors, or of sensors that friction also loads."""
        return inverse_dynamics(self.built, m.q, m.dq, m.ddq) + self.friction(m)

    def friction(self, m: TrueMotion) -> Array:
        """(N, n) dry, viscous, and what stays the same in both directions."""
        share = self.dry.share(m.t, m.dq)
        cold = 1.0 - self.conditions.warming * (1.0 - np.exp(-m.t / self.warm_up))
        viscous = self.viscous * m.dq + self.lopsided_viscous * np.abs(m.dq)
        dry = self.coulomb * share + self.lopsided * np.abs(share)
        return np.asarray(dry + cold[:, None] * viscous + self.offset)

    def temperature(self, t: Array) -> Array:
        """(N, n) of the gears [degrees Celsius]: the farther out, the smaller and the warmer."""
        rise = np.linspace(10.0, 25.0, self.arm.n)
        return 22.0 + np.outer(-np.expm1(-t / self.warm_up), rise)

    def describe(self) -> dict[str, Any]:
        """What a scorer may read."""
        return asdict(self.conditions) | {"dry": self.dry.to_dict()}


def draw_world(c: Conditions, rng: np.random.Generator, without: Collection[str] = ()) -> World:
    """Friction around what the URDF says, links as it says, joints where the conditions put them.

    without : of viscous_friction, coulomb_friction and torque_offset those that no joint has.
    """
    arm = load_arm(c.arm)
    n = arm.n

    def spread(low: float, high: float) -> Array:
        return np.asarray(np.exp(rng.uniform(np.log(low), np.log(high), n)))

    coulomb, viscous = arm.coulomb * spread(0.5, 1.5), arm.viscous * spread(0.5, 1.5)
    offset = 0.2 * arm.coulomb * rng.uniform(-1.0, 1.0, n)
    unit = arm.unit_speed
    width = spread(*c.width) * (1.0 if c.width[0] == c.width[1] else unit)
    dry = DryFriction(
        c.law, width, unit * spread(0.001, 0.01), rng.uniform(0.0, 0.4, n), unit * spread(0.02, 0.1)
    )
    sides = rng.choice([-1.0, 1.0], (2, n)) * c.asymmetry
    built = misplaced(arm.model, *c.misplacement, rng)
    warm_up = float(rng.uniform(30.0, 120.0))
    coulomb = coulomb * ("coulomb_friction" not in without)
    viscous = viscous * ("viscous_friction" not in without)
    offset = offset * ("torque_offset" not in without)
    return World(
        c, arm, built, dry, coulomb, viscous, offset, sides[0] * coulomb, sides[1] * viscous, warm_up
    )


def start_of(c: Conditions, k: int) -> float:
    """When run k begins on the clock of the sitting [s]; what is logged begins LEAD later."""
    return k * (c.duration + 2.0 * LEAD + PAUSE)


def draw_motion(world: World, k: int, rng: np.random.Generator) -> TrueMotion:
    """The motion of run k, on the fine grid."""
    c = world.conditions
    length = c.duration + 2.0 * LEAD
    local = np.arange(round(length * FINE)) / FINE
    return TrueMotion(start_of(c, k) + local, *plan(world.arm, c.motion, length, rng)(local))


@dataclass(frozen=True)
class Logged:
    """run : as logged; ideal : what perfect sensors would have logged at the same instants;
    shares : (N, n) what each hidden effect adds to its torque."""

    run: Measurements
    ideal: Measurements
    shares: tuple[Array, ...] = ()


def log_run(
    world: World, motion: TrueMotion, rng: np.random.Generator, added: Sequence[Array] = ()
) -> Logged:
    """What the sensors make of a run; added : (N, n) torques on top of the world's, on the fine grid."""
    c = world.conditions
    every = round(FINE / c.channel.rate)
    inside = slice(round(LEAD * FINE), round((LEAD + c.duration) * FINE), every)
    tau, *shares = (c.channel.torque(motion.t, x)[inside] for x in (world.torque(motion), *added))
    t, q, dq = motion.t[inside], motion.q[inside], motion.dq[inside]
    tau = tau + sum(shares)
    noisy = tau + c.noise.draw(len(t), world.arm.noise, rng)
    speed = None
    if c.channel.speed_noise is not None:
        speed = dq + c.channel.speed_noise * world.arm.unit_speed * rng.normal(size=dq.shape)
    counted = c.channel.position(q, world.arm.unit_speed)
    warm = np.round(world.temperature(t), 1) if c.thermometer else None
    run = Measurements(t, counted, noisy, speed, temperature=warm)
    return Logged(run, Measurements(t, q, tau, temperature=warm), tuple(shares))
