"""Where a motion comes back: after a period within a run, or again in another run.

Whatever a model gets wrong comes back with the motion; noise is new each time.
Everything that measures noise or tells it from error rests on the repeats found here.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.coloured_noise import ORDER
from sdp_vs_penalty.signals.runs import interpolated

#: Instants (M,) s and positions (M, n) of one uninterrupted motion.
Track: TypeAlias = tuple[Array, Array]

#: Motions are alike if their positions differ by less than this share of each joint's
#: motion.
ALIKE = 0.01
#: Shortest stretch that is compared [s]: shorter ones say little about slow noise.
_SHORTEST = 2.0


def motion_scale(q: Array) -> Array | None:
    """(n,) size of each joint's motion, so that a small one counts too, but for what is
    alike beside the largest; None for no motion at all."""
    size = q.std(axis=0)
    return np.maximum(size, ALIKE * size.max()) if size.max() > 0.0 else None


def repeat_period(t: Array, q: Array) -> float | None:
    """The period T [s] after which a run repeats its motion, or None where it does not.

    t (M,) s and q (M, n) of one run; ``_SHORTEST`` seconds at least must overlap. A
    stand at either end does not count, and up to ``_SHORTEST`` seconds there may be
    another motion: the way to where it repeats, a ramp.
    """
    scale = motion_scale(q)
    if scale is None:
        return None
    is_away = [
        np.any(np.abs(q - rest_position) > ALIKE * scale, axis=1)
        for rest_position in (q[0], q[-1])
    ]
    moving = slice(
        int(np.argmax(is_away[0])), len(t) - int(np.argmax(is_away[1][::-1]))
    )
    t = t[moving]
    q = q[moving]
    for cut in (0.0, 0.5 * _SHORTEST, _SHORTEST) if len(t) > 1 else ():
        inside = (t >= t[0] + cut) & (t <= t[-1] - cut)
        samples = t[inside], q[inside]
        if len(samples[0]) < 3 or (scale := motion_scale(samples[1])) is None:
            continue
        step = float(np.median(np.diff(samples[0])))
        last = int((samples[0][-1] - samples[0][0] - _SHORTEST) / step)
        # The first that is one, not its multiples.
        for _, lag in _valleys(
            samples, samples, scale, step, np.arange(max(1, int(0.5 / step)), last)
        ):
            if _alike(samples, samples, scale, lag):
                return lag
    return None


def repeat_lag(a: Track, b: Track, slip: float = 5.0) -> float | None:
    """Clock difference after which b repeats a, from a's beginning on; None where it
    does not.

    slip : how far b may begin before or after the motion of a [s].
    """
    scale = motion_scale(a[1])
    if scale is None or min(len(a[0]), len(b[0])) < 3:
        return None
    step = float(np.median(np.diff(a[0])))
    back, forward = (
        int(min(slip, float(t[-1] - t[0]) - _SHORTEST) / step) for t, _ in (a, b)
    )
    if min(back, forward) <= 0:
        return None
    best = min(_valleys(a, b, scale, step, np.arange(-back, forward + 1)), default=None)
    if best is None or not _alike(a, b, scale, best[1]):
        return None
    return best[1] + float(b[0][0] - a[0][0])


def _valleys(
    a: Track, b: Track, scale: Array, step: float, lags: NDArray[np.int64]
) -> list[tuple[float, float]]:
    """Mean square of the difference b(t_b0 + k step + lag) - a(t_a0 + k step), each
    joint in units of its scale (n,), where it has a minimum that reaches the ground,
    and that lag [s], in the order of ``lags`` [steps] in a row: all by one correlation.

    Between two lags the difference grows linearly, its square has the vertex of a
    parabola.
    """
    x = _on_grid(a, scale, step)
    y = x if b is a else _on_grid(b, scale, step)
    n, M = x.shape
    N = y.shape[1]
    middle = x.mean(axis=1, keepdims=True)
    x = x - middle
    y = y - middle
    product = _correlation(x, y)[lags]
    first = np.maximum(0, -lags)
    last = np.minimum(M, N - lags)
    energy = np.append(0.0, np.cumsum(np.sum(x**2, axis=0)))
    other = np.append(0.0, np.cumsum(np.sum(y**2, axis=0)))
    total = (
        energy[last]
        - energy[first]
        + other[last + lags]
        - other[first + lags]
        - 2.0 * product
    )
    squares = np.maximum(total, 0.0) / ((last - first) * n)
    left = squares[:-2]
    center = squares[1:-1]
    right = squares[2:]
    bend = left - 2.0 * center + right
    valley = (center <= left) & (center <= right) & (bend > 0.0)
    shift = 0.5 * (left - right) / np.where(valley, bend, 1.0)
    ground = center - 0.25 * (left - right) * shift
    at = np.flatnonzero(valley & (ground < (2.0 * ALIKE) ** 2))
    return list(zip(ground[at], (lags[1 + at] + shift[at]) * step, strict=True))


def _on_grid(track: Track, scale: Array, step: float) -> Array:
    """(n, M) positions every ``step`` [s], each joint in units of its scale (n,)."""
    t, q = track
    return interpolated(np.arange(t[0], t[-1], step), t, q / scale).T


def _correlation(x: Array, y: Array) -> Array:
    """(L,) sum over joints and k of x(k) y(k + lag) by the lag, x (n, M), y (n, N).

    Negative lags stand at the end. One joint after the other, in the memory of one.
    """
    length = fft.next_fast_len(x.shape[1] + y.shape[1], real=True)
    spectrum = np.zeros(length // 2 + 1, complex)
    for of_joint, other in zip(x, y, strict=True):
        spectrum += np.conj(fft.rfft(of_joint, length)) * fft.rfft(other, length)
    return np.asarray(fft.irfft(spectrum, length))


def _alike(a: Track, b: Track, scale: Array, lag: float) -> bool:
    """Whether b repeats a after a lag [s] of the instants since each began."""
    (t_a, q_a), (t_b, q_b) = a, b
    at = t_a - t_a[0] + lag + t_b[0]
    inside = (at >= t_b[0]) & (at <= t_b[-1])
    return _difference(q_a[inside], interpolated(at[inside], t_b, q_b), scale) < ALIKE


def _difference(q: Array, other: Array, scale: Array) -> float:
    """Root mean square of the difference of two motions (M, n), each joint in units of
    its scale."""
    return float(np.sqrt(np.mean(((q - other) / scale) ** 2)))


@dataclass(frozen=True)
class Filtered:
    """What of a segment is compared: rows t (M,) of which ``keep`` (M,) count;
    positions q_dense (D, n) at t_dense (D,), between which they can be read by
    interpolation."""

    t: Array
    keep: NDArray[np.bool_]
    t_dense: Array
    q_dense: Array


@dataclass(frozen=True)
class Repeat:
    """Rows ``rows`` (indices into all rows) of a segment come back at the instants
    ``later`` of the segment ``other``, of which the first rows from then on are
    ``there``."""

    rows: NDArray[np.intp]
    other: int
    later: Array
    there: NDArray[np.intp]


def is_part(window: Filtered, longer: Filtered) -> bool:
    """Whether a segment is a stretch of another one: the same positions at the same
    instants."""
    t = window.t_dense
    span = longer.t_dense
    inside = (t >= span[0]) & (t <= span[-1])
    scale = motion_scale(longer.q_dense)
    if not inside.any() or scale is None:
        return False
    from scipy.interpolate import CubicSpline

    there = CubicSpline(span, longer.q_dense)(t[inside])
    return _difference(window.q_dense[inside], there, scale) < 0.1 * ALIKE


def find_repeats(segments: Sequence[Filtered]) -> tuple[Repeat, ...]:
    """Every pair of stretches with the same motion, inside segments and between them."""
    from scipy.interpolate import CubicSpline

    out = []
    starts = np.cumsum([0, *(len(s.t) for s in segments)])
    for k, a in enumerate(segments):
        samples = (a.t_dense, a.q_dense)
        scale = motion_scale(a.q_dense)
        for m, b in enumerate(segments[k:], k):
            shift = (
                repeat_period(*samples)
                if m == k
                else repeat_lag(samples, (b.t_dense, b.q_dense))
            )
            if shift is None or scale is None:
                continue
            later = a.t + shift
            inside = a.keep & (later >= b.t_dense[0]) & (later <= b.t_dense[-1])
            fewest = 2 * ORDER  # noise is compared with its own past
            if inside.sum() < fewest:
                continue
            at = a.t[inside]
            later = later[inside]
            q = CubicSpline(a.t_dense, a.q_dense)(at)
            there = CubicSpline(b.t_dense, b.q_dense)(later)
            is_same = np.all(np.abs(q - there) < ALIKE * scale, axis=1)
            index = starts[k] + np.flatnonzero(inside)[is_same]
            later = later[is_same]
            if len(index) >= fewest:
                place = np.clip(np.searchsorted(b.t, later), 0, len(b.t) - 1)
                out.append(Repeat(index, m, later, starts[m] + place))
    return tuple(out)


def pairs(repeats: Sequence[Repeat]) -> NDArray[np.intp]:
    """(D, 2) of the differences of all repeats the rows at their two instants."""
    return np.concatenate([np.column_stack([r.rows, r.there]) for r in repeats])


def new_differences(both: NDArray[np.intp], count: int) -> int:
    """How many of the differences say something new: of K instants with the same
    motion, K - 1.

    both : of :func:`pairs`; count : rows in all. Six equal runs make fifteen pairs, but
    at most five such differences an instant.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    graph = coo_array((np.ones(len(both)), tuple(both.T)), shape=(count, count))
    return count - int(connected_components(graph, directed=False, return_labels=False))


def phases(both: NDArray[np.intp], count: int) -> Array:
    """(D,) the phase of the motion in each difference, in rows: the first row at which
    it is known."""
    phase = np.arange(count, dtype=float)
    for first, second in both[np.argsort(both[:, 0], kind="stable")]:
        phase[second] = min(phase[second], phase[first])
    return phase[both[:, 0]]


def recurring(
    both: NDArray[np.intp], phase: Array, reach: int, marked: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """(D,) which ``marked`` differences come back within ``reach`` rows of their phase
    in one of two other instants: noise that the motion swells, of which no one instant
    is the odd one. both, phase : of :func:`pairs` and :func:`phases`."""
    out = np.zeros(len(phase), bool)
    others = np.flatnonzero(marked)
    for k in others:
        near = others[np.abs(phase[others] - phase[k]) <= reach]
        apart = np.abs(both[near][:, :, None] - both[k]) > 2 * reach
        out[k] = apart.all(axis=(1, 2)).any()
    return out


def consecutive(repeats: Sequence[Repeat]) -> list[NDArray[np.intp]]:
    """The differences of all repeats, numbered through, as index arrays of
    uninterrupted rows."""
    rows = np.concatenate([np.arange(0), *(r.rows for r in repeats)])
    ends = np.cumsum([len(r.rows) for r in repeats])[:-1]
    return np.split(
        np.arange(len(rows)), np.union1d(ends, np.flatnonzero(np.diff(rows) != 1) + 1)
    )
