"""What an error can depend on: columns of each cause, and how much of an error they
explain on stretches of the motion that they have not seen.

A cause is what a person sees in a log: a reversal, a standstill, a position, the time.
Each has columns of which a joint's error may be a combination.
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
    """What is known of every row: filtered position, velocity, acceleration and torque
    (M, n), and time (M,)."""

    rows: SegmentedRuns
    q: Array
    dq: Array
    ddq: Array
    torque: Array
    t: Array

    @classmethod
    def of(cls, rows: SegmentedRuns) -> States:
        """Of filtered runs."""

        def filtered(name: str) -> Array:
            parts = [s.low_pass @ getattr(s.motion, name) for s in rows.segments]
            return np.concatenate(parts)

        q, dq, ddq, torque = map(filtered, ("q", "dq", "ddq", "torque"))
        return cls(rows, q, dq, ddq, torque, rows.t)

    def others(self, joint: int) -> list[int]:
        """All joints but one."""
        return [i for i in range(self.rows.n) if i != joint]


@dataclass(frozen=True)
class JointError:
    """The error (M,) of one joint (from 0), and the waves per turn that its spectrum
    shows."""

    joint: int
    error: Array
    orders: Sequence[int]


def hats(x: Array, knots: Array | None = None) -> Array:
    """(N, count) piecewise linear functions that add up to one; knots : by default at
    quantiles."""
    if knots is None:
        knots = np.unique(np.quantile(x, np.linspace(0.0, 1.0, _HATS)))
    if len(knots) < 2:
        return np.ones((len(x), 1))
    return np.column_stack(
        [
            np.interp(
                x,
                knots,
                unit,
            )
            for unit in np.eye(len(knots))
        ]
    )


def from_reversal(velocity: Array, rows: SegmentedRuns) -> tuple[Array, Array]:
    """(M,) seconds from the nearest reversal, below zero before it, infinite where there
    is none; and the direction after it."""
    row_numbers = np.arange(len(velocity))
    segment = rows.segment
    turns = np.sign(velocity[1:]) != np.sign(velocity[:-1])
    at = np.flatnonzero(turns & (segment[1:] == segment[:-1]))
    if not len(at):
        return np.full(len(velocity), np.inf), np.zeros(len(velocity))
    middle = 0.5 * (rows.t[at] + rows.t[at + 1])
    sides = np.searchsorted(at, row_numbers) + np.array([[-1], [0]])
    sides = np.clip(sides, 0, len(at) - 1)
    seconds = np.where(
        segment[at[sides]] == segment,
        rows.t - middle[sides],
        np.inf,
    )
    best = np.argmin(np.abs(seconds), axis=0)
    direction = np.sign(velocity[at[sides[best, row_numbers]] + 1])
    return seconds[best, row_numbers], direction


def travel_since_reversal(q: Array, velocity: Array, rows: SegmentedRuns) -> Array:
    """(M,) how far a joint has gone since it turned round [rad, m]."""
    segment = rows.segment
    begins = np.ones(len(q), bool)
    turned = np.sign(velocity[1:]) != np.sign(velocity[:-1])
    begins[1:] = turned | (segment[1:] != segment[:-1])
    start = np.maximum.accumulate(
        np.where(
            begins,
            np.arange(len(q)),
            0,
        )
    )
    return np.asarray(np.abs(q - q[start]))


def _near_reversals(x: States, e: JointError) -> Array:
    """Any function of the time from a reversal and of the travel since it, and both times
    the direction."""
    velocity = x.dq[:, e.joint]
    since, direction = from_reversal(velocity, x.rows)
    near = np.abs(since) < FOLLOWS
    in_time = near[:, None] * hats(since, np.linspace(-FOLLOWS, FOLLOWS, _HATS))
    travel = travel_since_reversal(
        x.q[:, e.joint],
        velocity,
        x.rows,
    )
    in_travel = hats(travel) * smooth_sign(velocity)[:, None]
    return np.hstack(
        [
            in_time,
            in_time * direction[:, None],
            in_travel,
        ]
    )


def _at_standstill(x: States, e: JointError) -> Array:
    """A torque in each direction while the joint stands."""
    still = np.asarray(x.rows.still[:, e.joint] > STILL, float)
    return np.column_stack(
        [
            still,
            still * smooth_sign(x.dq[:, e.joint]),
        ]
    )


def _at_high_speed(x: States, e: JointError) -> Array:
    """What grows beyond three quarters of the largest speed."""
    speed = np.abs(x.dq[:, e.joint])
    fast = np.maximum(speed - FAST * speed.max(), 0.0)
    return np.column_stack(
        [
            fast,
            fast * smooth_sign(x.dq[:, e.joint]),
        ]
    )


def _of_velocity(x: States, e: JointError) -> Array:
    """Any function of the velocity, and its squares."""
    v = x.dq[:, e.joint]
    return np.column_stack(
        [
            hats(v),
            v**2,
            v * np.abs(v),
        ]
    )


def _of_position(x: States, e: JointError) -> Array:
    """Any function of the position."""
    return hats(x.q[:, e.joint])


def _in_a_turn(x: States, e: JointError) -> Array:
    """Slow waves of the position: an eccentric gear, a place that comes back."""
    angles = [k * x.q[:, e.joint] for k in _TURNS]
    return np.column_stack([wave(a) for a in angles for wave in (np.sin, np.cos)])


def _of_position_by_direction(x: States, e: JointError) -> Array:
    """A friction that is any function of the position."""
    direction = smooth_sign(x.dq[:, e.joint])
    return hats(x.q[:, e.joint]) * direction[:, None]


def _of_pose(x: States, e: JointError) -> Array:
    """Products of sines and cosines of this joint's position and another one's, as
    gravity makes them."""
    own = _sine_and_cosine(x.q[:, e.joint])
    products = [
        a * b
        for i in x.others(e.joint)
        for a in own
        for b in _sine_and_cosine(x.q[:, i])
    ]
    return _columns(products, len(x.t))


def _sine_and_cosine(q: Array) -> tuple[Array, Array]:
    return np.sin(q), np.cos(q)


def _columns(parts: Sequence[Array], rows: int) -> Array:
    """(M, k), also of none."""
    return np.column_stack(parts) if parts else np.zeros((rows, 0))


def _waves(x: States, e: JointError) -> Array:
    """Filtered sine and cosine of each order of a joint's angle."""
    parts = []
    for s in x.rows.segments:
        q = s.motion.q[:, e.joint]
        waves = [s.low_pass @ w(k * q) for k in e.orders for w in (np.cos, np.sin)]
        parts.append(_columns(waves, len(s.t)))
    return np.concatenate(parts)


def _of_acceleration(x: States, e: JointError) -> Array:
    """Any function of the acceleration, and a line, which goes on."""
    a = x.ddq[:, e.joint]
    return np.column_stack([hats(a), a])


def _of_load(x: States, e: JointError) -> Array:
    """Any function of the torque, and a friction that is any function of its size."""
    torque = x.torque[:, e.joint]
    direction = smooth_sign(x.dq[:, e.joint])
    by_size = hats(np.abs(torque)) * direction[:, None]
    return np.column_stack([hats(torque), by_size, torque])


def _of_time(x: States, e: JointError) -> Array:
    """A drift, of a torque and of a friction in each direction."""
    t = x.t - x.t.mean()
    t = t / nonzero_or_one(np.abs(t).max())
    powers = np.column_stack([t**k for k in _TIME_POWERS])
    direction = smooth_sign(x.dq[:, e.joint])
    velocity = x.dq[:, e.joint]
    return np.hstack(
        [
            powers,
            powers * direction[:, None],
            powers * velocity[:, None],
        ]
    )


def _of_hum(x: States, e: JointError) -> Array:
    """Waves of the frequencies that stand out of the error's spectrum."""
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
    """Any function of one other joint's velocity, or direction, with its acceleration; or
    of its position."""
    out = []
    for i in x.others(e.joint):
        direction = smooth_sign(x.dq[:, i])
        moving = [
            hats(x.dq[:, i]),
            x.dq[:, [i]],
            direction[:, None],
            x.ddq[:, [i]],
        ]
        out += [
            np.hstack(moving),
            hats(x.q[:, i]),
        ]
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
    """What each cause explains on data left out, as shares by its name.

    of_error : of the error's variance; beyond_model : of the variance of that part of
    the error that no parameters of the model can make. Only that part tells causes
    apart: what the model makes itself looks like the model wherever it comes from.
    refit_share : of the error's variance, which other parameters of the model take.
    """

    of_error: Mapping[str, float]
    beyond_model: Mapping[str, float]
    refit_share: float = 0.0

    @cached_property
    def equivalent_causes(self) -> list[str]:
        """The causes that explain as much as the likeliest one, to within 2 % of the
        part that tells causes apart: the one first that explains most of the error."""
        likelihood = {
            name: self._weight(name, self.beyond_model) for name in self.names
        }
        best = max(self.names, key=likelihood.__getitem__)
        least = self.beyond_model[best] - _SAME_SHARE
        tied = [best]
        for name in self.names:
            share = self.beyond_model[name]
            if name != best and share > 0.0 and share >= least:
                tied.append(name)
        return sorted(tied, key=lambda name: -self._weight(name, self.of_error))

    @cached_property
    def ranking(self) -> list[str]:
        """All causes, the likeliest first."""
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
        """The causes in the order of a heat map's rows."""
        return list(self.of_error)

    @staticmethod
    def _weight(name: str, shares: Mapping[str, float]) -> float:
        """A share; what other joints do is looked for in more ways, so it counts less."""
        return shares[name] * (_OTHERS_COUNT if name in (POSE, OTHER_JOINTS) else 1.0)


@dataclass(frozen=True)
class SplitError:
    """The error (M,) of one joint, split into what other parameters of the model would
    take, and what they would leave.

    basis (M, r) : an orthonormal one of the model's columns; fold (M,) : of each row.
    """

    error: Array
    basis: Array
    fold: NDArray[np.intp]

    @cached_property
    def beyond_model(self) -> Array:
        """(M,) what other parameters of the model would leave."""
        return self._without_model(self.error)

    @property
    def refit_share(self) -> float:
        """Share of the error's variance that they would take."""
        energy = max(float(np.sum(self.error**2)), 1e-300)
        return max(0.0, 1.0 - float(np.sum(self.beyond_model**2)) / energy)

    def explained_shares(self, alternatives: Sequence[Array]) -> tuple[float, float]:
        """What the best of several sets of columns (M, k) explains on data left out: its
        share of the error, and its share of what is beyond the model.

        A model that was fitted to these rows has taken its part of what it lacks: columns
        may explain the error by themselves, or beside the model.
        """
        of_error = of_beyond = 0.0
        for columns in alternatives:
            left = self._without_model(columns)
            # What the model makes itself is rounding.
            energy = np.sum(columns**2, axis=0)
            left = left[:, np.sum(left**2, axis=0) > _ABSORBED * energy]
            share = held_out_share(left, self.beyond_model, self.fold)
            of_beyond = max(of_beyond, share)
            of_error = max(of_error, held_out_share(columns, self.error, self.fold))
        return max(of_error, (1.0 - self.refit_share) * of_beyond), of_beyond

    def _without_model(self, columns: Array) -> Array:
        """(M, ...) less what the model's columns make of them."""
        return np.asarray(columns - self.basis @ (self.basis.T @ columns))


def held_out_share(
    features: Array,
    error: Array,
    fold: NDArray[np.intp],
) -> float:
    """1 - squared error of the prediction / squared error of none, over held-out folds;
    >= 0.

    Of several ridges the best one counts: columns that a few reversals hardly determine
    need a large one, or they predict nothing.
    """
    n_features = features.shape[1]
    folds = np.unique(fold)
    total = float(np.sum(error**2))
    if not n_features or len(folds) < 2 or total == 0.0:
        return 0.0
    scaled = features / nonzero_or_one(np.sqrt(np.mean(features**2, axis=0)))
    pieces = [(scaled[fold == f], error[fold == f]) for f in folds]
    grams = np.array([A.T @ A for A, _ in pieces])
    pulls = np.array([A.T @ y for A, y in pieces])
    explained = np.zeros(len(_RIDGES))
    for gram_left_out, pull_left_out in zip(grams, pulls, strict=True):
        gram = grams.sum(axis=0) - gram_left_out
        ridges = _RIDGES * np.trace(gram) / n_features
        if not ridges[0] > 0.0:  # the cause does not occur
            return 0.0
        pull = pulls.sum(axis=0) - pull_left_out
        values, vectors = np.linalg.eigh(gram)
        along = vectors.T @ pull
        for k, ridge in enumerate(ridges):
            theta = vectors @ (along / (np.maximum(values, 0.0) + ridge))
            explained[k] += 2.0 * theta @ pull_left_out
            explained[k] -= theta @ gram_left_out @ theta
    return max(0.0, float(explained.max()) / total)
