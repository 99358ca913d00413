"""Arms as URDF files, read by Pinocchio itself, whose friction and limits set all
sizes; their runs, and what is logged of them."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from challenge.worlds.conditions import Conditions, FrictionLaw, RatedArm, Site
from challenge.worlds.motion import driven, plan
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.robot._pinocchio import pin
from sdp_vs_penalty.simulation.worlds.world import PAUSE, Array, TrueMotion, misplaced


def urdf_of(name: str) -> Path:
    """Of one of ARMS."""
    return Path(__file__).parent / f"{name}.urdf"


def load_arm(name: str) -> RatedArm:
    """One of ARMS."""
    return arm_of(pin.buildModelFromUrdf(str(urdf_of(name))))


def arm_of(model: Any) -> RatedArm:
    """The arm of a model of Pinocchio's, with its limits and friction, a tenth of which
    is noise."""
    rotary = np.array(
        [joint.shortname().startswith("JointModelR") for joint in model.joints[1:]]
    )
    bare = model, rotary, model.njoints - 1, np.eye(len(rotary)), np.zeros(len(rotary))
    limits = model.lowerPositionLimit, model.upperPositionLimit, model.velocityLimit
    sizes = model.friction, model.damping, 0.1 * model.friction
    return RatedArm(*bare, *map(np.array, (*limits, *sizes)))


def draw_world(
    c: Conditions,
    rng: np.random.Generator,
    without: Collection[str] = (),
    arm: RatedArm | None = None,
) -> Site:
    """Friction around what the URDF says, links as it says, joints where the conditions
    put them.

    without : of viscous_friction, coulomb_friction and torque_offset those that no
    joint has; arm : in place of the conditions' one.
    """
    arm = arm or load_arm(c.arm)
    n = arm.n

    def spread(low: float, high: float) -> Array:
        return np.exp(rng.uniform(np.log(low), np.log(high), n))

    coulomb = arm.coulomb * spread(0.5, 1.5) * ("coulomb_friction" not in without)
    viscous = arm.viscous * spread(0.5, 1.5) * ("viscous_friction" not in without)
    offset = (
        0.2 * arm.coulomb * rng.uniform(-1.0, 1.0, n) * ("torque_offset" not in without)
    )
    unit = arm.unit_speed
    width = spread(*c.width) * (1.0 if c.width[0] == c.width[1] else unit)
    travel = unit * spread(0.001, 0.01)
    rise = rng.uniform(0.0, 0.4, n)
    speed = unit * spread(0.02, 0.1)
    dry = FrictionLaw(width, c.law, travel, rise, speed)
    sides = rng.choice([-1.0, 1.0], (2, n)) * c.asymmetry
    middle = 0.5 * (arm.lower + arm.upper)
    return Site(
        arm=arm,
        built=misplaced(arm.model, *c.misplacement, rng),
        dry=dry,
        coulomb=coulomb,
        viscous=viscous,
        offset=offset,
        sides=sides,
        rotor=c.rotor * np.diag(pin.crba(arm.model, arm.model.createData(), middle)),
        noise=c.noise.level * arm.noise,
        warm_up=float(rng.uniform(30.0, 120.0)),
        conditions=c,
    )


#: Rate of the simulation [Hz]; of the log's rates each divides it.
FINE = 1000.0
#: Before and after what is logged [s]: filters and bristles have settled by then.
LEAD = 1.0


def start_of(c: Conditions, k: int) -> float:
    """When run k begins on the clock of the sitting [s]; what is logged begins LEAD
    later."""
    return k * (c.duration + 2.0 * LEAD + PAUSE)


def draw_motion(world: Site, k: int, rng: np.random.Generator) -> TrueMotion:
    """The motion of run k, on the fine grid: as planned, or as a servo gets it done."""
    c = world.conditions
    length = c.duration + 2.0 * LEAD
    local = np.arange(round(length * FINE)) / FINE
    motion = TrueMotion(
        start_of(c, k) + local, *plan(world.arm, c.motion, length, rng)(local)
    )
    return driven(world, motion) if c.servo else motion


@dataclass(frozen=True)
class Logged:
    """run : as logged; ideal : what perfect sensors would have logged at the same
    instants; shares : (N, n) what each hidden effect adds to its torque."""

    run: Measurements
    ideal: Measurements
    shares: tuple[Array, ...] = ()


def log_run(
    world: Site,
    motion: TrueMotion,
    rng: np.random.Generator,
    added: Sequence[Array] = (),
    jitter: Array | float = 0.0,
) -> Logged:
    """What the sensors make of a run; on the fine grid (N, n) added : torques on top of
    the world's, jitter : noise of the encoders."""
    c = world.conditions
    every = round(FINE / c.channel.rate)
    inside = slice(round(LEAD * FINE), round((LEAD + c.duration) * FINE), every)
    tau, *shares = (
        c.channel.torque(motion.t, x)[inside] for x in (world.torque(motion), *added)
    )
    t = motion.t[inside]
    q = motion.q[inside]
    dq = motion.dq[inside]
    tau = tau + sum(shares)
    noisy = tau + c.noise.draw(len(t), world.noise, rng)
    speed = None
    if c.channel.speed_noise is not None:
        speed = dq + c.channel.speed_noise * world.arm.unit_speed * rng.normal(
            size=dq.shape
        )
    counted = c.channel.position((motion.q + jitter)[inside], world.arm.unit_speed)
    warm = np.round(world.temperature(t), 1) if c.thermometer else None
    run = Measurements(t, counted, noisy, speed, temperature=warm)
    return Logged(run, Measurements(t, q, tau, temperature=warm), tuple(shares))
