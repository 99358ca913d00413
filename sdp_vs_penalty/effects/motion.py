"""What effects compute their columns from: a motion, and the current model where they
need a torque or the links."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
import scipy
from numpy.typing import NDArray

from sdp_vs_penalty.data.store import AppendableArray, drop_pages
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.robot.arrays import Array, Indices
from sdp_vs_penalty.robot.robot import Robot

#: Velocity [rad/s, m/s] over which the sign of a velocity is smoothed.
SIGN_WIDTH = 0.01
#: Positions between which a joint's inertia is averaged [rad, m], and how many.
_AVERAGED = 1.5
_POSITIONS = 16
#: Instants of a long motion at which derivatives are computed at a time.
_ROWS_AT_A_TIME = 8192


@dataclass(frozen=True)
class CurrentModel:
    """The model to which torque-dependent effects refer."""

    #: The robot.
    robot: Robot
    #: (n, 10) standard parameters of its links.
    links: Array

    @cached_property
    def mean_inertias(self) -> Array:
        """(n,) mean inertia of each joint over positions of the arm [kg m^2, kg].

        The positions are the same for all motions, so that a frequency stands for one
        stiffness in all recordings.
        """
        n = self.robot.n
        shape = _POSITIONS, n
        q = np.random.default_rng(0).uniform(-_AVERAGED, _AVERAGED, shape)
        zero = np.zeros(shape)
        at_rest = self.robot.inverse_dynamics(self.links, q, zero, zero)
        means = []
        for joint in range(n):
            acceleration = zero + np.eye(n)[joint]
            torque = self.robot.inverse_dynamics(self.links, q, zero, acceleration)
            means.append((torque - at_rest)[:, joint].mean())
        return np.array(means)


@dataclass(frozen=True)
class Sampling:
    """Samples of the log for which one instant of a motion stands."""

    #: Number of samples; 1 for the instant itself.
    count: int = 1
    #: Time between two of them [s].
    dt: float = 0.0


@dataclass(frozen=True)
class Command:
    """The command of the drives, at N evenly spaced instants.

    Between two instants Taylor's series is followed.
    """

    #: (N,) instants [s].
    t: Array
    #: (N, n) commanded positions [rad, m].
    q: Array
    #: (N, n) commanded velocities [rad/s, m/s].
    dq: Array
    #: (N, n) commanded accelerations [rad/s^2, m/s^2].
    ddq: Array
    #: (N, n) integral of the commanded position over time [rad s, m s].
    position_integral: Array

    def position(self, t: Array) -> Array:
        """Return the commanded position.

        From the nearest sample k, with h = t - t_k: q(t) = q_k + h dq_k + h^2 / 2 ddq_k.

        Parameters
        ----------
        t
            (N,) instants [s]. Instants before the first sample count as the first one,
            instants after the last as the last one.

        Returns
        -------
        Array
            (N, n) positions [rad, m].
        """
        k, h = self._nearest_sample(t)
        return self.q[k] + h * self.dq[k] + 0.5 * h * h * self.ddq[k]

    def velocity(self, t: Array) -> Array:
        """Return the commanded velocity.

        From the nearest sample k, with h = t - t_k: dq(t) = dq_k + h ddq_k.

        Parameters
        ----------
        t
            (N,) instants [s]. Instants before the first sample count as the first one,
            instants after the last as the last one.

        Returns
        -------
        Array
            (N, n) velocities [rad/s, m/s].
        """
        k, h = self._nearest_sample(t)
        return self.dq[k] + h * self.ddq[k]

    def integral(self, t: Array) -> Array:
        """Return the integral (N, n) of the commanded position over time [rad s, m s]
        at instants t (N,) [s].

        From the nearest sample k, with h = t - t_k and the integral I_k there: I(t) =
        I_k + h q_k + h^2 / 2 dq_k. Before the first and after the last sample the
        position is constant, so the integral grows linearly with q_k.
        """
        k, h = self._nearest_sample(t)
        # Time beyond the ends of the command, where h is 0; 0 between the ends.
        beyond = (t - np.clip(t, self.t[0], self.t[-1]))[:, None]
        return (
            self.position_integral[k]
            + (h + beyond) * self.q[k]
            + 0.5 * h * h * self.dq[k]
        )

    def _nearest_sample(self, t: Array) -> tuple[Array, Array]:
        """Find the sample of the command that is nearest to each of M instants t (M,).

        Returns its index (M,), and the time from it to the instant (M, 1) [s]. Instants
        outside of the samples count as the first or last one. The samples are evenly
        spaced, so the index follows by a division.
        """
        instants = np.clip(t, self.t[0], self.t[-1])
        step = float(self.t[-1] - self.t[0]) / max(len(self.t) - 1, 1)
        if step > 0.0:
            nearest = np.rint((instants - self.t[0]) / step).astype(np.intp)
        else:  # a command of one sample
            nearest = np.zeros(len(instants), np.intp)
        return nearest, (instants - self.t[nearest])[:, None]


@dataclass(frozen=True)
class Legs:
    """A path (N,) cut at its reversals into L legs of one direction."""

    #: (L + 1,) positions at the ends of the legs [rad, m].
    corners: Array
    #: (L,) 1 forwards, -1 backwards, 0 where the path never moves.
    direction: Array
    #: (N - 1,) leg of each step; a step without motion belongs to the leg before it.
    leg: Indices
    #: (N - 1,) signed distance from the leg's beginning to the step's end [rad, m].
    travel: Array

    @classmethod
    def along(cls, q: Array) -> Legs:
        """Cut a path q (N,) [rad, m] into legs at its reversals: within a leg the
        position is monotone."""
        sign = np.sign(np.diff(q))
        moving_steps = np.flatnonzero(sign)
        changes = np.flatnonzero(np.diff(sign[moving_steps]))
        reversals = moving_steps[changes + 1]  # first steps of new legs
        corners = q[np.array([0, *reversals, len(q) - 1])]
        begins_leg = np.zeros(len(sign), np.intp)
        begins_leg[reversals] = 1
        leg = np.cumsum(begins_leg)  # number of the leg of each step, from 0
        if len(moving_steps):
            direction = sign[np.concatenate([moving_steps[:1], reversals])]
        else:  # one leg at rest
            direction = np.zeros(1)
        return cls(corners, direction, leg, travel=q[1:] - corners[leg])


def _logged(field: str, what: str, columns: str) -> Any:
    """Make a property of Motion that returns an optional field, or raises InputError
    where the log does not have it.

    ``what`` names the measurements, ``columns`` the columns of RUN.csv, for the
    message.
    """

    def read(motion: Motion) -> Any:
        """Return the field of a motion, if the log has it."""
        value = getattr(motion, field)
        if value is None:
            raise InputError(
                f"these measurements hold no {what}",
                f"add columns {columns} to the log",
            )
        return value

    return property(read)


@dataclass(frozen=True)
class Motion:
    """A motion at N evenly spaced instants.

    Effects that need a torque read ``torque``, those that need inverse dynamics
    ``current``: both come from the model as it stands (in a diagnosis with what was
    found so far), never from the measured torque.
    """

    #: (N,) instants [s].
    t: Array
    #: (N, n) positions [rad, m].
    q: Array
    #: (N, n) velocities [rad/s, m/s].
    dq: Array
    #: (N, n) accelerations [rad/s^2, m/s^2].
    ddq: Array
    #: (N, n) torque of the current model [N m, N]; None without one.
    torque: Array | None = None
    #: The model to which torque-dependent effects refer; None without one.
    current: CurrentModel | None = None
    #: Velocities [rad/s, m/s] over which the sign of a velocity is smoothed: one for
    #: all joints, or one a joint. The model's own for Coulomb.
    sign_width: float | tuple[float, ...] = SIGN_WIDTH
    #: The samples of the log that each of these instants stands for, if not itself.
    within: Sampling | None = None
    #: (N, n) of each joint's gear or motor [degrees Celsius], where the log holds them.
    temperature: Array | None = None
    #: The command of the drives, None where it was not logged.
    command: Command | None = None
    #: (N, n) integral of the positions over time since the same instant as the
    #: command's [rad s, m s].
    position_integral: Array | None = None
    #: (N, n) accelerations of the motors on their joints' side of the gear, where the
    #: log holds both.
    motors: Array | None = None
    #: (N, n) what the current model makes of its torque where torque channels pass it.
    logged: Array | None = None

    #: The fields ``command``, ``position_integral``, ``temperature`` and ``motors``, but
    #: never None: InputError where the measurements hold none.
    logged_command: ClassVar[Command] = _logged("command", "commands", "qcmd1..qcmdn")
    integral: ClassVar[Array] = _logged("position_integral", "commands", "qcmd1..qcmdn")
    joint_temperature: ClassVar[Array] = _logged(
        "temperature", "temperatures", "temp1..tempn"
    )
    motor_acceleration: ClassVar[Array] = _logged(
        "motors", "positions of motors", "qmot1..qmotn"
    )

    def part(self, which: slice | NDArray[np.integer]) -> Motion:
        """Return the motion at some of its instants.

        Returns
        -------
        Motion
            The motion at these instants.
        """
        values = {f.name: getattr(self, f.name) for f in fields(self)}
        arrays: dict[str, Any] = {
            k: x[which] for k, x in values.items() if isinstance(x, np.ndarray)
        }
        return replace(self, **arrays)

    def with_torque(self, torque: Array) -> Motion:
        """Return the motion with another torque of the current model.

        What was computed from the states and the links alone is kept.

        Parameters
        ----------
        torque
            (N, n) torque [N m, N].

        Returns
        -------
        Motion
            A copy with that torque.
        """
        unaffected = ("link_torque", "_derivatives", "_signs", "_legs")
        return self._copy_keeping(unaffected, torque=torque)

    def with_link_torque(self, torque: Array) -> Motion:
        """Return the motion with a given torque in place of the current model's links.

        Parameters
        ----------
        torque
            (N, n) ``link_torque`` [N m, N].

        Returns
        -------
        Motion
            A copy without a current model, in which only that torque is known.
        """
        out = replace(self, current=None)
        out.__dict__["link_torque"] = torque
        return out

    def with_sign_width(self, width: float | tuple[float, ...]) -> Motion:
        """Return the motion with other velocities over which signs are smoothed.

        What does not follow from signs is kept.

        Parameters
        ----------
        width
            One velocity [rad/s, m/s] for all joints, or one a joint.

        Returns
        -------
        Motion
            A copy with these widths.
        """
        unaffected = ("link_torque", "_derivatives", "_legs")
        return self._copy_keeping(unaffected, sign_width=width)

    def _copy_keeping(self, computed: Sequence[str], **changes: Any) -> Motion:
        """Return a copy with changed fields, and with the named quantities where they
        have been computed, since they do not follow from these fields."""
        out = replace(self, **changes)
        for name in computed:
            if name in self.__dict__:
                out.__dict__[name] = self.__dict__[name]
        return out

    def sign(self, joint: int, width: float | None = None) -> Array:
        """Compute the smooth sign of the velocity of a joint (from 0).

        Parameters
        ----------
        width
            Velocity over which the sign turns [rad/s, m/s]; None: the joint's own.

        Returns
        -------
        Array
            (N,) values in [-1, 1].
        """
        if width is None:
            return self._signs[joint]
        return smooth_sign(self.dq[:, joint], width, self.ddq[:, joint], self.within)

    def sign_ahead(self, joint: int, lead: float) -> Array:
        """Compute the smooth sign of the velocity of a joint (from 0) a little later.

        Parameters
        ----------
        lead
            How much later [s]: the velocity there is dq + lead ddq, to first order.

        Returns
        -------
        Array
            (N,) values in [-1, 1].
        """
        acceleration = self.ddq[:, joint]
        velocity = self.dq[:, joint] + lead * acceleration
        return smooth_sign(velocity, self.width(joint), acceleration, self.within)

    def sign_along(self, ratios: Array, width: float | None = None) -> Array:
        """Compute the smooth sign of a combination of velocities.

        Parameters
        ----------
        ratios
            (n,) factors of the joints' velocities.
        width
            Velocity over which the sign turns [rad/s, m/s]; None: the largest of these
            joints'.

        Returns
        -------
        Array
            (N,) values in [-1, 1].
        """
        joint = _single_joint(ratios)
        if joint is not None:
            return self.sign(joint)
        if width is None:
            width = max(self.width(j) for j in np.flatnonzero(ratios).tolist())
        return smooth_sign(self.dq @ ratios, width, self.ddq @ ratios, self.within)

    def legs_along(self, ratios: Array) -> Legs:
        """Cut the path of a combination of positions into legs.

        Parameters
        ----------
        ratios
            (n,) factors of the joints' positions.
        """
        joint = _single_joint(ratios)
        return Legs.along(self.q @ ratios) if joint is None else self._legs[joint]

    @cached_property
    def _signs(self) -> Array:
        """(n, N) smooth signs of all joints' velocities, each over its joint's
        width."""
        joints = range(self.dq.shape[1])
        return np.stack([self.sign(j, self.width(j)) for j in joints])

    @cached_property
    def _legs(self) -> list[Legs]:
        """Legs between reversals of each joint's path."""
        return [Legs.along(q) for q in self.q.T]

    def width(self, joint: int) -> float:
        """Return the velocity over which the sign of a joint (from 0) is smoothed
        [rad/s, m/s]."""
        w = self.sign_width
        return w[joint] if isinstance(w, tuple) else w

    @cached_property
    def model_torque(self) -> Array:
        """(N, n) torque of the current model [N m, N]; ValueError in a motion without
        one."""
        if self.torque is None:
            raise ValueError(
                "this effect needs Motion.torque, the current model's prediction:"
                " declare needs_torque = True"
            )
        return self.torque

    @property
    def modelled(self) -> Array:
        """(N, n) torque of the current model [N m, N] as the torque channels read it:
        with their gains and delays if the model has some."""
        return self.model_torque if self.logged is None else self.logged

    @cached_property
    def link_torque(self) -> Array:
        """(N, n) torque that the gears transmit [N m, N]: the rigid-body torque of the
        current model's links, without friction."""
        return self._model.robot.inverse_dynamics(
            self.model_links, self.q, self.dq, self.ddq
        )

    def late_torque_rate(self, T: float) -> Array:
        """Compute (tau(t) - tau(t - T)) / T (N, n) [N m/s, N/s] of the current model's
        torque, with a delay T [s].

        For a T below two samples it is the difference over two samples about the same
        middle.
        """
        step = (self.t[-1] - self.t[0]) / max(len(self.t) - 1, 1)
        middle = self.t - 0.5 * T  # of the interval from t - T to t
        half = max(0.5 * abs(T), step)  # half the interval, at least one sample
        torques = self.model_torque.T
        later = np.stack([np.interp(middle + half, self.t, x) for x in torques], axis=1)
        sooner = np.stack(
            [np.interp(middle - half, self.t, x) for x in torques], axis=1
        )
        return (later - sooner) / (2.0 * half)

    def rates(self, values: Array) -> tuple[Array, Array, Array]:
        """Differentiate values twice in time.

        Parameters
        ----------
        values
            (N, ...) values at these instants.

        Returns
        -------
        tuple of Array
            The values, their first and their second derivative, each (N, ...).
        """
        rate = _time_derivative(values, self.t)
        return values, rate, _time_derivative(rate, self.t)

    def smoothed(self, values: Array, band: float) -> Array:
        """Remove from values (N, ...) at these instants what is faster than the
        frequency ``band`` [Hz].

        The gain is 1 / (1 + (f / band)^8): a Butterworth filter of fourth order,
        forwards and backwards. Values are continued as odd functions beyond both ends,
        so a sine transform of their deviation from the straight line between the ends
        applies it.
        """
        # Sampling rate [Hz]; the tiny number avoids a division by zero.
        rate = (len(self.t) - 1) / max(float(self.t[-1] - self.t[0]), 1e-300)
        # Frequencies at half the rate and above do not occur in samples.
        if not 2.0 * band < rate or len(values) < 3:
            return values
        line = np.linspace(values[0], values[-1], len(values))
        waves = scipy.fft.dst((values - line)[1:-1], type=1, axis=0)
        # Frequency [Hz] of each coefficient of the sine transform.
        f = np.arange(1, len(values) - 1) * rate / (2 * len(values) - 2)
        attenuation = 1.0 + (f / band) ** 8
        waves /= attenuation.reshape(
            -1, *[1] * (values.ndim - 1)
        )  # along the first axis
        smooth = line
        smooth[1:-1] += scipy.fft.idst(waves, type=1, axis=0)
        return smooth

    @property
    def mean_inertias(self) -> Array:
        """(n,) mean inertia of each joint of the current model over positions of the
        arm [kg m^2, kg]; ValueError without a current model."""
        return self._model.mean_inertias

    @property
    def model_links(self) -> Array:
        """(n, 10) standard parameters of the current model's links; ValueError without
        a current model."""
        return self._model.links

    @property
    def _model(self) -> CurrentModel:
        """The current model; ValueError in a motion without one."""
        if self.current is None:
            raise ValueError(
                "this effect needs Motion.current, the current model's links:"
                " declare needs_links = True"
            )
        return self.current

    def derivatives(self, joint: int) -> tuple[Array, Array, Array]:
        """Return derivatives of the inverse dynamics of the current model's links by
        the state of one joint (from 0).

        Returns
        -------
        three (N, n) arrays
            Change of all torques by the joint's position, velocity and acceleration.
        """
        last = self._last_derivatives
        if joint not in last:
            last.clear()
            of_joint = []
            for derivative in self._derivatives:
                of_joint.append(derivative[:, :, joint].copy())
                drop_pages(derivative)
            by_q, by_dq, by_ddq = of_joint
            if len(self.t) > _ROWS_AT_A_TIME:  # too much memory to keep
                return by_q, by_dq, by_ddq
            last[joint] = by_q, by_dq, by_ddq
        return last[joint]

    @cached_property
    def _last_derivatives(self) -> dict[int, tuple[Array, Array, Array]]:
        """What :meth:`derivatives` returned last, by its joint."""
        return {}

    @cached_property
    def _derivatives(self) -> list[Array]:
        """Derivatives of the torques by q, dq and ddq, three arrays (N, n, n): entry
        [t, i, j] is the change of torque i by the state of joint j. Large ones lie in
        temporary files."""
        model = self._model
        by_states = [AppendableArray() for _ in range(3)]
        for start in range(0, len(self.t), _ROWS_AT_A_TIME):
            rows = slice(start, start + _ROWS_AT_A_TIME)
            parts = model.robot.inverse_dynamics_derivatives(
                model.links, self.q[rows], self.dq[rows], self.ddq[rows]
            )
            for by_state, part in zip(by_states, parts, strict=True):
                by_state.append(part)
        return [by_state.array() for by_state in by_states]


def _single_joint(ratios: Array) -> int | None:
    """Return the joint (from 0) if a combination c q has the ratio 1 on one joint and
    zero on all others; None for any other combination. ``ratios`` c is (n,)."""
    joints = np.flatnonzero(ratios).tolist()
    if len(joints) != 1 or ratios[joints[0]] != 1.0:
        return None
    return joints[0]


def _time_derivative(values: Array, t: Array) -> Array:
    """Differentiate values (N, ...) at instants t (N,) [s] by central differences."""
    return np.gradient(values, t, axis=0) if len(t) > 1 else np.zeros_like(values)


def smooth_sign(
    velocity: Array,
    width: float = SIGN_WIDTH,
    rate: Array | None = None,
    within: Sampling | None = None,
) -> Array:
    """Compute tanh(dq / width), a sign of velocities dq (N,) [rad/s, m/s] that does not
    jump with noise near zero.

    Where each instant stands for several samples of the log (a motion at a lower rate),
    the mean of the sign over these samples is returned: a sign read at every fourth
    sample would turn up to two samples too early or too late.

    Parameters
    ----------
    width
        Velocity over which the sign turns [rad/s, m/s].
    rate
        (N,) accelerations [rad/s^2, m/s^2], needed for the mean.
    within
        Number and spacing of the samples that each instant stands for.

    Returns
    -------
    Array
        (N,) values in [-1, 1].
    """
    if rate is None or within is None or within.count < 2:
        # tanh(x) = 1 - 2 / (exp(2 x) + 1): the exponential is ten times as fast in
        # NumPy as tanh. Beyond x = 20 tanh is 1 to the last bit.
        exp_of_twice = np.exp(2.0 * np.clip(velocity / width, -20.0, 20.0))
        return 1.0 - 2.0 / (exp_of_twice + 1.0)
    out = np.sign(velocity)
    # The mean is computed only where the velocity comes near zero within the samples;
    # elsewhere tanh is +-1 to the last bit.
    reach = 20.0 * width + 0.5 * within.count * within.dt * np.abs(rate)
    near = np.flatnonzero(np.abs(velocity) < reach)
    # Samples before and after the instant, all of equal weight; an even number of them
    # has two half samples at the ends.
    half = within.count // 2
    weights = np.full(2 * half + 1, 1.0 / within.count)
    if within.count % 2 == 0:
        weights[[0, -1]] *= 0.5
    # tanh(x) = 1 - 2 / (exp(2 x) + 1), with 2 x growing by ``step`` from sample to
    # sample. The loop over samples needs little memory.
    step = 2.0 * within.dt / width * rate[near]
    twice = 2.0 / width * velocity[near] - half * step
    below = np.zeros(len(near))
    for weight in weights.tolist():
        below += weight / (np.exp(np.minimum(twice, 40.0)) + 1.0)
        twice += step
    out[near] = 1.0 - 2.0 * below
    return out
