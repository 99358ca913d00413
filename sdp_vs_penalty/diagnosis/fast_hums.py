"""Hums above the cut-off of the filters, which filtered rows do not show.

They are lines in the spectrum of measured minus modelled torque at the rate of the log.
Where the motion repeats, the difference of two repetitions is searched: a model's error
repeats with the motion, and has the motion's harmonics.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.diagnosis.events import spectral_lines
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.repetition import Repeat
from sdp_vs_penalty.signals.segments import SegmentedRuns

#: Share of the log's rate up to which lines are searched; its half is the highest
#: frequency that samples show.
_HIGHEST = 0.45
#: Frequencies that are tried around a line, in widths of a line of the spectrum.
_AROUND = np.linspace(-1.0, 1.0, 21)


class Hum(NamedTuple):
    """A hum of a joint's torque: its frequency [Hz] and amplitude [N m or N]."""

    frequency: float
    amplitude: float


class FullRate(NamedTuple):
    """One joint in one segment at the rate of the log, before the filters.

    t (N,) : time [s]; angle (N,) : position [rad or m]; residual (N,) : measured minus
    modelled torque [N m or N].
    """

    t: Array
    angle: Array
    residual: Array

    @property
    def rate(self) -> float:
        """Samples per second [Hz]."""
        return (len(self.t) - 1) / float(self.t[-1] - self.t[0])


def full_rate(
    runs: Sequence[Measurements],
    rows: SegmentedRuns,
    joint: int,
) -> list[FullRate]:
    """Return a joint's angle and residual at the rate of the log, for each segment.

    The modelled torque is interpolated linearly from the filtered motion.

    Parameters
    ----------
    runs
        The recordings.
    rows
        The filtered rows of these recordings, with the torque of a model.
    joint
        The joint (from 0).
    """
    out = []
    for segment in rows.segments:
        run = runs[segment.run]
        motion = segment.motion
        is_inside = (run.t >= motion.t[0]) & (run.t <= motion.t[-1])
        t = run.t[is_inside]
        modelled = np.interp(t, motion.t, motion.modelled[:, joint])
        angle = run.q[is_inside, joint]
        out.append(FullRate(t, angle, run.tau[is_inside, joint] - modelled))
    return out


def fast_hums(
    series: Sequence[FullRate],
    rows: SegmentedRuns,
    repeats: Sequence[Repeat] = (),
) -> tuple[Hum, ...]:
    """Find the hums of one joint between the filters' cut-off and the highest frequency
    that the log shows.

    Parameters
    ----------
    series
        The joint's residual at the rate of the log, for each segment.
    rows
        The filtered rows.
    repeats
        Which rows repeat the motion of others.

    Returns
    -------
    tuple of Hum
        The largest amplitude first.
    """
    searched = _differences(series, rows, repeats) if repeats else series
    long_enough = _long_ones(searched)
    if not long_enough:
        return ()
    rate = float(np.median([one.rate for one in long_enough]))
    lines = spectral_lines(
        [one.residual - one.residual.mean() for one in long_enough],
        rate,
        rows.n,
        lowest=rows.cutoff,
    )
    fitted_to = _long_ones(series)
    hums = [_fitted(f, fitted_to) for f in lines if f < _HIGHEST * rate]
    return tuple(sorted(hums, key=lambda hum: -hum.amplitude))


def _long_ones(series: Sequence[FullRate]) -> list[FullRate]:
    """Return the series that are longer than half the longest; none of two samples."""
    longest = max((len(one.t) for one in series), default=0)
    return [one for one in series if 2 * len(one.t) > longest > 2]


def _differences(
    series: Sequence[FullRate],
    rows: SegmentedRuns,
    repeats: Sequence[Repeat],
) -> list[FullRate]:
    """Subtract the residual of a repetition: (r(t) - r(t + T)) / sqrt(2), for each piece
    of a segment that is repeated.
    """
    out = []
    for repeat in repeats:
        # A repeat ends where a row is missing.
        ends = np.flatnonzero(np.diff(repeat.rows) != 1) + 1
        pieces = zip(
            np.split(repeat.rows, ends),
            np.split(repeat.later, ends),
            strict=True,
        )
        for its_rows, later in pieces:
            one = series[int(rows.segment[its_rows[0]])]
            other = series[repeat.other]
            t_rows = rows.t[its_rows]
            is_inside = (one.t >= t_rows[0]) & (one.t <= t_rows[-1])
            t = one.t[is_inside]
            if len(t) < 2:
                continue
            instants = np.interp(t, t_rows, later)
            repeated = np.interp(instants, other.t, other.residual)
            difference = (one.residual[is_inside] - repeated) / np.sqrt(2.0)
            out.append(FullRate(t, one.angle[is_inside], difference))
    return out


def _fitted(frequency: float, series: Sequence[FullRate]) -> Hum:
    """Fit a sine near a frequency [Hz] to each series, and return its RMS amplitude.

    The frequency is that of the best fit within a width of a line, 1 / duration.
    """
    longest = max(series, key=lambda one: len(one.t))
    width = 1.0 / float(longest.t[-1] - longest.t[0])
    tried = frequency + width * _AROUND
    best = float(max(tried, key=lambda f: _amplitude(f, longest)))
    squares = [_amplitude(best, one) ** 2 for one in series]
    return Hum(best, float(np.sqrt(np.mean(squares))))


def _amplitude(frequency: float, one: FullRate) -> float:
    """Return the amplitude [N m or N] of a sine of this frequency [Hz] in a residual."""
    angle = 2.0 * np.pi * frequency * one.t
    waves = np.column_stack([np.sin(angle), np.cos(angle), np.ones(len(angle))])
    sizes = np.linalg.lstsq(waves, one.residual, rcond=None)[0]
    return float(np.hypot(sizes[0], sizes[1]))
