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

from sdp_vs_penalty.effects.effect import smooth_sign
from sdp_vs_penalty.estimation.constants import CHANGES
from sdp_vs_penalty.regression.linalg import span
from sdp_vs_penalty.robot.arrays import Array, Indices, nonzero_or_one
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

    @property
    def rows_still(self) -> Array:
        """(M, n) share of standstill in each row."""
        return self.rows.still

    @classmethod
    def from_rows(cls, rows: SegmentedRuns) -> States:
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
    return np.abs(q - q[last_start])


@dataclass(frozen=True)
class _Seen:
    """What the columns of causes are functions of: the error's own joint, and others."""

    #: All joints.
    states: States
    #: The error.
    of: JointError

    def __getattr__(self, name: str) -> Array:
        """Return a state (M,) of the joint, such as its velocity ``dq``."""
        return getattr(self.states, name)[:, self.of.joint]

    @cached_property
    def direction(self) -> Array:
        """(M,) smoothed sign of the joint's velocity."""
        return smooth_sign(self.dq)

    def both_ways(self, columns: Array) -> Array:
        """Return columns (M, ...) beside the same ones times the direction."""
        columns = columns.reshape(len(self.direction), -1)
        return np.hstack([columns, columns * self.direction[:, None]])


def _near_reversals(x: _Seen) -> Array:
    """Return columns (M, k): hat functions of the time within FOLLOWS of the nearest
    reversal, the same times the direction after it, and hat functions of the travel
    since the last one times the direction (hysteresis)."""
    since, after = since_reversal(x.states.t, x.dq, x.states.rows.segment)
    near = np.abs(since) < FOLLOWS
    knots = np.linspace(-FOLLOWS, FOLLOWS, _HATS)
    in_time = near[:, None] * hat_functions(since, knots)
    travel = hat_functions(travel_since_reversal(x.q, x.dq, x.states.rows))
    in_travel = travel * x.direction[:, None]
    return np.hstack([in_time, in_time * after[:, None], in_travel])


def _poses(x: _Seen) -> Array:
    """Return columns (M, 4 (n - 1)), such as of an error of gravity: products of sine
    and cosine of the joint's position with those of each other joint's."""
    own = np.column_stack([np.sin(x.q), np.cos(x.q)])
    products = [np.zeros((len(own), 0))]  # of an arm of one joint there are none
    for joint in x.states.others(x.of.joint):
        other = x.states.q[:, joint]
        products += [own * wave(other)[:, None] for wave in (np.sin, np.cos)]
    return np.hstack(products)


def _waves(x: _Seen) -> Array:
    """Return columns (M, 2 K): cosine and sine of k q, low-passed as the torque was, of
    the K orders k that stand out of the error's spectrum."""
    orders = np.array(x.of.orders, float)
    parts = []
    for segment in x.states.rows.segments:
        angle = segment.motion.q[:, [x.of.joint]] * orders
        parts.append(segment.low_pass @ np.hstack([np.cos(angle), np.sin(angle)]))
    return np.concatenate(parts)


def _drifts(x: _Seen) -> Array:
    """Return columns (M, 9) of a drift of an offset, of Coulomb and of viscous friction:
    s, s^2, s^3, these times the direction, and times the velocity; s is time, from -1
    to 1."""
    t = x.states.t - x.states.t.mean()
    s = t / nonzero_or_one(np.abs(t).max())
    powers = np.column_stack([s**k for k in _TIME_POWERS])
    return np.hstack([x.both_ways(powers), powers * x.dq[:, None]])


#: What of another joint an error may depend on: hat functions, and what extrapolates.
_QUANTITIES: Mapping[str, Callable[[States, int], Array]] = {
    "velocity": lambda x, i: np.column_stack(
        [hat_functions(x.dq[:, i]), x.dq[:, i], smooth_sign(x.dq[:, i])]
    ),
    "acceleration": lambda x, i: np.column_stack(
        [hat_functions(x.ddq[:, i]), x.ddq[:, i]]
    ),
    "position": lambda x, i: hat_functions(x.q[:, i]),
}


def other_joint_quantity(states: States, joint: int, alternative: int) -> str:
    """Return what a set of columns of the cause "other joints" depends on, such as
    "acceleration of joint 4".

    joint : of the error, from 0; alternative : number of the set, from 0.
    """
    number, quantity = divmod(alternative, len(_QUANTITIES))
    return f"{[*_QUANTITIES][quantity]} of joint {states.others(joint)[number] + 1}"


def _fast(x: _Seen) -> Array:
    """Return the speed (M,) beyond FAST (3/4) of the joint's largest one."""
    speed = np.abs(x.dq)
    return np.maximum(speed - FAST * speed.max(), 0.0)


def _beside(*columns: Array) -> Array:
    """Return columns (M,) or (M, k) side by side; hat functions of a quantity make any
    function of it where it was, and others go on where it was not."""
    return np.column_stack(columns)


#: By cause its columns (M, k), or several sets of them of which the best counts, in the
#: order of a heat map's rows. A multiple of the model's torque is a wrong gain of the
#: channel, of its derivative a late torque (tau - d dtau/dt), of the second derivative
#: of what the gears transmit a gear that yields by tau / k.
CAUSE_COLUMNS: Mapping[str, Callable[[_Seen], Array | list[Array]]] = {
    REVERSAL: _near_reversals,
    STANDSTILL: lambda x: x.both_ways(np.asarray(x.rows_still > STILL, float)),
    HIGH_SPEED: lambda x: x.both_ways(_fast(x)),
    VELOCITY: lambda x: _beside(hat_functions(x.dq), x.dq**2, x.dq * np.abs(x.dq)),
    POSITION: lambda x: hat_functions(x.q),
    TURN: lambda x: _beside(*(w(k * x.q) for k in _TURNS for w in (np.sin, np.cos))),
    BY_DIRECTION: lambda x: hat_functions(x.q) * x.direction[:, None],
    POSE: _poses,
    WAVES: _waves,
    ACCELERATION: lambda x: _beside(hat_functions(x.ddq), x.ddq),
    LOAD: lambda x: _beside(
        hat_functions(x.torque),
        hat_functions(np.abs(x.torque)) * x.direction[:, None],
        x.torque,
    ),
    TIME: _drifts,
    OTHER_JOINTS: lambda x: [
        columns(x.states, i)
        for i in x.states.others(x.of.joint)
        for columns in _QUANTITIES.values()
    ],
    MODELLED_TORQUE: lambda x: x.modelled[:, None],
    TORQUE_RATE: lambda x: x.torque_rate[:, None],
    TORQUE_CURVATURE: lambda x: x.torque_curvature[:, None],
}


def columns_of_causes(states: States, error: JointError) -> dict[str, list[Array]]:
    """Return for each cause its sets of columns (M, k). A joint's error may be made of
    any one set; the set that explains most counts."""
    seen = _Seen(states, error)
    sets = {name: columns(seen) for name, columns in CAUSE_COLUMNS.items()}
    return {name: x if isinstance(x, list) else [x] for name, x in sets.items()}


@dataclass(frozen=True)
class CauseShares:
    """Shares (0 to 1) of a joint's error variance that each cause explains on data left
    out, by the cause's name."""

    #: Share of the whole error, by cause.
    of_error: Mapping[str, float]
    #: Share, by cause, of the part of the error that no other parameters of the model
    #: would make. Only this part tells causes apart, since the model's own columns
    #: resemble several causes.
    beyond_refit: Mapping[str, float]
    #: Share of the error's variance that other parameters of the model would remove.
    refit_share: float = 0.0
    #: What of another joint explains most, such as "velocity of joint 2"; empty if
    #: nothing does.
    other_joint: str = ""

    @cached_property
    def stands_out(self) -> bool:
        """Whether a cause explains CHANGES (5 %) of the error, and of the part of it that
        a refit leaves."""
        return any(
            min(self.beyond_refit[name], self.of_error[name]) >= CHANGES
            for name in self.names
        )

    @property
    def likelihood(self) -> Mapping[str, float]:
        """The shares that tell causes apart: those of what a refit leaves, or of the
        whole error where no cause stands out there."""
        return self.beyond_refit if self.stands_out else self.of_error

    @cached_property
    def equivalent_causes(self) -> list[str]:
        """The causes that these data do not tell from the likeliest one.

        Their shares are within _SAME_SHARE (2 %) of its share. Causes with a single
        column come first, then the one that explains most of the whole error.
        """
        # Causes in other joints have lower weights, since they are many.
        shares = self.likelihood
        best = max(self.names, key=lambda name: self._weight(name, shares))
        smallest_share = shares[best] - _SAME_SHARE
        tied = [best]
        for name in self.names:
            if name != best and shares[name] > 0.0 and shares[name] >= smallest_share:
                tied.append(name)
        return sorted(
            tied,
            key=lambda x: (x not in _SINGLE_COLUMNS, -self._weight(x, self.of_error)),
        )

    @cached_property
    def ranking(self) -> list[str]:
        """All causes, the likeliest first.

        The causes that these data do not tell from the likeliest one come first. The
        others follow by their share, and at equal shares by that of the whole error.
        """
        first = self.equivalent_causes
        others = [name for name in self.names if name not in first]
        both = self.likelihood, self.of_error
        others.sort(key=lambda x: [-self._weight(x, shares) for shares in both])
        return [*first, *others]

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
    def from_columns(cls, columns: Array, error: Array) -> Refit:
        """Fit the model's columns (n, M, p) to errors (n, M) [N m or N] of n joints."""
        scale = nonzero_or_one(np.sqrt(np.mean(error**2, axis=1)))
        n, n_rows, n_parameters = columns.shape
        # Not under a new name: the unscaled columns need not stay in memory.
        columns = columns / scale[:, None, None]
        basis = span(columns.reshape(n * n_rows, n_parameters))
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
        return columns - basis @ (basis.T @ columns)


class ExplainedShares(NamedTuple):
    """Shares of an error's variance that a cause explains on data left out, 0 to 1."""

    #: Share of the whole error.
    of_error: float
    #: Share of what no other parameters of the model would make.
    beyond_refit: float
    #: The set of the cause's columns, from 0, for which ``beyond_refit`` is largest.
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
    fold: Indices

    @property
    def beyond_model(self) -> Array:
        """(M,) the part of the error that no other parameters of the model make."""
        return self.refit.remainder[self.joint]

    @property
    def refit_share(self) -> float:
        """Share of the error's sum of squares that re-estimated parameters of the model
        would remove: 1 - |beyond_model|^2 / |error|^2.
        """
        energy = max(float(np.sum(self.error**2)), 1e-300)
        return max(0.0, 1.0 - float(np.sum(self.beyond_model**2)) / energy)

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
            Shares of the whole error, and of what no other parameters of the model would
            make.
        """
        of_error = []
        beyond_refit = []
        for columns in alternatives:
            visible = self._visible_beyond_model(columns)
            share = held_out_share(visible, self.beyond_model, self.fold)
            share_of_error = held_out_share(columns, self.error, self.fold)
            of_error.append(max(share_of_error, (1.0 - self.refit_share) * share))
            beyond_refit.append(share)
        if not alternatives:
            return ExplainedShares(0.0, 0.0, 0)
        return ExplainedShares(
            of_error=max(of_error),
            beyond_refit=max(beyond_refit),
            best_alternative=int(np.argmax(beyond_refit)),
        )

    def _visible_beyond_model(self, columns: Array) -> Array:
        """Return columns (M, k) beyond the model, without those that it makes itself.

        Of a column that the model itself can make only rounding remains.
        """
        beyond = self.refit.without_model(columns, self.joint)
        energy = np.sum(columns**2, axis=0)
        is_visible = np.sum(beyond**2, axis=0) > _ABSORBED * energy
        return beyond[:, is_visible]


def held_out_share(features: Array, error: Array, fold: Indices) -> float:
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
    # Of each fold, with columns A and error y, the products A'A (k, k) and A'y (k,).
    of_folds = [(scaled[fold == number], error[fold == number]) for number in folds]
    grams = np.array([A.T @ A for A, _ in of_folds])
    pulls = np.array([A.T @ y for A, y in of_folds])
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
