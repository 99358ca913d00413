"""The steps of encoders, and what they make of a motion."""

from dataclasses import replace

import numpy as np

from sdp_vs_penalty.data.measurements import Measurements, concatenate
from sdp_vs_penalty.robot.arrays import Array

#: Differences below this share of a channel's range are rounding errors of the file [-].
_ROUNDING = 1e-9


def lattice_step(values: Array) -> float:
    """Return the resolution of a channel: the smallest step between different values,
    if the values are those of a counter; else 0.

    Two things mark a counter, and at least half of each is required:

    - N samples on M = range / step levels repeat N - M (1 - exp(-N / M)) earlier
      values; values that all differ repeat none.
    - Where it changes, its fourth differences are whole steps. Those of a smooth
      motion, which may return to the same values without noise, are far smaller.

    Parameters
    ----------
    values : (N,) array
        The channel; rounding errors of the file are ignored.

    Returns
    -------
    float
        The step, in the channel's unit.
    """
    levels = np.unique(values)
    gaps = np.diff(levels)
    gaps = gaps[gaps > _ROUNDING * (levels[-1] - levels[0])]
    if len(values) < 5 or not len(gaps):
        return 0.0
    step = float(gaps.min())
    n_levels = (levels[-1] - levels[0]) / step + 1.0
    expected_repeats = len(values) + n_levels * np.expm1(-len(values) / n_levels)
    changes = np.abs(np.diff(values)) > 0.5 * step
    # A fourth difference spans four changes.
    is_near_change = np.convolve(changes, np.ones(4), "valid") > 0.5
    is_whole_step = np.abs(np.diff(values, 4))[is_near_change] > 0.5 * step
    is_repeated = len(values) - len(levels) >= 0.5 * expected_repeats
    is_jumpy = len(is_whole_step) > 0 and is_whole_step.mean() > 0.5
    return step if is_repeated and is_jumpy else 0.0


def lattice_step_bound(values: Array) -> float:
    """Return an upper bound of :func:`lattice_step` that needs no sorting: the smallest
    change of a channel (N,) from one sample to the next, infinite where no sample
    changes."""
    changes = np.abs(np.diff(values))
    is_change = changes > _ROUNDING * np.ptp(values)
    return float(np.min(changes, where=is_change, initial=np.inf))


def read_again(measurements: Measurements) -> Measurements:
    """Read the same motion by encoders whose steps lie elsewhere.

    Returns
    -------
    Measurements
        The same runs with other positions.
    """
    runs = []
    for run in measurements.runs():
        columns = [_with_other_steps(run.t, position) for position in run.q.T]
        runs.append(replace(run, q=np.column_stack(columns)))
    return concatenate(runs)


def _with_other_steps(t: Array, q: Array) -> Array:
    """Return the positions (N,) that an encoder with shifted steps would have read.

    The true position is taken to lie on straight lines between the instants at which
    the encoder counted, midway between its levels; from there it is rounded anew.
    """
    step = lattice_step(q)
    change = np.flatnonzero(np.diff(q))
    if not step:
        return q
    middle_time = 0.5 * (t[change] + t[change + 1])
    middle_position = 0.5 * (q[change] + q[change + 1])
    knot_times = np.concatenate([t[:1], middle_time, t[-1:]])
    knot_positions = np.concatenate([q[:1], middle_position, q[-1:]])
    true_position = np.interp(t, knot_times, knot_positions)
    # Rounding errors of two encoders whose levels are shifted by a share a of a step are
    # uncorrelated where 1 - 6 a (1 - a) = 0.
    shift = 0.5 - 12.0**-0.5
    return step * (np.round(true_position / step + shift) - shift)
