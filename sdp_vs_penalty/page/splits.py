"""One run alone: motion to identify from, motion to judge on, and what other splits show."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sdp_vs_penalty.data.files import windowed
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.diagnosis.diagnose import diagnose
from sdp_vs_penalty.diagnosis.doubts import Doubt
from sdp_vs_penalty.diagnosis.findings import Diagnosis, Finding
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimation.build_problem import PoseOptions, read_and_filter
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.estimation.identify import estimate_parameters
from sdp_vs_penalty.estimators.estimator import Progress, no_progress
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.signals.phases import (
    MotionClock,
    filter_reach,
    motion_clocks,
    phase_windows,
    rotated_windows,
    tracks_of,
)
from sdp_vs_penalty.signals.runs import moving_joints

Windows = list[tuple[float, float]]
#: Shares of a run's motion to identify from, in the order in which they are tried until
#: the filters leave enough to judge on.
SHARES = (0.7, 0.65, 0.6, 0.55, 0.5)
#: Share of the run behind the filters that is to be judged on, at least.
JUDGED_SHARE = 0.2
#: Splits of one run that are compared, its own among them.
N_SPLITS = 6
#: Share of the splits that have to show a confident finding.
CONFIRMED_SHARE = 2.0 / 3.0


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


def split_run(
    problem: Problem, run: Measurements, share: float | None = None
) -> dict[str, Any] | None:
    """Cut a run into windows to identify from, and windows to judge on.

    Parameters
    ----------
    problem : Problem
        Its filters decide how far the two keep apart.
    share : float or None
        Share of the motion to identify from; None: the largest one that leaves a fifth
        of the run to judge on.

    Returns
    -------
    dict or None
        Windows [s] "train" and "test", rounded so that a command can name them;
        "train_seconds", "test_seconds", "other_seconds" in neither; "share" of the motion for training;
        "judged_share" of the run behind the filters; "bar": side, begin and length [%
        of the run] of each window. None for a run that is too short.
    """
    try:
        cutting = _Cutting.for_run(problem, run)
    except InputError:  # no motion: the check says so
        return None
    best = _best_cut(cutting, SHARES if share is None else (share,))
    if best is None:
        return None
    chosen, windows, judged_share = best
    split: dict[str, Any] = {"share": chosen, "judged_share": judged_share, "bar": []}
    for side, stretches in zip(("train", "test"), windows, strict=True):
        split[side] = [(round(a, 3), round(b, 3)) for a, b in stretches]
        split[f"{side}_seconds"] = round(sum(b - a for a, b in stretches), 3)
        split["bar"] += [_piece(side, a, b, cutting.seconds) for a, b in stretches]
    used = split["train_seconds"] + split["test_seconds"]
    return split | {"other_seconds": cutting.seconds - used}


def _best_cut(
    cutting: _Cutting, shares: Sequence[float]
) -> tuple[float, tuple[Windows, Windows], float] | None:
    """Return the first of these training shares that leaves enough of the run to judge
    on.

    Returns
    -------
    tuple or None
        The share of the motion for training; its windows (begin, end) [s] for training
        and for testing; the share of the run that is judged. If no share leaves enough,
        it is the one that leaves most. None if the run is too short for all of them.
    """
    best = None
    for share in shares:
        windows = cutting.windows(share)
        if windows is None:
            continue
        _, testing = windows
        judged_share = cutting.judged_share(testing)
        if best is None or judged_share > best[2]:
            best = share, windows, judged_share
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


def other_splits(
    problem: Problem, run: Measurements, split: Mapping[str, Any]
) -> list[tuple[Windows, Windows]]:
    """List further splits of a run, whose tested stretches lie elsewhere in its motion.

    The tested stretches of the first split are moved along the motion's clock by 1, 2
    ... N_SPLITS - 1 steps. If they recur over the motion, they are moved between two of
    them.

    Parameters
    ----------
    problem : Problem
        Its filters decide how far training and testing keep apart.

    Returns
    -------
    list of (train, test)
        Windows (begin, end) [s] of each split, up to N_SPLITS - 1 of them.
    """
    cutting = _Cutting.for_run(problem, run)
    clock = cutting.clock
    length = float(clock.length if clock.periodic else cutting.seconds)
    first = [(a, b) for a, b in split["test"] if a < length]
    # Blocks that recur over the motion are moved within one of them.
    step = length / len(first) / N_SPLITS
    splits = []
    for k in range(1, N_SPLITS):
        rotated = rotated_windows(
            first, clock, cutting.seconds, k * step, cutting.pause, cutting.shortest
        )
        if (windows := cutting.with_motion(*rotated)) is not None:
            splits.append(windows)
    return splits


def confirmed(
    diagnosis: Diagnosis,
    model: Estimate,
    run: Measurements,
    splits: Sequence[tuple[Windows, Windows]],
    *,
    frozen: bool = False,
    progress: Progress = no_progress,
) -> Diagnosis:
    """Return a diagnosis with the number of splits that show each confident finding.

    The model is identified and diagnosed again on every split of the run. A confident
    finding that fewer than two thirds of the splits show becomes weak.

    Parameters
    ----------
    model : Estimate
        The model that was diagnosed.
    splits : sequence of (train, test)
        Windows of further splits, from :func:`other_splits`.
    frozen : bool
        Whether the model's parameters are held fixed; it is then not identified again.
    progress : callable
        Called with a short text before each split.

    Returns
    -------
    Diagnosis
        With `n_splits` and `n_splits_showing` of each confident finding.
    """
    shown = [_named(diagnosis)]
    for k, (train, test) in enumerate(splits, start=2):
        progress(f"the same on split {k} of {len(splits) + 1}")
        try:
            shown.append(_named(_diagnosed(model, run, train, test, frozen=frozen)))
        except InputError:  # too little is left of this split: it shows nothing
            continue
    effects = [_with_splits(finding, shown) for finding in diagnosis.effects]
    return replace(diagnosis, effects=tuple(effects))


def _diagnosed(
    model: Estimate, run: Measurements, train: Windows, test: Windows, *, frozen: bool
) -> Diagnosis:
    """Identify and diagnose a model anew on another split of the run.

    train, test : windows (begin, end) [s]; frozen : keep the model's parameters.
    """
    trained = windowed(run, train)
    if not frozen:
        model = estimate_parameters(
            model.problem,
            read_and_filter(model.problem, trained),
            model.method,
            PoseOptions(effects=model.model.effects),
        )
    return diagnose(
        model,
        trained,
        windowed(run, test),
        frozen=frozen,
        noise_from=run,
        judged_recordings=run,
    )


def _named(diagnosis: Diagnosis) -> set[tuple[str, tuple[int, ...]]]:
    """Return effect and joints of each finding that is more than weak.

    A near-tie counts as well: the torque is there, and this name fits it.
    """
    return {
        (finding.effect, finding.joints)
        for finding in diagnosis.effects
        if finding.rating != "weak"
    }


def _with_splits(
    finding: Finding, shown: Sequence[set[tuple[str, tuple[int, ...]]]]
) -> Finding:
    """Count how many splits show a confident finding; rate it weak if these are too
    few.

    shown : effect and joints of the findings of each split.
    """
    if finding.rating != "confident":
        return finding
    count = sum((finding.effect, finding.joints) in found for found in shown)
    counted = replace(finding, n_splits=len(shown), n_splits_showing=count)
    if count >= np.ceil(CONFIRMED_SHARE * len(shown) - 1e-9):
        return counted
    return replace(
        counted, confidence="weak", doubts=(*finding.doubts, Doubt("few_splits"))
    )
