"""What the torque channels do to the torque: a zero, a gain, a delay, a filter."""

from collections.abc import Iterable

import numpy as np
import scipy

from sdp_vs_penalty.effects.effect import (
    STANDS,
    Array,
    Effect,
    JointCoverage,
    JointEffect,
    Motion,
)
from sdp_vs_penalty.effects.partner import WithPartner
from sdp_vs_penalty.effects.shape import ShapeConstant, choice
from sdp_vs_penalty.robot.robot import Robot


class TorqueOffset(JointEffect):
    equation = "f_o"
    explanation = (
        "The zero of a torque or current sensor, or a friction that differs by"
        " direction."
    )
    on_the_arm = "the torque reading of {joint} is {signed} where it should be zero"
    seen_against = "time"
    has_constant_part = True
    simulator_field = "offset"
    reference = "Gaz et al., RA-L 2019, eq. 9"
    signless = True
    symbol = "f_o"

    def column(self, motion: Motion, joint: int) -> Array:
        """Return ones (N,): the torque per unit of offset."""
        return np.ones(len(motion.t))


#: Drives state their gains to some per cent; beyond this, something else is wrong.
_LARGEST = 0.3
#: Usual time constant of a drive's filter, and usual delay [s]: a bandwidth of 8 Hz.
_FILTER = 0.02
#: A delay below this share of the time between two samples may be one of the instants
#: alone: a controller holds its torque for a cycle, and logs keep every tenth cycle or
#: fewer.
_INSTANT = 0.1
#: Delays from which a search starts [s]. The shortest is not enough: where all joints are
#: 12 ms late and one of them 20 ms more, the column of 1 ms is within the error of the
#: common delay's column.
_STARTS = 0.001, 0.005, 0.025


class TorqueGain(JointEffect):
    equation = "g tau_hat"
    explanation = (
        "The torque channel of this joint reads 1 + g times the true torque: a sensor's"
        " or a drive's gain. It is identifiable because the other joints show the true"
        " inertia."
    )
    on_the_arm = "the torque reading of {joint} is {share} too {sign:large|small}"
    on_the_arm_unscaled = (
        "{joint} has another drive gain: for a torque its channel reads {share}"
        " {sign:more|less} than those of the other joints"
    )
    seen_against = "modelled torque"
    reference = "Gautier, Briot, ASME J. Dynamic Systems 2014 (drive gains)"
    symbol = "g"
    units = ("-", "-")
    usual = (_LARGEST, _LARGEST)
    faults = ("torque gain",)
    needs_torque = True
    forward = "channel"

    def column(self, motion: Motion, joint: int) -> Array:
        """Return the current model's torque (N,) [N m, N]: the channel adds the gain's
        share of it."""
        return motion.model_torque[:, joint]

    def invert_channel(self, theta: Array, t: Array, torque: Array) -> Array:
        """Divide the readings (N, n) of the effect's joints by 1 + g to recover the
        true torque."""
        true_torque = torque.copy()
        true_torque[:, list(self.joints)] /= 1.0 + theta
        return true_torque

    def looks_like(self, size: float, coverage: JointCoverage) -> str:
        """Give a reason to doubt a gain that is off by more than 30 %: a wrong gear
        ratio or unit is more likely. ``size`` is the gain's deviation g [-]."""
        if abs(size) > _LARGEST:
            return (
                f"a gain that is off by {100.0 * abs(size):.0f} % is rather a wrong"
                " ratio or unit"
            )
        return super().looks_like(size, coverage)


#: Sensors state their crosstalk to some per cent. Beyond this a motor drives through a
#: gear whose ratio somebody has chosen, and its friction turns with both joints: that of
#: the TX40's wrist (transmission_friction) looks like shares of .2 and .9.
_LARGEST_SHARE = 0.1


class TorqueCrosstalk(WithPartner):
    equation = "g_x tau_hat_i"
    explanation = (
        "The reading of joint j holds a share g_x, at most a tenth, of the torque of"
        " joint i: a torque sensor that feels the next one's load, a belt that carries"
        " some of it. i counts from 1; 0 means the previous joint (the next one for"
        " joint 1)."
    )
    on_the_arm = (
        "the torque reading of {joint} holds {share} of the torque of "
        "{other}{sign:|, with the sign reversed}"
    )
    reference = (
        "Khalil, Dombre, Modeling, Identification and Control of Robots, 2002, ch. 1"
        " (coupled gears)"
    )
    symbol = "g_x"
    units = ("-", "-")
    usual = (0.5 * _LARGEST_SHARE, 0.5 * _LARGEST_SHARE)
    largest_parameter = _LARGEST_SHARE
    several = True
    needs_torque = True
    forward = "channel"
    shapes = {"i": ShapeConstant(0.0, signed=True)}

    def column(self, motion: Motion, joint: int) -> Array:
        """Return the current model's torque (N,) [N m, N] of the partner."""
        return motion.model_torque[:, self.partner(joint)]

    def invert_channel(self, theta: Array, t: Array, torque: Array) -> Array:
        """Take the partners' shares out of the readings (N, n): of a mixture (1 + G)
        tau the true torque tau."""
        n = torque.shape[1]
        mixture = np.eye(n)
        for share, j in zip(theta, self.joints, strict=True):
            mixture[j, self.partner(j)] += share
        return np.asarray(np.linalg.solve(mixture, torque.T).T)


class DelayedTorque(Effect):
    """Torque that is logged later than the positions; each parameter is as long as the
    shape constant T."""

    reference = (
        "Hollerbach, Khalil, Gautier, Springer Handbook of Robotics, Model"
        " Identification"
    )
    units = ("s", "s")
    usual = (_FILTER, _FILTER)
    lower = 0.0
    needs_torque = True
    has_memory = True  # time derivatives and filters look at other samples
    sized_shape = "T"

    @classmethod
    def starts(cls, robot: Robot, joint: int) -> Iterable[dict[str, float]]:
        """List the shape constants with which a search begins.

        A robot with one joint gets none for an effect of the whole robot: a delay of
        all joints is the delay of that joint, which another effect describes; and
        filtered friction cannot be told from filtered inertia there.
        """
        is_that_of_one_joint = cls.whole_robot and robot.n == 1
        return [] if is_that_of_one_joint else super().starts(robot, joint)

    def looks_like(self, size: float, coverage: JointCoverage) -> str:
        """Give a reason to doubt a delay [s] that is shorter than the log's instants are
        known."""
        if size != 0.0 and abs(size) < _INSTANT * coverage.step:
            return (
                "it is shorter than a tenth of the time between two samples: a control"
                " cycle, or how positions were integrated, looks so"
            )
        return super().looks_like(size, coverage)


class ChannelDelay(DelayedTorque):
    """Torque that is logged later by the same time at every frequency."""

    forward = "channel"
    shapes = {"T": ShapeConstant(0.001, "s", grid=_STARTS, signed=True)}

    def invert_channel(self, theta: Array, t: Array, torque: Array) -> Array:
        """Read the torque (N, n) of each joint later by its delay, to undo the
        delay."""
        true_torque = torque.copy()
        delays = np.broadcast_to(theta, len(self.joints))
        for delay, j in zip(delays, self.joints, strict=True):
            true_torque[:, j] = np.interp(t + delay, t, torque[:, j])
        return true_torque


class TorqueDelay(ChannelDelay, JointEffect):
    equation = "T_d (tau_hat(t - T) - tau_hat(t)) / T"
    explanation = (
        "This joint's torque is logged T_d later than its position: a filter in the"
        " drive, a slower bus. T is T_d."
    )
    on_the_arm = "the torque of {joint} is logged {time} later than its position"
    symbol = "T_d"
    faults = ("channel delay", "channel filter")

    def column(self, motion: Motion, joint: int) -> Array:
        """Return the change of the current model's torque over the delay T, divided by
        -T (N,) [N m/s, N/s]: a later torque is tau - T dtau/dt to first order."""
        return -motion.late_torque_rate(self.shape["T"])[:, joint]


class GlobalDelay(ChannelDelay):
    equation = "T_g (tau_hat(t - T) - tau_hat(t)) / T on every joint"
    explanation = (
        "All torques are logged T_g later than the positions: two clocks, or one filter"
        " for all channels. Below 0 they are early: the log has the commands, which the"
        " drives follow later; a joint that sticks or bends before it moves looks"
        " similar. T is T_g."
    )
    on_the_arm = "all torques are logged {time} {sign:later|earlier} than the positions"
    symbol = "T_g"
    faults = ("delay", "torque filter")
    lower = -np.inf
    shapes = {
        "T": ShapeConstant(
            0.001, "s", grid=(-_STARTS[1], *_STARTS), signed=True, scale="linear"
        )
    }
    whole_robot = True

    def torques(self, motion: Motion) -> Array:
        """Return the change of the current model's torque over the delay T, divided by
        -T, of all joints (N, n, 1): a later torque is tau - T dtau/dt to first order.
        """
        return -motion.late_torque_rate(self.shape["T"])[:, :, None]


class TorqueFilter(DelayedTorque):
    equation = (
        "T_f (H(T) tau_hat - tau_hat) / T on every joint, H = 1 / (1 + T s) or H(T)"
        " H(-T)"
    )
    explanation = (
        "All torques are logged behind one low-pass filter of the time constant T, of"
        " which the positions know nothing: a drive's current filter, which also delays"
        " (phase late), or one that looks both ways, as a mean of samples does (phase"
        " zero: tau_hat without the links' torque). T is T_f: all of the torque passes."
    )
    on_the_arm = (
        "all torques have passed a filter of {time} that the positions have not"
    )
    symbol = "T_f"
    faults = ("delay", "torque filter")
    forward = "left out"  # no instant's torque is known from that instant's reading
    whole_robot = True
    shapes = {
        "T": ShapeConstant(0.005, "s", grid=_STARTS),
        "phase": choice("late", "zero"),
    }

    @property
    def resembles(self) -> tuple[str, ...]:  # type: ignore[override]
        """Names of effects with nearly the same torque.

        A zero-phase filter smooths the step of friction before and after a reversal.
        Pre-sliding friction, which changes sign over a travel, does the same.
        """
        return ("presliding_hysteresis",) if self.needs_links else ()

    @property
    def needs_links(self) -> bool:  # type: ignore[override]
        """Whether the filter is a zero-phase one (phase = zero): only then it acts on
        the torque without the links' torque, which the columns need."""
        return self.shape["phase"] == 2.0

    def torques(self, motion: Motion) -> Array:
        """Return (filtered torque - torque) / T (N, n, 1) [N m/s, N/s] of the current
        model.

        The filter is a first-order lag with time constant T. A zero-phase filter
        (``needs_links``) is a second lag backwards in time; it acts on the torque
        without the links' torque.
        """
        T = self.shape["T"]
        torque = motion.model_torque
        if self.needs_links:
            # The links' torque is smooth but for noise of the accelerations, which the
            # measured torque does not have: smoothing that noise would always help.
            torque = torque - motion.link_torque
        passed = first_order_lag(torque, motion.t, T)
        if self.needs_links:
            backwards = passed[::-1]
            passed = first_order_lag(backwards, motion.t, T)[::-1]
        return ((passed - torque) / T)[:, :, None]

    def looks_like(self, size: float, coverage: JointCoverage) -> str:
        """Give a reason to doubt a zero-phase filter if the joints stand still at
        reversals: there friction changes sign as slowly by itself."""
        if self.needs_links and coverage.stands > STANDS:
            return (
                "joints stand still at reversals, where friction turns round as slowly"
                " by itself"
            )
        return super().looks_like(size, coverage)

    def as_sized(self, size: float) -> float:
        """Return the filter's time constant [s] that follows from the parameter T_f.

        A filter with delay (phase = late) has the time constant T_f. A zero-phase
        filter changes the torque by the square of its time constant T_true, so the
        parameter found with the shape constant T is T_f = T_true^2 / T, and
        T_true = sqrt(T T_f).
        """
        is_late = self.shape["phase"] == 1.0
        if is_late:
            return size
        return float(np.sqrt(self.shape["T"] * max(size, 0.0)))


def first_order_lag(x: Array, t: Array, T: float) -> Array:
    """Filter x (N, n) by T dy/dt + y = x [T in s] at evenly spaced instants t (N,) [s],
    beginning in the steady state; y (N, n) is exact where x is linear between samples.
    """
    if len(t) < 2:
        return x
    step = (t[-1] - t[0]) / (len(t) - 1)
    decay = np.exp(-step / T)
    mean = (1.0 - decay) * T / step
    # y_k - decay y_k-1 = (1 - mean) x_k + (mean - decay) x_k-1, and y_0 = x_0.
    right_side = (1.0 - mean) * x
    right_side[1:] += (mean - decay) * x[:-1]
    right_side[0] = x[0]
    # The matrix has ones on its diagonal and -decay below it.
    bands = np.stack([np.ones(len(t)), np.full(len(t), -decay)])
    lower_and_upper = (1, 0)
    return scipy.linalg.solve_banded(
        lower_and_upper, bands, right_side, check_finite=False
    )
