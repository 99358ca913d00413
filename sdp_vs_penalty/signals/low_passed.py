"""A few low-passed instants of a run, to judge data by."""

from __future__ import annotations

import numpy as np

from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.effects.effect import Motion
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.preprocessing import Preprocessing, RunFilter, no_rows


def low_passed(run: Measurements, settings: Preprocessing, rows: int) -> tuple[Motion, Array]:
    """At most so many evenly spread instants of one run: states and torque, low-passed.

    The torque passes the kernel that the position passes, and columns are computed from the states
    as they are: cheaper than :func:`filtered_rows`, and equal to it for slow motion. Enough to
    judge data, not to identify from. Stand-still is dropped. Raises InputError for short runs.
    """
    filters = RunFilter(run, settings)
    kernel = filters.state
    width = 2 * kernel.half + 1
    places = filters.moving(kernel.half)
    count = sum(len(k) for _, k in places)
    if count == 0:
        raise no_rows(run, (width - 1) * filters.dt)
    chosen = np.unique(np.linspace(0, count - 1, min(rows, count)).round().astype(int))
    pieces, start = [], 0
    for part, k in places:
        own = k[chosen[(chosen >= start) & (chosen < start + len(k))] - start]
        start += len(k)
        # Only what the kernel reaches of a long run is looked at.
        for at in np.split(own, np.flatnonzero(np.diff(own) > width) + 1):
            if len(at):
                begin, end = at[0] - kernel.half, at[-1] + kernel.half + 1
                states = kernel.states(part.resampled(part.q, begin, end))
                smooth, *_ = kernel.states(part.resampled(part.tau, begin, end))
                pieces.append((part.clock(at), *(x[at - at[0]] for x in (*states, smooth))))
    t, q, dq, ddq, tau = (np.concatenate(parts) for parts in zip(*pieces, strict=True))
    return Motion(t, q, dq, ddq), tau
