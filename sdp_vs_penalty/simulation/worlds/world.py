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
        """Number of joints that move by themselves."""
        return len(self.rotary)

    @property
    def unit_speed(self) -> Array:
        """(n,) typical speed of each joint: 1 rad/s, or 0.5 m/s for a prismatic one."""
        return np.where(self.rotary, 1.0, 0.5)

    def inverse_dynamics(self, model: Any, q: Array, dq: Array, ddq: Array) -> Array:
        """Return the rigid-body torques of a Pinocchio model along a motion.

        With q_all = B q + shift for all joints, those that follow others included, the
        torque of the moving joints is B^T tau_all.

        Parameters
        ----------
        model : pin.Model
            The links.
        q : (N, n)
            Positions [rad, m].
        dq : (N, n)
            Velocities [rad/s, m/s].
        ddq : (N, n)
            Accelerations [rad/s^2, m/s^2].

        Returns
        -------
        (N, n)
            [N m, N].
        """
        B = self.follows
        torque_of_all = inverse_dynamics(
            model, q @ B.T + self.shift, dq @ B.T, ddq @ B.T
        )
        return torque_of_all @ B

    def last_jacobian(self, model: Any, data: Any, q: Array) -> Array:
        """Return the Jacobian of the joint that carries the last link.

        Parameters
        ----------
        model : pin.Model
            The links.
        data : pin.Data
            Workspace of the model.
        q : (n,)
            Positions [rad, m].

        Returns
        -------
        (6, n)
            Linear, then angular velocity, in world axes.
        """
        pin.computeJointJacobians(model, data, self.follows @ q + self.shift)
        J = pin.getJointJacobian(model, data, self.last, pin.LOCAL_WORLD_ALIGNED)
        return np.asarray(np.reshape(J, (6, -1)) @ self.follows)


def misplaced(
    model: Any, metres: float, degrees: float, rng: np.random.Generator
) -> Any:
    """Displace every joint's frame at random, as manufacturing tolerances do.

    Parameters
    ----------
    model : pin.Model
        The arm as it was designed.
    metres : float
        Standard deviation of the shift along each axis [m].
    degrees : float
        Standard deviation of the rotation about each axis [deg].
    rng : numpy.random.Generator
        Random numbers.

    Returns
    -------
    pin.Model
        The arm as it was built; links and axes are those of the design.
    """
    built = pin.Model(model)
    for i in range(1, model.njoints):
        slip = metres * rng.normal(size=3)
        turn = np.deg2rad(degrees) * rng.normal(size=3)
        built.jointPlacements[i] = model.jointPlacements[i] * pin.SE3(
            pin.exp3(turn), slip
        )
    return built


def inverse_dynamics(model: Any, q: Array, dq: Array, ddq: Array) -> Array:
    """Return M(q) ddq + C(q, dq) dq + g(q) along a motion, by Pinocchio's RNEA.

    Parameters
    ----------
    model : pin.Model
        The links.
    q : (N, n)
        Positions [rad, m].
    dq : (N, n)
        Velocities [rad/s, m/s].
    ddq : (N, n)
        Accelerations [rad/s^2, m/s^2].

    Returns
    -------
    (N, n)
        [N m, N].
    """
    data = model.createData()
    states = zip(q, dq, ddq, strict=True)
    return np.array([pin.rnea(model, data, *state) for state in states])


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
        """Whether friction changes sign with the velocity, instead of over some travel.

        It does for tanh; a world with presliding friction overrides this.
        """
        return True

    def share(self, t: Array, dq: Array) -> Array:
        """Return the dry friction in units of the Coulomb torque, tanh(dq / width).

        Parameters
        ----------
        t : (N,)
            Time stamps [s], evenly spaced at 1 kHz or more.
        dq : (N, n)
            Velocities [rad/s, m/s].

        Returns
        -------
        (N, n)
            -1 to 1.
        """
        return np.tanh(dq / self.width)


def bristles(
    t: Array, dq: Array, travel: Array, level: Callable[[Array], Array]
) -> Array:
    """Integrate the bristle state z of the Dahl and LuGre friction models.

    dz/dt = dq / d - |dq| z / (d g(dq)). Velocity is constant between two samples, where
    the equation has an exact solution, so that any step is stable. At a reversal the
    step is split at the instant of rest.

    Parameters
    ----------
    t : (N,)
        Time stamps [s], evenly spaced.
    dq : (N, n)
        Velocities [rad/s, m/s].
    travel : (n,)
        Presliding travel d of each joint [rad, m].
    level : callable
        The function g of the velocity: where z settles.

    Returns
    -------
    (N, n)
        z, which is 0 at first.
    """
    step = float(t[1] - t[0])
    before = dq[:-1]
    after = dq[1:]
    reverses = before * after < 0.0
    change = np.where(reverses, before - after, 1.0)
    share = np.where(reverses, before / change, 1.0)  # of the step before rest
    mean_velocity = np.where(reverses, 0.5 * before, 0.5 * (before + after))
    # Decay and goal of each step up to the reversal, and of what follows it. A step
    # without a reversal has no second part: share is 1.
    first = _step_of_bristles(mean_velocity, share, step, travel, level)
    second = _step_of_bristles(0.5 * after, 1.0 - share, step, travel, level)
    z = np.zeros_like(dq)
    for j in range(dq.shape[1]):
        # Python's floats: arrays of one entry would take twenty times as long.
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
    dq: Array, share: Array, step: float, travel: Array, level: Callable[[Array], Array]
) -> tuple[Array, Array]:
    """Return how the bristle state moves in a step at constant velocity.

    z becomes goal + (z - goal) decay.

    Parameters
    ----------
    dq : (N, n)
        Velocities in each step.
    share : (N, n)
        Share of the step for which they last.
    step : float
        Length of a step [s].
    travel : (n,)
        Presliding travel d [rad, m].
    level : callable
        Where |z| settles at a velocity.

    Returns
    -------
    (N, n) and (N, n)
        decay and goal.
    """
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
        """Return what the torque sensors show: rigid-body torque, friction, and added
        torque.

        Parameters
        ----------
        motion : TrueMotion
            N samples of the joints' motion.

        Returns
        -------
        (N, n)
            [N m, N].
        """
        return self.rigid(motion) + self.friction(motion) + self.more

    def rigid(self, motion: TrueMotion, model: Any = None) -> Array:
        """Return the rigid-body torque of the links.

        Parameters
        ----------
        motion : TrueMotion
            N samples of the joints' motion.
        model : pin.Model, optional
            Other links; by default those of the robot as it was built.

        Returns
        -------
        (N, n)
            [N m, N].
        """
        return self.arm.inverse_dynamics(
            model or self.built, motion.q, motion.dq, motion.ddq
        )

    def friction(self, motion: TrueMotion) -> Array:
        """Return Coulomb and viscous friction plus the constant torque offset.

        Parameters
        ----------
        motion : TrueMotion
            N samples of the joints' motion.

        Returns
        -------
        (N, n)
            [N m, N].
        """
        return np.asarray(
            self.coulomb * self.share(motion) + self.viscous * motion.dq + self.offset
        )

    def share(self, motion: TrueMotion) -> Array:
        """Return the dry friction in units of the Coulomb torque.

        Parameters
        ----------
        motion : TrueMotion
            N samples of the joints' motion.

        Returns
        -------
        (N, n)
            -1 to 1.
        """
        return self.dry.share(motion.t, motion.dq)

    def temperature(self, t: Array) -> Array:
        """Return the temperature of the gears, which warm up from 22 degrees Celsius.

        Gears farther out are smaller and become warmer, by 10 to 25 degrees.

        Parameters
        ----------
        t : (N,)
            Time since the robot was started [s].

        Returns
        -------
        (N, n)
            [degrees Celsius].
        """
        rise = np.linspace(10.0, 25.0, self.arm.n)
        return 22.0 + np.outer(-np.expm1(-t / self.warm_up), rise)
