"""An arm by Pinocchio itself, the true robot, its motion, and its dry friction on a
fine grid of time.

Sources: Dahl, AIAA Journal 1976; Canudas de Wit, Olsson, Astrom, Lischinsky, IEEE TAC
1995 (LuGre).
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from sdp_vs_penalty.robot._pinocchio import pin
from sdp_vs_penalty.robot.arrays import Array, Mask


@dataclass(frozen=True)
class Arm:
    """A robot in Pinocchio: the positions of its L joints are follows q + shift, with
    the positions q (n,) of those joints that move by themselves."""

    #: Pinocchio's model.
    model: Any
    #: (n,) whether each joint turns.
    rotary: Mask
    #: The model's joint that bears the last link.
    last: int
    #: (L, n) motion of the model's joints per motion of those that move by themselves.
    follows: Array
    #: (L,) positions of the model's joints at q = 0 [rad, m].
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
        """Return the rigid-body torques (N, n) [N m, N] of a Pinocchio model along a
        motion q, dq, ddq (N, n).

        With q_all = B q + shift for all joints, those that follow others included, the
        torque of the moving joints is B^T tau_all.
        """
        B = self.follows
        torque_of_all = inverse_dynamics(
            model, q @ B.T + self.shift, dq @ B.T, ddq @ B.T
        )
        return torque_of_all @ B

    def last_jacobian(self, model: Any, data: Any, q: Array) -> Array:
        """Return the Jacobian of the joint that carries the last link at positions (n,)
        [rad, m].

        Returns
        -------
        (6, n)
            Linear, then angular velocity, in world axes.
        """
        pin.computeJointJacobians(model, data, self.follows @ q + self.shift)
        J = pin.getJointJacobian(model, data, self.last, pin.LOCAL_WORLD_ALIGNED)
        return np.reshape(J, (6, -1)) @ self.follows


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
    """Return the torque M(q) ddq + C(q, dq) dq + g(q) (N, n) [N m, N] along a motion
    q, dq, ddq (N, n), by Pinocchio's RNEA."""
    data = model.createData()
    states = zip(q, dq, ddq, strict=True)
    return np.array([pin.rnea(model, data, *state) for state in states])


#: Time between two runs [s].
PAUSE = 30.0


@dataclass(frozen=True)
class TrueMotion:
    """Motion of the motors, which the encoders show."""

    #: (N,) instants since the first run began [s].
    t: Array
    #: (N, n) positions [rad, m].
    q: Array
    #: (N, n) velocities [rad/s, m/s].
    dq: Array
    #: (N, n) accelerations [rad/s^2, m/s^2].
    ddq: Array


@dataclass(frozen=True)
class DryFriction:
    """Dry friction tanh(dq / width); subclasses of the challenge have other laws."""

    #: (n,) velocity over which friction changes its sign [rad/s or m/s].
    width: Array

    @property
    def jumps(self) -> bool:
        """Whether friction changes sign with the velocity, instead of over some travel.

        It does for tanh; a world with presliding friction overrides this.
        """
        return True

    def share(self, t: Array, dq: Array) -> Array:
        """Return the dry friction in units of the Coulomb torque, tanh(dq / width), -1
        to 1, at velocities dq (N, n) [rad/s, m/s].

        Parameters
        ----------
        t : (N,)
            Time stamps [s], evenly spaced at 1 kHz or more.
        """
        return np.tanh(dq / self.width)


def bristles(
    t: Array, dq: Array, travel: Array, level: Callable[[Array], Array]
) -> Array:
    """Integrate the bristle state z of the Dahl and LuGre friction models at velocities
    dq (N, n) [rad/s, m/s].

    dz/dt = dq / d - |dq| z / (d g(dq)). Velocity is constant between two samples, where
    the equation has an exact solution, so that any step is stable. At a reversal the
    step is split at the instant of rest.

    Parameters
    ----------
    t : (N,)
        Time stamps [s], evenly spaced.
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
    """Return decay and goal (N, n) of the bristle state z in a step at constant velocities
    dq (N, n): z becomes goal + (z - goal) decay.

    Parameters
    ----------
    share : (N, n)
        Share of the step for which the velocities last.
    step : float
        Length of a step [s].
    travel : (n,)
        Presliding travel d [rad, m].
    level : callable
        Where |z| settles at a velocity.
    """
    settled = level(dq)
    decay = np.exp(-np.abs(dq) * share * step / (travel * settled))
    return decay, np.sign(dq) * settled


@dataclass(frozen=True)
class World:
    """The true robot of a simulation."""

    #: The robot as its file describes it.
    arm: Arm
    #: Pinocchio's model of the robot as it was built.
    built: Any
    #: Law of dry friction in units of the Coulomb torque.
    dry: DryFriction
    #: (n,) Coulomb torque [N m, N].
    coulomb: Array
    #: (n,) viscous friction [N m s/rad, N s/m].
    viscous: Array
    #: (n,) torque that is the same in both directions [N m, N].
    offset: Array
    #: (n,) standard deviation of the noise that a log adds to the torque [N m, N].
    noise: Array
    #: Time constant of the warming of the gears [s].
    warm_up: float = 120.0
    #: (N, n) further torque that the sensors carry along one motion [N m, N].
    more: Array | float = 0.0

    def torque(self, motion: TrueMotion) -> Array:
        """Return the torque (N, n) [N m, N] that the sensors show: rigid-body torque,
        friction, and added torque.

        Parameters
        ----------
        motion : TrueMotion
            N samples of the joints' motion.
        """
        return self.rigid(motion) + self.friction(motion) + self.more

    def rigid(self, motion: TrueMotion, model: Any = None) -> Array:
        """Return the rigid-body torque (N, n) [N m, N] of the links.

        Parameters
        ----------
        motion : TrueMotion
            N samples of the joints' motion.
        model : pin.Model, optional
            Other links; by default those of the robot as it was built.
        """
        return self.arm.inverse_dynamics(
            model or self.built, motion.q, motion.dq, motion.ddq
        )

    def friction(self, motion: TrueMotion) -> Array:
        """Return Coulomb and viscous friction plus the constant torque offset (N, n)
        [N m, N].

        Parameters
        ----------
        motion : TrueMotion
            N samples of the joints' motion.
        """
        return (
            self.coulomb * self.share(motion) + self.viscous * motion.dq + self.offset
        )

    def share(self, motion: TrueMotion) -> Array:
        """Return the dry friction (N, n) in units of the Coulomb torque, -1 to 1.

        Parameters
        ----------
        motion : TrueMotion
            N samples of the joints' motion.
        """
        return self.dry.share(motion.t, motion.dq)

    def temperature(self, t: Array) -> Array:
        """Return the temperature (N, n) [degrees Celsius] of the gears, which warm up
        from 22 degrees Celsius.

        Gears farther out are smaller and become warmer, by 10 to 25 degrees.

        Parameters
        ----------
        t : (N,)
            Time since the robot was started [s].
        """
        rise = np.linspace(10.0, 25.0, self.arm.n)
        return 22.0 + np.outer(-np.expm1(-t / self.warm_up), rise)
