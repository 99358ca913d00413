"""A run as it was recorded: its rate, its gaps, which joints move and when."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.errors import InputError

Array = NDArray[np.float64]

#: A joint whose position has at most this standard deviation [rad, m] may be an idle one's noise.
_LARGEST_NOISE = 0.01
#: Samples judged at a time, so that long runs cost no more memory than short ones.
_PART = 1 << 14


#: A step this long is no sampling but a pause [s]; and the grid has at most so many points a sample.
_PAUSE, _FINEST = 0.05, 10.0


def sample_rate(run: Measurements) -> float:
    """Samples a second: one over the median time step [Hz].

    Stamps that come in bursts have a median step of nothing: the grid on which a run is resampled never
    has more than ten points a sample, pauses apart.
    """
    steps = np.diff(run.t)
    middle = float(np.median(steps))
    longest = max(_PAUSE, 20.0 * middle)
    mean = float(np.mean(np.minimum(steps, longest)))
    return 1.0 / max(middle, mean / _FINEST)


def moving_joints(run: Measurements) -> NDArray[np.bool_]:
    """(n,) which joints move at all, rather than flicker about one position.

    From row to row a noisy position changes as much as it ever does (the ratio is 0.7 for white
    noise, up to 1.5 for the idle joints of a real arm), a smooth motion far less (over 100).
    """
    spread = np.array([q.std() for q in run.q.T])
    step = np.array([np.sqrt(np.mean(np.diff(q) ** 2)) for q in run.q.T])
    # A constant has the standard deviation of its rounding, and no motion.
    return np.asarray(
        ((spread > 4.0 * step) | (spread > _LARGEST_NOISE)) & (np.ptp(run.q, axis=0) > 0.0)
    )


class Movement:
    """Which instants belong to motion rather than standstill, from positions half a second apart.

    moves (N,) : of each sample whether some joint comes farther within half a second than ``share``
    of the farthest that it ever comes.
    """

    def __init__(self, run: Measurements, share: float) -> None:
        self.t = run.t
        self.moves = np.zeros(len(run.t), bool)
        parts = [slice(k, k + _PART) for k in range(0, len(run.t), _PART)]
        for j in np.flatnonzero(moving_joints(run)).tolist():
            largest = max(_travel(run, j, part).max() for part in parts)
            for part in parts:
                self.moves[part] |= _travel(run, j, part) > share * largest

    def at(self, t: Array) -> NDArray[np.bool_]:
        """The same at instants t [s]."""
        return self.moves[np.clip(np.searchsorted(self.t, t), 0, len(self.t) - 1)]


def _travel(run: Measurements, j: int, part: slice) -> Array:
    """How far a joint comes within half a second, at the samples of a part."""
    t = run.t[part]
    first, last = np.searchsorted(run.t, [t[0] - 0.25, t[-1] + 0.25])
    around = slice(max(int(first) - 1, 0), int(last) + 1)
    known, q = run.t[around], run.q[around, j]
    return np.abs(np.interp(t + 0.25, known, q) - np.interp(t - 0.25, known, q))


@dataclass(frozen=True)
class Stretch:
    """What lies between two gaps of a run's clock, resampled to t[0] + k dt where it is asked for."""

    t: Array
    q: Array
    tau: Array
    dt: float
    temperature: Array | None = None

    @property
    def count(self) -> int:
        return int((self.t[-1] - self.t[0]) / self.dt) + 1

    def clock(self, k: NDArray[np.int64]) -> Array:
        return np.asarray(self.t[0] + self.dt * k)

    def resampled(self, values: Array, start: int, stop: int) -> Array:
        """q or tau at the grid's samples start to stop - 1, (stop - start, n)."""
        grid = self.clock(np.arange(start, stop))
        # Of a long run only what lies around: interpolation copies what it is given.
        first = max(int(np.searchsorted(self.t, grid[0], "right")) - 1, 0)
        around = slice(first, int(np.searchsorted(self.t, grid[-1])) + 1)
        known = self.t[around]
        return np.column_stack([np.interp(grid, known, x) for x in values[around].T])


def stretches(run: Measurements) -> Iterator[Stretch]:
    """The uninterrupted parts of a run: a time step above 20 usual ones (at least 50 ms) is a gap."""
    dt = 1.0 / sample_rate(run)
    breaks = np.flatnonzero(np.diff(run.t) > max(20.0 * dt, 0.05)) + 1
    for start, stop in zip([0, *breaks], [*breaks, len(run.t)], strict=True):
        if stop - start >= 2:
            part = run.rows(slice(start, stop))
            yield Stretch(part.t, part.q, part.tau, dt, part.temperature)


def highest_harmonic(run: Measurements) -> float:
    """Highest frequency [Hz] at which some joint's position has 1 % of its largest amplitude.

    Raises InputError for a run without motion, or with gaps everywhere.
    """
    highest = 0.0
    moving = moving_joints(run)
    for part in stretches(run):
        count = part.count
        if count < 16:
            continue
        for j in np.flatnonzero(moving):
            q = part.resampled(part.q[:, j : j + 1], 0, count)[:, 0]
            if np.ptp(q) == 0.0:
                continue
            amplitude = np.abs(fft.rfft(np.hanning(count) * (q - q.mean())))
            present = np.flatnonzero(amplitude > 0.01 * amplitude.max())
            highest = max(highest, int(present[-1]) / (count * part.dt))
    if highest == 0.0:
        if not moving.any():
            raise no_motion(run)
        raise InputError(
            f"{len(run.t)} samples, but no 16 consecutive ones without a gap in time",
            "record longer",
            run.names[0],
        )
    return highest


def no_motion(run: Measurements) -> InputError:
    """For a run in which no joint moves."""
    return InputError("the robot does not move in this run", "record a motion", run.names[0])
