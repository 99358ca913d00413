"""What happens once: a contact, a knock, a hum. No function of the motion explains it.

A local event is a window of whitened noise with too much energy (signals/outliers.py). A hum is a line
in the spectrum: at the frequencies of a periodogram the power of whitened noise is exponential.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import special

from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.outliers import FALSE_EVENT

Mask = NDArray[np.bool_]


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
    level = _running_median(power, half) / float(special.gammaincinv(pooled, 0.5)) * pooled
    with np.errstate(divide="ignore", invalid="ignore"):
        excess = np.where(level > 0.0, power / level, 0.0) * 2 * pooled
    limit = float(special.chdtri(2 * pooled, FALSE_EVENT / (len(power) * tests)))
    # The median of 2 half + 1 values is itself uncertain by about 1 / sqrt(half).
    limit *= 1.0 + 4.0 / np.sqrt(2.0 * half * pooled)
    found = (excess > limit) & (frequency > lowest)
    peaks = [k for k in np.flatnonzero(found) if excess[k] >= excess[max(k - 3, 0) : k + 4].max()]
    return [float(frequency[k]) for k in peaks]


def _running_median(values: Array, half: int) -> Array:
    from scipy.ndimage import median_filter

    return median_filter(values, size=2 * half + 1, mode="nearest")
