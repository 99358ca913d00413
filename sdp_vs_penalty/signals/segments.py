"""Measured runs cut into filtered segments: the rows on which noise is measured and
models are judged.

Three grids, all uniform:

- the log's: positions become q, dq, ddq there, and the torque is low-passed there;
- the column grid (30 times the low-pass's cut-off): columns of effects are computed there, fast
  enough for a friction that turns round within milliseconds;
- the rows: twice the cut-off, one row an independent sample. Columns and torque pass the same kernel,
  so that a linear relation between them survives, the folding of what lies above the row rate included.

Rows are dropped where the robot stands.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property, partial
from itertools import pairwise
from typing import Any, TypeAlias

import numpy as np

from sdp_vs_penalty.data.measurements import Measurements, concatenate
from sdp_vs_penalty.data.store import PART
from sdp_vs_penalty.effects.effect import Block, Effect, JointCoverage, Motion
from sdp_vs_penalty.effects.model import depends
from sdp_vs_penalty.memory import LONG_RECORDING
from sdp_vs_penalty.robot.arrays import Array, Indices, Mask
from sdp_vs_penalty.signals.coloured_noise import Pieces
from sdp_vs_penalty.signals.encoder import read_again
from sdp_vs_penalty.signals.filtered import FilteredRun, low_passed
from sdp_vs_penalty.signals.kernels import Decimator
from sdp_vs_penalty.signals.preprocessing import OVERSAMPLING, Preprocessing, RunFilter
from sdp_vs_penalty.signals.repetition import Filtered, Repeat, find_repeats
from sdp_vs_penalty.signals.runs import Stretch, split_at_gaps
from sdp_vs_penalty.signals.standstill import (
    SLOW,
    STILL,
    friction_laws,
    is_sliding,
    resolution,
    standstill_leakage,
    unexplained_standstill_torque,
)

#: Rows at twice the cut-off that noise, residuals and a library of effects are judged
#: on at most.
MAX_ROWS = 4000
#: Windows of a single run.
_WINDOWS = 4


#: Adds torques to a motion.
Attach: TypeAlias = Callable[[Motion], Motion]
#: Effects with their columns, by a key that effects with the same columns share.
CachedColumns: TypeAlias = dict[Hashable, tuple[Effect, list[Block]]]


@dataclass(frozen=True)
class SegmentColumns:
    """Low-passed columns of effects at the rows of all segments."""

    #: Low-pass (M, N) from the column grid to the rows, and motion, of each segment.
    parts: Sequence[tuple[Decimator, Motion]]
    #: Columns computed before, in two dictionaries: those that depend on the motion
    #: alone, which all models share, and those that depend on the torque and links of
    #: this model.
    cache: tuple[CachedColumns, CachedColumns] = field(default_factory=lambda: ({}, {}))

    def blocks(self, effect: Effect, keep: bool) -> list[Block]:
        """Return an effect's blocks of low-passed columns (M, k), one for each joint,
        per unit of true torque.

        Columns are taken from the cache if it has them; new ones are added to it if
        ``keep``.
        """
        # Columns with the sign of a velocity depend on the width [rad/s, m/s] over which
        # the smoothed sign turns.
        sign_width = None
        if self.parts and not effect.signless:
            _, motion = self.parts[0]
            sign_width = motion.sign_width
        key = type(effect), effect.joints, *effect.shape.items(), sign_width
        # The second cache is for columns that depend on a model's torque.
        of_motion, of_model = self.cache
        cache = of_model if depends(effect) else of_motion
        cached_effect, blocks = cache.get(key, (effect, None))
        if blocks is None or not cached_effect.same_columns(effect):
            blocks = self._make_columns(effect)
            if keep:
                cache[key] = effect, blocks
        return blocks

    def _make_columns(self, effect: Effect) -> list[Block]:
        """Make an effect's low-passed columns (M, k) at the rows of all segments, one
        block for each joint.

        They are made a few rows at a time to bound the memory, because the grid of
        columns is many times as fine as the rows: the more columns, the fewer rows at
        once. Effects with memory, and those that depend on a model's torque, need all
        rows of a segment at once.
        """
        needs_all_rows = depends(effect) or effect.has_memory
        chunks = list[list[Block]]()
        for low_pass, motion in self.parts:
            count = len(low_pass.at)
            step = count if needs_all_rows else PART // (2 * len(effect.parameters))
            for start in range(0, count, step):
                chunk_low_pass, chunk_motion = low_pass, motion
                if step < count:
                    chunk_low_pass, samples = low_pass.part(start, start + step)
                    chunk_motion = motion.part(samples)
                blocks = {0: effect.blocks(chunk_motion)}
                chunks.append(low_passed(chunk_low_pass, blocks)[0])
        joined = []
        for parts_of_block in zip(*chunks, strict=True):
            columns = np.concatenate([part.columns for part in parts_of_block])
            joined.append(replace(parts_of_block[0], columns=columns))
        return joined


@dataclass(frozen=True)
class Segment(Filtered):
    """One uninterrupted piece of a run, filtered: M rows of n joints."""

    #: Number of the run, from 0.
    run: int
    #: States on the column grid of N samples.
    motion: Motion
    #: (M, n) filtered torque at the rows [N m or N].
    torque: Array
    #: The stretch of the log.
    stretch: Stretch
    #: Returns the share (M, n) of each row that comes from a standstill of the joint
    #: [-].
    still: Callable[[], Array]
    #: Low-pass (M, N) from the column grid to the rows.
    low_pass: Decimator
    #: (D, n) filtered torque on the dense grid [N m or N].
    torque_dense: Array
    #: Low-pass (D, N) from the column grid to the dense grid of D samples.
    dense: Decimator

    @property
    def residual(self) -> Array:
        """(M, n) filtered measured torque less the attached model's torque [N m or N]."""
        return self.torque - self.low_pass @ self.motion.modelled


@dataclass(frozen=True)
class SegmentedRuns:
    """All segments of all runs, their M rows stacked in order."""

    #: The segments.
    segments: tuple[Segment, ...]
    #: Number of joints.
    n: int
    #: Cut-off of the torque's low-pass [Hz].
    cutoff: float
    #: Cut-off of the positions' low-pass [Hz].
    state_cutoff: float
    #: Rows per second [Hz].
    rate: float
    #: Names of the runs.
    names: tuple[str, ...]
    #: Columns of effects on the rows.
    columns: SegmentColumns
    #: Returns the rows whose motion comes back, and where.
    repeats: Callable[[], tuple[Repeat, ...]]
    #: Returns each run by itself, without a model, read by encoders whose steps lie
    #: elsewhere.
    with_shifted_encoders: Callable[[], Iterable[SegmentedRuns]]
    #: (M, n) flags of the rows that do not count for a joint although its segment keeps
    #: them (events).
    masked: Mask = field(default_factory=lambda: np.zeros((0, 0), bool))
    #: The arguments of :meth:`with_model`; empty without a model.
    attached: tuple[Any, ...] = ()
    #: (n,) gains of the torque channels (reading over true torque), if the attached
    #: model has them.
    gains: tuple[float, ...] | None = None

    @cached_property
    def t(self) -> Array:
        """(M,) instants of the rows [s]."""
        return np.concatenate([s.t for s in self.segments])

    @cached_property
    def run(self) -> Indices:
        """(M,) number of each row's run, from 0."""
        return np.concatenate([np.full(len(s.t), s.run) for s in self.segments])

    @cached_property
    def segment(self) -> Indices:
        """(M,) number of each row's segment, from 0."""
        return np.concatenate(
            [np.full(len(s.t), k) for k, s in enumerate(self.segments)]
        )

    @cached_property
    def q(self) -> Array:
        """(M, n) filtered positions [rad or m]."""
        return np.concatenate([s.low_pass @ s.motion.q for s in self.segments])

    @cached_property
    def dq(self) -> Array:
        """(M, n) filtered velocities [rad/s or m/s]."""
        return np.concatenate([s.low_pass @ s.motion.dq for s in self.segments])

    @cached_property
    def torque(self) -> Array:
        """(M, n) filtered measured torque [N m or N]."""
        return np.concatenate([s.torque for s in self.segments])

    @cached_property
    def residual(self) -> Array:
        """(M, n) filtered measured torque less the attached model's torque [N m or N]."""
        return np.concatenate([s.residual for s in self.segments])

    @cached_property
    def still(self) -> Array:
        """(M, n) share of each row that comes from a standstill of the joint."""
        return np.concatenate([s.still() for s in self.segments])

    @cached_property
    def slow(self) -> Array:
        """(M, n) share of each row that comes from instants at which a joint did not
        slide."""
        is_slow = ~is_sliding(np.concatenate([s.motion.dq for s in self.segments]))
        ends = np.cumsum([len(s.motion.dq) for s in self.segments])
        by_segment = np.split(is_slow, ends[:-1])
        shares = [
            abs(s.low_pass) @ slow_samples.astype(float)
            for s, slow_samples in zip(self.segments, by_segment, strict=True)
        ]
        return np.concatenate(shares)

    @cached_property
    def slides(self) -> Mask:
        """(M, n) rows in which a joint neither stands still nor turns round."""
        return (self.still <= STILL) & (self.slow <= SLOW)

    @property
    def mean_inertias(self) -> Array:
        """(n,) mean inertia of each joint in the current model [kg m^2 or kg]; NaN
        without one.
        """
        motion = self.segments[0].motion
        if motion.current is None:
            return np.full(motion.q.shape[1], np.nan)
        return motion.mean_inertias

    def coverage(self, joint: int) -> JointCoverage:
        """Return how much of a joint (from 0) the runs show: its travel and both ends
        of it, the resolution of its position, and how often it stands still.

        Returns
        -------
        JointCoverage
            Travel, its ends and resolution [rad or m], and the share of rows at
            standstill.
        """
        paths = np.concatenate([s.motion.q[:, joint] for s in self.segments])
        resolutions = [resolution(s.stretch.q[:, joint]) for s in self.segments]
        return JointCoverage(
            travel=float(np.ptp(paths)),
            resolution=float(max(resolutions)),
            stands=float(np.mean(self.still > STILL)),
            lowest=float(paths.min()),
            highest=float(paths.max()),
            step=max(s.stretch.dt for s in self.segments),
        )

    @cached_property
    def standstill_std(self) -> Array:
        """(M, n) standard deviation of the unknown friction torque of a joint that
        stands still [N m or N].

        Dry friction of a joint at rest may have any value up to its size. The size is
        estimated by the root mean square of the torque, less that of the links if a
        model is attached; each row has it times its share of standstill.
        """
        friction = self.torque
        if all(s.motion.current for s in self.segments):
            links = [s.low_pass @ s.motion.link_torque for s in self.segments]
            friction = friction - np.concatenate(links)
        n_rows = np.maximum(self.keep.sum(axis=0), 1)
        mean_square = np.sum(self.keep * friction**2, axis=0) / n_rows
        return np.sqrt(mean_square) * self.still

    @cached_property
    def encoder_error(self) -> Array:
        """(M, n) one random sample of the error that the encoders' resolution causes in the
        residual [N m or N].

        It is (r - r') / sqrt(2): r is the residual under the logged positions, r' that
        under the same motion read by encoders whose steps lie elsewhere.
        """
        residuals = dict[tuple[int, float], Array]()  # by run and first instant
        for index, shifted in enumerate(self.with_shifted_encoders()):
            if self.attached:
                attach, *_ = self.attached
                shifted = shifted.with_model(attach)
            for segment in shifted.segments:
                residuals[index, segment.t[0]] = segment.residual
        differences = []
        for s in self.segments:
            residual = s.residual
            # Read anew, a segment may seem to stand, and be left out.
            other = residuals.get((s.run, s.t[0]), residual)
            differences.append(residual - other)
        return np.concatenate(differences) / np.sqrt(2.0)

    @cached_property
    def unexplained_standstill_torque(self) -> tuple[Array, Mask]:
        """Torque at standstill that no usual law of friction explains (sliding
        friction, Dahl's law of any travel).

        Returns
        -------
        (M, n) array
            Its standard deviation in each row [N m or N]; 0 where the joint moves.
        (M, n) array of bool
            Rows at standstill to which no law of friction applies.
        """
        standstill_std = np.zeros_like(self.still)
        stuck = np.zeros(self.still.shape, bool)
        for j, share in enumerate(self.still.T):
            keep = self.keep[:, j]
            if share[keep].any():
                laws = np.concatenate(
                    [s.low_pass @ friction_laws(s.motion, j) for s in self.segments]
                )
                std, no_law = unexplained_standstill_torque(
                    self.residual[keep, j], laws[keep], share[keep]
                )
                standstill_std[:, j] = std * share
                stuck[:, j] = no_law & (share > STILL)
        return standstill_std, stuck

    @cached_property
    def keep(self) -> Mask:
        """(M, n) which rows count for which joint."""
        moves = np.concatenate([s.keep for s in self.segments])
        keep = np.repeat(moves[:, None], self.n, axis=1)
        return keep & ~self.masked if self.masked.size else keep

    @cached_property
    def pieces(self) -> list[Pieces]:
        """For each joint, the uninterrupted pieces of rows that count for it.

        A piece ends at the end of a segment, and where rows do not count.
        """
        index = np.arange(len(self.t))
        of_joints = []
        is_other_segment = np.diff(self.segment) != 0
        for keep in self.keep.T:
            is_cut = is_other_segment | (keep[1:] != keep[:-1])
            ends = np.flatnonzero(is_cut) + 1
            pieces = np.split(index, ends)
            of_joints.append(Pieces(piece for piece in pieces if keep[piece[0]]))
        return of_joints

    def with_model(
        self,
        attach: Attach,
        add_others: Attach = lambda motion: motion,
        gains: tuple[float, ...] | None = None,
    ) -> SegmentedRuns:
        """Return the runs with a model's torque attached to the motion of each segment.

        Parameters
        ----------
        attach : callable
            Returns a motion with the torques of the model and of its links added.
        add_others : callable, optional
            Returns a motion with the torques of other models, to which some columns
            refer.
        gains : (n,) tuple, optional
            The model's gains of the torque channels (reading over true torque) [-].

        Returns
        -------
        SegmentedRuns
            Cached columns that depend on the motion alone are kept; those that depend
            on another model are dropped.
        """
        segments = tuple(replace(s, motion=attach(s.motion)) for s in self.segments)
        parts = [(s.low_pass, add_others(s.motion)) for s in segments]
        columns = SegmentColumns(parts, (self.columns.cache[0], {}))
        return replace(
            self,
            segments=segments,
            columns=columns,
            attached=(attach, add_others, gains),
            gains=gains,
        )

    def blocks(self, effect: Effect, keep: bool = True) -> list[Block]:
        """Return an effect's columns at the rows, as the torque channels read them;
        ``keep`` caches them.

        Returns
        -------
        list of Block
            Columns (M, k), one block for each joint.
        """
        column_blocks = self.columns.blocks(effect, keep)
        if self.gains is None or effect.needs_torque:
            return column_blocks
        return [
            replace(b, columns=self.gains[b.joint] * b.columns) for b in column_blocks
        ]


def segmented(measurements: Measurements, settings: Preprocessing) -> SegmentedRuns:
    """Filter all runs, and cut them into segments at gaps of their clocks.

    Parameters
    ----------
    settings : Preprocessing
        Filters, resolved: their cut-off frequencies are numbers.

    Returns
    -------
    SegmentedRuns
        Stretches that are too short for the filters, or in which the arm stands, are
        left out; there may be no segment at all.
    """
    assert settings.torque_cutoff is not None
    assert settings.state_cutoff is not None
    measurements = measurements.cut_at_pauses
    segments: list[Segment] = []
    rate = 0.0
    for index, run in enumerate(measurements.runs()):
        filtered = FilteredRun(run, settings)
        if not filtered.has_rows:
            continue
        filters = filtered.filters
        for part in split_at_gaps(run):
            segment = _segment(index, part, filters)
            if segment is not None:
                segments.append(segment)
                rate = 1.0 / (filters.dt * filters.step(0.5 * OVERSAMPLING))

    def read_shifted() -> Iterator[SegmentedRuns]:
        """Yield each run, filtered as encoders read it whose steps lie elsewhere."""
        for run in measurements.runs():
            yield segmented(read_again(run), settings)

    is_long = measurements.samples >= LONG_RECORDING  # too much memory to keep all runs
    return SegmentedRuns(
        segments=tuple(segments),
        n=measurements.n,
        cutoff=settings.torque_cutoff,
        state_cutoff=settings.state_cutoff,
        rate=rate,
        names=measurements.names,
        columns=SegmentColumns([(s.low_pass, s.motion) for s in segments]),
        # A report whose noise is known never asks for repeats.
        repeats=cache(partial(find_repeats, segments)),
        with_shifted_encoders=(
            read_shifted if is_long else cache(lambda: list(read_shifted()))
        ),
    )


def _segment(index: int, part: Stretch, filters: RunFilter) -> Segment | None:
    """Filter one stretch of run ``index``; None where it is too short for the filters,
    or the arm stands all the time."""
    state = filters.state
    column = filters.column
    stride = filters.stride
    count = (part.count - 2 * state.half + stride - 1) // stride
    # Rows begin where both low-passes are filled: that of the columns, and that of the
    # torque, rounded up to the column grid.
    half = max(filters.coarse.half, -((state.half - column.half) // stride))
    # Half as many as a regression has; on the dense grid twice as many.
    step = filters.step(0.5 * OVERSAMPLING) // stride
    dense_step = filters.step(2.0 * OVERSAMPLING) // stride
    if count < 2 * half + 1 + 2 * step:
        return None
    grid = state.half + stride * np.arange(count)
    motion = filters.motion(part, state.half, part.count - state.half - 1)
    rows = np.arange(half, count - half, step)
    dense = np.arange(half, count - half, dense_step)
    low_pass = Decimator(filters.coarse, rows)

    keep = filters.movement.at(motion.t[rows])
    if not keep.any():
        return None
    leakage = partial(standstill_leakage, part, (state, column), grid[rows])
    return Segment(
        t=motion.t[rows],
        keep=keep,
        t_dense=motion.t[dense],
        q_dense=motion.q[dense],
        run=index,
        motion=motion,
        torque=filters.torque(part, grid[rows]),
        stretch=part,
        still=cache(leakage),  # most logs never ask for it
        low_pass=low_pass,
        torque_dense=filters.torque(part, grid[dense]),
        dense=Decimator(filters.coarse, dense),
    )


def window_subsample(
    measurements: Measurements, settings: Preprocessing
) -> Measurements:
    """Take windows of a long recording, for computations that need all rows at once.

    The windows are spread evenly over all runs, from the first to the last, and are
    long enough that a motion may repeat within one. Of many short runs some are taken
    whole.

    Parameters
    ----------
    settings : Preprocessing
        Filters, resolved: their cut-off frequencies are numbers.

    Returns
    -------
    Measurements
        Windows of about MAX_ROWS filtered rows in all, each as a run; the measurements
        themselves if they have fewer.
    """
    assert settings.torque_cutoff is not None
    measurements = measurements.cut_at_pauses
    runs = measurements.runs()
    spans = [float(run.t[-1] - run.t[0]) for run in runs]
    # Rows are independent at twice the cut-off a second.
    allowed = MAX_ROWS / (2.0 * settings.torque_cutoff)  # [s]
    if measurements.seconds <= allowed:
        return measurements
    # All runs are cut into slots of equal length, of which some are taken.
    slots = []
    for run, span in zip(runs, spans, strict=True):
        n_slots = max(1, int(span * _WINDOWS / allowed))
        edges = np.linspace(0.0, span, n_slots + 1)
        slots += [(run, a, b) for a, b in pairwise(edges.tolist())]
    count = max(1, int(len(slots) * allowed / sum(spans)))
    evenly = np.linspace(0, len(slots) - 1, count)
    places = evenly.round().astype(int)
    windows = []
    for place in np.unique(places):
        run, start, stop = slots[place]
        name = f"{run.names[0]}, {start:.4g} s to {stop:.4g} s"
        windows.append(replace(run.window(start, stop), names=(name,)))
    return concatenate(windows)


def subsample_sentence(
    windows: Measurements, recording: Measurements, subject_and_verb: str
) -> str | None:
    """Return the sentence that a result rests on windows of a long recording, and on
    how many; None if it rests on the complete recording. ``subject_and_verb`` is such as
    "the noise is measured on"."""
    recording = recording.cut_at_pauses
    if windows is recording:
        return None
    return (
        f"Long recording: {subject_and_verb} {windows.seconds:.3g} s of its"
        f" {recording.seconds:.4g} s, {len(windows.names)} windows spread over it."
    )
