"""Time stamps that are not those of the samples: packets that come in bursts, and jitter."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sdp_vs_penalty.check.issue import Issue
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.robot.arrays import Array

#: A time step above this many medians is no jitter any more.
LONG = 5.0
#: Stamps jitter for no reason if q is this many times rougher over them than over the row number.
_ROUGHER = 3.0
_ENOUGH = 50  # samples
#: In bursts the usual step is at most this share of the mean one.
_BURST = 0.1


def bursts(run: Measurements) -> Issue | None:
    """Stamps of packets: many rows at once, then a pause, although the motion goes on evenly."""
    steps = np.diff(run.t)
    typical = float(np.median(steps))
    pauses = np.flatnonzero(steps > LONG * typical)
    if len(pauses) < 10 or len(pauses) > 0.5 * len(steps):
        return None
    pause = float(np.median(steps[pauses]))
    per = float(np.median(np.diff(pauses)))
    if typical > _BURST * pause / per or np.mean(steps[pauses] < LONG * pause) < 0.9:
        return None
    even = pause / per
    return Issue(
        "burst stamps", "error", "column t",
        f"rows come in bursts of {per:.0f}, {typical:.2g} s apart, every {pause:.3g} s: these are the "
        "times of packets, not of samples.", "certain: read from the file",
        f"space the time stamps evenly, {even:.3g} s apart (and log the samples' own time)",
        lambda given: _evened(given, LONG * pause), {"rows_a_burst": per, "seconds": pause},
    )  # fmt: skip


def jitter(run: Measurements) -> Issue | None:
    """Stamps that jitter although the samples were taken evenly: q is smoother over the row number."""
    steps = np.diff(run.t)
    typical = float(np.median(steps))
    even = np.all(np.stack([steps[1:], steps[:-1]]) < LONG * typical, axis=0)
    spread = float(np.std(steps[steps < LONG * typical])) / typical
    moving = np.ptp(run.q, axis=0) > 0.0
    if spread < 0.02 or not moving.any() or np.count_nonzero(even) < _ENOUGH:
        return None
    share = (steps[:-1] / (run.t[2:] - run.t[:-2]))[:, None]
    over_time = run.q[1:-1] - (run.q[:-2] * (1.0 - share) + run.q[2:] * share)
    over_rows = run.q[1:-1] - 0.5 * (run.q[:-2] + run.q[2:])
    rough_time, rough_rows = (np.sqrt(np.mean(x[even] ** 2, axis=0)) for x in (over_time, over_rows))
    ratio = float(np.median((rough_time / np.maximum(rough_rows, 1e-300))[moving]))
    if ratio < _ROUGHER:
        return None
    return Issue(
        "jittered time stamps", "warning", "column t",
        f"the time steps vary by {100.0 * spread:.0f} %, but the positions are {ratio:.0f} times "
        "smoother over the row number than over these times: the samples are evenly spaced, the "
        "time stamps are not.",
        "likely: if the sampling itself jittered, the motion would be smoother over the recorded times",
        f"space the time stamps evenly, {typical:.6g} s apart",
        lambda given: _evened(given, LONG * float(np.median(np.diff(given.t)))),
        {"jitter_percent": 100.0 * spread, "roughness_ratio": ratio},
    )  # fmt: skip


def _evened(run: Measurements, pause: float) -> Measurements:
    """Evenly spread stamps between the steps that are longer than a pause."""
    t = run.t.copy()
    for part in np.split(np.arange(len(t)), np.flatnonzero(np.diff(t) > pause) + 1):
        t[part] = np.linspace(t[part[0]], t[part[-1]], len(part))
    return replace(run, t=t)


def with_steps(run: Measurements, steps: Array) -> Measurements:
    """The same rows, so far apart (N - 1,)."""
    return replace(run, t=run.t[0] + np.concatenate([[0.0], np.cumsum(steps)]))
