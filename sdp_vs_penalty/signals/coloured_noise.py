"""Noise of a residual: the autoregression that makes it white, events that stand out of
it, and how the motion makes it grow.

Whitened noise has unit variance, so the energy of m rows is chi-square with m degrees
of freedom: a window with too much energy is an event.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np
import scipy

from sdp_vs_penalty.robot.arrays import Array, Indices, Mask
from sdp_vs_penalty.signals.constants import MOTION_OVER_NOISE, SAME_PHASE

#: Order of the autoregression: it predicts a row from so many rows before.
ORDER = 4
#: Family-wise probability of a false event in one record of Gaussian noise. Small,
#: because a log's noise has heavier tails: what a jittering clock does to a torque
#: grows with its rate of change.
FALSE_EVENT = 1e-5
#: An event's window has an energy whose logarithm lies so many robust standard
#: deviations above the median.
_FAR = 5.0
#: Lengths of the windows that are searched [rows].
LENGTHS = (1, 4, 16)
#: Events fill at most this share of the rows: what fills more is noise that is not
#: stationary.
RARE = 0.15
#: Like FALSE_EVENT, for a residual that holds a model's error: only the other windows
#: show how far its tail reaches.
FALSE_LONE_WINDOW = 1e-2


class Pieces(tuple[Indices, ...]):
    """Uninterrupted pieces of a series, each an array of row numbers in order.

    An autoregression of order ORDER predicts the rows that have ORDER rows before them
    in their piece.
    """

    @cached_property
    def predicted(self) -> Indices:
        """(P,) numbers of the rows that have ORDER rows before them in their piece."""
        none = np.arange(0)
        return np.concatenate([none, *(piece[ORDER:] for piece in self)])

    @cached_property
    def past(self) -> list[Indices]:
        """For each lag k = 1 ... ORDER, the number i - k of the row that lies k rows
        before each row i of ``predicted``, (P,)."""
        none = np.arange(0)
        rows_by_lag = []
        for lag in range(1, ORDER + 1):
            earlier_rows = (piece[ORDER - lag : -lag] for piece in self)
            rows_by_lag.append(np.concatenate([none, *earlier_rows]))
        return rows_by_lag

    #: The last filter, with its coefficients and number of rows.
    _last: tuple[tuple[bytes, int], scipy.sparse.csr_array] | None = None

    def filter(self, ar: Array, count: int) -> scipy.sparse.csr_array:
        """Return the sparse matrix W that whitens a series x (count,).

        (W x)_i = x_i - sum_k a_k x_(i-k): each row minus its prediction by an
        autoregression from the ORDER rows before it. The last matrix is cached.

        Parameters
        ----------
        ar : (ORDER,) array
            Coefficients a_1, a_2 ... of the autoregression.
        count : int
            Number of rows of the series.

        Returns
        -------
        (count, count) sparse array
            W; its rows are zero where a piece has fewer than ORDER rows before.
        """
        key = ar.tobytes(), count
        if self._last is None or self._last[0] != key:
            rows = self.predicted
            # Compressed sparse rows: ORDER + 1 entries in each predicted row, of the
            # past rows in order and the row itself; none in the others.
            n_entries = np.zeros(count + 1, np.intp)
            n_entries[rows + 1] = ORDER + 1
            places = np.column_stack([*reversed(self.past), rows]).ravel()
            row_weights = np.append(-ar[::-1], 1.0)
            weights = np.tile(row_weights, len(rows))
            parts = (weights, places, np.cumsum(n_entries))
            self._last = key, scipy.sparse.csr_array(parts, shape=(count, count))
        return self._last[1]


class Autoregression(NamedTuple):
    """An autoregression x_i = sum_k a_k x_(i-k) + e_i, k = 1 ... ORDER, as fitted."""

    #: (ORDER,) coefficients a.
    coefficients: Array
    #: Standard deviation of the innovations e, above 0 so that it may divide.
    sigma: float
    #: Degrees of freedom behind ``sigma``.
    degrees: float


def autoregression(x: Array, pieces: Pieces) -> Autoregression:
    """Fit an autoregression to a series x (M,) by least squares, on the rows that
    ``pieces`` let it predict.

    With fewer than 4 ORDER rows to predict, the series is taken for white noise: a = 0.
    """
    count = len(pieces.predicted)
    if count < 4 * ORDER:
        # Too few rows for coefficients: white noise of the samples' scatter.
        samples = np.concatenate([x[p] for p in pieces]) if pieces else x
        return Autoregression(
            np.zeros(ORDER),
            sigma=max(float(samples.std()), 1e-12),
            degrees=max(len(samples) - 1.0, 1.0),
        )
    matrix = np.column_stack([x[rows] for rows in pieces.past])  # (P, ORDER)
    target = x[pieces.predicted]
    a = np.linalg.lstsq(matrix, target, rcond=1e-10)[0]
    residual = target - matrix @ a
    sigma = float(np.sqrt(residual @ residual / (count - ORDER)))
    largest = float(np.abs(x).max(initial=1.0))
    rounding = max(1e-9 * largest, 1e-15)
    return Autoregression(
        np.asarray(a, float), sigma=max(sigma, rounding), degrees=float(count - ORDER)
    )


def local_excess(
    white: Array, pieces: Sequence[Indices], n_series: int, degrees: float
) -> Mask:
    """Find windows of a whitened series with more energy than noise has by chance, as
    flags (M,) of their rows.

    The energy (sum of squares) of a window of m rows over the estimated unit variance
    is m F, F distributed with m and ``degrees`` degrees of freedom. The limit is
    exceeded with the probability FALSE_EVENT in all windows of all series together. It
    is raised where the energies of all windows scatter more than that
    (:func:`_usual_limit`).

    Parameters
    ----------
    white : (M,) array
        A whitened series, of unit variance.
    pieces : sequence of arrays of int
        Numbers of the rows of each piece without an interruption.
    n_series : int
        Number of series that are searched in all.
    degrees : float
        Degrees of freedom behind the estimate of the unit variance.
    """
    has_excess = np.zeros(len(white), bool)
    n_rows = sum(len(p) for p in pieces)
    n_windows = max(n_rows, 1) * len(LENGTHS) * n_series
    # The upper quantile of F: w = d / (d + length F) is distributed as beta.
    lengths = np.array(LENGTHS)
    w = scipy.special.betaincinv(0.5 * degrees, 0.5 * lengths, FALSE_EVENT / n_windows)
    limits = (degrees * (1.0 - w) / w).tolist()
    for piece in pieces:
        cumulated = np.concatenate([[0.0], np.cumsum(white[piece] ** 2)])
        for length, limit in zip(LENGTHS, limits, strict=True):
            if length > len(piece):
                continue
            energies = cumulated[length:] - cumulated[:-length]
            # The logarithm of a single row's energy is not nearly normal.
            if length > 1 and energies.any():
                limit = max(limit, _usual_limit(energies))
            for first in np.flatnonzero(energies > limit):
                has_excess[piece[first : first + length]] = True
    return has_excess


def _usual_limit(energies: Array) -> float:
    """Return the energy up to which a window is noise, which may swell and fade.

    The logarithm of the energies is nearly normal: the limit lies _FAR robust standard
    deviations above their median.
    """
    logs = np.log(energies[energies > 0.0])
    middle = np.median(logs)
    return float(np.exp(middle + _FAR * robust_scale(logs - middle)))


def lone_windows(
    white: Array, pieces: Sequence[Indices], slow: Mask, rate: float, n_series: int
) -> Mask:
    """Flag the rows (M,) of those windows of a whitened series (M,) whose energy is far
    above that of all other windows.

    This is for a residual that holds a model's error, whose scale and tails are
    unknown: the windows are compared with each other. Windows in which the joint is
    slow are compared among themselves, and so are the others. The log is cut into
    stretches of one phase of the motion, and the largest energy of each counts; the
    limit comes from the tail of these (:func:`_tail_limit`).

    Parameters
    ----------
    pieces : sequence of arrays of int
        Numbers of the rows of each piece without an interruption.
    slow : (M,) array of bool
        Rows in which the joint is slow.
    rate : float
        Rows per second of the series [Hz].
    n_series : int
        Number of series that are searched in all.
    """
    is_in_lone_window = np.zeros(len(white), bool)
    stretches = cut_into_stretches(pieces, max(2, round(2.0 * SAME_PHASE * rate)))
    n_searches = 2 * len(LENGTHS) * n_series  # two kinds: slow windows and the others
    for length in LENGTHS:
        log_energy, is_slow = _window_energy(white, pieces, slow, length)
        for is_of_kind in (is_slow, ~is_slow):
            of_kind = np.where(is_of_kind, log_energy, -np.inf)
            largest = np.array([of_kind[rows].max() for rows in stretches])
            descending = np.sort(largest[np.isfinite(largest)])[::-1]
            is_lone = of_kind > _tail_limit(descending, n_searches)
            for row in np.flatnonzero(is_lone):
                first = row - length // 2  # the window is centred on its row
                is_in_lone_window[max(first, 0) : first + length] = True
    return is_in_lone_window


def cut_into_stretches(pieces: Sequence[Indices], size: int) -> list[Indices]:
    """Cut pieces (arrays of row numbers) into stretches of about ``size`` rows each."""
    stretches = []
    for piece in pieces:
        n_stretches = max(1, round(len(piece) / size))
        stretches += np.array_split(piece, n_stretches)
    return stretches


def _window_energy(
    white: Array, pieces: Sequence[Indices], slow: Mask, length: int
) -> tuple[Array, Mask]:
    """Sum the squares of a whitened series in the window of ``length`` rows around each
    row.

    Returns
    -------
    log_energy : (M,) array
        Natural logarithm of the sums; minus infinity in pieces shorter than a window.
    is_slow : (M,) array of bool
        Whether the joint is slow (``slow``, (M,)) at some row of the window.
    """
    moving_sum = partial(np.convolve, np.ones(length), mode="same")
    log_energy = np.full(len(white), -np.inf)
    is_slow = np.zeros(len(white), bool)
    for piece in pieces:
        if len(piece) < length:
            continue
        with np.errstate(divide="ignore"):  # no energy: minus infinity
            log_energy[piece] = np.log(moving_sum(white[piece] ** 2))
        is_slow[piece] = moving_sum(slow[piece]) > 0.5
    return log_energy, is_slow


def _tail_limit(descending: Array, n_searches: int) -> float:
    """Return the limit above which the first of some descending values stand out of the
    tail of the others; infinity where none does.

    The values (N,) are logarithms of energies, whose tail decays exponentially, as heavy
    tails do. The k = N / 2 values above a threshold exceed it by h in the mean (Hill
    1975); a new value exceeds it by x with probability (1 + x / (k h))^-k. The limit is
    the x at which that is FALSE_LONE_WINDOW / (k n_searches). The largest number of
    outliers that is possible (the share RARE of all) is tried first, then fewer: outliers
    do not count among the k values.
    """
    k = len(descending) // 2
    if not k:
        return np.inf
    x_over_h = k * ((k * n_searches / FALSE_LONE_WINDOW) ** (1.0 / k) - 1.0)
    n_most = min(int(RARE * len(descending)), len(descending) - k - 1)
    for n_outliers in range(n_most, 0, -1):
        threshold = float(descending[n_outliers + k])
        h = float(np.mean(descending[n_outliers : n_outliers + k])) - threshold
        limit = threshold + x_over_h * h
        if descending[n_outliers - 1] > limit:
            return limit
    return np.inf


def noise_profile(white: Array, rates: Array, rates_shown: Array) -> Array:
    """Estimate how the motion modulates the standard deviation of white noise.

    The variance is modelled as a + sum_i b_i rate_i, with a, b_i >= 0, because a clock
    that jitters turns rates of change into noise. Squares of the noise are clipped at
    three standard deviations, so that an event does not shape it. The relative variance
    stays between 1 / MOTION_OVER_NOISE and MOTION_OVER_NOISE.

    Parameters
    ----------
    white : (M,) array
        Whitened noise; zero where it is unknown.
    rates : (M, r) array
        Squared rates on these rows.
    rates_shown : (K, r) array
        Squared rates on the rows for which the profile is returned.

    Returns
    -------
    (K,) array
        Standard deviation relative to that of ``white`` [-]; 1 where there are fewer
        than 20 rows a coefficient.
    """
    known = white != 0.0
    if known.sum() < 20 * (rates.shape[1] + 1):
        return np.ones(len(rates_shown))
    mean_rates = np.maximum(np.mean(rates[known], axis=0), 1e-24)
    squares = white[known] ** 2
    squares = np.minimum(squares, (3.0 * robust_scale(white[known])) ** 2)
    columns = np.column_stack([np.ones(len(squares)), rates[known] / mean_rates])
    a, *b = scipy.optimize.nnls(columns, squares)[0].tolist()
    level = float(np.sum([a, *b]))  # the variance at the mean rates
    if level <= 0.0:
        return np.ones(len(rates_shown))
    variance = (a + (rates_shown / mean_rates) @ np.array(b)) / level
    return np.sqrt(np.clip(variance, 1.0 / MOTION_OVER_NOISE, MOTION_OVER_NOISE))


def robust_scale(white: Array) -> float:
    """Estimate the standard deviation of noise (M,) from the median of its absolute
    values, which a few events do not change; 1 for an empty array."""
    if not len(white):
        return 1.0
    return float(np.median(np.abs(white)) / scipy.special.ndtri(0.75))
