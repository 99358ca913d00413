"""An arm by Pinocchio itself; its friction and limits set all sizes."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.robot._pinocchio import pin

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Arm:
    """lower, upper, speed (n,) : limits of the joints [rad or m, and per s]; coulomb, viscous, noise
    (n,) : nominal sizes [N m or N]; rotary (n,) : whether a joint turns; model : Pinocchio's; last : its
    joint that bears the last link; follows (L, n), shift (L,) : the positions of its joints are
    follows q + shift, of those q that move by themselves."""

    model: Any
    lower: Array
    upper: Array
    speed: Array
    coulomb: Array
    viscous: Array
    rotary: NDArray[np.bool_]
    noise: Array
    last: int
    follows: Array
    shift: Array

    @property
    def n(self) -> int:
        """How many joints."""
        return len(self.lower)

    @property
    def unit_speed(self) -> Array:
        """(n,) what 1 rad/s of a turning joint corresponds to: on a prismatic one 0.5 m/s."""
        return np.where(self.rotary, 1.0, 0.5)

    def inverse_dynamics(self, model: Any, q: Array, dq: Array, ddq: Array) -> Array:
        """(N, n) of a model of Pinocchio's with these joints."""
        B = self.follows
        return inverse_dynamics(model, q @ B.T + self.shift, dq @ B.T, ddq @ B.T) @ B

    def last_jacobian(self, model: Any, data: Any, q: Array) -> Array:
        """(6, n) of the last link's joint at q (n,): linear, then angular velocity, in world axes."""
        pin.computeJointJacobians(model, data, self.follows @ q + self.shift)
        J = pin.getJointJacobian(model, data, self.last, pin.LOCAL_WORLD_ALIGNED)
        return np.asarray(np.reshape(J, (6, -1)) @ self.follows)


def misplaced(model: Any, metres: float, degrees: float, rng: np.random.Generator) -> Any:
    """The arm as it was built: every joint's frame is off by normal errors of these sizes an axis."""
    built = pin.Model(model)
    for i in range(1, model.njoints):
        slip = metres * rng.normal(size=3)
        turn = np.deg2rad(degrees) * rng.normal(size=3)
        built.jointPlacements[i] = model.jointPlacements[i] * pin.SE3(pin.exp3(turn), slip)
    return built


def inverse_dynamics(model: Any, q: Array, dq: Array, ddq: Array) -> Array:
    """(N, n) M(q) ddq + C(q, dq) dq + g(q)."""
    data = model.createData()
    return np.array([pin.rnea(model, data, *x) for x in zip(q, dq, ddq, strict=True)])
