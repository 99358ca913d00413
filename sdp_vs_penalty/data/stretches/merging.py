"""Channels with stamps of their own come together at the stamps of the torque: columns
of a sparse table, files, messages of a bag.

The torque stays as it was measured, for its noise is what errors are compared with. The
other channels are interpolated to its stamps: a position that is two milliseconds old
makes an error of two milliseconds of speed.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.data.store import concatenate_chunks, iter_chunks
from sdp_vs_penalty.robot.arrays import Array

#: Neighbours that are farther apart than so many usual steps have lost a sample between
#: them.
_LOST = 1.5
#: From this share of repeated stamps on a clock is rounded, and between its stamps
#: nothing is known of the time.
_ROUNDED = 0.01


@dataclass(frozen=True)
class Interpolation:
    """Channels with M stamps, at the N stamps of another clock.

    A value is that of the cubic through the four samples around it; of a straight line
    near the ends and beside a lost sample; of the nearest sample where stamps are
    rounded.
    """

    #: (N,) stamps at which values are wanted [s].
    clock: Array
    #: (M,) stamps of the samples, in any order [s].
    other: Array
    #: Distance within which the nearest sample says enough [s].
    within: float

    @cached_property
    def order(self) -> NDArray[np.intp]:
        """(M,) rows of the samples in the order of time."""
        return np.argsort(self.other, kind="stable")

    @cached_property
    def _stamps(self) -> Array:
        """(M,) stamps of the samples in the order of time [s]."""
        return np.asarray(self.other[self.order])

    @cached_property
    def _usual_step(self) -> float:
        """Median step of the samples' stamps [s]; 0 without steps."""
        return 2.0 * half_period(self._stamps) / 1.0002

    @cached_property
    def is_rounded(self) -> bool:
        """Whether stamps repeat, so that they do not tell when samples were taken."""
        repeated = np.diff(self._stamps) == 0.0
        return bool(repeated.sum() > _ROUNDED * len(self._stamps))

    @cached_property
    def nearest(self) -> NDArray[np.intp]:
        """(N,) row of the sample that is nearest in time."""
        after = np.clip(self._after, 0, len(self.other) - 1)
        before = np.maximum(after - 1, 0)
        t = self._stamps
        is_before = np.abs(t[before] - self.clock) <= np.abs(t[after] - self.clock)
        return self.order[np.where(is_before, before, after)]

    @cached_property
    def _after(self) -> NDArray[np.intp]:
        """(N,) place, in the order of time, of the first sample not before a stamp."""
        return np.searchsorted(self._stamps, self.clock)

    @cached_property
    def distances(self) -> Array:
        """(N,) time to the nearest sample [s]."""
        if len(self.other) == 0:
            return np.full(len(self.clock), np.inf)
        return np.abs(self.other[self.nearest] - self.clock)

    @cached_property
    def is_known(self) -> NDArray[np.bool_]:
        """(N,) whether the samples say the value: one is near, or both neighbours are a
        usual step apart."""
        is_near = self.distances <= self.within
        if len(self.other) < 2 or self.is_rounded:
            return is_near
        after = np.clip(self._after, 1, len(self.other) - 1)
        steps = self._stamps[after] - self._stamps[after - 1]
        is_between = (self._after > 0) & (self._after < len(self.other))
        return is_near | (is_between & (steps <= _LOST * self._usual_step))

    def values(
        self, samples: Array, rows: NDArray[np.intp] | slice = slice(None)
    ) -> Array:
        """Return the values (K, ...) of samples (M, ...) at some of the stamps."""
        nearest = self.nearest[rows]
        if len(self.other) < 2 or self.is_rounded or not self.distances[rows].any():
            return np.asarray(samples[nearest])
        t = self._stamps
        x = self.clock[rows]
        right = np.clip(self._after[rows], 1, len(t) - 1)
        # (4, K) places of the samples around each stamp; the outer two count where no
        # sample is lost beside them.
        places = right + np.arange(-2, 2)[:, None]
        inside = np.clip(places, 0, len(t) - 1)
        steps = np.diff(t[inside], axis=0)
        is_even = np.all((steps > 0.0) & (steps <= _LOST * self._usual_step), axis=0)
        is_even &= (places[0] >= 0) & (places[3] < len(t))
        weights = np.where(is_even, _lagrange(x, t[inside]), 0.0)
        line = _lagrange(x, t[inside[1:3]])
        weights[1:3] = np.where(is_even, weights[1:3], line)
        around = np.asarray(samples[self.order[inside]])  # (4, K, ...)
        shape = (*weights.shape, *[1] * (around.ndim - 2))
        return np.asarray(np.sum(weights.reshape(shape) * around, axis=0))


def _lagrange(x: Array, nodes: Array) -> Array:
    """Return the weights (k, K) of k samples at ``nodes`` (k, K) in the polynomial
    through them at x (K,), w_i = prod_{j != i} (x - x_j) / (x_i - x_j); 0 where two
    nodes are equal."""
    k = len(nodes)
    weights = np.ones_like(nodes)
    for i in range(k):
        for j in range(k):
            if i != j:
                apart = nodes[i] - nodes[j]
                safe = np.where(apart == 0.0, np.inf, apart)
                weights[i] *= (x - nodes[j]) / safe
    return weights


def half_period(clock: Array) -> float:
    """Return half of the median step of a clock (N,) [s], and a little more so that
    rounded stamps match; 0 without steps."""
    steps = np.diff(clock)
    steps = steps[steps > 0.0]
    return 0.5001 * float(np.median(steps)) if len(steps) else 0.0


@dataclass(frozen=True)
class ChannelSamples:
    """A channel with stamps of its own."""

    #: (M,) stamps, in any order [s].
    t: Array
    #: (M,) or (M, n) values.
    values: Array
    #: Name of the clock that gives the stamps.
    clock: str = ""
    #: (M,) rows of the samples in a table of that clock; None where it has no rows.
    rows: NDArray[np.intp] | None = None

    def of_rows_of(self, other: "ChannelSamples") -> NDArray[np.intp] | None:
        """Return the place (N,) of the sample in each row of another channel; None where
        one of these rows has none."""
        if self.rows is None or other.rows is None or self.clock != other.clock:
            return None
        in_order = np.argsort(self.rows)
        places = np.searchsorted(self.rows[in_order], other.rows)
        places = in_order[np.minimum(places, len(in_order) - 1)]
        return places if np.array_equal(self.rows[places], other.rows) else None


@dataclass(frozen=True)
class Aligned:
    """Channels at common stamps."""

    #: (K,) stamps [s].
    t: Array
    #: (K,) places of the leading channel's samples whose stamps they have.
    rows: NDArray[np.intp]
    #: (K,) or (K, n) values by name.
    columns: dict[str, Array]
    #: Samples, of the leading channel or of another, that are in no row.
    n_lost: int
    #: What was interpolated and how far; "" where nothing was.
    remark: str


def align(
    channels: Mapping[str, ChannelSamples],
    leading: str,
    discrete: Collection[str | None] = (),
) -> Aligned:
    """Bring channels with stamps of their own to those of the leading one: a torque,
    where there is one.

    Every other channel is interpolated; those named in ``discrete``, such as a counter,
    take the nearest value. Instants for which one has no samples around are left out; a
    channel that never changes has its value at any time.
    """
    base = channels[leading].t
    within = half_period(base)
    is_kept = np.ones(len(base), bool)
    found = dict[int, Interpolation]()  # channels of one message share their stamps
    n_lost = 0
    for channel in channels.values():
        # Of a column that is never a number whoever reads it says so.
        if len(channel.t) == 0 or np.array_equal(channel.t, base):
            continue
        if channel.of_rows_of(channels[leading]) is not None:
            continue
        key = id(channel.t)
        if key not in found:
            found[key] = Interpolation(base, channel.t, within)
            back = Interpolation(channel.t, base, within)
            n_lost = max(n_lost, int(np.sum(~back.is_known)))
        if np.ptp(channel.values) != 0.0:
            is_kept &= found[key].is_known
    rows = np.flatnonzero(is_kept)
    columns = dict[str, Array]()
    for name, channel in channels.items():
        way, values = found.get(id(channel.t)), channel.values
        if len(channel.t) == 0:
            columns[name] = np.full((len(rows), *values.shape[1:]), np.nan)
        elif way is None:
            places = channel.of_rows_of(channels[leading])
            columns[name] = values[rows if places is None else places[rows]]
        elif name in discrete:
            columns[name] = values[way.nearest[rows]]
        else:
            parts = (way.values(values, part) for _, part in iter_chunks(rows))
            columns[name] = concatenate_chunks([values[:0], *parts])
    moved = [x.distances[rows] for x in found.values()]
    moved = [x for x in moved if len(x) and x.max() > 1e-9]
    remark = ""
    if moved:
        typical = 1e3 * max(float(np.median(x)) for x in moved)
        largest = 1e3 * max(float(x.max()) for x in moved)
        remark = (
            "channels with stamps of their own are interpolated to the torque's stamps,"
            f" from samples {typical:.3g} ms away (at most {largest:.3g} ms)"
        )
    return Aligned(
        base[rows], rows, columns, max(n_lost, len(base) - len(rows)), remark
    )
