"""One run alone: motion to identify from, and motion to judge on."""

from __future__ import annotations

from dataclasses import dataclass
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


@dataclass(frozen=True)
class _Cutting:
    """What a run is cut by."""

    #: The run.
    run: Measurements
    #: Clock of its motion.
    clock: MotionClock
    #: Length of the run [s].
    seconds: float
    #: Seconds of the log that a filtered row is made of [s].
    reach: float

    @classmethod
    def for_run(cls, problem: Problem, run: Measurements) -> _Cutting:
        """Read from a run how it can be cut: the clock of its motion, its duration, and
        the reach of the filters. Raises InputError for a run without motion.
        """
        settings = problem.preprocessing.resolve(run)
        (clock,) = motion_clocks(tracks_of(run))
        return cls(
            run=run,
            clock=clock,
            seconds=float(run.t[-1] - run.t[0]),
            reach=filter_reach(run, settings),
        )

    @property
    def pause(self) -> float:
        """Gap between training and testing [s]: half the filters' reach, so none
        sees both.
        """
        return 0.5 * self.reach

    @property
    def shortest(self) -> float:
        """Length [s] from which on the filters leave rows of a window."""
        return 1.5 * self.reach

    def windows(self, share: float) -> tuple[Windows, Windows] | None:
        """Return the windows (begin, end) [s] for training and for testing.

        share : share of the motion for training. None if the run is too short.
        """
        windows = phase_windows(
            self.clock, self.seconds, share, self.pause, self.shortest
        )
        return windows and self.with_motion(*windows)

    def with_motion(self, *sides: Windows) -> tuple[Windows, Windows] | None:
        """Return the windows for training and for testing in which a joint moves: of the
        others the filters leave no row. None where a side has none."""
        train, test = (
            [(a, b) for a, b in side if moving_joints(self.run.window(a, b)).any()]
            for side in sides
        )
        return (train, test) if train and test else None

    def judged_share(self, tested: Windows) -> float:
        """Return the share of the run's filtered rows that lie in the tested windows
        [-].

        The filters take their reach off each window (begin, end) [s], and off the run.
        """
        judged = sum(max(b - a - self.reach, 0.0) for a, b in tested)
        return judged / max(self.seconds - self.reach, 1e-9)


def split_run(problem: Problem, run: Measurements) -> dict[str, Any] | None:
    """Cut a run into windows to identify from, and windows to judge on.

    Parameters
    ----------
    problem : Problem
        Its filters decide how far the two keep apart.

    Returns
    -------
    dict or None
        Windows [s] "train" and "test", rounded so that a command can name them;
        "train_seconds", "test_seconds", "other_seconds" in neither; "bar": side, begin
        and length [% of the run] of each window. None for a run that is too short.
    """
    try:
        cutting = _Cutting.for_run(problem, run)
    except InputError:  # no motion: the check says so
        return None
    windows = _best_cut(cutting)
    if windows is None:
        return None
    split: dict[str, Any] = {"bar": []}
    for side, stretches in zip(("train", "test"), windows, strict=True):
        split[side] = [(round(a, 3), round(b, 3)) for a, b in stretches]
        split[f"{side}_seconds"] = round(sum(b - a for a, b in stretches), 3)
        split["bar"] += [_piece(side, a, b, cutting.seconds) for a, b in stretches]
    used = split["train_seconds"] + split["test_seconds"]
    return split | {"other_seconds": cutting.seconds - used}


def _best_cut(cutting: _Cutting) -> tuple[Windows, Windows] | None:
    """Return the windows (begin, end) [s] for training and for testing of the largest
    training share that leaves enough of the run to judge on, or else of the one that
    leaves most; None if the run is too short for all of them."""
    best, most = None, 0.0
    for share in SHARES:
        windows = cutting.windows(share)
        if windows is None:
            continue
        judged_share = cutting.judged_share(windows[1])
        if best is None or judged_share > most:
            best, most = windows, judged_share
        if judged_share >= JUDGED_SHARE:
            break
    return best


def _piece(side: str, start: float, stop: float, seconds: float) -> dict[str, Any]:
    """Return side, left edge and width [% of the run] of a window, for drawing it as
    a bar.
    """
    return {
        "side": side,
        "left": 100.0 * start / seconds,
        "width": 100.0 * (stop - start) / seconds,
    }
