"""What happens once: a contact, a knock, a hum. No function of the motion explains it.

A local event is a window of whitened noise with too much energy: with unit variance, the energy of
m rows is chi-square with m degrees of freedom. A hum is a line in the spectrum: at the frequencies
of a periodogram the power of whitened noise is exponential.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import optimize, stats

Array = NDArray[np.float64]
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


@dataclass(frozen=True)
class Event:
    """joint from 0; t_start, t_end [s] on the clock of the measurements; what : "local" or "hum"."""

    joint: int
    t_start: float
    t_end: float
    what: str = "local"
    frequency: float | None = None

    def to_dict(self) -> dict[str, Any]:
        return {**vars(self), "joint": self.joint + 1}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Event:
        frequency = data["frequency"]
        return cls(
            int(data["joint"]) - 1,
            float(data["t_start"]),
            float(data["t_end"]),
            str(data["what"]),
            None if frequency is None else float(frequency),
        )


def local_excess(white: Array, pieces: Sequence[NDArray[np.intp]], tests: int, degrees: float) -> Mask:
    """(M,) rows inside windows whose energy noise of unit variance does not reach by chance.

    pieces : index arrays of uninterrupted rows; tests : how many such series are searched in all;
    degrees : of freedom behind the estimate of that unit variance.
    """
    mask = np.zeros(len(white), bool)
    count = max(sum(len(p) for p in pieces), 1) * len(_LENGTHS) * tests
    limits = [length * float(stats.f.isf(FALSE_EVENT / count, length, degrees)) for length in _LENGTHS]
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
    used = white != 0.0
    if used.sum() < 20 * (rates.shape[1] + 1):
        return np.ones(len(wanted))
    size = np.maximum(np.mean(rates[used], axis=0), 1e-24)
    squares = white[used] ** 2
    squares = np.minimum(squares, 9.0 * np.median(squares) / stats.chi2.median(1))
    law = optimize.nnls(np.column_stack([np.ones(len(squares)), rates[used] / size]), squares)[0]
    level = float(law.sum())
    if level <= 0.0:
        return np.ones(len(wanted))
    variance = (law[0] + (wanted / size) @ law[1:]) / level
    return np.sqrt(np.clip(variance, *_MODULATION))


def robust_scale(white: Array) -> float:
    """Standard deviation of noise with a few events in it, from the median of its square."""
    return float(np.sqrt(np.median(white**2) / stats.chi2.median(1))) if len(white) else 1.0


def intervals(
    mask: Mask, t: Array, pieces: Sequence[NDArray[np.intp]], gap: float
) -> list[tuple[float, float]]:
    """First and last instant of the runs of True, joined over gaps shorter than ``gap`` [s]."""
    out: list[tuple[float, float]] = []
    for piece in pieces:
        fresh = True
        for k in piece[mask[piece]]:
            if not fresh and t[k] - out[-1][1] <= gap:
                out[-1] = (out[-1][0], float(t[k]))
            else:
                out.append((float(t[k]), float(t[k])))
                fresh = False
    return out


def spectral_lines(
    series: Sequence[Array], rate: float, tests: int, lowest: float = 0.0, smooth: float = 1.0
) -> list[float]:
    """Frequencies [Hz] at which the pooled periodogram of the series stands out of its surroundings.

    series : records of the same channel, each at least 2 s long; ``smooth`` [Hz] : the width over
    which the noise's spectrum is taken as flat.
    """
    length = min((len(s) for s in series), default=0)
    if length < 2.0 * rate:
        return []
    window = np.hanning(length)
    power = np.zeros(length // 2 + 1)
    pooled = 0
    for s in series:
        for first in range(0, len(s) - length + 1, length):
            piece = s[first : first + length]
            power += np.abs(np.fft.rfft(window * (piece - piece.mean()))) ** 2
            pooled += 1
    frequency = np.fft.rfftfreq(length, 1.0 / rate)
    half = max(8, int(smooth / frequency[1]))
    floor = _running_median(power, half) / stats.chi2.median(2 * pooled) * (2 * pooled)
    with np.errstate(divide="ignore", invalid="ignore"):
        excess = np.where(floor > 0.0, power / floor, 0.0) * 2 * pooled
    limit = stats.chi2.isf(FALSE_EVENT / (len(power) * tests), 2 * pooled)
    # The median of 2 half + 1 values is itself uncertain by about 1 / sqrt(half).
    limit *= 1.0 + 4.0 / np.sqrt(2.0 * half * pooled)
    found = (excess > limit) & (frequency > lowest)
    peaks = [k for k in np.flatnonzero(found) if excess[k] >= excess[max(k - 3, 0) : k + 4].max()]
    return [float(frequency[k]) for k in peaks]


def _running_median(values: Array, half: int) -> Array:
    from scipy.ndimage import median_filter

    return median_filter(values, size=2 * half + 1, mode="nearest")
