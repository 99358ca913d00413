"""The noise floor of measured torque, from repetition: free of any model's error.

Where a motion repeats, a model's residual r repeats too, whatever the model gets wrong, and
r(t) - r(t + T) holds nothing but twice the noise's variance.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.fft
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: Two stretches of motion count as repeated if their positions differ by less than this share of
#: each joint's motion.
_ALIKE = 0.01
#: A joint that moves less than this share of the largest motion is compared with that instead.
_IDLE = 1e-3
#: Shortest stretch that is compared [s]: shorter ones say little about slow noise.
_SHORTEST = 2.0


def repeat_period(t: Array, q: Array) -> float | None:
    """The period T [s] after which a run repeats its motion, or None where it does not.

    t (M,) s and q (M, n) of one run; the last ``_SHORTEST`` seconds at least must overlap.
    """
    span = t[-1] - t[0]
    step = float(np.median(np.diff(t)))
    grid = np.arange(t[0], t[-1], step)
    scale = _scale(q)
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
    for k in np.flatnonzero(valley & (ground < (2.0 * _ALIKE) ** 2)):
        period = float((lags[k + 1] + shift[k]) * step)
        late = t >= t[0] + period
        back = np.column_stack([np.interp(t[late] - period, t, column) for column in q.T])
        if _alike(q[late], back, scale):
            return period
    return None


def _scale(q: Array) -> Array | None:
    """(n,) size of each joint's motion, so that a small one counts too; None for no motion at all."""
    size = q.std(axis=0)
    return np.maximum(size, _IDLE * size.max()) if size.max() > 0.0 else None


def _alike(q: Array, other: Array, scale: Array) -> bool:
    return bool(np.sqrt(np.mean(((q - other) / scale) ** 2)) < _ALIKE)


def _differences(x: Array, lags: NDArray[np.int64]) -> Array:
    """Root mean square of x[k + lag] - x[k] for each lag, by one correlation."""
    n = len(x)
    length = scipy.fft.next_fast_len(2 * n)
    spectrum = scipy.fft.rfft(x, length, axis=0)
    products = scipy.fft.irfft(np.sum(np.abs(spectrum) ** 2, axis=1), length)[lags]
    squares = np.concatenate([[0.0], np.cumsum(np.sum(x**2, axis=1))])
    total = squares[n - lags] + (squares[n] - squares[lags]) - 2.0 * products
    return np.asarray(np.sqrt(np.maximum(total, 0.0) / ((n - lags) * x.shape[1])))


def noise_floor(runs: Sequence[tuple[Array, Array, Array]]) -> Array | None:
    """Standard deviation (n,) of the torque noise from runs (t, q, residual); None without repeats.

    Repeats are looked for inside each run (a periodic motion) and between runs (the same motion
    again, counted from each run's own start).
    """
    squares: list[Array] = []
    for t, q, residual in runs:
        period = repeat_period(t, q)
        if period is not None:
            late = t >= t[0] + period
            squares.append(_difference(t[late] - period, residual[late], t, residual))
    for first in range(len(runs)):
        for second in range(first + 1, len(runs)):
            t1, q1, r1 = runs[first]
            t2, q2, r2 = runs[second]
            clock = t1 - t1[0] + t2[0]
            shared = clock <= t2[-1]
            if clock[shared][-1] - clock[0] < _SHORTEST:
                continue
            scale = _scale(q1)
            other = np.column_stack([np.interp(clock[shared], t2, c) for c in q2.T])
            if scale is not None and _alike(q1[shared], other, scale):
                squares.append(_difference(clock[shared], r1[shared], t2, r2))
    if not squares:
        return None
    return np.sqrt(np.concatenate(squares).mean(axis=0) / 2.0)


def _difference(t: Array, residual: Array, t_other: Array, other: Array) -> Array:
    """Squared difference (M, n) of a residual and another one read at the instants t."""
    read = np.column_stack([np.interp(t, t_other, column) for column in other.T])
    return (residual - read) ** 2
