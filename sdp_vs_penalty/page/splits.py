"""One run alone: motion to identify from, and motion to judge on."""

from __future__ import annotations

from typing import Any

from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.signals.phases import (
    MotionClock,
    filter_reach,
    motion_clocks,
    phase_windows,
    tracks_of,
)
from sdp_vs_penalty.signals.runs import moving_joints

Windows = list[tuple[float, float]]
#: Shares of a run's motion to identify from, in the order in which they are tried until
#: the filters leave enough to judge on.
SHARES = (0.7, 0.65, 0.6, 0.55, 0.5)
#: Share of the run behind the filters that is to be judged on, at least.
JUDGED_SHARE = 0.2


def split_run(problem: Problem, run: Measurements) -> dict[str, Any] | None:
    """Cut a run into windows to identify from, and windows to judge on.

    Parameters
    ----------
    problem : Problem
        Its filters decide how far the two keep apart: by half of their reach on either
        side, so that none sees both.

    Returns
    -------
    dict or None
        Windows [s] "train" and "test", rounded so that a command can name them;
        "train_seconds", "test_seconds", "other_seconds" in neither; "bar": side, begin
        and length [% of the run] of each window. None for a run that is too short.
    """
    try:
        reach = filter_reach(run, problem.preprocessing.resolve(run))
        (clock,) = motion_clocks(tracks_of(run))
    except InputError:  # no motion: the check says so
        return None
    seconds = float(run.t[-1] - run.t[0])
    windows = _best_windows(run, clock, seconds, reach)
    if windows is None:
        return None
    split: dict[str, Any] = {"bar": []}
    for side, stretches in zip(("train", "test"), windows, strict=True):
        split[side] = [(round(a, 3), round(b, 3)) for a, b in stretches]
        split[f"{side}_seconds"] = round(sum(b - a for a, b in stretches), 3)
        split["bar"] += [
            {
                "side": side,
                "left": 100.0 * a / seconds,
                "width": 100.0 * (b - a) / seconds,
            }
            for a, b in stretches
        ]
    used = split["train_seconds"] + split["test_seconds"]
    return split | {"other_seconds": seconds - used}


def _best_windows(
    run: Measurements, clock: MotionClock, seconds: float, reach: float
) -> tuple[Windows, Windows] | None:
    """Return the windows (begin, end) [s] for training and for testing of the largest
    training share that leaves enough of the run to judge on, or else of the one that
    leaves most; None if the run is too short for all of them.

    The filters take their ``reach`` [s] off each window, and off the run; of windows in
    which no joint moves they leave no row.
    """
    best, most = None, 0.0
    for share in SHARES:
        cut = phase_windows(clock, seconds, share, 0.5 * reach, 1.5 * reach)
        train, test = (
            [(a, b) for a, b in side if moving_joints(run.window(a, b)).any()]
            for side in cut or ([], [])
        )
        if not (train and test):
            continue
        judged = sum(max(b - a - reach, 0.0) for a, b in test)
        judged /= max(seconds - reach, 1e-9)
        if best is None or judged > most:
            best, most = (train, test), judged
        if judged >= JUDGED_SHARE:
            break
    return best
