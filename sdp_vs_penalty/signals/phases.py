"""Splits by phase: repetitions of one motion never lie on both sides of a split.

A run that repeats itself, or another run, holds the same motion several times: if it
were cut by time, a model would be judged on motion that it has been fitted to. Every
split that the program makes goes by the clock of the motion instead: seconds since its
beginning, modulo its period where it has one, common to all its runs. A fold is one
stretch of every motion's clock; training keeps off it by a guard, because filtered rows
share samples of the log.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.robot.arrays import Array, Indices
from sdp_vs_penalty.signals.constants import SAMPLES
from sdp_vs_penalty.signals.preprocessing import Preprocessing, RunFilter
from sdp_vs_penalty.signals.repetition import (
    SAME_MOTION,
    Track,
    repeat_lag,
    repeat_period,
)
from sdp_vs_penalty.signals.runs import interpolated, sample_rate

#: A part of a motion's clock: where it begins and ends [s].
ClockPart: TypeAlias = tuple[float, float]
#: Rate at which positions are compared; motion holds little above half of it.
_LARGEST_TRACK_RATE_HZ = 100.0


@dataclass(frozen=True)
class MotionClock:
    """The clock of one run's motion."""

    #: Number of the motion; runs of the same number show the same motion.
    motion: int
    #: The run's instant at which its clock shows zero [s].
    start: float
    #: The period, or how long a motion lasts that does not repeat itself [s].
    length: float
    #: Whether the motion repeats itself within the run.
    periodic: bool

    def at(self, t: ArrayLike) -> Array:
        """Return the motion's clock at instants of the run.

        A periodic motion's clock starts anew with each period. Another's stops at its
        ends.

        Parameters
        ----------
        t : array
            Instants of the run [s].

        Returns
        -------
        array
            Seconds since the motion's beginning, in [0, length].
        """
        since = np.asarray(t, float) - self.start
        if self.periodic:
            return since % self.length
        return np.clip(since, 0.0, self.length)


def tracks_of(measurements: Measurements) -> list[Track]:
    """Return the positions of each run, thinned to find repeated motion in.

    The rate is 100 Hz at most, because a robot's motion holds little above half of it,
    and low enough that a run has no more than SAMPLES samples.

    Returns
    -------
    list of (t (M,), q (M, n))
        Instants [s] and positions of each run.
    """
    tracks = []
    for run in measurements.runs():
        span = float(run.t[-1] - run.t[0])
        rate = min(sample_rate(run), _LARGEST_TRACK_RATE_HZ, SAMPLES / span)
        t = run.t[0] + np.arange(int(span * rate) + 1) / rate
        q = interpolated(t, run.t, run.q)
        tracks.append((t, q))
    return tracks


def motion_clocks(tracks: Sequence[Track]) -> tuple[MotionClock, ...]:
    """Return a clock for each run, on which repeated motion has the same time.

    Parameters
    ----------
    tracks : sequence of (t (M,), q (M, n))
        Instants [s] and positions of each run.

    Returns
    -------
    tuple of MotionClock
        One a run. A run that repeats an earlier run's motion gets the clock of that
        run, shifted by the difference of their beginnings.
    """
    clocks: list[MotionClock] = []
    for number, track in enumerate(tracks):
        t = track[0]
        period = repeat_period(*track)
        length = float(t[-1] - t[0]) if period is None else period
        clock = MotionClock(
            motion=number, start=float(t[0]), length=length, periodic=period is not None
        )
        # The first of the earlier runs that shows the same motion lends its clock.
        for other, track_of_other in zip(clocks, tracks, strict=False):
            both_periodic = clock.periodic and other.periodic
            if both_periodic and abs(other.length - length) > SAME_MOTION * length:
                continue
            if both_periodic:
                # A little more than half a period reaches every phase.
                lag = repeat_lag(track_of_other, track, slip=0.6 * length)
            else:
                lag = repeat_lag(track_of_other, track)
            if lag is not None:
                clock = replace(other, start=other.start + lag)
                break
        clocks.append(clock)
    return tuple(clocks)


class _MotionCells(NamedTuple):
    """The cells of one motion."""

    #: Number of its first cell, among those of all motions.
    first: int
    #: Its clock.
    clock: MotionClock
    #: (K,) borders of its cells on that clock [s].
    edges: Array


@dataclass(frozen=True)
class PhaseFolds:
    """Folds of runs: fold k tests on the k-th of ``count`` equal stretches of every
    motion's clock."""

    #: The clocks of the runs, one a run.
    clocks: tuple[MotionClock, ...]
    #: Number of folds.
    count: int
    #: Time by which training keeps off the tested stretch, on either side and, where a
    #: motion is periodic, around its period [s].
    guard: float = 0.0

    def fold(self, run: int, t: ArrayLike) -> Indices:
        """Return the fold (N,), from 0, that tests on each instant t (N,) [s] of a run
        (from 0).

        The fold is floor(count phase), with the phase in [0, 1] of the motion's clock.
        """
        clock = self.clocks[run]
        phase = clock.at(t) / clock.length
        slot = np.floor(phase * self.count).astype(np.intp)
        return np.clip(slot, 0, self.count - 1)

    def cell(self, run: int, t: ArrayLike) -> Indices:
        """Return the cell (N,) in which each instant t (N,) [s] of a run (from 0) lies,
        counted from 0 through all motions.

        Cells cut each motion's clock at the borders of folds and of their guards, so
        that a fold tests, trains on or leaves out whole cells.
        """
        clock = self.clocks[run]
        cells = self._motions[clock.motion]
        inner = cells.edges[1:-1]
        return cells.first + np.searchsorted(inner, clock.at(t), side="right")

    @property
    def places(self) -> list[tuple[int, float, float]]:
        """For each cell (motion, begin, end): the number of its motion, and the
        instants on that motion's clock at which the cell begins and ends [s].
        """
        places = []
        for motion, cells in self._motions.items():
            for begin, end in pairwise(cells.edges.tolist()):
                places.append((motion, begin, end))
        return places

    def tested(self, fold: int) -> list[int]:
        """List the cells (from 0) on which a fold (from 0) tests.

        A cell is a stretch of a motion's clock between two borders of folds or guards.
        """
        return np.flatnonzero(self._seconds_to_stretch(fold) < 0.0).tolist()

    def training(self, fold: int) -> list[int]:
        """List the cells (from 0) on which a fold (from 0) trains: those farther than
        the guard from tested ones.

        A cell is a stretch of a motion's clock between two borders of folds or guards.
        """
        return np.flatnonzero(self._seconds_to_stretch(fold) >= self.guard).tolist()

    def stretch(self, fold: int) -> ClockPart:
        """Return the first and last instant [s] of a fold's stretch on the clock of the
        first run's motion."""
        length = self.clocks[0].length
        return fold * length / self.count, (fold + 1) * length / self.count

    @cached_property
    def _motions(self) -> dict[int, _MotionCells]:
        """The cells of each motion, by its number.

        Borders are those of the folds, and the guard's distance before and behind each.
        """
        motions = dict[int, _MotionCells]()
        first = 0
        clocks = {clock.motion: clock for clock in reversed(self.clocks)}
        for motion, clock in sorted(clocks.items()):
            edges = np.linspace(0.0, clock.length, self.count + 1)
            marks = np.concatenate([edges, edges - self.guard, edges + self.guard])
            marks = marks % clock.length if clock.periodic else marks
            marks = marks[(marks > 0.0) & (marks < clock.length)]
            borders = np.unique([0.0, *marks, clock.length])
            motions[motion] = _MotionCells(first, clock, borders)
            first += len(borders) - 1
        return motions

    def _seconds_to_stretch(self, fold: int) -> Array:
        """Return how far each cell's middle is from the stretch that a fold tests,
        (cells,) [s].

        The time is that of the motion's clock; on a periodic clock it is the shorter
        way round. It is -1 for cells within the stretch.
        """
        of_motions = list[Array]()
        for _, clock, edges in self._motions.values():
            middle = 0.5 * (edges[:-1] + edges[1:])
            begin = fold * clock.length / self.count
            to_begin = begin - middle
            from_end = middle - begin - clock.length / self.count
            # Both are negative within the stretch, one of them on either side of it.
            ways = np.array([to_begin, from_end])
            if clock.periodic:
                seconds = np.min(ways % clock.length, axis=0)
            else:
                seconds = np.max(ways, axis=0)
            is_within = np.all(ways < 0.0, axis=0)
            of_motions.append(np.where(is_within, -1.0, seconds))
        return np.concatenate(of_motions)


def phase_folds(
    measurements: Measurements, settings: Preprocessing, count: int
) -> PhaseFolds:
    """Cut runs into folds by the phase of their motion.

    The guard between training and testing is as long as the reach of the filters, so
    that no two rows on either side share a sample of the log.

    Parameters
    ----------
    settings : Preprocessing
        Filters, resolved: their cut-off frequencies are numbers.
    """
    guard = max(filter_reach(run, settings) for run in measurements.runs())
    return PhaseFolds(motion_clocks(tracks_of(measurements)), count, guard)


def filter_reach(run: Measurements, settings: Preprocessing) -> float:
    """Return the length [s] of the part of a run's log that one filtered row depends
    on: twice the half lengths of the low-passes of states and of columns.
    """
    filters = RunFilter(run, settings)
    return 2.0 * (filters.state.half + filters.column.half) * filters.dt


def phase_windows(
    clock: MotionClock, span: float, share: float, pause: float, shortest: float
) -> tuple[list[ClockPart], list[ClockPart]] | None:
    """Split one run into windows for training and windows for testing.

    The motion is cut into as many equal parts as there is room for, up to five; each
    begins with training and ends with testing, so that both see the whole run.

    Parameters
    ----------
    clock : MotionClock
        The run's clock, which starts at the run's first instant.
    span : float
        How long the run lasts [s].
    share : float
        Share of the motion, and of all its repetitions, that is for training, where the
        filters leave enough for testing.
    pause : float
        Time between training and testing [s]: half of what the filters take of a
        window.
    shortest : float
        Shortest window of which the filters leave something [s].

    Returns
    -------
    tuple of two lists of (float, float), or None
        Windows for training and for testing [s from the run's start]; None where the
        motion is too short, or repeats too fast.
    """
    length = float(clock.length if clock.periodic else span)
    parts = _largest_number_of_parts(length, share, pause, shortest)
    if parts is None:
        return None
    n_parts, trained = parts
    part = length / n_parts
    train = []
    test = []
    for repetition in np.arange(0.0, span, length).tolist():
        for number in range(n_parts):
            start = repetition + number * part
            train.append((start, min(start + trained, span)))
            is_end_of_run = not clock.periodic and number == n_parts - 1
            end = span if is_end_of_run else start + part - pause
            test.append((start + trained + pause, min(end, span)))
    train = [(begin, end) for begin, end in train if end - begin >= shortest]
    test = [(begin, end) for begin, end in test if end - begin >= shortest]
    return (train, test) if train and test else None


def _largest_number_of_parts(
    length: float, share: float, pause: float, shortest: float
) -> tuple[int, float] | None:
    """Return into how many parts a motion of some length [s] can be cut, and how long
    training is in each [s]; None where even one part is too short.

    A part is [trained, pause, tested, pause]. What the filters leave of ``tested`` is at
    least a fifth of it, and training keeps six tenths; half, if there is only one part.
    The arguments are those of :func:`phase_windows`.
    """
    for n_parts in range(5, 0, -1):
        part = length / n_parts
        tested = max((1.0 - share) * part, 0.2 * part + 2.0 * pause, shortest)
        trained = part - tested - 2.0 * pause
        smallest_share = 0.6 if n_parts > 1 else 0.5
        # 1e-9 allows for rounding.
        if trained >= max(shortest, smallest_share * part - 1e-9):
            return n_parts, trained
    return None
