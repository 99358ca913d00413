"""Where a motion comes back: after a period within a run, or again in another run.

Whatever a model gets wrong comes back with the motion; noise is new each time.
Everything that measures noise or tells it from error rests on the repeats found here.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
import scipy

from sdp_vs_penalty.robot.arrays import Array, Indices, Mask
from sdp_vs_penalty.signals.coloured_noise import ORDER
from sdp_vs_penalty.signals.runs import interpolated
from sdp_vs_penalty.signals.splines import CubicSpline

#: Instants (M,) s and positions (M, n) of one uninterrupted motion.
Track: TypeAlias = tuple[Array, Array]

#: Motions are alike if their positions differ by less than this share of each joint's
#: motion.
SAME_MOTION = 0.01
#: Shortest stretch that is compared [s]: shorter ones say little about slow noise.
_SHORTEST = 2.0
#: Fewest rows of a repetition: noise is compared with its own past.
_FEWEST_ROWS = 2 * ORDER


def motion_scale(q: Array) -> Array | None:
    """Return the size (n,) of each joint's motion [rad or m], the standard deviation of
    its positions q (N, n); None if no joint moves.

    It is at least SAME_MOTION (1 %) of the largest joint's, because the noise of a joint that
    hardly moves is no motion.
    """
    size = q.std(axis=0)
    largest = size.max()
    return np.maximum(size, SAME_MOTION * largest) if largest > 0.0 else None


def repeat_period(t: Array, q: Array) -> float | None:
    """Find the period [s] after which a run repeats its motion, positions q (M, n) [rad
    or m] at instants t (M,) [s]; None if it does not repeat.

    Standstill at either end is cut off first. Then up to ``_SHORTEST`` seconds are cut
    off both ends if needed, where the motion may be another one (an approach, a ramp).
    Repetitions have to overlap by ``_SHORTEST`` seconds or more.
    """
    scale = motion_scale(q)
    if scale is None:
        return None
    # From the first row away from the initial pose to the last away from the final one.
    has_left = np.any(np.abs(q - q[0]) > SAME_MOTION * scale, axis=1)
    is_coming = np.any(np.abs(q - q[-1]) > SAME_MOTION * scale, axis=1)
    begin = int(np.argmax(has_left))
    end = len(t) - int(np.argmax(is_coming[::-1]))
    t = t[begin:end]
    q = q[begin:end]
    if len(t) <= 1:
        return None
    # Cut more and more off both ends, where the motion may be another one.
    for cut in (0.0, 0.5 * _SHORTEST, _SHORTEST):
        inside = (t >= t[0] + cut) & (t <= t[-1] - cut)
        lag = _first_period((t[inside], q[inside]))
        if lag is not None:
            return lag
    return None


def _first_period(track: Track) -> float | None:
    """Return the shortest lag [s] after which a track repeats itself; None if it does
    not.

    Lags from half a second on are tried, in ascending order, so that the result is the
    period and no multiple of it. track : instants (M,) [s] and positions (M, n).
    """
    t, q = track
    scale = motion_scale(q) if len(t) >= 3 else None
    if scale is None:
        return None
    step = float(np.median(np.diff(t)))
    first = max(1, int(0.5 / step))
    last = int((t[-1] - t[0] - _SHORTEST) / step)
    lags = np.arange(first, last)  # in steps
    # Each valley is a pair of the mean square difference and the lag [s].
    for _, lag in _valleys(track, track, scale, step, lags):
        if _is_repeated(track, track, scale, lag):
            return lag
    return None


def repeat_lag(a: Track, b: Track, slip: float = 5.0) -> float | None:
    """Find by how much the clock of one track differs from that of another with the
    same motion.

    Parameters
    ----------
    a : (t (M,), q (M, n))
        Instants [s] and positions [rad or m] of a track.
    b : (t (N,), q (N, n))
        The track that may repeat ``a``.
    slip : float
        How much earlier or later than ``a`` the same motion may begin in ``b`` [s].

    Returns
    -------
    float or None
        The difference d [s], so that q_b(t + d) = q_a(t); None if ``b`` does not repeat
        ``a``.
    """
    t_a, q_a = a
    t_b = b[0]
    scale = motion_scale(q_a)
    if scale is None or min(len(t_a), len(t_b)) < 3:
        return None
    step = float(np.median(np.diff(t_a)))
    # At the largest lag to either side the tracks still overlap by _SHORTEST seconds.
    back = int(min(slip, float(t_a[-1] - t_a[0]) - _SHORTEST) / step)
    forward = int(min(slip, float(t_b[-1] - t_b[0]) - _SHORTEST) / step)
    if min(back, forward) <= 0:
        return None
    lags = np.arange(-back, forward + 1)
    # Pairs of mean square difference and lag: the smallest difference is the best.
    valleys = _valleys(a, b, scale, step, lags)
    best = min(valleys, default=None)
    if best is None:
        return None
    lag = best[1]
    if not _is_repeated(a, b, scale, lag):
        return None
    return lag + float(t_b[0] - t_a[0])


def _valleys(
    a: Track, b: Track, scale: Array, step: float, lags: Indices
) -> list[tuple[float, float]]:
    """List the lags at which track b may repeat track a: minima of their difference D.

    Parameters
    ----------
    scale : (n,) array
        Size of each joint's motion [rad or m].
    step : float
        Time from one lag to the next [s].
    lags : (L,) array of int
        Consecutive lags, in steps.

    Returns
    -------
    list of (float, float)
        D and the lag [s] at each minimum that is near enough to 0 for a repetition, in
        the order of the lags.
    """
    squares = _mean_squares(a, b, scale, step, lags)
    left = squares[:-2]
    center = squares[1:-1]
    right = squares[2:]
    # Between lags D is a parabola: the vertex of the one through three neighbours.
    bend = left - 2.0 * center + right
    is_minimum = (center <= left) & (center <= right) & (bend > 0.0)
    shift = 0.5 * (left - right) / np.where(is_minimum, bend, 1.0)
    lowest = center - 0.25 * (left - right) * shift
    is_near_zero = lowest < (2.0 * SAME_MOTION) ** 2
    valleys = np.flatnonzero(is_minimum & is_near_zero)
    seconds = (lags[1 + valleys] + shift[valleys]) * step
    return list(zip(lowest[valleys], seconds, strict=True))


def _mean_squares(
    a: Track, b: Track, scale: Array, step: float, lags: Indices
) -> Array:
    """Return the difference D (L,) of two tracks at each lag.

    D(lag) is the mean square of b(t_b0 + k step + lag) - a(t_a0 + k step) over k and
    joints, each joint in units of its scale. All lags are computed by one correlation,
    as sum a^2 + sum b^2 - 2 sum a b; the arguments are those of :func:`_valleys`.
    """
    x = _evenly_sampled(a, step, scale)
    y = x if b is a else _evenly_sampled(b, step, scale)
    # Small numbers: the sums of squares lose fewer digits.
    middle = x.mean(axis=1, keepdims=True)
    x = x - middle
    y = y - middle
    n_joints, n_of_a = x.shape
    n_of_b = y.shape[1]
    product = _correlation(x, y)[lags]
    # Samples of a that overlap with b at each lag, and sums of squares over them.
    first = np.maximum(0, -lags)
    last = np.minimum(n_of_a, n_of_b - lags)
    squares_of_a = np.append(0.0, np.cumsum(np.sum(x**2, axis=0)))
    squares_of_b = np.append(0.0, np.cumsum(np.sum(y**2, axis=0)))
    sum_of_a = squares_of_a[last] - squares_of_a[first]
    # The order of these terms decides the rounding.
    total = (
        sum_of_a
        + squares_of_b[last + lags]
        - squares_of_b[first + lags]
        - 2.0 * product
    )
    return np.maximum(total, 0.0) / ((last - first) * n_joints)


def _evenly_sampled(track: Track, step: float, scale: Array) -> Array:
    """Return the positions (n, M) of a track in units of the scale (n,), interpolated
    linearly at instants ``step`` seconds apart.
    """
    t, q = track
    return interpolated(np.arange(t[0], t[-1], step), t, q / scale).T


def _correlation(x: Array, y: Array) -> Array:
    """Return the cross-correlation (L,) of signals x (n, M) and y (n, N): the sum over
    joints and k of x(k) y(k + lag), at place ``lag``.

    Negative lags count from the end, as in x[-1]. It is computed by FFT, one joint
    after the other, which needs the memory of one.
    """
    length = scipy.fft.next_fast_len(x.shape[1] + y.shape[1], real=True)
    spectrum = np.zeros(length // 2 + 1, complex)
    for of_joint, other in zip(x, y, strict=True):
        spectrum += np.conj(scipy.fft.rfft(of_joint, length)) * scipy.fft.rfft(
            other, length
        )
    return scipy.fft.irfft(spectrum, length)


def _is_repeated(a: Track, b: Track, scale: Array, lag: float) -> bool:
    """Whether track b repeats track a with a lag [s]: q_b(t_b0 + s + lag) = q_a(t_a0 +
    s).

    The root mean square difference over all s in both tracks has to be below SAME_MOTION (1
    %) of the joints' motion, ``scale`` (n,).
    """
    t_a, q_a = a
    t_b, q_b = b
    at = t_a - t_a[0] + lag + t_b[0]
    inside = (at >= t_b[0]) & (at <= t_b[-1])
    repeated = interpolated(at[inside], t_b, q_b)
    return _difference(q_a[inside], repeated, scale) < SAME_MOTION


def _difference(q: Array, other: Array, scale: Array) -> float:
    """Return the root mean square difference of two motions (M, n), each joint in units
    of its scale (n,)."""
    relative = (q - other) / scale
    return float(np.sqrt(np.mean(relative**2)))


@dataclass(frozen=True)
class Filtered:
    """The filtered positions of a segment, to find repeated motion in."""

    #: (M,) instants of the rows [s].
    t: Array
    #: (M,) flags of the rows that count.
    keep: Mask
    #: (D,) instants [s], close enough to interpolate positions between them.
    t_dense: Array
    #: (D, n) positions at these instants [rad or m].
    q_dense: Array


@dataclass(frozen=True)
class Repeat:
    """M rows of a segment whose motion repeats at other instants."""

    #: (M,) numbers of the rows among the rows of all segments.
    rows: Indices
    #: Number of the segment that repeats the rows' motion.
    other: int
    #: (M,) instants of that segment with the same motion [s].
    later: Array
    #: (M,) first rows of that segment from those instants on, numbers among all rows.
    there: Indices


def is_part(window: Filtered, longer: Filtered) -> bool:
    """Whether a segment is a window of a longer one.

    It is if both have the same positions at the same instants, within a tenth of SAME_MOTION
    (0.1 % of the joints' motion).
    """
    t = window.t_dense
    span = longer.t_dense
    inside = (t >= span[0]) & (t <= span[-1])
    scale = motion_scale(longer.q_dense)
    if not inside.any() or scale is None:
        return False

    there = CubicSpline(span, longer.q_dense)(t[inside])
    return _difference(window.q_dense[inside], there, scale) < 0.1 * SAME_MOTION


def find_repeats(segments: Sequence[Filtered]) -> tuple[Repeat, ...]:
    """Find all pairs of stretches with the same motion, within segments and between
    them.

    Parameters
    ----------
    segments : sequence of Filtered
        The segments, in the order of their rows.

    Returns
    -------
    tuple of Repeat
        Which rows repeat, in which segment, and when.
    """
    repeats = []
    # Number of the first row of each segment, among all rows.
    starts = np.cumsum([0, *(len(segment.t) for segment in segments)])
    for k, a in enumerate(segments):
        for m, b in enumerate(segments[k:], k):
            if m == k:
                shift = repeat_period(a.t_dense, a.q_dense)
            else:
                shift = repeat_lag((a.t_dense, a.q_dense), (b.t_dense, b.q_dense))
            if shift is None:
                continue
            rows, later = _same_positions(a, b, shift)
            if len(rows) >= _FEWEST_ROWS:
                place = np.searchsorted(b.t, later)
                place = np.clip(place, 0, len(b.t) - 1)
                repeat = Repeat(
                    rows=starts[k] + rows, other=m, later=later, there=starts[m] + place
                )
                repeats.append(repeat)
    return tuple(repeats)


def _same_positions(a: Filtered, b: Filtered, shift: float) -> tuple[Indices, Array]:
    """Find the rows (K,) of segment a whose positions segment b has ``shift`` seconds
    later.

    Returns
    -------
    rows : (K,) array of int
        Numbers of the rows within a; empty if there are fewer than _FEWEST_ROWS to
        compare.
    later : (K,) array
        Instants in b with the same positions [s].
    """
    later = a.t + shift
    is_within = (later >= b.t_dense[0]) & (later <= b.t_dense[-1])
    rows = np.flatnonzero(a.keep & is_within)
    scale = motion_scale(a.q_dense)
    if scale is None or len(rows) < _FEWEST_ROWS:
        return rows[:0], later[:0]
    later = later[rows]
    positions_of_a = CubicSpline(a.t_dense, a.q_dense)(a.t[rows])
    positions_of_b = CubicSpline(b.t_dense, b.q_dense)(later)
    is_same = np.all(
        np.abs(positions_of_a - positions_of_b) < SAME_MOTION * scale, axis=1
    )
    return rows[is_same], later[is_same]


def pairs(repeats: Sequence[Repeat]) -> Indices:
    """Return the two rows with the same motion, for each repeated row.

    Noise is measured on the D differences of the torque's residual between two such
    rows.

    Parameters
    ----------
    repeats : sequence of Repeat
        Which rows repeat, and when.

    Returns
    -------
    (D, 2) array of int
        Number of the row at the earlier instant, and of the row at or behind the later
        one.
    """
    rows = [np.column_stack([r.rows, r.there]) for r in repeats]
    return np.concatenate(rows)


def motions_of_rows(row_pairs: Indices, n_rows: int) -> tuple[int, Indices]:
    """Count the independent differences between rows with the same motion, and tell
    which differences are of one motion.

    K rows with the same motion have K (K - 1) / 2 differences, of which K - 1 are
    independent: six equal runs make fifteen pairs of each row, five of them
    independent.

    Parameters
    ----------
    row_pairs : (D, 2) array of int
        Pairs of rows with the same motion, from :func:`pairs`.
    n_rows : int
        Number of all rows.

    Returns
    -------
    int
        Number of independent differences: the rows less groups of rows with the same
        motion (connected components; a row without a pair is one).
    (D,) array of int
        The phase of each difference's motion: the first of all rows that pairs connect
        with its own.
    """
    entries = (np.ones(len(row_pairs)), tuple(row_pairs.T))
    graph = scipy.sparse.coo_array(entries, shape=(n_rows, n_rows))
    n_motions, motion = scipy.sparse.csgraph.connected_components(graph, directed=False)
    first_rows = np.full(n_motions, n_rows, dtype=np.intp)
    np.minimum.at(first_rows, motion, np.arange(n_rows))
    return n_rows - int(n_motions), first_rows[motion[row_pairs[:, 0]]]


def recurring_differences(
    row_pairs: Indices, phase: Indices, reach: int, marked: Mask
) -> Mask:
    """Return which of the marked differences (D,) recur between two other instants of
    the same phase, as flags (D,).

    A difference that recurs is noise that the motion amplifies; one that does not is an
    event at one instant.

    Parameters
    ----------
    row_pairs : (D, 2) array of int
        The two rows with the same motion of each difference, from :func:`pairs`.
    phase : (D,) array of int
        Phase of each difference, from :func:`motions_of_rows`.
    reach : int
        Number of rows within which two phases count as the same.
    marked : (D,) array of bool
        Differences that are asked about.
    """
    recurs = np.zeros(len(phase), bool)
    candidates = np.flatnonzero(marked)
    for k in candidates:
        same_phase = candidates[np.abs(phase[candidates] - phase[k]) <= reach]
        # From both rows of each of these to both rows of difference k, (K, 2, 2).
        distance = np.abs(row_pairs[same_phase][:, :, None] - row_pairs[k])
        is_elsewhere = (distance > 2 * reach).all(axis=(1, 2))
        recurs[k] = is_elsewhere.any()
    return recurs


def consecutive(repeats: Sequence[Repeat]) -> list[Indices]:
    """Cut the differences of all repeats into pieces of consecutive rows.

    Parameters
    ----------
    repeats : sequence of Repeat
        Rows whose motion repeats; each row makes one difference.

    Returns
    -------
    list of int arrays
        Numbers of the differences of each piece, counted from 0 through all repeats. A
        piece ends where a row is missing, and where a repeat ends.
    """
    none = np.arange(0)
    rows = np.concatenate([none, *(repeat.rows for repeat in repeats)])
    ends = np.cumsum([len(r.rows) for r in repeats])[:-1]
    gaps = np.flatnonzero(np.diff(rows) != 1) + 1
    return np.split(np.arange(len(rows)), np.union1d(ends, gaps))
