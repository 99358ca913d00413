"""What a joint's torque error may depend on: columns of each cause, and the share of
the error that they explain on stretches of the motion that were not fitted.

A cause is what a person sees in a log: a reversal, a standstill, a position, the time.
Each cause has columns; the error may be any combination of them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.diagnosis.events import spectral_lines
from sdp_vs_penalty.diagnosis.linear_fit import orthonormal
from sdp_vs_penalty.effects.effect import smooth_sign
from sdp_vs_penalty.estimation.constants import CHANGES
from sdp_vs_penalty.robot.arrays import Array, nonzero_or_one
from sdp_vs_penalty.signals.reversals import since_reversal
from sdp_vs_penalty.signals.segments import SegmentedRuns
from sdp_vs_penalty.signals.standstill import STILL

REVERSAL = "reversal"
STANDSTILL = "standstill"
HIGH_SPEED = "high speed"
VELOCITY = "velocity"
POSITION = "position"
TURN = "position in a turn"
BY_DIRECTION = "position and direction"
POSE = "position of several joints"
WAVES = "waves per turn"
ACCELERATION = "acceleration"
LOAD = "load"
TIME = "time"
HUM = "hum"
OTHER_JOINTS = "other joints"
MODELLED_TORQUE = "modelled torque"
TORQUE_RATE = "late torque"
TORQUE_CURVATURE = "yielding gear"

#: Seconds around a velocity reversal over which an error follows it.
FOLLOWS = 0.4
#: Share of the largest speed from which on a joint is fast.
FAST = 0.75
#: Hat functions of a quantity; an odd number, so that one of them sits at the reversal
#: itself.
_HATS = 9
#: Waves in a turn that count as slow: those of gears are looked for in the spectrum.
_TURNS = (1, 2, 3, 4)
#: What a share counts that functions of other joints explain.
_OTHERS_COUNT = 0.75
#: Share of a column's energy below which the model makes it itself; rounding and
#: interpolation leave less.
_ABSORBED = 1e-6
#: Ridges that are tried, over the mean energy of a column.
_RIDGES = np.array([1e-3, 1e-2, 1e-1])
#: Shares that differ by less are of causes that data do not tell apart.
_SAME_SHARE = 0.02
#: Causes with a single column: the simplest, where several explain the same.
_SINGLE_COLUMNS = (MODELLED_TORQUE, TORQUE_RATE, TORQUE_CURVATURE)
#: Powers of time: a drift goes on where it was not seen, hat_functions do not.
_TIME_POWERS = (1, 2, 3)


@dataclass(frozen=True)
class States:
    """The state of motion and the torque at every filtered row."""

    #: The filtered rows.
    rows: SegmentedRuns
    #: (M, n) position [rad or m].
    q: Array
    #: (M, n) velocity [rad/s or m/s].
    dq: Array
    #: (M, n) acceleration [rad/s^2 or m/s^2].
    ddq: Array
    #: (M, n) measured torque [N m or N].
    torque: Array
    #: (M,) time [s].
    t: Array
    #: (M, n) torque of the model [N m or N].
    modelled: Array
    #: (M, n) derivative of the model's torque by time [N m/s or N/s].
    torque_rate: Array
    #: (M, n) second derivative by time of the torque that the gears transmit, which is
    #: the modelled torque without friction [N m/s^2 or N/s^2].
    torque_curvature: Array

    @classmethod
    def of(cls, rows: SegmentedRuns) -> States:
        """Compute the motion and torque of all rows, low-passed as the measured torque
        was.

        Each array is (M, n): segments below each other, a column for each joint.
        """

        def filtered(name: str, derivatives: int = 0) -> Array:
            """Return a low-passed signal (M, n) of all segments, or a derivative."""
            parts = []
            for segment in rows.segments:
                signal = getattr(segment.motion, name)
                for _ in range(derivatives):
                    signal = np.gradient(signal, segment.motion.t, axis=0)
                parts.append(segment.low_pass @ signal)
            return np.concatenate(parts)

        return cls(
            rows=rows,
            q=filtered("q"),
            dq=filtered("dq"),
            ddq=filtered("ddq"),
            torque=filtered("torque"),
            t=rows.t,
            modelled=filtered("modelled"),
            torque_rate=filtered("modelled", derivatives=1),
            torque_curvature=filtered("link_torque", derivatives=2),
        )

    def others(self, joint: int) -> list[int]:
        """List the numbers (from 0) of all joints except ``joint``."""
        return [i for i in range(self.rows.n) if i != joint]


@dataclass(frozen=True)
class JointError:
    """The torque error of one joint."""

    #: Number of the joint, from 0.
    joint: int
    #: (M,) torque error [N m or N].
    error: Array
    #: Waves per turn of the joint that stand out of its spectrum.
    orders: Sequence[int]


def hat_functions(x: Array, knots: Array | None = None) -> Array:
    """Return piecewise linear hat functions (N, K) of x (N,), one for each of K knots.

    Each is 1 at its knot and falls to 0 at the two neighbouring knots, so that they add
    up to one; their weighted sums are all piecewise linear functions of x. Default
    knots: up to _HATS (9) quantiles of x. A constant x has one function, 1.
    """
    if knots is None:
        knots = np.unique(np.quantile(x, np.linspace(0.0, 1.0, _HATS)))
    if len(knots) < 2:
        return np.ones((len(x), 1))
    # A row of the identity: the values of one hat at all knots.
    functions = [np.interp(x, knots, values) for values in np.eye(len(knots))]
    return np.column_stack(functions)


def travel_since_reversal(q: Array, velocity: Array, rows: SegmentedRuns) -> Array:
    """Return the distance (M,) of a joint from its position at the last reversal [rad
    or m].

    Parameters
    ----------
    q, velocity
        (M,) position and velocity of the joint.
    rows
        The rows with their segments. At the begin of a segment the distance counts from
        its first row.
    """
    segment = rows.segment
    has_turned = np.sign(velocity[1:]) != np.sign(velocity[:-1])
    is_new_segment = segment[1:] != segment[:-1]
    begins = np.ones(len(q), bool)
    begins[1:] = has_turned | is_new_segment
    # Of each row the last row before it at which something begins.
    starts = np.where(begins, np.arange(len(q)), 0)
    last_start = np.maximum.accumulate(starts)
    return np.asarray(np.abs(q - q[last_start]))


def _reversal_columns(states: States, joint_error: JointError) -> Array:
    """Return the columns (M, k) for the cause "reversal": functions that a
    least-squares fit to the joint's error combines.

    There are hat functions (piecewise linear) of the time within FOLLOWS (0.4 s) of the
    nearest velocity reversal, the same times the direction after it, and hat functions
    of the distance travelled since the last reversal times the direction (hysteresis).
    """
    velocity = states.dq[:, joint_error.joint]
    since, direction = since_reversal(states.t, velocity, states.rows.segment)
    near = np.abs(since) < FOLLOWS
    in_time = near[:, None] * hat_functions(
        since, np.linspace(-FOLLOWS, FOLLOWS, _HATS)
    )
    travel = travel_since_reversal(
        states.q[:, joint_error.joint], velocity, states.rows
    )
    in_travel = hat_functions(travel) * smooth_sign(velocity)[:, None]
    return np.hstack([in_time, in_time * direction[:, None], in_travel])


def _standstill_columns(states: States, joint_error: JointError) -> Array:
    """Return the columns (M, 2) for the cause "standstill".

    At rows where the joint stands they are 1 and the smoothed sign of its velocity; at
    all other rows 0.
    """
    still = np.asarray(states.rows.still[:, joint_error.joint] > STILL, float)
    direction = smooth_sign(states.dq[:, joint_error.joint])
    return np.column_stack([still, still * direction])


def _high_speed_columns(states: States, joint_error: JointError) -> Array:
    """Return the columns (M, 2) for the cause "high speed": e = max(|dq| - FAST max
    |dq|, 0), and e times the direction.

    They are 0 below FAST (3/4) of the joint's largest speed.
    """
    velocity = states.dq[:, joint_error.joint]
    speed = np.abs(velocity)
    excess = np.maximum(speed - FAST * speed.max(), 0.0)
    return np.column_stack([excess, excess * smooth_sign(velocity)])


def _velocity_columns(states: States, joint_error: JointError) -> Array:
    """Return the columns (M, k) for the cause "velocity" v of the joint.

    They are hat functions, whose sums approximate any function of v, with v^2 and v
    |v|, which extrapolate beyond the fitted speeds as hat functions do not.
    """
    v = states.dq[:, joint_error.joint]
    return np.column_stack([hat_functions(v), v**2, v * np.abs(v)])


def _position_columns(states: States, joint_error: JointError) -> Array:
    """Return the columns (M, k) for the cause "position": hat functions of the joint's
    position, whose sums approximate any function of it.
    """
    return hat_functions(states.q[:, joint_error.joint])


def _turn_columns(states: States, joint_error: JointError) -> Array:
    """Return the columns (M, 8) for the cause "position in a turn": sin(k q) and cos(k
    q) for k = 1 ... 4 waves per turn of the joint.

    An eccentric gear, or a tight place that returns at each turn, shows in them.
    """
    angles = [k * states.q[:, joint_error.joint] for k in _TURNS]
    return np.column_stack([wave(a) for a in angles for wave in (np.sin, np.cos)])


def _position_and_direction_columns(states: States, joint_error: JointError) -> Array:
    """Return the columns (M, k) for the cause "position and direction": Coulomb
    friction whose size is any function of the position.

    They are hat functions of the joint's position times the smoothed sign of its
    velocity.
    """
    direction = smooth_sign(states.dq[:, joint_error.joint])
    return hat_functions(states.q[:, joint_error.joint]) * direction[:, None]


def _pose_columns(states: States, joint_error: JointError) -> Array:
    """Return the columns (M, 4 (n - 1)) for the cause "position of several joints",
    such as an error of gravity.

    They are the products of sin q_j and cos q_j of this joint with sin q_i and cos q_i
    of each other joint.
    """
    of_joint = _sine_and_cosine(states.q[:, joint_error.joint])
    products = []
    for i in states.others(joint_error.joint):
        of_other = _sine_and_cosine(states.q[:, i])
        products += [a * b for a in of_joint for b in of_other]
    return _stack_columns(products, len(states.t))


def _sine_and_cosine(q: Array) -> tuple[Array, Array]:
    """Return sin q and cos q of an angle q (M,) [rad], in this order."""
    return np.sin(q), np.cos(q)


def _stack_columns(parts: Sequence[Array], rows: int) -> Array:
    """Stack arrays (M,) as columns of one array (M, k); an empty list gives (M, 0)."""
    return np.column_stack(parts) if parts else np.zeros((rows, 0))


def _wave_columns(states: States, joint_error: JointError) -> Array:
    """Return the columns (M, 2 K) for the cause "waves per turn": cos(k q) and sin(k
    q), low-passed as the torque was, of the K orders k in ``joint_error.orders``.
    """
    parts = []
    for segment in states.rows.segments:
        q = segment.motion.q[:, joint_error.joint]
        waves = []
        for order in joint_error.orders:
            waves.append(segment.low_pass @ np.cos(order * q))
            waves.append(segment.low_pass @ np.sin(order * q))
        parts.append(_stack_columns(waves, len(segment.t)))
    return np.concatenate(parts)


def _acceleration_columns(states: States, joint_error: JointError) -> Array:
    """Return the columns (M, k) for the cause "acceleration": hat functions of ddq,
    whose sums approximate any function of it, and ddq itself.

    Beyond the fitted range hat functions stay constant; the column ddq extrapolates
    there.
    """
    a = states.ddq[:, joint_error.joint]
    return np.column_stack([hat_functions(a), a])


def _load_columns(states: States, joint_error: JointError) -> Array:
    """Return the columns (M, k) for the cause "load", the joint's measured torque tau.

    They are hat functions of tau (any function of it), hat functions of |tau| times the
    direction (friction that grows with the load), and tau itself, which extrapolates.
    """
    torque = states.torque[:, joint_error.joint]
    direction = smooth_sign(states.dq[:, joint_error.joint])
    by_size = hat_functions(np.abs(torque)) * direction[:, None]
    return np.column_stack([hat_functions(torque), by_size, torque])


def _time_columns(states: States, joint_error: JointError) -> Array:
    """Return the columns (M, 9) for the cause "time": a drift of an offset, of Coulomb
    and of viscous friction.

    They are s, s^2, s^3, then these times the direction, then times the velocity. s is
    the time from the middle of the recording over half its length, so from -1 to 1.
    """
    t = states.t - states.t.mean()
    t = t / nonzero_or_one(np.abs(t).max())
    powers = np.column_stack([t**k for k in _TIME_POWERS])
    direction = smooth_sign(states.dq[:, joint_error.joint])
    velocity = states.dq[:, joint_error.joint]
    return np.hstack([powers, powers * direction[:, None], powers * velocity[:, None]])


def _hum_columns(states: States, joint_error: JointError) -> Array:
    """Return the columns (M, 2 L) for the cause "hum": sine and cosine of 2 pi f t for
    each of L spectral lines f [Hz] of the error below the filter's cut-off.

    Only segments of at least half the length of the longest are searched for lines,
    since all are cut to the length of the shortest.
    """
    rows = states.rows
    pieces = [joint_error.error[rows.segment == k] for k in np.unique(rows.segment)]
    longest = max(len(p) for p in pieces)
    long_enough = [p for p in pieces if 2 * len(p) > longest]
    lines = spectral_lines(long_enough, rows.rate, rows.n, highest=rows.cutoff)
    waves = []
    for frequency in lines:
        angle = 2.0 * np.pi * frequency * states.t
        waves += [np.sin(angle), np.cos(angle)]
    return _stack_columns(waves, len(states.t))


#: What of another joint an error may depend on, in the order of the sets of columns.
_QUANTITIES = ("velocity", "acceleration", "position")


def _other_joint_columns(states: States, joint_error: JointError) -> list[Array]:
    """List alternative sets of columns for the cause "other joints": three for each
    other joint, named by :func:`other_joint_quantity`.

    The first set (M, k) has hat functions of that joint's velocity, the velocity, and
    its direction; the second has hat functions of its acceleration, and the
    acceleration; the third has hat functions of its position. Of all sets the one that
    explains most counts.
    """
    out = []
    for i in states.others(joint_error.joint):
        velocity = states.dq[:, i]
        acceleration = states.ddq[:, i]
        direction = smooth_sign(velocity)
        out.append(np.column_stack([hat_functions(velocity), velocity, direction]))
        out.append(np.column_stack([hat_functions(acceleration), acceleration]))
        out.append(hat_functions(states.q[:, i]))
    return out


def other_joint_quantity(joint: int, alternative: int) -> str:
    """Return what a set of columns of the cause "other joints" depends on, such as
    "acceleration of joint 4".

    joint : of the error, from 0; alternative : number of the set, from 0.
    """
    number, quantity = divmod(alternative, len(_QUANTITIES))
    other = number if number < joint else number + 1
    return f"{_QUANTITIES[quantity]} of joint {other + 1}"


def _modelled_torque_columns(states: States, joint_error: JointError) -> Array:
    """Return the column (M, 1) for the cause "modelled torque": the model's torque on
    the joint.

    The error is a multiple of it if the gain of the torque channel is wrong.
    """
    return states.modelled[:, [joint_error.joint]]


def _torque_rate_columns(states: States, joint_error: JointError) -> Array:
    """Return the column (M, 1) for the cause "late torque": the derivative of the
    model's torque by time.

    A torque tau that is logged later by d is tau - d dtau/dt to first order.
    """
    return states.torque_rate[:, [joint_error.joint]]


def _torque_curvature_columns(states: States, joint_error: JointError) -> Array:
    """Return the column (M, 1) for the cause "yielding gear": the second derivative
    of the torque that the gear transmits.

    A gear of stiffness k that yields by tau / k under the torque tau accelerates the
    link by -(d^2 tau / dt^2) / k beside what the motor's encoder shows.
    """
    return states.torque_curvature[:, [joint_error.joint]]


#: By cause its columns (M, k), or several sets of them of which the best counts, in the
#: order of a heat map's rows.
CAUSE_COLUMNS: Mapping[str, Callable[[States, JointError], Array | list[Array]]] = {
    REVERSAL: _reversal_columns,
    STANDSTILL: _standstill_columns,
    HIGH_SPEED: _high_speed_columns,
    VELOCITY: _velocity_columns,
    POSITION: _position_columns,
    TURN: _turn_columns,
    BY_DIRECTION: _position_and_direction_columns,
    POSE: _pose_columns,
    WAVES: _wave_columns,
    ACCELERATION: _acceleration_columns,
    LOAD: _load_columns,
    TIME: _time_columns,
    HUM: _hum_columns,
    OTHER_JOINTS: _other_joint_columns,
    MODELLED_TORQUE: _modelled_torque_columns,
    TORQUE_RATE: _torque_rate_columns,
    TORQUE_CURVATURE: _torque_curvature_columns,
}


@dataclass(frozen=True)
class CauseShares:
    """Shares (0 to 1) of a joint's error variance that each cause explains on data left
    out, by the cause's name."""

    #: Share of the whole error, by cause.
    of_error: Mapping[str, float]
    #: Share, by cause, of the part of the error that neither other parameters of the
    #: model nor the usual error would make. Only this part tells causes apart, since
    #: the model's own columns resemble several causes, and every drive's friction and
    #: lag do.
    beyond_usual: Mapping[str, float]
    #: Share of the error's variance that other parameters of the model would remove.
    refit_share: float = 0.0
    #: Share of what a refit leaves that usual drives show as well
    #: (:mod:`~sdp_vs_penalty.diagnosis.usual_error`).
    usual_share: float = 0.0
    #: What of another joint explains most, such as "velocity of joint 2"; empty if
    #: nothing does.
    other_joint: str = ""

    @cached_property
    def is_usual(self) -> bool:
        """Whether no cause explains CHANGES (5 %) of the error beyond the usual one.

        The usual error counts as a part of the error here: a share of a small rest is no
        cause of the whole.
        """
        share_beyond_usual = 1.0 - self.usual_share
        return not any(
            min(share_beyond_usual * self.beyond_usual[name], self.of_error[name])
            >= CHANGES
            for name in self.names
        )

    @property
    def likelihood(self) -> Mapping[str, float]:
        """The shares that tell causes apart: those beyond the usual error, or of the
        whole error where the usual error is all that is seen.
        """
        return self.of_error if self.is_usual else self.beyond_usual

    @property
    def total_usual_share(self) -> float:
        """Share of the whole error that usual drives show as well."""
        return (1.0 - self.refit_share) * self.usual_share

    @cached_property
    def equivalent_causes(self) -> list[str]:
        """The causes that these data do not tell from the likeliest one.

        Their shares are within _SAME_SHARE (2 %) of its share. Causes with a single
        column come first, then the one that explains most of the whole error.
        """
        # Causes in other joints have lower weights, since they are many.
        shares = self.likelihood
        weights = {name: self._weight(name, shares) for name in self.names}
        best = max(self.names, key=weights.__getitem__)
        smallest_share = shares[best] - _SAME_SHARE
        tied = [best]
        for name in self.names:
            share = shares[name]
            if name != best and share > 0.0 and share >= smallest_share:
                tied.append(name)
        return sorted(
            tied,
            key=lambda name: (
                name not in _SINGLE_COLUMNS,
                -self._weight(name, self.of_error),
            ),
        )

    @cached_property
    def ranking(self) -> list[str]:
        """All causes, the likeliest first.

        The causes that these data do not tell from the likeliest one come first. The
        others follow by their share, and at equal shares by that of the whole error.
        """
        first = self.equivalent_causes
        others = [name for name in self.names if name not in first]
        others.sort(
            key=lambda name: (
                -self._weight(name, self.likelihood),
                -self._weight(name, self.of_error),
            )
        )
        return [*first, *others]

    def with_fast_hum(self, energy: float) -> CauseShares:
        """Return the shares of an error that also has hums above the filters' cut-off.

        energy : mean square of these hums over that of the error without them [-].
        """
        below = 1.0 / (1.0 + energy)  # share of the error below the cut-off
        beyond_refit = 1.0 - self.refit_share
        share_beyond_usual = beyond_refit * (1.0 - self.usual_share)
        below_beyond = share_beyond_usual / max(share_beyond_usual + energy, 1e-300)

        def with_hum(shares: Mapping[str, float], below: float) -> dict[str, float]:
            """Return shares of an error with the hums, of which ``below`` is below the
            cut-off.
            """
            out = {name: share * below for name, share in shares.items()}
            out[HUM] += 1.0 - below
            return out

        refit_share = self.refit_share * below
        usual = self.usual_share * beyond_refit * below
        return CauseShares(
            of_error=with_hum(self.of_error, below),
            beyond_usual=with_hum(self.beyond_usual, below_beyond),
            refit_share=refit_share,
            usual_share=usual / max(1.0 - refit_share, 1e-300),
            other_joint=self.other_joint,
        )

    @property
    def names(self) -> list[str]:
        """Names of the causes, such as "velocity", in the order of heat maps' rows."""
        return list(self.of_error)

    @staticmethod
    def _weight(name: str, shares: Mapping[str, float]) -> float:
        """Return the share of a cause, times _OTHERS_COUNT (0.75) for causes in other
        joints.

        These are searched in more ways, n - 1 for n joints, so that chance finds more.
        """
        return shares[name] * (_OTHERS_COUNT if name in (POSE, OTHER_JOINTS) else 1.0)


@dataclass(frozen=True)
class Refit:
    """Parameters of the model, fitted to the errors of all n joints at once.

    All arrays are scaled joint by joint, so that each joint's error has an RMS of 1.
    All joints are fitted together because they share parameters: the columns of one
    joint alone can make any multiple of its torque.
    """

    #: (n,) RMS error of each joint [N m or N].
    scale: Array
    #: (n, M, r) orthonormal basis of the model's columns over all joints and rows
    #: together.
    basis: Array
    #: (n, M) errors that no parameters of the model could make.
    remainder: Array

    @classmethod
    def of(cls, columns: Array, error: Array) -> Refit:
        """Fit the model's columns (n, M, p) to errors (n, M) [N m or N] of n joints."""
        scale = nonzero_or_one(np.sqrt(np.mean(error**2, axis=1)))
        n, n_rows, n_parameters = columns.shape
        # Not under a new name: the unscaled columns need not stay in memory.
        columns = columns / scale[:, None, None]
        basis = orthonormal(columns.reshape(n * n_rows, n_parameters))
        scaled_error = (error / scale[:, None]).ravel()
        remainder = scaled_error - basis @ (basis.T @ scaled_error)
        return cls(
            scale=scale,
            basis=basis.reshape(n, n_rows, basis.shape[1]),
            remainder=remainder.reshape(n, n_rows),
        )

    def without_model(self, columns: Array, joint: int) -> Array:
        """Return columns (M, ...) of a joint (from 0) minus what a refit of the model
        makes of them: x - B B' x, with the joint's rows B (M, r) of the ``basis``.
        """
        basis = self.basis[joint]
        return np.asarray(columns - basis @ (basis.T @ columns))


class ExplainedShares(NamedTuple):
    """Shares of an error's variance that a cause explains on data left out, 0 to 1."""

    #: Share of the whole error.
    of_error: float
    #: Share of what neither other parameters of the model nor the usual error would
    #: make.
    beyond_usual: float
    #: The set of the cause's columns, from 0, for which ``beyond_usual`` is largest.
    best_alternative: int


@dataclass(frozen=True)
class SplitError:
    """One joint's error, and the part of it that no other parameters of the model could
    make."""

    #: (M,) error of the joint over its RMS error.
    error: Array
    #: The fit that shows what other parameters of the model make of columns.
    refit: Refit
    #: Number of the joint, from 0.
    joint: int
    #: (M,) fold of each row, for shares on data left out.
    fold: NDArray[np.intp]
    #: (M, k) columns of usual friction beyond the model.
    turning: Array
    #: (M,) error that the lag of the other joints would make on this joint
    #: (:class:`~sdp_vs_penalty.diagnosis.usual_error.UsualError`).
    lag: Array

    @property
    def beyond_model(self) -> Array:
        """(M,) the part of the error that no other parameters of the model make."""
        return np.asarray(self.refit.remainder[self.joint])

    @property
    def refit_share(self) -> float:
        """Share of the error's sum of squares that re-estimated parameters of the model
        would remove: 1 - |beyond_model|^2 / |error|^2.
        """
        energy = max(float(np.sum(self.error**2)), 1e-300)
        return max(0.0, 1.0 - float(np.sum(self.beyond_model**2)) / energy)

    @cached_property
    def _beyond_lag(self) -> Array:
        """(M,) the part beyond the model, less the lag that the joints share."""
        return np.asarray(self.beyond_model - self.lag)

    @cached_property
    def _turning_share(self) -> float:
        """Share of the part beyond the lag that usual friction explains on data left
        out.
        """
        return held_out_share(self.turning, self._beyond_lag, self.fold)

    @cached_property
    def usual_share(self) -> float:
        """Share of the part beyond the model that usual drives show as well: friction
        that turns round over a short travel, and a lag that the joints share.
        """
        energy = max(float(np.sum(self.beyond_model**2)), 1e-300)
        beyond_lag = float(np.sum(self._beyond_lag**2)) / energy
        return max(0.0, 1.0 - beyond_lag * (1.0 - self._turning_share))

    def explained_shares(self, alternatives: Sequence[Array]) -> ExplainedShares:
        """Return the shares of an error that a cause explains on data left out.

        A model that was fitted to these rows has absorbed a part of what it lacks. The
        cause's columns are therefore fitted to the error itself, and to the part of it
        beyond the model (that no other parameters of the model could make). The larger
        share counts for the error.

        Parameters
        ----------
        alternatives
            Several sets of columns (M, k) of the cause; the best set counts.

        Returns
        -------
        ExplainedShares
            Shares of the whole error, and of what neither other parameters of the model
            nor the usual error would make.
        """
        of_error = []
        beyond_usual = []
        for columns in alternatives:
            visible = self._visible_beyond_model(columns)
            share = held_out_share(visible, self.beyond_model, self.fold)
            share_of_error = held_out_share(columns, self.error, self.fold)
            beyond_as_share_of_error = (1.0 - self.refit_share) * share
            of_error.append(max(share_of_error, beyond_as_share_of_error))
            beyond_usual.append(self._share_beyond_usual(visible))
        if not alternatives:
            return ExplainedShares(0.0, 0.0, 0)
        return ExplainedShares(
            of_error=max(of_error),
            beyond_usual=max(beyond_usual),
            best_alternative=int(np.argmax(beyond_usual)),
        )

    def _share_beyond_usual(self, columns: Array) -> float:
        """Return the share that columns (M, k) explain of what the usual error leaves
        beyond the model.

        It is the gain of columns and usual friction together over that friction alone.
        """
        left = 1.0 - self._turning_share
        if not columns.shape[1] or left <= 0.0:
            return 0.0
        together = np.hstack([self.turning, columns])
        share = held_out_share(together, self._beyond_lag, self.fold)
        return max(0.0, (share - self._turning_share) / left)

    def _visible_beyond_model(self, columns: Array) -> Array:
        """Return columns (M, k) beyond the model, without those that it makes itself.

        Of a column that the model itself can make only rounding remains.
        """
        beyond = self.refit.without_model(columns, self.joint)
        energy = np.sum(columns**2, axis=0)
        is_visible = np.sum(beyond**2, axis=0) > _ABSORBED * energy
        return np.asarray(beyond[:, is_visible])


def held_out_share(features: Array, error: Array, fold: NDArray[np.intp]) -> float:
    """Return the share of an error (M,) that features predict on data left out, at
    least 0.

    For each fold, ridge regression is fitted to the other folds and predicts the fold.
    The share is 1 - (sum of squared prediction errors) / (sum of squared errors). Of
    several ridges the best counts: columns that only a few reversals determine need a
    large one.

    Parameters
    ----------
    features
        (M, k) columns of a cause.
    fold
        (M,) fold of each row.

    Returns
    -------
    float
        The share, from 0 to 1.
    """
    n_features = features.shape[1]
    folds = np.unique(fold)
    total = float(np.sum(error**2))
    if not n_features or len(folds) < 2 or total == 0.0:
        return 0.0
    scaled = features / nonzero_or_one(np.sqrt(np.mean(features**2, axis=0)))
    # Of each fold the products A'A (k, k) and A'y (k,).
    rows_by_fold = [(scaled[fold == f], error[fold == f]) for f in folds]
    grams = np.array([A.T @ A for A, _ in rows_by_fold])
    pulls = np.array([A.T @ y for A, y in rows_by_fold])
    # Of each fold the products of all others, to which it is fitted.
    gram = grams.sum(axis=0) - grams
    pull = pulls.sum(axis=0) - pulls
    ridges = np.trace(gram, axis1=1, axis2=2)[:, None] / n_features * _RIDGES
    if not np.all(ridges[:, 0] > 0.0):  # the cause does not occur in the other folds
        return 0.0
    # One eigendecomposition a fold solves (A'A + ridge I) theta = A'y for all ridges.
    values, vectors = np.linalg.eigh(gram)
    eigenvalues = np.maximum(values, 0.0)
    projected = np.swapaxes(vectors, 1, 2) @ pull[:, :, None]
    theta = vectors @ (projected / (eigenvalues[:, :, None] + ridges[:, None, :]))
    # On the fold left out: y'y - (y - A theta)'(y - A theta).
    linear = np.einsum("fk,fkr->r", pulls, theta)
    quadratic = np.einsum("fkr,fkr->r", theta, grams @ theta)
    explained = 2.0 * linear - quadratic
    return max(0.0, float(explained.max()) / total)
