"""Errors of timing: what a torque errs by where it changes fast.

A torque that is delta late errs by delta times its rate of change. Delta is never zero:
a torque that jumps between two samples is known to jump within a sample, clocks jitter,
and drives filter. So one sharp corner may err more than all the rest of a log, and yet
be nothing that happened to the arm.
"""

from collections.abc import Sequence

import numpy as np
import scipy

from sdp_vs_penalty.robot.arrays import Array, Indices
from sdp_vs_penalty.signals.segments import SegmentedRuns

#: Chance that the scatter of an error of timing makes it larger than its limit.
_CHANCE = 1e-3


def torque_rates(runs: SegmentedRuns) -> Array:
    """Return how fast the modelled torque changes in the samples of each row.

    The absolute rate is low-passed like the torque, in absolute values, so that the
    error of a row is at most the largest delta of its samples times this rate. The
    largest rate of all rows that share samples with a row counts.

    Parameters
    ----------
    runs : SegmentedRuns
        The rows, with the torque of a model.

    Returns
    -------
    (M, n) array
        Rates [N m/s or N/s].
    """
    rates = []
    for s in runs.segments:
        rate = np.abs(np.gradient(s.motion.modelled, s.motion.t, axis=0))
        of_rows = abs(s.low_pass) @ rate
        # A kernel reaches 2 / cut-off to each side.
        n_beside = int(np.ceil(2.0 / runs.cutoff * runs.rate))
        rates.append(scipy.ndimage.maximum_filter1d(of_rows, 2 * n_beside + 1, axis=0))
    return np.concatenate(rates)


def largest_timing_errors(
    errors: Array, rates: Array, stretches: Sequence[Indices]
) -> Array:
    """Return the largest errors that the rates of change explain.

    Delta is normally distributed. Its variance follows from the stretches: the largest
    squared error of a stretch is a + delta^2 rate^2, with the largest rate there and
    a >= 0 for what does not grow with the rate. The limit is exceeded with the
    probability 0.001.

    Parameters
    ----------
    errors : (M,) array
        Errors of a torque [N m or N].
    rates : (M,) array
        Rates of change of that torque [N m/s or N/s].
    stretches : sequence of int arrays
        Row numbers of the stretches that show how late the torque is: without the rows
        that are judged.

    Returns
    -------
    (M,) array
        Limits of the absolute errors [N m or N]; 0 with fewer than two stretches.
    """
    used = [rows for rows in stretches if len(rows)]
    if len(used) < 2:
        return np.zeros(len(errors))
    squares = np.array([np.max(errors[rows] ** 2) for rows in used])
    steepest = np.array([np.max(rates[rows] ** 2) for rows in used])
    size = max(float(steepest.mean()), np.finfo(float).tiny)
    columns = np.column_stack([np.ones(len(used)), steepest / size])
    _, slope = scipy.optimize.nnls(columns, squares)[0]
    variance = float(slope) / size  # of delta [s^2]
    return np.sqrt(float(scipy.special.chdtri(1, _CHANCE)) * variance) * rates
