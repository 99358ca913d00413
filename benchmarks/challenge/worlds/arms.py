"""Arms as URDF files, read by Pinocchio itself; what they say of friction and limits sets all sizes."""

from collections.abc import Collection
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from challenge.worlds.conditions import Conditions
from sdp_vs_penalty.robot._pinocchio import pin
from sdp_vs_penalty.simulation.worlds.arm import Arm, Array, misplaced
from sdp_vs_penalty.simulation.worlds.world import DryFriction, World


@dataclass(frozen=True)
class Site(World):
    """A world, and the conditions under which it is measured."""

    conditions: Conditions = field(default_factory=Conditions)


def urdf_of(name: str) -> Path:
    """Of one of ARMS."""
    return Path(__file__).parent / f"{name}.urdf"


def load_arm(name: str, noise: float = 0.1) -> Arm:
    """One of ARMS; noise : of its torques over the Coulomb friction in its URDF."""
    model = pin.buildModelFromUrdf(str(urdf_of(name)))
    rotary = np.array([joint.shortname().startswith("JointModelR") for joint in model.joints[1:]])
    limits = (model.lowerPositionLimit, model.upperPositionLimit, model.velocityLimit)
    lower, upper, speed, coulomb, viscous = map(np.array, (*limits, model.friction, model.damping))
    sizes, n = (coulomb, viscous, rotary, noise * coulomb), len(rotary)
    ends = (lower, upper, speed)
    return Arm(model, *ends, *sizes, model.njoints - 1, np.eye(n), np.zeros(n))


def draw_world(c: Conditions, rng: np.random.Generator, without: Collection[str] = ()) -> Site:
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
    middle = 0.5 * (arm.lower + arm.upper)
    rotor = c.rotor * np.diag(pin.crba(arm.model, arm.model.createData(), middle))
    lopsided = sides[0] * coulomb, sides[1] * viscous
    noise = c.noise.level * arm.noise
    own = (coulomb, viscous, offset, *lopsided, rotor, noise, warm_up, c.warming)
    return Site(arm, built, dry, *own, c)
