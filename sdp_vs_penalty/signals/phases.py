"""Splits by phase: what a motion repeats never lies on both sides of one.

A run that repeats itself, or another run, holds the same motion several times: cut by
time, a model would be judged on what it has been fitted to. Every split that the
program makes goes by the clock of the motion instead: seconds since its beginning,
modulo its period where it has one, common to all runs that show it. A fold is one
stretch of every motion's clock; training keeps off it by a guard, because filtered rows
share samples of the log.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.constants import SAMPLES
from sdp_vs_penalty.signals.preprocessing import Preprocessing, RunFilter
from sdp_vs_penalty.signals.repetition import ALIKE, Track, repeat_lag, repeat_period
from sdp_vs_penalty.signals.runs import interpolated, sample_rate


@dataclass(frozen=True)
class MotionClock:
    """The clock of one run's motion.

    motion : runs of the same number show the same motion; start [s] : the run's instant
    at which its clock shows zero; length [s] : the period, or how long a motion lasts
    that does not repeat itself.
    """

    motion: int
    start: float
    length: float
    periodic: bool

    def at(self, t: ArrayLike) -> Array:
        """Read the motion's clock.

        Parameters
        ----------
        t
            Instants of the run [s].

        Returns
        -------
        Array
            Seconds in [0, length].
        """
        since = np.asarray(t, float) - self.start
        if self.periodic:
            return np.asarray(since % self.length)
        return np.asarray(np.clip(since, 0.0, self.length))


def tracks_of(measurements: Measurements) -> list[Track]:
    """Positions of each run, thinned to 100 Hz at most; motion holds little above.

    Parameters
    ----------
    measurements : Measurements
        The runs.

    Returns
    -------
    list of Track
        One a run.
    """
    out = []
    for run in measurements.runs():
        span = float(run.t[-1] - run.t[0])
        rate = min(sample_rate(run), 100.0, SAMPLES / span)
        t = run.t[0] + np.arange(int(span * rate) + 1) / rate
        out.append((t, interpolated(t, run.t, run.q)))
    return out


def motion_clocks(tracks: Sequence[Track]) -> tuple[MotionClock, ...]:
    """Clocks of the runs, on which repeated motion has the same time.

    Parameters
    ----------
    tracks : sequence of Track
        Positions of each run.

    Returns
    -------
    tuple of MotionClock
        One a run. Runs that repeat each other share a clock.
    """
    clocks: list[MotionClock] = []
    for k, track in enumerate(tracks):
        t = track[0]
        period = repeat_period(*track)
        length = float(t[-1] - t[0]) if period is None else period
        clock = MotionClock(
            k,
            float(t[0]),
            length,
            period is not None,
        )
        for other, there in zip(clocks, tracks, strict=False):
            both = clock.periodic and other.periodic
            if both and abs(other.length - length) > ALIKE * length:
                continue
            lag = repeat_lag(
                there,
                track,
                *([0.6 * length] if both else []),
            )
            if lag is not None:
                clock = replace(other, start=other.start + lag)
                break
        clocks.append(clock)
    return tuple(clocks)


@dataclass(frozen=True)
class PhaseFolds:
    """Folds of runs: fold k tests on the k-th of ``count`` equal stretches of every
    motion's clock.

    clocks : one a run; guard [s] : by which training keeps off the tested stretch, on
    either side and, where a motion is periodic, around its period.
    """

    clocks: tuple[MotionClock, ...]
    count: int
    guard: float = 0.0

    def fold(
        self,
        run: int,
        t: ArrayLike,
    ) -> NDArray[np.intp]:
        """Index of the fold that tests on given instants.

        Parameters
        ----------
        run : int
            Index of the run.
        t : (N,) array
            Instants [s].

        Returns
        -------
        (N,) array of int
            Folds.
        """
        clock = self.clocks[run]
        phase = clock.at(t) / clock.length
        slot = np.floor(phase * self.count).astype(np.intp)
        return np.clip(slot, 0, self.count - 1)

    def cell(
        self,
        run: int,
        t: ArrayLike,
    ) -> NDArray[np.intp]:
        """Index of the cell in which given instants lie, between two borders of folds or guards.

        Parameters
        ----------
        run : int
            Index of the run.
        t : (N,) array
            Instants [s].

        Returns
        -------
        (N,) array of int
            Cells.
        """
        clock = self.clocks[run]
        first, _, edges = self._motions[clock.motion]
        inner = edges[1:-1]
        return first + np.searchsorted(inner, clock.at(t), side="right")

    @property
    def places(self) -> list[tuple[int, float, float]]:
        """Of each cell its motion, and where it begins and ends on that motion's clock
        [s]."""
        motions = self._motions.items()
        return [
            (k, a, b)
            for k, (_, _, edges) in motions
            for a, b in pairwise(edges.tolist())
        ]

    def tested(self, fold: int) -> list[int]:
        """Cells on which a fold tests.

        Parameters
        ----------
        fold : int
            Index of the fold.

        Returns
        -------
        list of int
            Cells.
        """
        return np.flatnonzero(self._apart(fold) < 0.0).tolist()

    def training(self, fold: int) -> list[int]:
        """Cells on which a fold trains.

        Parameters
        ----------
        fold : int
            Index of the fold.

        Returns
        -------
        list of int
            Cells.
        """
        return np.flatnonzero(self._apart(fold) >= self.guard).tolist()

    def stretch(self, fold: int) -> tuple[float, float]:
        """First and last instant of a fold on the clock of the first motion.

        Parameters
        ----------
        fold : int
            Index of the fold.

        Returns
        -------
        tuple of float
            Instants [s].
        """
        length = self.clocks[0].length
        return fold * length / self.count, (fold + 1) * length / self.count

    @cached_property
    def _motions(self) -> dict[int, tuple[int, MotionClock, Array]]:
        """Of each motion the number of its first cell, its clock, and the borders of
        its cells on it."""
        out = dict[int, tuple[int, MotionClock, Array]]()
        first = 0
        clocks = {clock.motion: clock for clock in reversed(self.clocks)}
        for motion, clock in sorted(clocks.items()):
            edges = np.linspace(0.0, clock.length, self.count + 1)
            marks = np.concatenate(
                [
                    edges,
                    edges - self.guard,
                    edges + self.guard,
                ]
            )
            marks = marks % clock.length if clock.periodic else marks
            marks = marks[(marks > 0.0) & (marks < clock.length)]
            out[motion] = first, clock, np.unique([0.0, *marks, clock.length])
            first += len(out[motion][2]) - 1
        return out

    def _apart(self, fold: int) -> Array:
        """Seconds on its clock from each cell to a fold's stretch, the shorter way; -1
        within it."""
        out = list[Array]()
        for _, clock, edges in self._motions.values():
            middle = 0.5 * (edges[:-1] + edges[1:])
            begin = fold * clock.length / self.count
            before = begin - middle
            after = middle - begin - clock.length / self.count
            ways = np.array([before, after])
            if clock.periodic:
                apart = np.min(ways % clock.length, axis=0)
            else:
                apart = np.max(ways, axis=0)
            is_within = np.all(ways < 0.0, axis=0)
            out.append(np.where(is_within, -1.0, apart))
        return np.concatenate(out)


def phase_folds(
    measurements: Measurements,
    settings: Preprocessing,
    count: int,
) -> PhaseFolds:
    """Folds of runs, guarded by the reach of the filters; ``settings`` must be
    resolved.

    Two rows farther apart than the guard share no sample of the log.
    """
    guard = max(filter_reach(run, settings) for run in measurements.runs())
    return PhaseFolds(motion_clocks(tracks_of(measurements)), count, guard)


def filter_reach(run: Measurements, settings: Preprocessing) -> float:
    """Seconds of a run's log that one filtered row is made of."""
    filters = RunFilter(run, settings)
    return 2.0 * (filters.state.half + filters.column.half) * filters.dt


def phase_windows(
    clock: MotionClock,
    span: float,
    share: float,
    pause: float,
    shortest: float,
) -> tuple[list[tuple[float, float]], list[tuple[float, float]]] | None:
    """One run split in two: windows [s from its start] for training, and windows for
    testing.

    The motion is cut into as many equal parts as there is room for, up to five; each
    begins with training and ends with testing, so that both see the whole run. What the
    filters leave of the tested windows is at least a fifth of the motion.

    clock : of the run, whose start is its own first instant; span [s] : how long it
    lasts; share : of the motion that is for training, all its repetitions with it,
    where the filters leave enough beside it; pause [s] : between the two, half of what
    the filters take of a window; shortest [s] : of what the filters leave something.
    None where the motion is too short, or repeats too fast, for two such parts.
    """
    length = float(clock.length if clock.periodic else span)
    for n_parts in range(5, 0, -1):
        part = length / n_parts
        tested = max(
            (1.0 - share) * part,
            0.2 * part + 2.0 * pause,
            shortest,
        )
        trained = part - tested - 2.0 * pause
        most_trained = 0.6 if n_parts > 1 else 0.5
        if trained >= max(shortest, most_trained * part - 1e-9):
            break
    else:
        return None
    train = []
    test = []
    for begin in np.arange(0.0, span, length).tolist():
        for k in range(n_parts):
            start = begin + k * part
            train.append((start, min(start + trained, span)))
            is_end = not clock.periodic and k == n_parts - 1
            end = span if is_end else start + part - pause
            test.append((start + trained + pause, min(end, span)))
    long_enough = [
        [(a, b) for a, b in windows if b - a >= shortest] for windows in (train, test)
    ]
    return (long_enough[0], long_enough[1]) if all(long_enough) else None


def rotated_windows(
    tested: Sequence[tuple[float, float]],
    clock: MotionClock,
    span: float,
    offset: float,
    pause: float,
    shortest: float,
) -> tuple[list[tuple[float, float]], list[tuple[float, float]]]:
    """The windows of another split of a run: the tested stretches of the motion lie
    ``offset`` later, and training is all that keeps off them.

    Parameters
    ----------
    tested : sequence of (float, float)
        Stretches of the motion's clock that the first split tests on [s].
    clock : MotionClock
        Of the run, whose start is its own first instant.
    span : float
        How long the run lasts [s].
    offset : float
        By which they are moved along the clock [s]; past its end they go on at its
        beginning.
    pause : float
        Between training and testing [s].
    shortest : float
        Windows below this length are left out [s].

    Returns
    -------
    tuple of two lists of (float, float)
        Windows for training and for testing [s from the run's start].
    """
    length = float(clock.length if clock.periodic else span)
    test = _turned(tested, offset, length)
    guarded = [(a - pause, b + pause) for a, b in test]
    if clock.periodic:
        guarded += [
            (a + turn, b + turn) for a, b in guarded for turn in (-length, length)
        ]
    train = _gaps(guarded, length)
    begins = np.arange(0.0, span, length).tolist()
    return (
        _in_run(train, begins, span, shortest),
        _in_run(test, begins, span, shortest),
    )


def _turned(
    stretches: Sequence[tuple[float, float]],
    offset: float,
    length: float,
) -> list[tuple[float, float]]:
    """Stretches of a clock moved by an offset; one that passes its end is cut there."""
    moved = []
    for a, b in stretches:
        start = (a + offset) % length
        end = start + b - a
        moved.append((start, min(end, length)))
        if end > length:
            moved.append((0.0, end - length))
    return sorted(moved)


def _gaps(
    taken: Sequence[tuple[float, float]],
    length: float,
) -> list[tuple[float, float]]:
    """What stretches leave of a clock from 0 to its length."""
    free = []
    reached = 0.0
    for a, b in sorted(taken):
        if a > reached:
            free.append((reached, min(a, length)))
        reached = max(reached, b)
    if reached < length:
        free.append((reached, length))
    return free


def _in_run(
    stretches: Sequence[tuple[float, float]],
    begins: Sequence[float],
    span: float,
    shortest: float,
) -> list[tuple[float, float]]:
    """Stretches of the clock in every repetition of a run; those that meet are one."""
    windows: list[tuple[float, float]] = []
    for begin in begins:
        for a, b in stretches:
            window = (begin + a, min(begin + b, span))
            if windows and abs(windows[-1][1] - window[0]) < 1e-9:
                window = (windows.pop()[0], window[1])
            windows.append(window)
    return [(a, b) for a, b in windows if b - a >= shortest]
