"""Runs behind their filters: the rows on which models are fitted and judged, and where
they are kept.

A run is filtered when a model first needs its rows. They are cached, and so are the
low-passed columns of the last model's effects: the next model makes only the columns
that it does not share with the last one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from sdp_vs_penalty.data.measurements import Measurements, concatenate
from sdp_vs_penalty.data.store import PART, DiskCache
from sdp_vs_penalty.effects.effect import Block, Effect, Motion
from sdp_vs_penalty.effects.model import JointColumns, Model, depends
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.robot.arrays import Array, Indices, Mask
from sdp_vs_penalty.signals.constants import SAMPLES
from sdp_vs_penalty.signals.kernels import Decimator
from sdp_vs_penalty.signals.preprocessing import (
    OVERSAMPLING,
    Preprocessing,
    RunFilter,
    no_rows,
)
from sdp_vs_penalty.signals.runs import Movement, Stretch, split_at_gaps, still_seconds


@dataclass(frozen=True)
class Rows:
    """M filtered, decimated rows of one run, with the columns of the regression."""

    #: States (M, n) at the rows.
    motion: Motion
    #: (M, n) filtered torque [N m or N].
    torque: Array
    #: The regression's columns of each joint.
    columns: list[JointColumns]


@dataclass(frozen=True)
class FilteredChunk:
    """Consecutive filtered rows of a run, before a model makes columns of them."""

    #: States on the fine grid on which columns are made.
    column_motion: Motion
    #: Low-pass from the fine grid to the rows.
    low_pass: Decimator
    #: States on a coarser grid, enough for columns without jumps.
    smooth: Motion
    #: Low-pass from the coarser grid to the rows.
    smooth_low_pass: Decimator
    #: States at the M rows.
    rows: Motion
    #: (M, n) filtered torque at the rows [N m or N].
    torque: Array


#: A block of so many columns is filtered by a product of its own: a copy beside other
#: blocks would cost more.
_WIDE = 16

#: How to read an effect's low-passed columns.
Read = Callable[[], list[Block]]


@dataclass
class _ChunkCache:
    """Cache of one chunk of a run, and of the columns of the last model's effects on
    it."""

    #: Reads the chunk.
    read: Callable[[], FilteredChunk]
    #: File of a long run that holds the chunk and the columns of smooth effects, which
    #: take the longest; None if all is in memory.
    disk_cache: DiskCache | None
    #: Effects, the model's widths of a turning sign with which their columns were made,
    #: and how to read the columns.
    columns: list[tuple[Effect, tuple[float, ...], Read]] = field(default_factory=list)

    def rows(self, model: Model) -> Rows:
        """Return the rows of the chunk with the columns of a model, cached ones where
        there are any."""
        chunk = self.read()
        readers = self._column_readers(model)
        blocks = {place: read() for place, read in readers.items()}
        blocks |= _new_columns(chunk, model, blocks)
        self._cache_columns(model, readers, blocks)
        columns = model.joined(blocks, len(chunk.torque))
        return Rows(chunk.rows, chunk.torque, columns)

    def _column_readers(self, model: Model) -> dict[int, Read]:
        """Return the readers of cached columns that a model can use, by the effect's
        place in the model.

        Columns of an effect that turns with the sign of a velocity can be used again
        only where the sign turns over the same width.
        """
        width = model.sign_width
        readers = {}
        for place, effect in enumerate(model.effects):
            for cached_effect, cached_width, read in self.columns:
                has_same_width = effect.signless or cached_width == width
                if cached_effect.same_columns(effect) and has_same_width:
                    readers[place] = read
        return readers

    def _cache_columns(
        self,
        model: Model,
        readers: Mapping[int, Read],
        blocks: Mapping[int, list[Block]],
    ) -> None:
        """Cache the columns of a model's effects, ``blocks`` by the effect's place, in
        place of those of the last model; ``readers`` read those that are cached already.

        Left out are columns that depend on a current model's torque and, of a long run,
        those that are quick to make again.
        """
        self.columns = [
            (
                effect,
                model.sign_width,
                readers.get(k) or _stored(self.disk_cache, blocks[k]),
            )
            for k, effect in enumerate(model.effects)
            if not depends(effect) and (effect.smooth or self.disk_cache is None)
        ]


def _new_columns(
    chunk: FilteredChunk, model: Model, known: Mapping[int, list[Block]]
) -> dict[int, list[Block]]:
    """Make the low-passed columns, at the rows of a chunk, of a model's effects whose
    columns are not ``known`` yet; by the effect's place in the model.

    Smooth effects are made on the coarser grid, unless the model needs all columns on
    one grid.
    """
    smooth = None if model.needs_reference else chunk.smooth
    blocks = model.blocks(chunk.column_motion, known, smooth)
    if smooth is None:
        return low_passed(chunk.low_pass, blocks)
    is_smooth = {place: model.effects[place].smooth for place in blocks}
    on_coarse_grid = {k: block for k, block in blocks.items() if is_smooth[k]}
    on_fine_grid = {k: block for k, block in blocks.items() if not is_smooth[k]}
    filtered = low_passed(chunk.smooth_low_pass, on_coarse_grid)
    return filtered | low_passed(chunk.low_pass, on_fine_grid)


def low_passed(
    low_pass: Decimator, blocks: Mapping[int, list[Block]]
) -> dict[int, list[Block]]:
    """Filter effects' columns: narrow blocks by one product, which reads the low-pass
    once for all, each wide one by a product of its own, without a copy.

    Parameters
    ----------
    low_pass
        (K, N) filter from the N instants of a chunk to its K rows.
    blocks
        Columns (N, k) by the place of their effect in the model.

    Returns
    -------
    dict
        The same blocks with columns (K, k).
    """
    columns_by_place = {
        (effect, number): block.columns
        for effect, effect_blocks in blocks.items()
        for number, block in enumerate(effect_blocks)
    }
    narrow = {x: y for x, y in columns_by_place.items() if y.shape[1] < _WIDE}
    narrow_filtered = _filtered_together(low_pass, [*narrow.values()])
    filtered = dict(zip(narrow, narrow_filtered, strict=True))
    for place, columns in columns_by_place.items():
        if place not in narrow:
            filtered[place] = low_pass @ columns
    return {
        effect: [
            replace(block, columns=filtered[effect, number])
            for number, block in enumerate(effect_blocks)
        ]
        for effect, effect_blocks in blocks.items()
    }


def _filtered_together(low_pass: Decimator, columns: Sequence[Array]) -> list[Array]:
    """Filter arrays of columns, (N, k) each, by one product; return (M, k) of each."""
    if len(columns) < 2:
        return [low_pass @ x for x in columns]
    transposed = [x.T for x in columns]
    ends = np.cumsum([len(x) for x in transposed])
    return np.split(low_pass @ np.vstack(transposed).T, ends[:-1], axis=1)


@dataclass(eq=False)
class FilteredRun:
    """One run behind its filters.

    Asked for rows, it raises InputError for a run that is shorter than the filters
    need.
    """

    #: The run as logged.
    run: Measurements
    #: The filters' settings, resolved, so that cut-off frequencies are numbers.
    settings: Preprocessing
    #: Which instants count; None for those at which the run moves.
    movement_override: Movement | None = None
    #: Chunks read so far, by whether each stretch between gaps is one chunk.
    _chunk_caches: dict[bool, list[_ChunkCache]] = field(
        default_factory=dict, init=False, repr=False
    )

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle for another process without the rows, which it filters anew."""
        return FilteredRun, (self.run, self.settings, self.movement_override)

    @cached_property
    def filters(self) -> RunFilter:
        """The low-pass filters of the run's positions, columns and torques."""
        return RunFilter(self.run, self.settings)

    @property
    def moving(self) -> Movement:
        """Which instants become rows: by default those at which the arm moves."""
        return self.movement_override or self.filters.movement

    @cached_property
    def simulated(self) -> FilteredRun:
        """The simulated motion of the run, filtered, with rows at the same instants.

        The run's file has to hold simulated positions as the channel "qsim", and may
        hold their integral over time as "isim".
        """
        commanded = dict(self.run.commanded)
        if "isim" in commanded:
            # "isum" is the channel of the integral of the positions q.
            commanded["isum"] = commanded["isim"]
        run = replace(self.run, q=commanded["qsim"], commanded=commanded)
        return FilteredRun(run, self.settings, self.moving)

    def rows(self, model: Model) -> Iterator[Rows]:
        """Compute the regression rows, piece by piece.

        Parameters
        ----------
        model
            The model whose columns are computed.

        Returns
        -------
        Iterator of Rows
            One entry a piece of the run.
        """
        # What an effect with memory remembers has to be followed sample by sample, from
        # the start.
        uncut = any(effect.has_memory for effect in model.effects)
        return (chunk.rows(model) for chunk in self._pieces(uncut))

    def all_rows(self, model: Model) -> Rows:
        """Compute all regression rows at once.

        Parameters
        ----------
        model
            The model whose columns are computed.

        Returns
        -------
        Rows
            Motion, torque and columns of the run.
        """
        pieces = list(self.rows(model))
        torque = np.concatenate([p.torque for p in pieces])
        columns = [
            JointColumns(parts[0].indices, np.concatenate([p.columns for p in parts]))
            for parts in zip(*(p.columns for p in pieces), strict=True)
        ]
        return Rows(joined(p.motion for p in pieces), torque, columns)

    def states(self) -> Iterator[Motion]:
        """Return an iterator over the filtered states q, dq, ddq (M, n) at the rows of
        each chunk of the run; no columns of a model are made."""
        return (chunk.read().rows for chunk in self._pieces(uncut=False))

    @property
    def step(self) -> int:
        """Number of samples of the log from one row to the next."""
        return self.filters.step(OVERSAMPLING)

    @property
    def rows_per_sample(self) -> float:
        """Number of rows that are worth one independent sample, for white torque noise.

        A row has the variance sigma^2 sum h^2 of noise low-passed by h; within the pass
        band, where the columns are, the noise keeps its density, which at one row in
        ``step`` samples is that of independent rows of variance sigma^2 / step.
        """
        kernel = self.filters.column.value
        return float(1.0 / (self.step * (kernel @ kernel)))

    def _pieces(self, uncut: bool) -> list[_ChunkCache]:
        """Return the cached chunks of the run; the run is filtered on the first call.

        Chunks of a long run are kept in a file, those of a short one in memory. With
        ``uncut`` each stretch between gaps is one chunk with every sample of the log,
        which effects with memory need.
        """
        if uncut not in self._chunk_caches:
            is_long = self.run.q.size > SAMPLES
            disk_cache = DiskCache() if is_long else None
            caches = []
            for chunk in self._cut(uncut):
                caches.append(_ChunkCache(_stored(disk_cache, chunk), disk_cache))
            self._chunk_caches[uncut] = caches
        return self._chunk_caches[uncut]

    def _cut(self, uncut: bool) -> Iterator[FilteredChunk]:
        """Filter the run and yield its chunks; long stretches are cut at PART samples,
        unless ``uncut``. Raises InputError where the filters leave no row."""
        filters = self.filters.every_sample if uncut else self.filters
        has_rows = False
        for part, at, keep in self._places(uncut):
            has_rows = True
            yield _chunk(filters, part, at, keep)
        if not has_rows:
            raise no_rows(self.run, 2 * self._margin * filters.dt)

    @property
    def _margin(self) -> int:
        """Number of samples that the filters take from each end of a stretch."""
        return self.filters.state.half + self.filters.column.half

    def _places(self, uncut: bool) -> Iterator[tuple[Stretch, Indices, Mask]]:
        """Yield each chunk's stretch, its samples (K,) that may become rows, and which
        of them (K,) do; chunks without a row are left out."""
        is_whole = uncut or self.run.q.size <= SAMPLES
        for part in split_at_gaps(self.run):
            rows = np.arange(self._margin, part.count - self._margin, self.step)
            n_at_once = max(len(rows) if is_whole else PART // self.step, 1)
            for start in range(0, len(rows), n_at_once):
                at = rows[start : start + n_at_once]
                keep = self.moving.at(part.clock(at))
                if keep.any():
                    yield part, at, keep

    @property
    def has_rows(self) -> bool:
        """Whether the run is long enough for the filters, and moves."""
        try:
            return any(True for _ in self._places(uncut=False))
        except InputError:
            return False


def _stored(disk_cache: DiskCache | None, value: Any) -> Callable[[], Any]:
    """Put a value away, on the disk_cache or, without one, in memory; return what reads it."""
    return (lambda: value) if disk_cache is None else disk_cache.put(value)


def _chunk(filters: RunFilter, part: Stretch, at: Indices, keep: Mask) -> FilteredChunk:
    """Filter a stretch of the log around some of its samples.

    Both column grids begin half a kernel before the first sample, so that a row that
    lies s samples after it has the place s / stride + half on a grid.

    Parameters
    ----------
    part : Stretch
        A stretch of the log without gaps.
    at : (K,) array of int
        Samples of the stretch that may become rows.
    keep : (K,) array of bool
        Which of them do.
    """
    motion, smooth_motion = filters.around(part, at)
    since_first = at[keep] - at[0]  # samples of the log
    places = since_first // filters.stride + filters.coarse.half
    smooth_places = since_first // filters.smooth_stride + filters.smooth.half
    states = Motion(
        motion.t[places], motion.q[places], motion.dq[places], motion.ddq[places]
    )
    return FilteredChunk(
        column_motion=motion,
        low_pass=Decimator(filters.coarse, places),
        smooth=smooth_motion,
        smooth_low_pass=Decimator(filters.smooth, smooth_places),
        rows=states,
        torque=filters.torque(part, at[keep]),
    )


@dataclass(frozen=True)
class FilteredRuns:
    """Measurements behind filters, run by run."""

    #: The measurements as logged.
    measurements: Measurements
    #: The filters' settings, resolved.
    settings: Preprocessing
    #: The filtered runs.
    runs: tuple[FilteredRun, ...]

    @property
    def are_long(self) -> bool:
        """Whether they are too long to be kept in memory for later."""
        return self.measurements.q.size > SAMPLES

    @property
    def still_seconds(self) -> float:
        """How long the arm stands still in all runs [s]: such samples make no rows."""
        return sum(still_seconds(run.run, run.moving) for run in self.runs)

    @classmethod
    def filtering(
        cls, measurements: Measurements, settings: Preprocessing
    ) -> FilteredRuns:
        """Put runs behind filters; nothing is computed yet.

        Parameters
        ----------
        settings : Preprocessing
            The filters' settings. Numbers that are not given are chosen from the
            measurements.

        Returns
        -------
        FilteredRuns
            The filtered runs, cut at pauses of their clocks; rows are computed when
            they are used.
        """
        settings = settings.resolve(measurements)
        cut = measurements.cut_at_pauses
        runs = [FilteredRun(run, settings) for run in cut.runs()]
        if cut is not measurements:
            # A stretch in which the arm stands, or that is too short, is no run.
            runs_with_rows = [run for run in runs if run.has_rows]
            if 0 < len(runs_with_rows) < len(runs):
                cut = concatenate([run.run for run in runs_with_rows])
                runs = runs_with_rows
        return cls(cut, settings, tuple(runs))


def joined(pieces: Iterable[Motion]) -> Motion:
    """Join the states of several motions.

    Returns
    -------
    Motion
        Their states, one after the other.
    """
    motions = list(pieces)
    return Motion(
        np.concatenate([m.t for m in motions]),
        np.concatenate([m.q for m in motions]),
        np.concatenate([m.dq for m in motions]),
        np.concatenate([m.ddq for m in motions]),
    )
