"""Isolated disturbances: what happens once and is no function of the motion, such as a
contact or a knock; and hums.

Events are rows in which the final model's residual is an outlier: windows of whitened
residual with too much energy (:mod:`~sdp_vs_penalty.signals.coloured_noise`), in only
one repetition where the motion repeats. A hum is a line in the spectrum: the power of
whitened noise at the frequencies of a periodogram is distributed exponentially.
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
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.coloured_noise import (
    FALSE_EVENT,
    RARE,
    local_excess,
    lone_windows,
    robust_scale,
)
from sdp_vs_penalty.signals.constants import SAME_PHASE
from sdp_vs_penalty.signals.noise import REPETITION, differences
from sdp_vs_penalty.signals.repetition import consecutive
from sdp_vs_penalty.signals.spectrum import periodograms
from sdp_vs_penalty.signals.standstill import SLOW

Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Event(JsonRecord):
    """joint from 1; t_start, t_end [s] on the clock of the measurements; what : "local"
    for an isolated disturbance, or "hum"; frequency [Hz] : of a hum.
    """

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
    """List the isolated disturbances and hums that the final model leaves.

    Parameters
    ----------
    data
        White rows.
    outlier_rows
        (M, n) rows in which the residual is an outlier.
    residual
        (M, n) what the model leaves [N m or N].
    unexplained
        Joints (from 0) with unexplained torque: their outliers are no events.

    Returns
    -------
    list of Event
        By time. A disturbance is cut to the rows that hold nearly all of its energy.
    """
    rows = data.rows
    mask = outlier_rows.copy()
    mask[:, list(unexplained)] = False
    out = find_hums(data, residual)
    for j in range(rows.n):
        for group in _groups_in_time(data, mask[:, j], j):
            core = _core_of_event(group, residual[:, j])
            begin = float(rows.t[core[0]])
            end = float(rows.t[core[-1]])
            out.append(Event(j + 1, begin, end))
    return sorted(out, key=lambda e: (e.t_start, e.joint))


def _groups_in_time(
    data: WhiteData,
    outlier_rows: NDArray[np.bool_],
    joint: int,
) -> list[NDArray[np.intp]]:
    """Divide a joint's outlier rows into groups that are apart by more than 2
    SAME_PHASE.

    outlier_rows (M,); returns the numbers of the rows of each group.
    """
    rows = data.rows
    out = []
    all_rows = replace(rows, masked=np.zeros((0, 0), bool))  # masked ones, too
    for piece in all_rows.pieces[joint]:
        event_rows = piece[outlier_rows[piece]]
        if len(event_rows):
            is_far = np.diff(rows.t[event_rows]) > 2.0 * SAME_PHASE
            out += np.split(event_rows, np.flatnonzero(is_far) + 1)
    return out


def _core_of_event(group: NDArray[np.intp], residual: Array) -> NDArray[np.intp]:
    """Return the rows from the first to the last of those that hold 99 % of the energy.

    Windows are longer than what happens in them. group : numbers of rows; residual
    (M,).
    """
    squares = residual[group] ** 2
    largest_first = np.argsort(-squares)
    most_of_energy = (1.0 - MINOR) * squares.sum()
    energy = np.cumsum(squares[largest_first])
    n_needed = int(np.searchsorted(energy, most_of_energy)) + 1
    places = largest_first[:n_needed]
    return group[places.min() : places.max() + 1]


def outliers(data: WhiteData, white: Array, residual: Array) -> Mask:
    """Flag the rows (M, n) whose residual is an outlier: isolated disturbances.

    While a joint moves slowly or reverses, friction laws are only approximate: there a
    row is an outlier only if no similar motion has a similar residual.

    Parameters
    ----------
    data
        White rows.
    white
        (M, n) whitened residual.
    residual
        (M, n) residual [N m or N].
    """
    rows = data.rows
    noise = data.noise
    unrepeated = _unrepeated_rows(data, residual)
    out = np.zeros(white.shape, bool)
    for j in range(rows.n):
        # The noise may be larger than was thought; its median does not see an event.
        steady = white[:, j] / max(robust_scale(white[white[:, j] != 0.0, j]), 1.0)
        degrees = float(noise.degrees[j])
        is_outlier = local_excess(steady, rows.pieces[j], rows.n, degrees)
        suspect = unrepeated[:, j]
        if is_outlier.any() or suspect.any():
            slow = (rows.slow[:, j] > SLOW) | (rows.still[:, j] > 0.0)
            lone = lone_windows(
                white[:, j],
                rows.pieces[j],
                slow,
                rows.rate,
                rows.n,
            )
            # Where no repetition tells it from noise, it stands out of the joint's error.
            is_outlier &= lone if noise.source != REPETITION else lone | ~slow
            suspect = suspect & (lone | ~slow)
        if is_outlier.sum() < RARE * rows.keep[:, j].sum():
            out[:, j] = is_outlier
        out[:, j] |= suspect
    return out


def _unrepeated_rows(data: WhiteData, residual: Array) -> Mask:
    """Flag the rows (M, n) in which repetitions of a motion disagree.

    Of two repetitions the one with the larger residual near that phase is flagged.
    """
    rows = data.rows
    repeats = data.noise.repeats
    suspect = data.noise.suspect
    if not suspect.any():
        return suspect
    # Rows within half this window are at the same phase.
    window = np.ones(2 * max(1, round(SAME_PHASE * rows.rate)) + 1)

    def sum_nearby(values: Array) -> Array:
        """(M, n) sums over the window around each row."""
        return np.column_stack([np.convolve(x, window, mode="same") for x in values.T])

    is_near_suspect = sum_nearby(suspect.astype(float)) > 0.5
    energy = sum_nearby(residual**2)
    out = suspect.copy()
    for repetition in repeats:
        first = repetition.rows
        second = repetition.there
        first_has_less = energy[first] <= energy[second]
        out[first] &= ~(is_near_suspect[second] & first_has_less)
        cleared = np.zeros_like(out)
        second_has_less = is_near_suspect[first] & ~first_has_less
        np.logical_or.at(cleared, second, second_has_less)  # rows may come twice
        out &= ~cleared
    return out


def find_hums(data: WhiteData, residual: Array) -> list[Event]:
    """List the hums: one event a run for each joint whose residual (M, n) has spectral
    lines.

    The frequency is that of the lowest line.
    """
    out = []
    for j, lines in hum_lines(data, residual).items():
        for segment in data.rows.segments:
            begin = float(segment.t[0])
            end = float(segment.t[-1])
            hum = Event(j + 1, begin, end, what="hum", frequency=lines[0])
            out.append(hum)
    return out


def hum_lines(data: WhiteData, residual: Array) -> dict[int, list[float]]:
    """Return the frequencies [Hz] of spectral lines, by joint (from 0) that has any.

    Where the motion repeats, lines are looked for in the differences of repetitions,
    since a model's error has the motion's harmonics. The residual (M, n) is not
    whitened: the autoregressive model of the noise would take a sine for its own
    colour.
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
    """Find frequencies [Hz] at which a periodogram stands out of its surroundings.

    Parameters
    ----------
    series
        Records of one channel, each at least 2 s long; their periodograms are summed.
    rate
        Sampling rate [Hz].
    tests
        Number of channels tested, for the chance of a false line.
    lowest
        Frequency [Hz] below which lines are the motion's own harmonics.
    smooth
        Width [Hz] over which the noise's spectrum is taken as flat.

    Returns
    -------
    list of float
        The frequencies.
    """
    length = min((len(s) for s in series), default=0)
    if length < 2.0 * rate:
        return []
    pieces = list[Array]()
    for values in series:
        starts = range(0, len(values) - length + 1, length)
        pieces += [values[start : start + length] for start in starts]
    power = periodograms(np.stack(pieces, axis=1), length)[0].sum(axis=1)
    pooled = len(pieces)
    frequency = np.fft.rfftfreq(length, 1.0 / rate)
    # At least 8 neighbours on each side, and no more than there are, whatever the clock.
    half = max(8, min(int(smooth / frequency[1]), length))
    median = scipy.ndimage.median_filter(power, size=2 * half + 1, mode="nearest")
    # The sum of ``pooled`` exponentials has a gamma distribution: its mean from its
    # median, and 2 pooled times power over mean is chi-squared.
    level = median / float(scipy.special.gammaincinv(pooled, 0.5)) * pooled
    with np.errstate(divide="ignore", invalid="ignore"):
        excess = np.where(level > 0.0, power / level, 0.0) * 2 * pooled
    false_chance = FALSE_EVENT / (len(power) * tests)
    limit = float(scipy.special.chdtri(2 * pooled, false_chance))
    # The median of 2 half + 1 values is itself uncertain by about 1 / sqrt(half).
    limit *= 1.0 + 4.0 / np.sqrt(2.0 * half * pooled)
    is_line = (excess > limit) & (frequency > lowest)
    peaks = is_line & (excess >= scipy.ndimage.maximum_filter1d(excess, 7))
    return [float(f) for f in frequency[peaks]]
