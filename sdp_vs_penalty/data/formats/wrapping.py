"""Angles that a controller cuts at a full turn."""

import warnings
from collections.abc import Sequence
from dataclasses import replace
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
    run: Measurements,
    path: str | Path,
    groups: Sequence[str] = POSITIONS,
) -> Measurements:
    """The run with angles that go on where they were cut at a full turn, their means
    within half a turn of zero.

    Parameters
    ----------
    run : one run whose positions in ``groups`` are angles [rad]
    path : how the remark that counts the cuts calls the file
    groups : of positions

    Returns
    -------
    Measurements
        The run itself where nothing was cut.
    """
    blocks = dict(run.groups)
    n_cuts = 0
    for group in groups:
        if group not in blocks:
            continue
        turns = [_turns(column) for column in blocks[group].T]
        n_of_group = sum(int(np.count_nonzero(np.diff(x))) for x in turns)
        if n_of_group:
            going_on = blocks[group] - 2.0 * np.pi * np.column_stack(turns)
            # A controller of 0 to 360 degrees says 350 of a joint at -10.
            middle = np.round(np.nanmean(going_on, axis=0) / (2.0 * np.pi))
            blocks[group] = going_on - 2.0 * np.pi * middle
            n_cuts += n_of_group
    if n_cuts == 0:
        return run
    places = formatting.count(n_cuts, "place")
    warning = f"{path}: angles are cut at a full turn in {places}: they go on there"
    warnings.warn(warning, Remark, stacklevel=2)
    mended = Measurements.of(
        run.t,
        blocks,
        run.names,
        run.run,
    )
    return replace(mended, joint_names=run.joint_names)


def _turns(angles: Array) -> Array:
    """(N,) whole turns by which angles (N,) [rad] have been moved since the first."""
    steps = np.diff(angles)
    steps = np.where(np.isfinite(steps), steps, 0.0)
    n_turns = np.round(steps / (2.0 * np.pi))
    is_cut = np.abs(steps - 2.0 * np.pi * n_turns) < _TOLERANCE
    return np.concatenate(
        [
            [0.0],
            np.cumsum(np.where(is_cut, n_turns, 0.0)),
        ]
    )
