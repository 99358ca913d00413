"""An arm by Pinocchio itself, the true robot, its motion, and its dry friction on a
fine grid of time.

Sources: Dahl, AIAA Journal 1976; Canudas de Wit, Olsson, Astrom, Lischinsky, IEEE TAC
1995 (LuGre).
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.robot._pinocchio import pin

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Arm:
    """model : Pinocchio's; rotary (n,) : whether a joint turns; last : the model's
    joint that bears the last link; follows (L, n), shift (L,) : the positions of its
    joints are follows q + shift, of those q that move by themselves."""

    model: Any
    rotary: NDArray[np.bool_]
    last: int
    follows: Array
    shift: Array

    @property
    def n(self) -> int:
        """How many joints."""
        return len(self.rotary)

    @property
    def unit_speed(self) -> Array:
        """(n,) what 1 rad/s of a turning joint corresponds to: on a prismatic one 0.5
        m/s."""
        return np.where(self.rotary, 1.0, 0.5)

    def inverse_dynamics(
        self,
        model: Any,
        q: Array,
        dq: Array,
        ddq: Array,
    ) -> Array:
        """Torques of a model of Pinocchio's with these joints.

        Parameters
        ----------
        model : pin.Model
            The links.
        q : (N, n)
            Positions.
        dq : (N, n)
            Velocities.
        ddq : (N, n)
            Accelerations.

        Returns
        -------
        (N, n)
            [N m, N].
        """
        B = self.follows
        return (
            inverse_dynamics(
                model,
                q @ B.T + self.shift,
                dq @ B.T,
                ddq @ B.T,
            )
            @ B
        )

    def last_jacobian(
        self,
        model: Any,
        data: Any,
        q: Array,
    ) -> Array:
        """The Jacobian of the last link's joint.

        Parameters
        ----------
        model : pin.Model
            The links.
        data : pin.Data
            Of the model.
        q : (n,)
            Positions.

        Returns
        -------
        (6, n)
            Linear, then angular velocity, in world axes.
        """
        pin.computeJointJacobians(model, data, self.follows @ q + self.shift)
        J = pin.getJointJacobian(
            model,
            data,
            self.last,
            pin.LOCAL_WORLD_ALIGNED,
        )
        return np.asarray(np.reshape(J, (6, -1)) @ self.follows)


def misplaced(
    model: Any,
    metres: float,
    degrees: float,
    rng: np.random.Generator,
) -> Any:
    """The arm as it was built: every joint's frame is off by normal errors.

    Parameters
    ----------
    model : pin.Model
        As it was drawn.
    metres : float
        Standard deviation of a shift, an axis.
    degrees : float
        Standard deviation of a turn, an axis.
    rng : numpy.random.Generator
        Of everything random.

    Returns
    -------
    pin.Model
        As it was built.
    """
    built = pin.Model(model)
    for i in range(1, model.njoints):
        slip = metres * rng.normal(size=3)
        turn = np.deg2rad(degrees) * rng.normal(size=3)
        built.jointPlacements[i] = model.jointPlacements[i] * pin.SE3(
            pin.exp3(turn), slip
        )
    return built


def inverse_dynamics(
    model: Any,
    q: Array,
    dq: Array,
    ddq: Array,
) -> Array:
    """M(q) ddq + C(q, dq) dq + g(q).

    Parameters
    ----------
    model : pin.Model
        The links.
    q : (N, n)
        Positions.
    dq : (N, n)
        Velocities.
    ddq : (N, n)
        Accelerations.

    Returns
    -------
    (N, n)
        [N m, N].
    """
    data = model.createData()
    return np.array(
        [
            pin.rnea(model, data, *x)
            for x in zip(
                q,
                dq,
                ddq,
                strict=True,
            )
        ]
    )


PAUSE = 30.0  # s between runs


@dataclass(frozen=True)
class TrueMotion:
    """t (N,) s on the clock of the sitting; q, dq, ddq (N, n): the motors', which the
    encoders show."""

    t: Array
    q: Array
    dq: Array
    ddq: Array


@dataclass(frozen=True)
class DryFriction:
    """tanh(dq / width), width (n,) [rad/s or m/s]; other laws are the challenge's."""

    width: Array

    @property
    def jumps(self) -> bool:
        """Whether it changes sign where the velocity does, and not over a travel."""
        return True

    def share(self, t: Array, dq: Array) -> Array:
        """The dry friction over the Coulomb torque.

        Parameters
        ----------
        t : (N,)
            [s], evenly spaced at 1 kHz or more.
        dq : (N, n)
            Velocities.

        Returns
        -------
        (N, n)
            -1 to 1.
        """
        return np.tanh(dq / self.width)


def bristles(
    t: Array,
    dq: Array,
    travel: Array,
    level: Callable[[Array], Array],
) -> Array:
    """z with dz/dt = dq / d - |dq| z / (d g(dq)).

    Between two samples dq is taken as constant, for which the equation is solved
    exactly: the step is stable however stiff d is. At a reversal the step is split at
    the instant of rest.

    Parameters
    ----------
    t : (N,)
        [s].
    dq : (N, n)
        Velocities.
    travel : (n,)
        d [rad, m].
    level : callable
        g of a velocity.

    Returns
    -------
    (N, n)
        z.
    """
    step = float(t[1] - t[0])
    before = dq[:-1]
    after = dq[1:]
    turns = before * after < 0.0
    change = np.where(turns, before - after, 1.0)
    share = np.where(turns, before / change, 1.0)  # of the step before rest
    middle = np.where(
        turns,
        0.5 * before,
        0.5 * (before + after),
    )
    first = _step_of_bristles(middle, share, step, travel, level)
    second = _step_of_bristles(0.5 * after, 1.0 - share, step, travel, level)
    z = np.zeros_like(dq)
    for j in range(dq.shape[1]):
        # Numbers of Python's: an array of one entry takes twenty times as long.
        columns = [values[:, j].tolist() for values in (*first, *second)]
        state = 0.0
        states = [state]
        for decay, goal, decay_2, goal_2 in zip(*columns, strict=True):
            state = goal + (state - goal) * decay
            state = goal_2 + (state - goal_2) * decay_2
            states.append(state)
        z[:, j] = states
    return z


def _step_of_bristles(
    dq: Array,
    share: Array,
    step: float,
    travel: Array,
    level: Callable[[Array], Array],
) -> tuple[Array, Array]:
    """What is left after shares (N, n) of a step [s] at constant velocities dq (N, n) of
    the distance from where the bristles go, and where they go, both (N, n)."""
    reach = level(dq)
    decay = np.exp(-np.abs(dq) * share * step / (travel * reach))
    return decay, np.sign(dq) * reach


@dataclass(frozen=True)
class World:
    """arm : as the URDF says; built : Pinocchio's model as it is; coulomb, viscous,
    offset (n,) : friction and what stays the same in both directions; noise (n,) :
    standard deviation of what a log adds; warm_up : of the gears [s]; more (N, n) :
    what else the sensors carry along one motion."""

    arm: Arm
    built: Any
    dry: DryFriction
    coulomb: Array
    viscous: Array
    offset: Array
    noise: Array
    warm_up: float = 120.0
    more: Array | float = 0.0

    def torque(self, motion: TrueMotion) -> Array:
        """The torque of the motors, or of sensors that friction also loads.

        Parameters
        ----------
        motion : TrueMotion
            Of the joints.

        Returns
        -------
        (N, n)
            [N m, N].
        """
        return self.rigid(motion) + self.friction(motion) + self.more

    def rigid(self, motion: TrueMotion, model: Any = None) -> Array:
        """The torque of the links.

        Parameters
        ----------
        motion : TrueMotion
            Of the joints.
        model : pin.Model, optional
            Other links; default: as built.

        Returns
        -------
        (N, n)
            [N m, N].
        """
        return self.arm.inverse_dynamics(
            model or self.built,
            motion.q,
            motion.dq,
            motion.ddq,
        )

    def friction(self, motion: TrueMotion) -> Array:
        """Dry and viscous friction, and what stays the same in both directions.

        Parameters
        ----------
        motion : TrueMotion
            Of the joints.

        Returns
        -------
        (N, n)
            [N m, N].
        """
        return np.asarray(
            self.coulomb * self.share(motion) + self.viscous * motion.dq + self.offset
        )

    def share(self, motion: TrueMotion) -> Array:
        """Dry friction over the Coulomb torque.

        Parameters
        ----------
        motion : TrueMotion
            Of the joints.

        Returns
        -------
        (N, n)
            -1 to 1.
        """
        return self.dry.share(motion.t, motion.dq)

    def temperature(self, t: Array) -> Array:
        """The temperature of the gears: the farther out, the smaller and the warmer.

        Parameters
        ----------
        t : (N,)
            [s].

        Returns
        -------
        (N, n)
            [degrees Celsius].
        """
        rise = np.linspace(10.0, 25.0, self.arm.n)
        return 22.0 + np.outer(-np.expm1(-t / self.warm_up), rise)
