"""Channels with stamps of their own come together at the stamps of the torque: columns
of a sparse table, files, messages of a bag.

The torque stays as it was measured, for its noise is what errors are compared with. The
other channels are interpolated to its stamps: a position that is two milliseconds old
makes an error of two milliseconds of speed.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

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


def interpolation_remark(distances: Sequence[Array]) -> str:
    """Return the sentence that channels were interpolated, and how far; "" where all
    had samples at the torque's stamps.

    Parameters
    ----------
    distances : sequence of (K,) arrays
        Of each channel, the times to the nearest sample [s].
    """
    moved = [x for x in distances if len(x) and x.max() > 1e-9]
    if not moved:
        return ""
    typical = 1e3 * max(float(np.median(x)) for x in moved)
    largest = 1e3 * max(float(x.max()) for x in moved)
    return (
        "channels with stamps of their own are interpolated to the torque's stamps,"
        f" from samples {typical:.3g} ms away (at most {largest:.3g} ms)"
    )


def half_period(clock: Array) -> float:
    """Return half of the median step of a clock (N,) [s], and a little more so that
    rounded stamps match.

    Returns
    -------
    float
        Half of the median step [s]; 0 without steps.
    """
    steps = np.diff(clock)
    steps = steps[steps > 0.0]
    return 0.5001 * float(np.median(steps)) if len(steps) else 0.0


@dataclass(frozen=True)
class MergedColumns:
    """Columns at common stamps."""

    #: (K,) rows whose stamps they have, in the order of time.
    rows: NDArray[np.intp]
    #: (K,) or (K, n) values by name.
    columns: dict[str, Array]
    #: What was interpolated and how far, without a full stop; "" where nothing was.
    remark: str


def merge_columns(
    clock: Array,
    columns: Mapping[str, Array],
    leading: str,
    discrete: Collection[str | None] = (),
) -> MergedColumns:
    """Merge columns that have values in different rows.

    The leading column gives the rows. Every other column is interpolated to their
    stamps; rows for which it has no samples around are left out.

    Parameters
    ----------
    clock : array
        (N,) stamps of all rows [s].
    columns : mapping of str to array
        (N,) or (N, n) values by name, NaN where a row has none.
    leading : str
        Column whose rows stay: a torque, where there is one.
    discrete : collection of str
        Columns, such as a counter, that take the nearest value.
    """
    base = _rows_with_value(clock, columns[leading])
    within = half_period(clock[base])
    is_kept = np.ones(len(base), bool)
    # By the rows in which a column has values; columns of one message share them.
    places = dict[bytes, tuple[NDArray[np.intp], Interpolation]]()
    keys = dict[str, bytes]()
    for name, values in columns.items():
        rows = _rows_with_value(clock, values)
        # A column that is never a number: whoever reads it says so.
        if len(rows) == 0 or np.array_equal(rows, base):
            continue
        keys[name] = rows.tobytes()
        if keys[name] not in places:
            found = Interpolation(clock[base], clock[rows], within)
            places[keys[name]] = rows, found
            is_kept &= found.is_known
    kept = np.flatnonzero(is_kept)
    merged = dict[str, Array]()
    for name, values in columns.items():
        if name not in keys:
            merged[name] = values[base[kept]]
            continue
        rows, found = places[keys[name]]
        if name in discrete:
            merged[name] = values[rows[found.nearest[kept]]]
        else:
            merged[name] = found.values(values[rows], kept)
    distances = [found.distances[kept] for _, found in places.values()]
    return MergedColumns(base[kept], merged, interpolation_remark(distances))


def _rows_with_value(clock: Array, values: Array) -> NDArray[np.intp]:
    """Return the rows (M,) in which a column (N,) or (N, n) has a value, in the order
    of time."""
    first_values = values if values.ndim == 1 else values[:, 0]
    rows = np.flatnonzero(~np.isnan(first_values) & np.isfinite(clock))
    return rows[np.argsort(clock[rows], kind="stable")]
