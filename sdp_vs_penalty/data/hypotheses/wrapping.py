"""Angles that a controller cuts at a full turn."""

import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from sdp_vs_penalty import formatting
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.errors import Remark
from sdp_vs_penalty.robot.arrays import Array

#: Groups of positions, which can be angles.
POSITIONS = ("q", "qcmd", "qmot")
#: A step between two samples that is nearer to full turns than this is a cut [rad].
_TOLERANCE = 0.25 * np.pi


def unwrapped(
    run: Measurements, path: str | Path, groups: Sequence[str] = POSITIONS
) -> Measurements:
    """Undo the jumps by full turns of angles that a controller keeps within one turn.

    The means of the angles are moved to within half a turn of zero: a controller that
    counts from 0 to 360 degrees writes 350 for a joint at -10.

    Parameters
    ----------
    run : Measurements
        One run, whose positions in ``groups`` are angles [rad].
    path : str or Path
        How the remark that counts the jumps calls the file.
    groups : sequence of str
        Channel groups to mend, among q, qcmd and qmot.

    Returns
    -------
    Measurements
        The run with continuous angles; the run itself where no angle jumps.
    """
    blocks = dict(run.groups)
    n_cuts = 0
    for group in groups:
        if group not in blocks:
            continue
        turns = [_turns(angles) for angles in blocks[group].T]
        n_cuts_of_group = sum(int(np.count_nonzero(np.diff(x))) for x in turns)
        if n_cuts_of_group:
            continuous = blocks[group] - 2.0 * np.pi * np.column_stack(turns)
            turns_of_mean = np.round(np.nanmean(continuous, axis=0) / (2.0 * np.pi))
            blocks[group] = continuous - 2.0 * np.pi * turns_of_mean
            n_cuts += n_cuts_of_group
    if n_cuts == 0:
        return run
    places = formatting.count(n_cuts, "place")
    warning = f"{path}: angles are cut at a full turn in {places}: they go on there"
    warnings.warn(warning, Remark, stacklevel=2)
    return run.with_channels(run.t, blocks)


def _turns(angles: Array) -> Array:
    """Count the full turns by which each of the angles (N,) [rad] has jumped since the
    first sample.

    Returns (N,) turns, positive for jumps upwards. A step within a quarter of pi of
    full turns is a jump. Steps to or from NaN are none.
    """
    steps = np.diff(angles)
    steps = np.where(np.isfinite(steps), steps, 0.0)
    n_turns = np.round(steps / (2.0 * np.pi))
    is_cut = np.abs(steps - 2.0 * np.pi * n_turns) < _TOLERANCE
    turns_since_first = np.cumsum(np.where(is_cut, n_turns, 0.0))
    return np.concatenate([[0.0], turns_since_first])
