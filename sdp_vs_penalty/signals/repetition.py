"""Where a motion comes back: after a period within a run, or again in another run.

Whatever a model gets wrong comes back with the motion; noise is new each time. Everything that
measures noise or tells it from error rests on the repeats found here.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.fft import next_fast_len

from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.autoregression import ORDER

#: Instants (M,) s and positions (M, n) of one uninterrupted motion.
Track: TypeAlias = tuple[Array, Array]

#: Motions are alike if their positions differ by less than this share of each joint's motion.
ALIKE = 0.01
#: Shortest stretch that is compared [s]: shorter ones say little about slow noise.
_SHORTEST = 2.0
#: Steps in which the slip of a motion from one run to another is looked for [s].
_SLIP_STEP = 0.1
#: A motion has settled where it differs from its repetition by this many times what is usual, or by this
#: share of :data:`ALIKE`.
_SETTLED, _SETTLES = 10.0, 0.1


def motion_scale(q: Array) -> Array | None:
    """(n,) size of each joint's motion, so that a small one counts too, but for what is alike beside the
    largest; None for no motion at all."""
    size = q.std(axis=0)
    return np.maximum(size, ALIKE * size.max()) if size.max() > 0.0 else None


def repeat_period(t: Array, q: Array) -> float | None:
    """The period T [s] after which a run repeats its motion, or None where it does not.

    t (M,) s and q (M, n) of one run; ``_SHORTEST`` seconds at least must overlap. A stand at either end
    does not count, and up to ``_SHORTEST`` seconds there may be another motion: the way to where it
    repeats, a ramp.
    """
    scale = motion_scale(q)
    if scale is None:
        return None
    away = [np.any(np.abs(q - rest) > ALIKE * scale, axis=1) for rest in (q[0], q[-1])]
    moving = slice(int(np.argmax(away[0])), len(t) - int(np.argmax(away[1][::-1])))
    t, q = t[moving], q[moving]
    if len(t) < 2:
        return None
    for cut in (0.0, 0.5 * _SHORTEST, _SHORTEST):
        inside = (t >= t[0] + cut) & (t <= t[-1] - cut)
        period = _period(t[inside], q[inside])
        if period is not None:
            return period
    return None


def _period(t: Array, q: Array) -> float | None:
    if len(t) < 3:
        return None
    span = t[-1] - t[0]
    step = float(np.median(np.diff(t)))
    grid = np.arange(t[0], t[-1], step)
    scale = motion_scale(q)
    if scale is None:
        return None
    x = np.column_stack([np.interp(grid, t, column) for column in (q / scale).T])
    lags = np.arange(max(1, int(0.5 / step)), int((span - _SHORTEST) / step))
    if len(lags) < 3:
        return None
    errors = _differences(x - x.mean(axis=0), lags)
    # The first valley that reaches the ground, not its multiples. Between two lags the difference
    # grows linearly, its square has the vertex of a parabola.
    squares = errors**2
    left, middle, right = squares[:-2], squares[1:-1], squares[2:]
    bend = left - 2.0 * middle + right
    valley = (middle <= left) & (middle <= right) & (bend > 0.0)
    shift = 0.5 * (left - right) / np.where(valley, bend, 1.0)
    ground = middle - 0.25 * (left - right) * shift
    for k in np.flatnonzero(valley & (ground < (2.0 * ALIKE) ** 2)):
        period = float((lags[k + 1] + shift[k]) * step)
        late = t >= t[0] + period
        back = np.column_stack([np.interp(t[late] - period, t, column) for column in q.T])
        if _difference(q[late], back, scale) < ALIKE:
            return period
    return None


def _difference(q: Array, other: Array, scale: Array) -> float:
    """Root mean square of the difference of two motions (M, n), each joint in units of its scale."""
    return float(np.sqrt(np.mean(((q - other) / scale) ** 2)))


def _differences(x: Array, lags: NDArray[np.int64]) -> Array:
    """Root mean square of x[k + lag] - x[k] for each lag, by one correlation."""
    n = len(x)
    length = next_fast_len(2 * n, real=True)
    spectrum = np.fft.rfft(x, length, axis=0)
    products = np.fft.irfft(np.sum(np.abs(spectrum) ** 2, axis=1), length)[lags]
    squares = np.concatenate([[0.0], np.cumsum(np.sum(x**2, axis=1))])
    total = squares[n - lags] + (squares[n] - squares[lags]) - 2.0 * products
    return np.asarray(np.sqrt(np.maximum(total, 0.0) / ((n - lags) * x.shape[1])))


@dataclass(frozen=True)
class Filtered:
    """What of a segment is compared: rows t (M,) of which ``keep`` (M,) count; positions q_dense (D, n)
    at t_dense (D,), between which they can be read by interpolation."""

    t: Array
    keep: NDArray[np.bool_]
    t_dense: Array
    q_dense: Array


@dataclass(frozen=True)
class Repeat:
    """Rows ``rows`` (indices into all rows) of a segment come back at the instants ``later`` of the
    segment ``other``."""

    rows: NDArray[np.intp]
    other: int
    later: Array


def is_part(window: Filtered, whole: Filtered) -> bool:
    """Whether a segment is a stretch of another one: the same positions at the same instants."""
    t, span = window.t_dense, whole.t_dense
    inside = (t >= span[0]) & (t <= span[-1])
    scale = motion_scale(whole.q_dense)
    if not inside.any() or scale is None:
        return False
    from scipy.interpolate import CubicSpline

    there = CubicSpline(span, whole.q_dense)(t[inside])
    return _difference(window.q_dense[inside], there, scale) < 0.1 * ALIKE


def find_repeats(segments: Sequence[Filtered]) -> tuple[Repeat, ...]:
    """Every pair of stretches with the same motion, inside segments and between them."""
    out = []
    starts = np.cumsum([0, *(len(s.t) for s in segments)])
    for k, segment in enumerate(segments):
        period = repeat_period(segment.t_dense, segment.q_dense)
        if period is not None:
            out += _pair(segment, segment, period, k, starts[k])
        for m in range(k + 1, len(segments)):
            other = segments[m]
            lag = repeat_lag((segment.t_dense, segment.q_dense), (other.t_dense, other.q_dense))
            if lag is not None:
                out += _pair(segment, other, lag, m, starts[k])
    return tuple(out)


def _pair(a: Filtered, b: Filtered, shift: float, other: int, start: int) -> list[Repeat]:
    """The rows of a whose motion b repeats ``shift`` seconds later."""
    later = a.t + shift
    inside = a.keep & (later >= b.t_dense[0]) & (later <= b.t_dense[-1])
    scale, fewest = motion_scale(a.q_dense), 2 * ORDER  # noise is compared with its own past
    if inside.sum() < fewest or scale is None:
        return []
    from scipy.interpolate import CubicSpline

    q_a = CubicSpline(a.t_dense, a.q_dense)(a.t[inside])
    q_b = CubicSpline(b.t_dense, b.q_dense)(later[inside])
    apart = np.abs(q_a - q_b) / scale
    alike = np.all(apart < ALIKE, axis=1)
    # The way into the motion leaves a controller ringing for longer than its positions show.
    usual = np.maximum(_SETTLED * np.median(apart, axis=0), _SETTLES * ALIKE)
    alike[: int(np.argmax(np.all(apart < usual, axis=1)))] = False
    index = start + np.flatnonzero(inside)[alike]
    return [Repeat(index, other, later[inside][alike])] if len(index) >= fewest else []


def repeat_lag(a: Track, b: Track, slip: float = 5.0) -> float | None:
    """Clock difference after which b repeats a, from a's beginning on; None where it does not.

    slip : how far b may begin before or after the motion of a [s].
    """
    (t_a, q), (t_b, there) = a, b
    scale = motion_scale(q)
    if scale is None or len(t_a) < 2 or len(t_b) < 2:
        return None
    from scipy.interpolate import CubicSpline
    from scipy.optimize import minimize_scalar

    step = float(np.median(np.diff(t_a)))
    q_b = CubicSpline(t_b - t_b[0], there)
    clock = t_a - t_a[0]
    span = t_b[-1] - t_b[0]

    def error(slip: float) -> float:
        at = clock + slip
        inside = (at >= 0.0) & (at <= span)
        if inside.sum() * step < _SHORTEST:
            return np.inf
        some = np.flatnonzero(inside)[:: max(1, int(0.1 / step))]
        return _difference(q[some], q_b(at[some]), scale)

    slips = np.arange(-slip, slip, _SLIP_STEP)
    errors = np.array([error(s) for s in slips])
    best = float(slips[int(np.argmin(errors))])
    if errors.min() > 0.3:  # another motion; the same one is nearer even half a step beside
        return None
    near = (best - _SLIP_STEP, best + _SLIP_STEP)
    fine = float(minimize_scalar(error, bounds=near, method="bounded").x)
    return fine + float(t_b[0] - t_a[0]) if error(fine) < ALIKE else None


def later_rows(segments: Sequence[Filtered], repeat: Repeat) -> NDArray[np.intp]:
    """Among all rows the first at or after each instant at which the repeat comes back."""
    start = sum(len(s.t) for s in segments[: repeat.other])
    times = segments[repeat.other].t
    return start + np.clip(np.searchsorted(times, repeat.later), 0, len(times) - 1)


def pairs(segments: Sequence[Filtered], repeats: Sequence[Repeat]) -> NDArray[np.intp]:
    """(D, 2) of the differences of all repeats the rows at their two instants."""
    later = [later_rows(segments, r) for r in repeats]
    return np.column_stack([np.concatenate([r.rows for r in repeats]), np.concatenate(later)])


def new_differences(both: NDArray[np.intp], count: int) -> int:
    """How many of the differences say something new: of K instants with the same motion, K - 1.

    both : of :func:`pairs`; count : rows in all. Six equal runs make fifteen pairs, but at most five
    such differences an instant.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    alike = coo_array((np.ones(len(both)), tuple(both.T)), shape=(count, count))
    return count - int(connected_components(alike, directed=False, return_labels=False))


def phases(both: NDArray[np.intp], count: int) -> Array:
    """(D,) the phase of the motion in each difference, in rows: the first row at which it is known."""
    phase = np.arange(count, dtype=float)
    for first, second in both[np.argsort(both[:, 0], kind="stable")]:
        phase[second] = min(phase[second], phase[first])
    return phase[both[:, 0]]


def recurring(
    both: NDArray[np.intp], phase: Array, marked: NDArray[np.bool_], faint: NDArray[np.bool_], reach: int
) -> NDArray[np.bool_]:
    """(D,) which ``marked`` differences come back, if only faintly, within ``reach`` rows of their phase
    in a difference of two other instants: noise that the motion swells, of which no one instant is the
    odd one. both, phase : of :func:`pairs` and :func:`phases`."""
    out, others = np.zeros(len(phase), bool), np.flatnonzero(faint)
    for k in np.flatnonzero(marked):
        near = others[np.abs(phase[others] - phase[k]) <= reach]
        apart = np.abs(both[near][:, :, None] - both[k]) > 2 * reach
        out[k] = apart.all(axis=(1, 2)).any()
    return out


def consecutive(repeats: Sequence[Repeat]) -> list[NDArray[np.intp]]:
    """The differences of all repeats, numbered through, as index arrays of uninterrupted rows."""
    pieces, first = [], 0
    for r in repeats:
        index = first + np.arange(len(r.rows))
        pieces += np.split(index, np.flatnonzero(np.diff(r.rows) != 1) + 1)
        first += len(r.rows)
    return pieces
