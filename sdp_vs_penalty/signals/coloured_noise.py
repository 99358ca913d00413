"""Noise of a residual: the autoregression that makes it white, and what of it is not
stationary.

With unit variance the energy of m rows of whitened noise is chi-square with m degrees
of freedom: windows with too much of it are events. Motion swells noise.
"""

from collections.abc import Sequence
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.special import betaincinv, ndtri

from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.constants import ABOVE, SAME_PHASE

Mask = NDArray[np.bool_]

#: Of the autoregression.
ORDER = 4
#: Family-wise probability of a false event in one record of Gaussian noise. Small,
#: because a log's noise has heavier tails: what a jittering clock does to a torque
#: grows with its rate of change.
FALSE_EVENT = 1e-5
#: How far out of the others an event's window is, in robust deviations of the
#: logarithms.
_FAR = 5.0
#: Lengths of the windows that are searched [rows].
LENGTHS = (1, 4, 16)
#: Events are rare: what fills more than this share of the rows is noise of another
#: kind.
RARE = 0.15
#: The same probability beside a model's error, whose tail is known from the other
#: windows only.
FALSE_LONE = 1e-2


class Pieces(tuple[NDArray[np.intp], ...]):
    """Index arrays of uninterrupted rows of a series, in order, and where an
    autoregression predicts."""

    @cached_property
    def predicted(self) -> NDArray[np.intp]:
        """The rows that have a past of ORDER rows in their piece."""
        return np.concatenate([np.arange(0), *(p[ORDER:] for p in self)])

    @cached_property
    def past(self) -> list[NDArray[np.intp]]:
        """The rows 1, 2, ... ORDER before each of those."""
        lags = range(1, ORDER + 1)
        return [
            np.concatenate([np.arange(0), *(p[ORDER - k : -k] for p in self)])
            for k in lags
        ]

    #: The filter that was asked for last, and by what.
    _last: tuple[tuple[bytes, int], sparse.csr_array] | None = None

    def filter(self, ar: Array, count: int) -> sparse.csr_array:
        """(count, count) what an autoregression does to a series: each predicted row
        less what its past says of it, zero rows elsewhere; the last is kept."""
        key = ar.tobytes(), count
        if self._last is None or self._last[0] != key:
            rows = self.predicted
            ends = np.zeros(count + 1, np.intp)
            ends[rows + 1] = ORDER + 1
            places = np.column_stack([*reversed(self.past), rows]).ravel()
            weights = np.tile(np.append(-ar[::-1], 1.0), len(rows))
            parts = weights, places, np.cumsum(ends)
            self._last = key, sparse.csr_array(parts, shape=(count, count))
        return self._last[1]


def autoregression(x: Array, pieces: Pieces) -> tuple[Array, float, float]:
    """AR coefficients (ORDER,), standard deviation of the innovations, degrees of
    freedom."""
    count = len(pieces.predicted)
    if count < 4 * ORDER:
        samples = np.concatenate([x[p] for p in pieces]) if pieces else x
        return (
            np.zeros(ORDER),
            max(float(samples.std()), 1e-12),
            max(len(samples) - 1.0, 1.0),
        )
    matrix = np.column_stack([x[k] for k in pieces.past])
    target = x[pieces.predicted]
    a = np.linalg.lstsq(matrix, target, rcond=1e-10)[0]
    residual = target - matrix @ a
    sigma = float(np.sqrt(residual @ residual / (count - ORDER)))
    smallest = max(1e-9 * float(np.abs(x).max(initial=1.0)), 1e-15)
    return np.asarray(a, float), max(sigma, smallest), float(count - ORDER)


def local_excess(
    white: Array, pieces: Sequence[NDArray[np.intp]], tests: int, degrees: float
) -> Mask:
    """(M,) rows inside windows whose energy noise of unit variance does not reach by
    chance.

    pieces : index arrays of uninterrupted rows; tests : how many such series are
    searched in all; degrees : of freedom behind the estimate of that unit variance.
    """
    mask = np.zeros(len(white), bool)
    count = max(sum(len(p) for p in pieces), 1) * len(LENGTHS) * tests
    # The upper quantile of F: d / (d + length F) is distributed as beta.
    lengths = np.array(LENGTHS)
    w = betaincinv(0.5 * degrees, 0.5 * lengths, FALSE_EVENT / count)
    limits = (degrees * (1.0 - w) / w).tolist()
    for piece in pieces:
        energy = np.concatenate([[0.0], np.cumsum(white[piece] ** 2)])
        for length, limit in zip(LENGTHS, limits, strict=True):
            if length > len(piece):
                continue
            windows = energy[length:] - energy[:-length]
            if length > 1 and windows.any():
                # The logarithm of their energy is nearly normal: noise that swells and
                # fades by itself makes no event.
                logs = np.log(windows[windows > 0.0])
                middle = np.median(logs)
                limit = max(
                    limit, float(np.exp(middle + _FAR * robust_scale(logs - middle)))
                )
            for first in np.flatnonzero(windows > limit):
                mask[piece[first : first + length]] = True
    return mask


def lone_windows(
    white: Array,
    pieces: Sequence[NDArray[np.intp]],
    slow: Mask,
    rate: float,
    tests: int,
) -> Mask:
    """(M,) rows of windows whose energy no other window in the same state of motion
    comes near.

    For a residual that holds a model's error, of which neither scale nor tails are
    known: of every stretch of one phase the largest logarithm of a window's energy, of
    windows in which the joint is ``slow`` (M,) and of the others by themselves. pieces,
    tests : as in :func:`local_excess`; rate : rows a second.
    """
    mask = np.zeros(len(white), bool)
    size = max(2, round(2.0 * SAME_PHASE * rate))
    stretches = [
        x for p in pieces for x in np.array_split(p, max(1, round(len(p) / size)))
    ]
    for length in LENGTHS:
        moving_sum = partial(np.convolve, np.ones(length), mode="same")
        energy = np.full(len(white), -np.inf)
        slowly = np.zeros(len(white), bool)
        for piece in pieces:  # of the window around each row
            if len(piece) >= length:
                with np.errstate(divide="ignore"):  # no energy: minus infinity
                    energy[piece] = np.log(moving_sum(white[piece] ** 2))
                slowly[piece] = moving_sum(slow[piece]) > 0.5
        for kind in (slowly, ~slowly):
            energy_of_kind = np.where(kind, energy, -np.inf)
            largest = np.array([energy_of_kind[rows].max() for rows in stretches])
            known = np.sort(largest[np.isfinite(largest)])[::-1]
            for row in np.flatnonzero(
                energy_of_kind > _tail_limit(known, 2 * len(LENGTHS) * tests)
            ):
                mask[max(row - length // 2, 0) : row - length // 2 + length] = True
    return mask


def _tail_limit(values: Array, tests: int) -> float:
    """Above what a few of descending ``values`` stand out of the tail of the others;
    infinite where none does.

    Logarithms of energies decay exponentially, as heavy tails do, with a mean excess h
    over a threshold that k values show (Hill 1975); a new one exceeds it by x with
    probability (1 + x / (k h))^-k.
    """
    k = len(values) // 2
    if not k:
        return np.inf
    far = k * ((k * tests / FALSE_LONE) ** (1.0 / k) - 1.0)
    for out in range(min(int(RARE * len(values)), len(values) - k - 1), 0, -1):
        threshold = float(values[out + k])
        limit = threshold + far * (float(np.mean(values[out : out + k])) - threshold)
        if values[out - 1] > limit:
            return limit
    return np.inf


def noise_profile(white: Array, rates: Array, at: Array) -> Array:
    """(K,) standard deviation of white noise as the motion modulates it, on rows
    ``at`` (K, r), around 1 on those of ``white``.

    A log's clock that jitters turns rates of change into noise: its variance is
    modelled as a + sum b_i rate_i with a, b_i >= 0, rates (M, r) squared, from squares
    clipped so that an event does not shape it; at most what counts as motion itself,
    ABOVE, either way.
    """
    from scipy.optimize import nnls

    used = white != 0.0
    if used.sum() < 20 * (rates.shape[1] + 1):
        return np.ones(len(at))
    size = np.maximum(np.mean(rates[used], axis=0), 1e-24)
    squares = white[used] ** 2
    squares = np.minimum(squares, (3.0 * robust_scale(white[used])) ** 2)
    law = nnls(np.column_stack([np.ones(len(squares)), rates[used] / size]), squares)[0]
    level = float(law.sum())
    if level <= 0.0:
        return np.ones(len(at))
    variance = (law[0] + (at / size) @ law[1:]) / level
    return np.sqrt(np.clip(variance, 1.0 / ABOVE, ABOVE))


def robust_scale(white: Array) -> float:
    """Standard deviation of noise with a few events in it, from the median of its size."""
    return float(np.median(np.abs(white)) / ndtri(0.75)) if len(white) else 1.0
