"""The noise floor of measured torque, from repetition: free of any model's error.

Where a motion repeats, a model's residual r repeats too, whatever the model gets wrong, and
r(t) - r(t + T) holds nothing but twice the noise's variance.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: Two stretches of motion count as repeated if their positions differ by less than this share.
_ALIKE = 0.01
#: Shortest stretch that is compared [s]: shorter ones say little about slow noise.
_SHORTEST = 2.0


def repeat_period(t: Array, q: Array) -> float | None:
    """The period T [s] after which a run repeats its motion, or None where it does not.

    t (M,) s and q (M, n) of one run; the last ``_SHORTEST`` seconds at least must overlap.
    """
    span = t[-1] - t[0]
    step = float(np.median(np.diff(t)))
    grid = np.arange(t[0], t[-1], step)
    x = np.column_stack([np.interp(grid, t, column) for column in q.T])
    x = x - x.mean(axis=0)
    size = np.sqrt(np.mean(x**2))
    if size == 0.0:
        return None

    def difference(lag: int) -> float:
        return float(np.sqrt(np.mean((x[lag:] - x[:-lag]) ** 2)))

    lags = np.arange(max(1, int(0.5 / step)), int((span - _SHORTEST) / step))
    if len(lags) < 3:
        return None
    errors = np.array([difference(int(lag)) for lag in lags])
    # The first valley below the limit, not its multiples.
    good = np.flatnonzero(errors < 2.0 * _ALIKE * size)
    valleys = [k for k in good if 0 < k < len(errors) - 1 and errors[k] <= errors[k - 1 : k + 2].min()]
    if not valleys:
        return None
    k = valleys[0]
    # The vertex of the parabola through the squared errors: the period between two samples.
    a, b, c = errors[k - 1] ** 2, errors[k] ** 2, errors[k + 1] ** 2
    shift = 0.5 * (a - c) / (a - 2.0 * b + c) if a - 2.0 * b + c > 0.0 else 0.0
    period = float((lags[k] + shift) * step)
    late = t >= t[0] + period
    back = np.column_stack([np.interp(t[late] - period, t, column) for column in q.T])
    return period if np.sqrt(np.mean((q[late] - back) ** 2)) < _ALIKE * size else None


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
            size = np.sqrt(np.mean((q1 - q1.mean(axis=0)) ** 2))
            other = np.column_stack([np.interp(clock[shared], t2, c) for c in q2.T])
            if np.sqrt(np.mean((q1[shared] - other) ** 2)) < _ALIKE * size:
                squares.append(_difference(clock[shared], r1[shared], t2, r2))
    if not squares:
        return None
    return np.sqrt(np.concatenate(squares).mean(axis=0) / 2.0)


def _difference(t: Array, residual: Array, t_other: Array, other: Array) -> Array:
    """Squared difference (M, n) of a residual and another one read at the instants t."""
    read = np.column_stack([np.interp(t, t_other, column) for column in other.T])
    return (residual - read) ** 2
