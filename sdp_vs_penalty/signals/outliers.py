"""Noise that is not stationary: windows with too much energy, and how motion swells noise.

With unit variance the energy of m rows of whitened noise is chi-square with m degrees of freedom.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import special

from sdp_vs_penalty.robot.arrays import Array

Mask = NDArray[np.bool_]

#: Family-wise probability of a false event in one record of Gaussian noise. Small, because a log's
#: noise has heavier tails: what a jittering clock does to a torque grows with its rate of change.
FALSE_EVENT = 1e-5
#: By how much motion may change the noise's variance.
_MODULATION = (0.1, 10.0)
#: Lengths of the windows that are searched [rows].
_LENGTHS = (1, 2, 4, 8, 16, 32)
#: From this length on the logarithm of a window's energy is nearly normal; and how far out an event is.
_LOGARITHMIC, _FAR = 4, 5.0
#: The median of the square of a standard normal variable.
_MEDIAN_SQUARE = 2.0 * float(special.gammaincinv(0.5, 0.5))


def local_excess(white: Array, pieces: Sequence[NDArray[np.intp]], tests: int, degrees: float) -> Mask:
    """(M,) rows inside windows whose energy noise of unit variance does not reach by chance.

    pieces : index arrays of uninterrupted rows; tests : how many such series are searched in all;
    degrees : of freedom behind the estimate of that unit variance.
    """
    mask = np.zeros(len(white), bool)
    count = max(sum(len(p) for p in pieces), 1) * len(_LENGTHS) * tests
    limits = [length * _largest_variance(FALSE_EVENT / count, length, degrees) for length in _LENGTHS]
    for piece in pieces:
        energy = np.concatenate([[0.0], np.cumsum(white[piece] ** 2)])
        for length, limit in zip(_LENGTHS, limits, strict=True):
            if length > len(piece):
                continue
            windows = energy[length:] - energy[:-length]
            if length >= _LOGARITHMIC:
                limit = max(limit, _outlying(windows))
            hits = np.flatnonzero(windows > limit)
            for first in hits:
                mask[piece[first : first + length]] = True
    return mask


def _largest_variance(p: float, length: int, degrees: float) -> float:
    """The variance of ``length`` rows that noise exceeds with probability p: F's upper quantile."""
    w = float(special.betaincinv(0.5 * degrees, 0.5 * length, p))  # d / (d + length F)
    return degrees * (1.0 - w) / (length * w)


def _outlying(windows: Array) -> float:
    """The energy that stands _FAR robust deviations out of the windows' own, in logarithms: noise
    that swells and fades by itself makes no event."""
    logs = np.log(windows[windows > 0.0])
    if not len(logs):
        return np.inf
    middle = float(np.median(logs))
    return float(np.exp(middle + _FAR * 1.4826 * np.median(np.abs(logs - middle))))


def noise_profile(white: Array, rates: Array, wanted: Array) -> Array:
    """(K,) standard deviation of white noise as the motion modulates it, on rows ``wanted`` (K, r),
    around 1 on those of ``white``.

    A log's clock that jitters turns rates of change into noise: its variance is modelled as a + sum
    b_i rate_i with a, b_i >= 0, rates (M, r) squared, from squares clipped so that an event does not
    shape it.
    """
    from scipy.optimize import nnls

    used = white != 0.0
    if used.sum() < 20 * (rates.shape[1] + 1):
        return np.ones(len(wanted))
    size = np.maximum(np.mean(rates[used], axis=0), 1e-24)
    squares = white[used] ** 2
    squares = np.minimum(squares, 9.0 * np.median(squares) / _MEDIAN_SQUARE)
    law = nnls(np.column_stack([np.ones(len(squares)), rates[used] / size]), squares)[0]
    level = float(law.sum())
    if level <= 0.0:
        return np.ones(len(wanted))
    variance = (law[0] + (wanted / size) @ law[1:]) / level
    return np.sqrt(np.clip(variance, *_MODULATION))


def robust_scale(white: Array) -> float:
    """Standard deviation of noise with a few events in it, from the median of its square."""
    return float(np.sqrt(np.median(white**2) / _MEDIAN_SQUARE)) if len(white) else 1.0
