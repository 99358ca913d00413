"""Channels with stamps of their own come together at the stamps of the torque: columns
of a sparse table, files, messages of a bag.

The torque stays as it was measured, for its noise is what errors are compared with. The
other channels are interpolated to its stamps: a position that is two milliseconds old
makes an error of two milliseconds of speed.
"""

from collections.abc import Collection, Hashable, Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import chain

import numpy as np

from sdp_vs_penalty.data.store import concatenate_chunks, iter_chunks
from sdp_vs_penalty.robot.arrays import Array, Indices, Mask

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

    #: (N,) stamps of the other clock, at which values are interpolated [s].
    clock: Array
    #: (M,) stamps of the samples in the order of time [s].
    stamps: Array
    #: Distance within which the nearest sample says enough [s].
    within: float

    @cached_property
    def longest_step(self) -> float:
        """Time between two samples [s] above which one is lost between them; 0 where
        stamps repeat, so that they do not tell when samples were taken."""
        steps = np.diff(self.stamps)
        is_rounded = np.sum(steps == 0.0) > _ROUNDED * len(self.stamps)
        return 0.0 if is_rounded else _LOST * usual_distance(self.stamps)

    @cached_property
    def after(self) -> Indices:
        """(N,) place of the first sample that is not before a stamp."""
        return np.searchsorted(self.stamps, self.clock)

    @cached_property
    def nearest(self) -> Indices:
        """(N,) place of the sample that is nearest in time."""
        after = np.clip(self.after, 0, len(self.stamps) - 1)
        before = np.maximum(after - 1, 0)
        distances = np.abs(self.stamps[[before, after]] - self.clock)
        return np.where(distances[0] <= distances[1], before, after)

    @cached_property
    def distances(self) -> Array:
        """(N,) time to the nearest sample [s]."""
        return np.abs(self.stamps[self.nearest] - self.clock)

    @cached_property
    def is_known(self) -> Mask:
        """(N,) whether a stamp's value is known: a sample is near in time, or no sample is
        lost between the two around it."""
        steps = np.diff(self.stamps, prepend=-np.inf, append=np.inf)[self.after]
        return (self.distances <= self.within) | (steps <= self.longest_step)

    def values(self, samples: Array, rows: Indices | slice = slice(None)) -> Array:
        """Return the values (K, ...) of samples (M, ...) at some of the stamps."""
        if not self.longest_step or not self.distances[rows].any():
            return np.asarray(samples[self.nearest[rows]])
        t, x, last = self.stamps, self.clock[rows], len(self.stamps) - 1
        # (4, K) places of the samples around each stamp; the outer two count where no
        # sample is lost beside them.
        places = np.clip(self.after[rows], 1, last) + np.arange(-2, 2)[:, None]
        inside = np.clip(places, 0, last)
        steps = np.diff(t[inside], axis=0)
        is_even = np.all((steps > 0.0) & (steps <= self.longest_step), axis=0)
        weights = np.where(is_even, _lagrange(x, t[inside]), 0.0)
        line = _lagrange(x, t[inside[1:3]])
        weights[1:3] = np.where(is_even, weights[1:3], line)
        neighbours = np.asarray(samples[inside])  # (4, K, ...)
        return np.asarray(np.einsum("ik,ik...->k...", weights, neighbours))


def _lagrange(x: Array, nodes: Array) -> Array:
    """Return the weights (k, K) of k samples at ``nodes`` (k, K) in the polynomial
    through them at x (K,), w_i = prod_{j != i} (x - x_j) / (x_i - x_j); 0 where two
    nodes are equal."""
    differences = nodes[:, None] - nodes
    differences[differences == 0.0] = np.inf
    factors = (x - nodes) / differences
    k = np.arange(len(nodes))
    factors[k, k] = 1.0
    return np.asarray(factors.prod(axis=1))


def usual_distance(clock: Array) -> float:
    """Return the median step of a clock (N,) that is above zero [s]; 0 without one."""
    steps = np.diff(clock)
    steps = steps[steps > 0.0]
    return float(np.median(steps)) if len(steps) else 0.0


@dataclass(frozen=True)
class ChannelStamps:
    """When channels have values: in rows of a table, or with messages of a stream."""

    #: (M,) stamps in the order of time [s].
    t: Array
    #: (M,) place of each sample in the table or stream.
    rows: Indices
    #: Name of the clock that gives the stamps.
    clock: str = ""


def align(
    samples: Mapping[Hashable, ChannelStamps],
    channels: Mapping[str, tuple[Hashable, Array]],
    leading: str,
    discrete: Collection[str | None] = (),
) -> tuple[Indices, dict[str, Array], int, str]:
    """Bring channels with stamps of their own to those of the leading one: a torque,
    where there is one.

    Every other channel is interpolated; those named in ``discrete``, such as a counter,
    take the nearest value. Instants for which one has no samples around are left out; a
    channel that never changes has its value at any time.

    Parameters
    ----------
    channels : mapping
        By name the key of the channel's samples, and its values (M,) or (M, n).

    Returns
    -------
    rows : (K,) array
        Places of the leading channel's samples whose stamps all channels have.
    columns : dict
        (K,) or (K, n) values by name.
    n_lost : int
        Number of samples, of the leading channel or of another, that are in no row.
    remark : str
        What was interpolated and how far; "" where nothing was.
    """
    base = samples[channels[leading][0]]
    # Half a step, and a little more, so that rounded stamps match.
    within = 0.5001 * usual_distance(base.t)
    is_kept = np.ones(len(base.t), bool)
    places = dict[Hashable, Indices]()
    ways = dict[Hashable, Interpolation]()
    n_lost = 0
    for key, own in samples.items():
        if own.clock == base.clock:  # rows of one table belong together
            size = 1 + max(np.max(x.rows, initial=0) for x in (own, base))
            place = np.full(size, -1)  # of each row among the samples; -1: none
            place[own.rows] = np.arange(len(own.rows))
            places[key] = place[base.rows]
        elif np.array_equal(own.t, base.t):
            places[key] = np.arange(len(own.t))
        if key not in places or np.any(places[key] < 0):
            ways[key] = Interpolation(base.t, own.t, within)
            back = Interpolation(own.t, base.t, within)
            n_lost = max(n_lost, int(np.sum(~back.is_known)))
    for key, values in channels.values():
        if key in ways and np.ptp(values) != 0.0:
            is_kept &= ways[key].is_known
    rows = np.flatnonzero(is_kept)
    columns = dict[str, Array]()
    for name, (key, values) in channels.items():
        if key not in ways:
            columns[name] = values[places[key][rows]]
        elif name in discrete:
            columns[name] = values[ways[key].nearest[rows]]
        else:
            parts = (ways[key].values(values, part) for _, part in iter_chunks(rows))
            columns[name] = concatenate_chunks(chain([values[:0]], parts))
    distances = [1e3 * x.distances[rows] for x in ways.values()]  # [ms]
    distances = [x for x in distances if len(x) and x.max() > 1e-6]
    remark = ""
    if distances:
        typical = max(float(np.median(x)) for x in distances)
        largest = max(float(x.max()) for x in distances)
        remark = (
            "channels with stamps of their own are interpolated to the torque's stamps,"
            f" from samples {typical:.3g} ms away (at most {largest:.3g} ms)"
        )
    return rows, columns, max(n_lost, len(base.t) - len(rows)), remark
