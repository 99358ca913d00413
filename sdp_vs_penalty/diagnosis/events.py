"""What happens once, of which no function of the motion is the cause: a contact, a
knock, a hum.

Events are rows of which the final model's residual is an outlier: windows of whitened
residual with too much energy (:mod:`~sdp_vs_penalty.signals.coloured_noise`), in one
repetition of the motion only where it repeats. A hum is a line in the spectrum: at the
frequencies of a periodogram the power of whitened noise is exponential.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy
from numpy.typing import NDArray

from sdp_vs_penalty.diagnosis.constants import MINOR
from sdp_vs_penalty.diagnosis.white_rows import WhiteData
from sdp_vs_penalty.files import JsonRecord
from sdp_vs_penalty.robot.arrays import Array, nonzero_or_one
from sdp_vs_penalty.signals.coloured_noise import (
    FALSE_EVENT,
    RARE,
    local_excess,
    lone_windows,
    robust_scale,
)
from sdp_vs_penalty.signals.constants import SAME_PHASE
from sdp_vs_penalty.signals.noise import differences
from sdp_vs_penalty.signals.repetition import Repeat, consecutive
from sdp_vs_penalty.signals.spectrum import periodograms
from sdp_vs_penalty.signals.standstill import SLOW

Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Event(JsonRecord):
    """joint from 1; t_start, t_end [s] on the clock of the measurements; what : "local"
    or "hum"."""

    joint: int
    t_start: float
    t_end: float
    what: str = "local"
    frequency: float | None = None


def find_events(
    data: WhiteData,
    outlier_rows: Mask,
    residual: Array,
    unexplained: Sequence[int],
) -> list[Event]:
    """Outliers of the final model: windows of too much energy, cut to the rows that hold
    it, and lines of the spectrum.

    residual (M, n) [N m or N] : what the model leaves; outlier_rows (M, n) : its
    outliers; unexplained : the joints (from 0) on which something without a name is left,
    whose peaks are no events.
    """
    rows = data.rows
    mask = outlier_rows.copy()
    mask[:, list(unexplained)] = False
    out = find_hums(data, residual)
    for j in range(rows.n):
        for group in _groups_in_time(data, mask[:, j], j):
            core = _core_of_event(group, residual[:, j])
            out.append(
                Event(
                    j + 1,
                    float(rows.t[core[0]]),
                    float(rows.t[core[-1]]),
                )
            )
    return sorted(out, key=lambda e: (e.t_start, e.joint))


def _groups_in_time(
    data: WhiteData,
    outlier_rows: NDArray[np.bool_],
    joint: int,
) -> list[NDArray[np.intp]]:
    """A joint's outlier rows (M,), those apart that are far in time."""
    rows = data.rows
    out = []
    for piece in replace(rows, masked=np.zeros((0, 0), bool)).pieces[joint]:
        event_rows = piece[outlier_rows[piece]]
        if len(event_rows):
            is_far = np.diff(rows.t[event_rows]) > 2.0 * SAME_PHASE
            out += np.split(event_rows, np.flatnonzero(is_far) + 1)
    return out


def _core_of_event(group: NDArray[np.intp], residual: Array) -> NDArray[np.intp]:
    """From the first to the last row of those that hold nearly all of a window's
    energy: windows are longer than what happens in them."""
    squares = residual[group] ** 2
    order = np.argsort(-squares)
    enough = (1.0 - MINOR) * squares.sum()
    count = int(np.searchsorted(np.cumsum(squares[order]), enough)) + 1
    core_rows = np.sort(order[:count])
    return group[core_rows[0] : core_rows[-1] + 1]


def outliers(data: WhiteData, white: Array, residual: Array) -> Mask:
    """(M, n) rows of which the residual, white (M, n), is an outlier: what happens once.

    An outlier that comes back with the motion is an error of the model. Where no motion
    comes back, an event stands out of all windows in the same state of motion. So does
    what one repetition has near reversals, where any law of friction is only nearly
    right.
    """
    rows = data.rows
    noise = data.noise
    unrepeated = _unrepeated_rows(data, residual)
    comes_back = _rows_that_come_back(noise.repeats, len(rows.t))
    out = np.zeros(white.shape, bool)
    for j in range(rows.n):
        # The noise may be larger than was thought; its median does not see an event.
        steady = white[:, j] / max(robust_scale(white[white[:, j] != 0.0, j]), 1.0)
        degrees = float(noise.degrees[j])
        is_outlier = local_excess(steady, rows.pieces[j], rows.n, degrees)
        suspect = unrepeated[:, j]
        if is_outlier.any() or suspect.any():
            slow = (rows.slow[:, j] > SLOW) | (rows.still[:, j] > 0.0)
            lone = _lone_rows(data, white[:, j], j, slow)
            # A push of a second stands out in N m rather than in what is white.
            torque = residual[:, j] * (white[:, j] != 0.0)
            lone |= _lone_rows(data, torque, j, slow)
            lone |= ~slow & _stands_out(torque, rows.pieces[j], rows.n)
            is_outlier &= lone | (comes_back & ~slow)
            suspect = suspect & (lone | ~slow)
        if is_outlier.sum() < RARE * rows.keep[:, j].sum():
            out[:, j] = is_outlier
        out[:, j] |= suspect
    return out & ~_repeated_outliers(data, out)


def _rows_that_come_back(repeats: Sequence[Repeat], count: int) -> Mask:
    """(M,) whether the motion of a row comes back."""
    out = np.zeros(count, bool)
    for repeat in repeats:
        out[repeat.rows] = True
        out[repeat.there] = True
    return out


def _lone_rows(
    data: WhiteData,
    series: Array,
    joint: int,
    slow: Mask,
) -> Mask:
    """(M,) rows of a joint's series (M,) to which no window in the same state of motion
    comes near."""
    rows = data.rows
    return lone_windows(
        series,
        rows.pieces[joint],
        slow,
        rows.rate,
        rows.n,
    )


def _stands_out(
    torque: Array,
    pieces: Sequence[NDArray[np.intp]],
    tests: int,
) -> Mask:
    """(M,) rows of windows in which a residual (M,) [N m or N] swells as in no others."""
    degrees = max(float(np.count_nonzero(torque)), 1.0)
    usual = float(nonzero_or_one(np.sqrt(np.sum(torque**2) / degrees)))
    return local_excess(torque / usual, pieces, tests, degrees)


def _near_in_time(mask: Mask, rate: float) -> Mask:
    """(M, n) rows within which two windows are at the same phase of those of a mask."""
    return np.asarray(_sums_near_in_time(mask.astype(float), rate) > 0.5)


def _sums_near_in_time(series: Array, rate: float) -> Array:
    """(M, n) sums of a series over the rows at the same phase."""
    width = np.ones(2 * max(1, round(SAME_PHASE * rate)) + 1)
    return np.array([np.convolve(x, width, mode="same") for x in series.T]).T


def _repeated_outliers(data: WhiteData, is_outlier: Mask) -> Mask:
    """(M, n) outliers that another repetition of the motion has, too."""
    near = _near_in_time(is_outlier, data.rows.rate)
    out = np.zeros_like(is_outlier)
    for repeat in data.noise.repeats:
        in_both = near[repeat.rows] & near[repeat.there]
        out[repeat.rows] |= in_both
        np.logical_or.at(out, repeat.there, in_both)
    return out


def _unrepeated_rows(data: WhiteData, residual: Array) -> Mask:
    """(M, n) where the repetitions of a motion differ: an event, in the one that leaves
    more error."""
    rows = data.rows
    repeats = data.noise.repeats
    suspect = data.noise.suspect
    if not suspect.any():
        return suspect
    near = _near_in_time(suspect, rows.rate)
    energy = _sums_near_in_time(residual**2, rows.rate)
    out = suspect.copy()
    for one, other in ((r.rows, r.there) for r in repeats):
        first_less = energy[one] <= energy[other]
        out[one] &= ~(near[other] & first_less)
        lost = np.zeros_like(out)
        np.logical_or.at(lost, other, near[one] & ~first_less)
        out &= ~lost
    return out


def find_hums(data: WhiteData, residual: Array) -> list[Event]:
    """One event a run for each joint in whose residual (M, n) a spectral line stands."""
    out = []
    for j, lines in hum_lines(data, residual).items():
        for segment in data.rows.segments:
            begin = float(segment.t[0])
            end = float(segment.t[-1])
            out.append(
                Event(
                    j + 1,
                    begin,
                    end,
                    "hum",
                    lines[0],
                )
            )
    return out


def hum_lines(data: WhiteData, residual: Array) -> dict[int, list[float]]:
    """By joint (from 0) the frequencies [Hz] of spectral lines, of joints that have any.

    Where the motion repeats they are looked for in what does not: a model's error is a
    comb of lines. The residual is not whitened for it: an autoregression takes a sine
    for its own colour.
    """
    rows = data.rows
    repeats = data.noise.repeats
    slow = rows.slow > SLOW  # reversals are harmonics of the motion
    left = residual
    if repeats:
        left = differences(rows, repeats)
        slow = np.concatenate([slow[r.rows] for r in repeats])
    left = np.where(slow, 0.0, left)
    out = {}
    for j in range(rows.n):
        pieces = consecutive(repeats) if repeats else rows.pieces[j]
        longest = max((len(p) for p in pieces), default=0)
        series = [left[p, j] for p in pieces if 2 * len(p) > longest]
        found = spectral_lines(series, rows.rate, rows.n)
        # What the low-pass folds has no flat surroundings.
        lines = [f for f in found if f < rows.cutoff]
        if lines:
            out[j] = lines
    return out


def spectral_lines(
    series: Sequence[Array],
    rate: float,
    tests: int,
    lowest: float = 0.8,
    smooth: float = 1.0,
) -> list[float]:
    """Frequencies [Hz] at which the pooled periodogram of the series stands out of its
    surroundings.

    series : records of the same channel, each at least 2 s long; lowest [Hz] : below,
    lines are the motion's own harmonics; smooth [Hz] : the width over which the noise's
    spectrum is taken as flat.
    """

    length = min((len(s) for s in series), default=0)
    if length < 2.0 * rate:
        return []
    pieces = [
        s[k : k + length] for s in series for k in range(0, len(s) - length + 1, length)
    ]
    power = periodograms(np.stack(pieces, axis=1), length)[0].sum(axis=1)
    pooled = len(pieces)
    frequency = np.fft.rfftfreq(length, 1.0 / rate)
    half = max(8, min(int(smooth / frequency[1]), length))  # a clock may say anything
    level = scipy.ndimage.median_filter(
        power,
        size=2 * half + 1,
        mode="nearest",
    )
    level = level / float(scipy.special.gammaincinv(pooled, 0.5)) * pooled
    with np.errstate(divide="ignore", invalid="ignore"):
        excess = np.where(level > 0.0, power / level, 0.0) * 2 * pooled
    limit = float(scipy.special.chdtri(2 * pooled, FALSE_EVENT / (len(power) * tests)))
    # The median of 2 half + 1 values is itself uncertain by about 1 / sqrt(half).
    limit *= 1.0 + 4.0 / np.sqrt(2.0 * half * pooled)
    is_line = (excess > limit) & (frequency > lowest)
    peaks = is_line & (excess >= scipy.ndimage.maximum_filter1d(excess, 7))
    return [float(f) for f in frequency[peaks]]
