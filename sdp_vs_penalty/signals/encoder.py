"""The steps of encoders, and what they make of a motion."""

from dataclasses import replace

import numpy as np

from sdp_vs_penalty.data.measurements import Measurements, concatenate
from sdp_vs_penalty.robot.arrays import Array


def lattice_step(values: Array) -> float:
    """Resolution of a channel: the smallest step between different values.

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
    steps = np.diff(levels)
    steps = steps[steps > 1e-9 * (levels[-1] - levels[0])]
    return float(steps.min()) if len(steps) else 0.0


def read_again(measurements: Measurements) -> Measurements:
    """Read the same motion by encoders whose steps lie elsewhere.

    Parameters
    ----------
    measurements
        The runs.

    Returns
    -------
    Measurements
        The same runs with other positions.
    """
    out = []
    for run in measurements.runs():
        columns = [_again(run.t, position) for position in run.q.T]
        out.append(replace(run, q=np.column_stack(columns)))
    return concatenate(out)


def _again(t: Array, q: Array) -> Array:
    """(N,) positions: on straight lines between the instants at which the encoder
    counted, and from there counted anew."""
    step = lattice_step(q)
    change = np.flatnonzero(np.diff(q))
    if not step:
        return q
    middle_time = 0.5 * (t[change] + t[change + 1])
    middle_position = 0.5 * (q[change] + q[change + 1])
    when = np.concatenate(
        [
            t[:1],
            middle_time,
            t[-1:],
        ]
    )
    where = np.concatenate(
        [
            q[:1],
            middle_position,
            q[-1:],
        ]
    )
    between = np.interp(t, when, where)
    # Errors of encoders whose steps lie apart by such a share a of one are not
    # correlated, as 1 - 6 a (1 - a) = 0.
    apart = 0.5 - 12.0**-0.5
    return np.asarray(step * (np.round(between / step + apart) - apart))
