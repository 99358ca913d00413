"""What a joint's torque error may depend on: columns of each cause, and the share of
the error that they explain on stretches of the motion that were not fitted.

A cause is what a person sees in a log: a reversal, a standstill, a position, the time.
Each cause has columns; the error may be any combination of them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.diagnosis.events import spectral_lines
from sdp_vs_penalty.effects.effect import smooth_sign
from sdp_vs_penalty.robot.arrays import Array, nonzero_or_one
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
#: Share of a column's energy below which the model makes it itself.
_ABSORBED = 1e-3
#: Ridges that are tried, over the mean energy of a column.
_RIDGES = np.array([1e-3, 1e-2, 1e-1])
#: Shares that differ by less are of causes that data do not tell apart.
_SAME_SHARE = 0.02
#: Powers of time: a drift goes on where it was not seen, hats do not.
_TIME_POWERS = (1, 2, 3)


@dataclass(frozen=True)
class States:
    """The state at every row: filtered position q, velocity dq, acceleration ddq and
    torque, (M, n) each in SI units, and time t (M,) in s.
    """

    rows: SegmentedRuns
    q: Array
    dq: Array
    ddq: Array
    torque: Array
    t: Array

    @classmethod
    def of(cls, rows: SegmentedRuns) -> States:
        """Low-pass the motion of filtered runs as their torque was."""

        def filtered(name: str) -> Array:
            parts = [s.low_pass @ getattr(s.motion, name) for s in rows.segments]
            return np.concatenate(parts)

        q, dq, ddq, torque = map(filtered, ("q", "dq", "ddq", "torque"))
        return cls(rows, q, dq, ddq, torque, rows.t)

    def others(self, joint: int) -> list[int]:
        """List all joints (from 0) but one."""
        return [i for i in range(self.rows.n) if i != joint]


@dataclass(frozen=True)
class JointError:
    """The torque error (M,) of one joint (from 0), in N m or N.

    orders : waves per turn of the joint that stand out of its spectrum.
    """

    joint: int
    error: Array
    orders: Sequence[int]


def hats(x: Array, knots: Array | None = None) -> Array:
    """Return piecewise linear hat functions (N, count) of x (N,), which add up to one.

    Each is 1 at its own knot and 0 at the others. Default knots: up to _HATS quantiles
    of x. A constant x has one function, 1.
    """
    if knots is None:
        knots = np.unique(np.quantile(x, np.linspace(0.0, 1.0, _HATS)))
    if len(knots) < 2:
        return np.ones((len(x), 1))
    # A row of the identity: the values of one hat at all knots.
    functions = [np.interp(x, knots, values) for values in np.eye(len(knots))]
    return np.column_stack(functions)


def from_reversal(velocity: Array, rows: SegmentedRuns) -> tuple[Array, Array]:
    """Return the time from the nearest velocity reversal, and the direction after it.

    Parameters
    ----------
    velocity
        (M,) of the joint.
    rows
        The rows, with their times and segments.

    Returns
    -------
    (M,) array
        Seconds, negative before the reversal; infinite in a segment without one.
    (M,) array
        Sign of the velocity after that reversal.
    """
    row_numbers = np.arange(len(velocity))
    segment = rows.segment
    sign_changes = np.sign(velocity[1:]) != np.sign(velocity[:-1])
    is_same_segment = segment[1:] == segment[:-1]
    last_rows = np.flatnonzero(sign_changes & is_same_segment)  # before each reversal
    if not len(last_rows):
        return np.full(len(velocity), np.inf), np.zeros(len(velocity))
    instants = 0.5 * (rows.t[last_rows] + rows.t[last_rows + 1])
    # (2, M) numbers of the reversals before and after each row.
    neighbours = np.searchsorted(last_rows, row_numbers) + np.array([[-1], [0]])
    neighbours = np.clip(neighbours, 0, len(last_rows) - 1)
    is_in_segment = segment[last_rows[neighbours]] == segment
    seconds = np.where(is_in_segment, rows.t - instants[neighbours], np.inf)
    nearest = np.argmin(np.abs(seconds), axis=0)
    reversal = neighbours[nearest, row_numbers]
    direction = np.sign(velocity[last_rows[reversal] + 1])
    return seconds[nearest, row_numbers], direction


def travel_since_reversal(q: Array, velocity: Array, rows: SegmentedRuns) -> Array:
    """Return the distance (M,) of a joint from where it last reversed [rad or m].

    At the begin of a segment it counts from there.
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


def _near_reversals(x: States, e: JointError) -> Array:
    """Return columns (M, k) of the time around a reversal, and of the travel since it.

    Within FOLLOWS (0.4 s) they are hat functions of the time, alone and times the
    direction; hat functions of the travel are times the direction.
    """
    velocity = x.dq[:, e.joint]
    since, direction = from_reversal(velocity, x.rows)
    near = np.abs(since) < FOLLOWS
    in_time = near[:, None] * hats(since, np.linspace(-FOLLOWS, FOLLOWS, _HATS))
    travel = travel_since_reversal(x.q[:, e.joint], velocity, x.rows)
    in_travel = hats(travel) * smooth_sign(velocity)[:, None]
    return np.hstack([in_time, in_time * direction[:, None], in_travel])


def _at_standstill(x: States, e: JointError) -> Array:
    """Return columns (M, 2) of a torque at standstill: constant, and times the
    direction.
    """
    still = np.asarray(x.rows.still[:, e.joint] > STILL, float)
    direction = smooth_sign(x.dq[:, e.joint])
    return np.column_stack([still, still * direction])


def _at_high_speed(x: States, e: JointError) -> Array:
    """Return columns (M, 2) that grow beyond FAST (3/4) of the largest speed.

    One has the same sign in both directions, one follows the direction.
    """
    velocity = x.dq[:, e.joint]
    speed = np.abs(velocity)
    excess = np.maximum(speed - FAST * speed.max(), 0.0)
    return np.column_stack([excess, excess * smooth_sign(velocity)])


def _of_velocity(x: States, e: JointError) -> Array:
    """Return columns (M, k) of any function of the velocity, with v^2 and v |v|."""
    v = x.dq[:, e.joint]
    return np.column_stack([hats(v), v**2, v * np.abs(v)])


def _of_position(x: States, e: JointError) -> Array:
    """Return columns (M, k) of any function of the position: hat functions."""
    return hats(x.q[:, e.joint])


def _in_a_turn(x: States, e: JointError) -> Array:
    """Return sines and cosines (M, 8) of 1 to 4 waves per turn of the joint.

    An eccentric gear, or a place that comes back every turn, shows in them.
    """
    angles = [k * x.q[:, e.joint] for k in _TURNS]
    return np.column_stack([wave(a) for a in angles for wave in (np.sin, np.cos)])


def _of_position_by_direction(x: States, e: JointError) -> Array:
    """Return columns (M, k) of friction that is any function of the position."""
    direction = smooth_sign(x.dq[:, e.joint])
    return hats(x.q[:, e.joint]) * direction[:, None]


def _of_pose(x: States, e: JointError) -> Array:
    """Return columns (M, 4 (n - 1)) of gravity that depends on two joints.

    They are the products of sine and cosine of this joint's position with those of each
    other joint's.
    """
    of_joint = _sine_and_cosine(x.q[:, e.joint])
    products = []
    for i in x.others(e.joint):
        of_other = _sine_and_cosine(x.q[:, i])
        products += [a * b for a in of_joint for b in of_other]
    return _columns(products, len(x.t))


def _sine_and_cosine(q: Array) -> tuple[Array, Array]:
    """Return sine and cosine of an angle."""
    return np.sin(q), np.cos(q)


def _columns(parts: Sequence[Array], rows: int) -> Array:
    """Stack columns to (M, k); (M, 0) where there are none."""
    return np.column_stack(parts) if parts else np.zeros((rows, 0))


def _waves(x: States, e: JointError) -> Array:
    """Return the filtered cosine and sine (M, 2 orders) of each order of waves per
    turn.
    """
    parts = []
    for segment in x.rows.segments:
        q = segment.motion.q[:, e.joint]
        waves = []
        for order in e.orders:
            waves.append(segment.low_pass @ np.cos(order * q))
            waves.append(segment.low_pass @ np.sin(order * q))
        parts.append(_columns(waves, len(segment.t)))
    return np.concatenate(parts)


def _of_acceleration(x: States, e: JointError) -> Array:
    """Return columns (M, k) of any function of the acceleration, and the acceleration
    itself.

    Hat functions are constant outside of the range they were fitted in; a line goes on.
    """
    a = x.ddq[:, e.joint]
    return np.column_stack([hats(a), a])


def _of_load(x: States, e: JointError) -> Array:
    """Return columns (M, k) of any function of the torque, and of friction that follows
    it.
    """
    torque = x.torque[:, e.joint]
    direction = smooth_sign(x.dq[:, e.joint])
    by_size = hats(np.abs(torque)) * direction[:, None]
    return np.column_stack([hats(torque), by_size, torque])


def _of_time(x: States, e: JointError) -> Array:
    """Return columns (M, 9) of a drift in time: of a torque, of Coulomb and viscous
    friction.

    Each has time, its square and its cube; time is in units of half the recording.
    """
    t = x.t - x.t.mean()
    t = t / nonzero_or_one(np.abs(t).max())
    powers = np.column_stack([t**k for k in _TIME_POWERS])
    direction = smooth_sign(x.dq[:, e.joint])
    velocity = x.dq[:, e.joint]
    return np.hstack([powers, powers * direction[:, None], powers * velocity[:, None]])


def _of_hum(x: States, e: JointError) -> Array:
    """Return sines and cosines (M, k) of the lines of the error's spectrum below the
    cut-off.
    """
    rows = x.rows
    pieces = [e.error[rows.segment == k] for k in np.unique(rows.segment)]
    longest = max(len(p) for p in pieces)
    long_enough = [p for p in pieces if 2 * len(p) > longest]
    lines = spectral_lines(long_enough, rows.rate, rows.n)
    waves = []
    for frequency in lines:
        if frequency < rows.cutoff:
            angle = 2.0 * np.pi * frequency * x.t
            waves += [np.sin(angle), np.cos(angle)]
    return _columns(waves, len(x.t))


def _of_other_joints(x: States, e: JointError) -> list[Array]:
    """List, for each other joint, columns of its motion and columns of its position.

    Those of motion are any function of the velocity, its direction and acceleration.
    The best set of the list counts.
    """
    out = []
    for i in x.others(e.joint):
        direction = smooth_sign(x.dq[:, i])
        of_velocity = [hats(x.dq[:, i]), x.dq[:, [i]], direction[:, None]]
        out.append(np.hstack([*of_velocity, x.ddq[:, [i]]]))
        out.append(hats(x.q[:, i]))
    return out


#: By cause its columns (M, k), or several sets of them of which the best counts, in the
#: order of a heat map's rows.
CAUSE_COLUMNS: Mapping[str, Callable[[States, JointError], Array | list[Array]]] = {
    REVERSAL: _near_reversals,
    STANDSTILL: _at_standstill,
    HIGH_SPEED: _at_high_speed,
    VELOCITY: _of_velocity,
    POSITION: _of_position,
    TURN: _in_a_turn,
    BY_DIRECTION: _of_position_by_direction,
    POSE: _of_pose,
    WAVES: _waves,
    ACCELERATION: _of_acceleration,
    LOAD: _of_load,
    TIME: _of_time,
    HUM: _of_hum,
    OTHER_JOINTS: _of_other_joints,
}


@dataclass(frozen=True)
class CauseShares:
    """Shares of a joint's error variance that each cause explains on data left out, by
    name.

    of_error : share of the whole error. beyond_model : share of the part of the error
    that no other parameters of the model could make; only this part tells causes apart,
    since the model's own columns resemble several causes. refit_share : share of the
    error's variance that other parameters of the model would remove.
    """

    of_error: Mapping[str, float]
    beyond_model: Mapping[str, float]
    refit_share: float = 0.0

    @cached_property
    def equivalent_causes(self) -> list[str]:
        """The causes that these data do not tell from the likeliest one.

        Their shares beyond the model are within _SAME_SHARE (2 %) of its share. The one
        that explains most of the whole error comes first.
        """
        likelihood = {
            name: self._weight(name, self.beyond_model) for name in self.names
        }
        best = max(self.names, key=likelihood.__getitem__)
        smallest_share = self.beyond_model[best] - _SAME_SHARE
        tied = [best]
        for name in self.names:
            share = self.beyond_model[name]
            if name != best and share > 0.0 and share >= smallest_share:
                tied.append(name)
        return sorted(tied, key=lambda name: -self._weight(name, self.of_error))

    @cached_property
    def ranking(self) -> list[str]:
        """All causes, the likeliest first: by the share beyond the model, then of the
        error.
        """
        first = self.equivalent_causes
        others = [name for name in self.names if name not in first]
        others.sort(
            key=lambda name: (
                -self._weight(name, self.beyond_model),
                -self._weight(name, self.of_error),
            )
        )
        return [*first, *others]

    @property
    def names(self) -> list[str]:
        """The names of the causes, in the order of a heat map's rows."""
        return list(self.of_error)

    @staticmethod
    def _weight(name: str, shares: Mapping[str, float]) -> float:
        """Return the share of a cause, times 0.75 for causes in other joints.

        Those are looked for in more ways, one for each other joint, so that chance
        finds more.
        """
        return shares[name] * (_OTHERS_COUNT if name in (POSE, OTHER_JOINTS) else 1.0)


@dataclass(frozen=True)
class SplitError:
    """One joint's error (M,), split into the part that the model's own columns could
    make and the part that they could not.

    basis (M, r) : orthonormal basis of the model's columns on this joint; fold (M,) :
    fold of each row, for shares on data left out.
    """

    error: Array
    basis: Array
    fold: NDArray[np.intp]

    @cached_property
    def beyond_model(self) -> Array:
        """(M,) the part of the error that no other parameters of the model could
        make.
        """
        return self._without_model(self.error)

    @property
    def refit_share(self) -> float:
        """Share of the error's squares that other parameters of the model would
        remove.
        """
        energy = max(float(np.sum(self.error**2)), 1e-300)
        return max(0.0, 1.0 - float(np.sum(self.beyond_model**2)) / energy)

    def explained_shares(self, alternatives: Sequence[Array]) -> tuple[float, float]:
        """Return the shares that a cause explains on data left out: of the error, and
        beyond.

        A model that was fitted to these rows has absorbed a part of what it lacks.
        Columns are therefore tried on the error itself, and on the part beyond the
        model; the larger share counts for the error.

        Parameters
        ----------
        alternatives
            Several sets of columns (M, k) of the cause, of which the best counts.

        Returns
        -------
        (float, float)
            Share of the error's variance, and share of the variance beyond the model.
        """
        of_error = of_beyond = 0.0
        for columns in alternatives:
            columns_left = self._without_model(columns)
            # Of a column that the model makes itself only rounding is left.
            energy = np.sum(columns**2, axis=0)
            is_visible = np.sum(columns_left**2, axis=0) > _ABSORBED * energy
            share_beyond = held_out_share(
                columns_left[:, is_visible],
                self.beyond_model,
                self.fold,
            )
            of_beyond = max(of_beyond, share_beyond)
            of_error = max(of_error, held_out_share(columns, self.error, self.fold))
        beyond_as_share_of_error = (1.0 - self.refit_share) * of_beyond
        return max(of_error, beyond_as_share_of_error), of_beyond

    def _without_model(self, columns: Array) -> Array:
        """Remove from columns (M, ...) what the model's columns can make."""
        return np.asarray(columns - self.basis @ (self.basis.T @ columns))


def held_out_share(
    features: Array,
    error: Array,
    fold: NDArray[np.intp],
) -> float:
    """Return the share of an error that features predict on data left out, at least 0.

    For each fold, ridge regression is fitted to the other folds and predicts the fold.
    The share is 1 - (sum of squared prediction errors) / (sum of squared errors). Of
    several ridges the best counts: columns that only a few reversals determine need a
    large one.

    Parameters
    ----------
    features
        (M, k) columns of a cause.
    error
        (M,) error to explain.
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
    explained = np.zeros(len(_RIDGES))
    for gram_left_out, pull_left_out in zip(grams, pulls, strict=True):
        gram = grams.sum(axis=0) - gram_left_out
        pull = pulls.sum(axis=0) - pull_left_out
        ridges = _RIDGES * np.trace(gram) / n_features
        if not ridges[0] > 0.0:  # the cause does not occur in the other folds
            return 0.0
        # One eigendecomposition solves (A'A + ridge I) theta = A'y for all ridges.
        values, vectors = np.linalg.eigh(gram)
        eigenvalues = np.maximum(values, 0.0)
        projected = vectors.T @ pull
        for k, ridge in enumerate(ridges):
            theta = vectors @ (projected / (eigenvalues + ridge))
            # On the fold left out: y'y - (y - A theta)'(y - A theta).
            explained[k] += 2.0 * theta @ pull_left_out
            explained[k] -= theta @ gram_left_out @ theta
    return max(0.0, float(explained.max()) / total)
