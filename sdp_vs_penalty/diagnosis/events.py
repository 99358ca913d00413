"""Rows with isolated disturbances, such as a contact or a knock: what happens once and is
no function of the motion. What is left there tells nothing of a model; `check` names it.

The final model's residual is an outlier in them: windows of whitened residual with too
much energy (:mod:`~sdp_vs_penalty.signals.coloured_noise`), in only one repetition where
the motion repeats.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sdp_vs_penalty.diagnosis.white_rows import WhiteData
from sdp_vs_penalty.robot.arrays import Array, Indices, Mask, nonzero_or_one
from sdp_vs_penalty.signals.coloured_noise import (
    RARE,
    local_excess,
    lone_windows,
    noise_profile,
    robust_scale,
)
from sdp_vs_penalty.signals.constants import SAME_PHASE
from sdp_vs_penalty.signals.standstill import SLOW


def outliers(data: WhiteData, white: Array, residual: Array) -> Mask:
    """Flag the rows with isolated disturbances, in which the residual is an outlier.

    An outlier is a window of rows with too much energy for the noise. It is a
    disturbance only if no other window in the same state of motion, and no other
    repetition of the motion, shows the like: what repeats is an error of the model.
    Rows in which a repetition differs from the others are suspect in any case.

    Parameters
    ----------
    data
        White rows (weighted so that the noise is independent with variance 1).
    white
        (M, n) whitened residual; 0 where there is none.
    residual
        (M, n) residual [N m or N].

    Returns
    -------
    (M, n) bool array
    """
    rows = data.rows
    noise = data.noise
    unrepeated = _unrepeated_rows(data, residual)
    out = np.zeros(white.shape, bool)
    for j in range(rows.n):
        # The noise may be larger than estimated. A scale from the median corrects that,
        # and is not changed by an event.
        is_known = white[:, j] != 0.0
        # Errors of timing grow with the rate of the torque: the corner of a trapezoid
        # move has the largest rate of a log, and is no event.
        rates = data.rates[j]
        swells = noise_profile(white[:, j], rates, rates)
        even = white[:, j] / swells
        steady = even / max(robust_scale(even[is_known]), 1.0)
        degrees = float(noise.degrees[j])
        is_outlier = local_excess(steady, rows.pieces[j], rows.n, degrees)
        suspect = unrepeated[:, j]
        if is_outlier.any() or suspect.any():
            slow = (rows.slow[:, j] > SLOW) | (rows.still[:, j] > 0.0)
            # A push of a second stands out of the torque in N m rather than out of the
            # whitened one, in which slow changes are small.
            torque = residual[:, j] * is_known / swells
            # Alone among the windows of its state of motion, in N m or whitened; or far
            # above all windows while the joint moves fast.
            lone = _lone_rows(data, torque, j, slow)
            lone |= _lone_rows(data, even, j, slow)
            lone |= ~slow & _stands_out(torque, rows.pieces[j], rows.n)
            is_outlier &= lone
            # Repetitions also differ while a joint is slow, by friction.
            suspect = suspect & (lone | ~slow)
        # Outliers in many rows are an error of the model, and no events.
        if is_outlier.sum() < RARE * rows.keep[:, j].sum():
            out[:, j] = is_outlier
        out[:, j] |= suspect
    return out


def _lone_rows(data: WhiteData, series: Array, joint: int, slow: Mask) -> Mask:
    """Flag the rows (M,) of outlier windows for which no other window in the same state
    of motion has a similar residual.

    ``joint`` counts from 0.

    Parameters
    ----------
    series
        (M,) residual of the joint.
    slow
        (M,) flags the rows in which the joint moves slowly or reverses: one of two
        states.
    """
    rows = data.rows
    return lone_windows(series, rows.pieces[joint], slow, rows.rate, rows.n)


def _rms(torque: Array) -> float:
    """Return the root mean square of a residual (M,) over its rows that are not zero.

    Zero marks rows without a residual. The result is 1 if all are zero, since it
    divides.
    """
    n_known = max(float(np.count_nonzero(torque)), 1.0)
    return float(nonzero_or_one(np.sqrt(np.sum(torque**2) / n_known)))


def _stands_out(torque: Array, pieces: Sequence[Indices], tests: int) -> Mask:
    """Flag the rows (M,) of windows with much more energy than the others of all
    motion.

    The residual is divided by its RMS, and windows are tested as if it were white
    noise.

    Parameters
    ----------
    torque
        (M,) residual of a joint [N m or N]; 0 where there is none.
    pieces
        Row numbers of each uninterrupted piece of the motion.
    tests
        Number of joints that are searched, for the chance of a false alarm.
    """
    degrees = max(float(np.count_nonzero(torque)), 1.0)
    return local_excess(torque / _rms(torque), pieces, tests, degrees)


def _near_in_time(mask: Mask, rate: float) -> Mask:
    """Flag the rows (M, n) within SAME_PHASE seconds of a flagged row; rate in Hz."""
    return _sums_near_in_time(mask.astype(float), rate) > 0.5


def _sums_near_in_time(series: Array, rate: float) -> Array:
    """Sum a series (M, n) over the rows within SAME_PHASE seconds of each; ``rate`` in
    Hz.
    """
    width = np.ones(2 * max(1, round(SAME_PHASE * rate)) + 1)
    return np.array([np.convolve(x, width, mode="same") for x in series.T]).T


def _unrepeated_rows(data: WhiteData, residual: Array) -> Mask:
    """Flag the rows (M, n) that differ from another repetition of the same motion.

    ``noise.suspect`` flags both repetitions. Of the two only the one with more energy
    of the residual (M, n) near that phase keeps its flag.
    """
    rows = data.rows
    repeats = data.noise.repeats
    suspect = data.noise.suspect
    if not suspect.any():
        return suspect
    is_near_suspect = _near_in_time(suspect, rows.rate)
    energy = _sums_near_in_time(residual**2, rows.rate)
    out = suspect.copy()
    for repeat in repeats:
        # Numbers of the rows of one repetition, and of another at the same phases.
        first = repeat.rows
        second = repeat.there
        first_has_less = energy[first] <= energy[second]
        out[first] &= ~(is_near_suspect[second] & first_has_less)
        cleared = np.zeros_like(out)
        second_has_less = is_near_suspect[first] & ~first_has_less
        np.logical_or.at(cleared, second, second_has_less)  # rows may come twice
        out &= ~cleared
    return out
