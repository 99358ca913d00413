"""The runs that are made in a world, and what is logged of them."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from challenge.worlds.arms import Site
from challenge.worlds.conditions import Conditions
from challenge.worlds.motion import plan
from challenge.worlds.servo import driven
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.simulation.worlds.arm import Array
from sdp_vs_penalty.simulation.worlds.world import PAUSE, TrueMotion

#: Rate of the simulation [Hz]; of the log's rates each divides it.
FINE = 1000.0
#: Before and after what is logged [s]: filters and bristles have settled by then.
LEAD = 1.0


def start_of(c: Conditions, k: int) -> float:
    """When run k begins on the clock of the sitting [s]; what is logged begins LEAD later."""
    return k * (c.duration + 2.0 * LEAD + PAUSE)


def draw_motion(world: Site, k: int, rng: np.random.Generator) -> TrueMotion:
    """The motion of run k, on the fine grid: as planned, or as a servo gets it done."""
    c = world.conditions
    length = c.duration + 2.0 * LEAD
    local = np.arange(round(length * FINE)) / FINE
    motion = TrueMotion(start_of(c, k) + local, *plan(world.arm, c.motion, length, rng)(local))
    return driven(world, motion) if c.servo else motion


@dataclass(frozen=True)
class Logged:
    """run : as logged; ideal : what perfect sensors would have logged at the same instants;
    shares : (N, n) what each hidden effect adds to its torque."""

    run: Measurements
    ideal: Measurements
    shares: tuple[Array, ...] = ()


def log_run(
    world: Site, motion: TrueMotion, rng: np.random.Generator, added: Sequence[Array] = ()
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
