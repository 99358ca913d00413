"""Windows that stand for a long recording, where a method needs all of its rows at once.

Least squares, errors and checks of numbers are worked out of all samples, piece by piece and in little
memory. What compares a motion with itself (noise from repetition), or searches a library of effects
again and again, is not: of a recording with more rows than it can take, windows spread evenly over all
runs are looked at, long enough that a motion repeats inside one. Both ends are among them, so that what
changes from beginning to end is seen.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np

from sdp_vs_penalty.data.measurements import Measurements, concatenate
from sdp_vs_penalty.signals.preprocessing import Preprocessing

#: Rows at twice the cut-off that noise, residuals and a library of effects are judged on at most.
MOST = 4000
#: Windows of a single run.
_WINDOWS = 4


def window_subsample(measurements: Measurements, settings: Preprocessing) -> Measurements:
    """Windows of at most MOST rows in all, each a run of its own; all of a recording that has fewer.

    settings : resolved. Of many short runs some are taken whole.
    """
    assert settings.torque_cutoff is not None
    runs = measurements.runs()
    spans = [float(run.t[-1] - run.t[0]) for run in runs]
    allowed = MOST / (2.0 * settings.torque_cutoff)
    if sum(spans) <= allowed:
        return measurements
    slots = []
    for run, span in zip(runs, spans, strict=True):
        edges = np.linspace(0.0, span, max(1, int(span * _WINDOWS / allowed)) + 1)
        slots += [(run, a, b) for a, b in pairwise(edges.tolist())]
    count = max(1, int(len(slots) * allowed / sum(spans)))
    out = []
    for k in np.unique(np.linspace(0, len(slots) - 1, count).round().astype(int)):
        run, start, stop = slots[k]
        name = f"{run.names[0]}, {start:.4g} s to {stop:.4g} s"
        out.append(replace(run.window(start, stop), names=(name,)))
    return concatenate(out)


def subsample_sentence(part: Measurements, measurements: Measurements, what: str) -> str | None:
    """That ``what`` rests on windows only, and on how many; None where it rests on all."""
    if part is measurements:
        return None
    looked, there = (sum(float(r.t[-1] - r.t[0]) for r in m.runs()) for m in (part, measurements))
    return (
        f"Long recording: {what} {looked:.3g} s of its {there:.4g} s, "
        f"{len(part.names)} windows spread over it."
    )
