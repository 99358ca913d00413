"""A true robot under conditions."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.robot._pinocchio import pin
from sdp_vs_penalty.simulation.worlds.arm import Arm, load_arm, misplaced
from sdp_vs_penalty.simulation.worlds.conditions import Conditions
from sdp_vs_penalty.simulation.worlds.friction import DryFriction
from sdp_vs_penalty.simulation.worlds.motion import TrueMotion

Array = NDArray[np.float64]


@dataclass(frozen=True)
class World:
    """arm : as the URDF says; built : Pinocchio's model as it is; coulomb, viscous, offset, lopsided,
    lopsided_viscous (n,) : friction and its part that has the same sign in both directions; rotor (n,) :
    inertia [kg m^2 or kg] that a motor turns besides its link."""

    conditions: Conditions
    arm: Arm
    built: Any
    dry: DryFriction
    coulomb: Array
    viscous: Array
    offset: Array
    lopsided: Array
    lopsided_viscous: Array
    rotor: Array
    warm_up: float

    def torque(self, m: TrueMotion) -> Array:
        """(N, n) of the motors, or of sensors that friction also loads."""
        return self.rigid(m) + self.rotor * m.ddq + self.friction(m)

    def rigid(self, m: TrueMotion, model: Any = None) -> Array:
        """(N, n) of the links, as built or of another model of Pinocchio's."""
        return self.arm.inverse_dynamics(model or self.built, m.q, m.dq, m.ddq)

    def friction(self, m: TrueMotion) -> Array:
        """(N, n) dry, viscous, and what stays the same in both directions."""
        share = self.share(m)
        cold = 1.0 - self.conditions.warming * (1.0 - np.exp(-m.t / self.warm_up))
        viscous = self.viscous * m.dq + self.lopsided_viscous * np.abs(m.dq)
        dry = self.coulomb * share + self.lopsided * np.abs(share)
        return np.asarray(dry + cold[:, None] * viscous + self.offset)

    def share(self, m: TrueMotion) -> Array:
        """(N, n) dry friction over the Coulomb torque: as the servo met it, or by its law."""
        return self.dry.share(m.t, m.dq) if m.share is None else m.share

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
    middle = 0.5 * (arm.lower + arm.upper)
    rotor = c.rotor * np.diag(pin.crba(arm.model, arm.model.createData(), middle))
    lopsided = sides[0] * coulomb, sides[1] * viscous
    return World(c, arm, built, dry, coulomb, viscous, offset, *lopsided, rotor, warm_up)
