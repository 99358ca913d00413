"""Runs behind their filters: the rows on which models are fitted and judged, and where
they are kept.

A run's rows are cut when a model first asks for them. The next model finds them again,
and with them the low-passed columns of those effects that it shares with the last one:
nothing is filtered twice by what is given the same :class:`FilteredRuns`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.data.store import PART, DiskCache
from sdp_vs_penalty.effects.effect import Block, Effect, Motion
from sdp_vs_penalty.effects.model import JointColumns, Model, depends
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.constants import SAMPLES
from sdp_vs_penalty.signals.kernels import Decimator
from sdp_vs_penalty.signals.preprocessing import (
    OVERSAMPLING,
    Preprocessing,
    RunFilter,
    no_rows,
)
from sdp_vs_penalty.signals.runs import Movement, Stretch, split_at_gaps


@dataclass(frozen=True)
class Rows:
    """Filtered, decimated rows of one run: motion (M, n), torque (M, n), columns joint
    by joint."""

    motion: Motion
    torque: Array
    columns: list[JointColumns]


@dataclass(frozen=True)
class FilteredChunk:
    """Consecutive rows of a run before they have columns: the motion on the column grid
    around them, the low-pass from there to the rows, the same of smooth columns, motion
    and torque at the rows."""

    column_motion: Motion
    low_pass: Decimator
    smooth: Motion
    smooth_low_pass: Decimator
    rows: Motion
    torque: Array


#: How to read an effect's low-passed columns.
Read = Callable[[], list[Block]]


@dataclass
class _ChunkCache:
    """A piece, and the columns of the last model's effects on it: of each effect those
    over which velocities signs turned. shelf : of a long run, the file in which the
    piece lies, and the columns of smooth effects, which take the longest."""

    read: Callable[[], FilteredChunk]
    shelf: DiskCache | None
    columns: list[tuple[Effect, tuple[float, ...], Read]] = field(default_factory=list)

    def rows(self, model: Model) -> Rows:
        """The piece in the columns of a model."""
        piece = self.read()
        reads = self._reads(model)
        known = {k: read() for k, read in reads.items()}
        known |= _new_columns(piece, model, known)
        self._keep(model, reads, known)
        joined_columns = model.joined(known, len(piece.torque))
        columns, torque = model.without_known(joined_columns, piece.torque)
        return Rows(piece.rows, torque, columns)

    def _reads(self, model: Model) -> dict[int, Read]:
        """What reads the columns that are kept, by the effect's place in the model."""
        width = model.sign_width
        return {
            k: read
            for k, effect in enumerate(model.effects)
            for one, turned, read in self.columns
            if one.same_columns(effect) and (effect.signless or turned == width)
        }

    def _keep(
        self,
        model: Model,
        reads: Mapping[int, Read],
        known: Mapping[int, list[Block]],
    ) -> None:
        """Keep the columns that do not depend on a current model."""
        put = partial(partial, list) if self.shelf is None else self.shelf.put
        self.columns = [
            (effect, model.sign_width, reads.get(k) or put(known[k]))
            for k, effect in enumerate(model.effects)
            if not depends(effect) and (effect.smooth or self.shelf is None)
        ]


def _new_columns(
    piece: FilteredChunk,
    model: Model,
    known: Mapping[int, list[Block]],
) -> dict[int, list[Block]]:
    """The columns at the rows of the effects that are not known yet."""
    smooth = None if model.needs_reference else piece.smooth
    others = model.blocks(piece.column_motion, known, smooth)
    if smooth is None:
        return low_passed(piece.low_pass, others)
    smooth_places = [k for k in others if model.effects[k].smooth]
    of_smooth = {k: others.pop(k) for k in smooth_places}
    out = low_passed(piece.smooth_low_pass, of_smooth)
    return out | low_passed(piece.low_pass, others)


def low_passed(
    low_pass: Decimator, blocks: Mapping[int, list[Block]]
) -> dict[int, list[Block]]:
    """Filter effects' columns by one product, which reads the low-pass once for all.

    Parameters
    ----------
    low_pass
        The filter.
    blocks
        Columns by the place of their effect in the model.

    Returns
    -------
    dict
        The same with columns at the rows.
    """
    columns = [b.columns.T for effect_blocks in blocks.values() for b in effect_blocks]
    if not columns:
        return dict(blocks)
    ends = np.cumsum([len(x) for x in columns])
    filtered = low_pass @ np.vstack(columns).T
    parts = iter(
        np.split(
            filtered,
            ends[:-1],
            axis=1,
        )
    )
    return {
        k: [replace(b, columns=next(parts)) for b in effect_blocks]
        for k, effect_blocks in blocks.items()
    }


@dataclass(eq=False)
class FilteredRun:
    """One run behind its filters. settings : resolved; movement_override : which instants count
    (default: those at which the run moves).

    Raises InputError, when it is asked for rows, for a run that is shorter than the
    filters need.
    """

    run: Measurements
    settings: Preprocessing
    movement_override: Movement | None = None
    _kept: dict[bool, list[_ChunkCache]] = field(
        default_factory=dict,
        init=False,
        repr=False,
    )

    def __reduce__(self) -> tuple[Any, ...]:
        """Without rows: another process cuts them again."""
        return FilteredRun, (self.run, self.settings, self.movement_override)

    @cached_property
    def filters(self) -> RunFilter:
        """The run's filters."""
        return RunFilter(self.run, self.settings)

    @property
    def moving(self) -> Movement:
        """Which instants count."""
        return self.movement_override or self.filters.movement

    @cached_property
    def simulated(self) -> FilteredRun:
        """The motion "qsim" that the run holds beside its own, at the same instants."""
        commanded = dict(self.run.commanded)
        if "isim" in commanded:
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
        """The states at the rows, piece by piece, without columns: enough to judge
        data."""
        return (chunk.read().rows for chunk in self._pieces(False))

    @property
    def step(self) -> int:
        """Samples of the log from row to row."""
        return self.filters.step(OVERSAMPLING)

    @property
    def rows_per_sample(self) -> float:
        """How many rows hold as much of white torque noise as one independent sample.

        A row has the variance sigma^2 sum h^2 of noise low-passed by h; within the pass
        band, where the columns are, the noise keeps its density, which at one row in
        ``step`` samples is that of independent rows of variance sigma^2 / step.
        """
        kernel = self.filters.column.value
        return float(1.0 / (self.step * (kernel @ kernel)))

    def _pieces(self, uncut: bool) -> list[_ChunkCache]:
        """The run cut into pieces; ``uncut``: where effects remember, each stretch
        sample by sample."""
        if uncut not in self._kept:
            shelf = DiskCache() if self.run.q.size > SAMPLES else None
            put: Any = (lambda piece: lambda: piece) if shelf is None else shelf.put
            self._kept[uncut] = [
                _ChunkCache(put(piece), shelf) for piece in self._cut(uncut)
            ]
        return self._kept[uncut]

    def _cut(self, uncut: bool) -> Iterator[FilteredChunk]:
        """Filter the run, piece by piece; InputError where no row is left."""
        filters = self.filters.every_sample if uncut else self.filters
        margin = filters.state.half + filters.column.half
        is_whole = uncut or self.run.q.size <= SAMPLES
        has_rows = False
        for part in split_at_gaps(self.run):
            rows = np.arange(margin, part.count - margin, self.step)
            n_at_once = max(len(rows) if is_whole else PART // self.step, 1)
            for start in range(0, len(rows), n_at_once):
                at = rows[start : start + n_at_once]
                keep = self.moving.at(part.clock(at))
                if keep.any():
                    has_rows = True
                    yield _chunk(filters, part, at, keep)
        if not has_rows:
            raise no_rows(self.run, 2 * margin * filters.dt)


def _chunk(
    filters: RunFilter,
    part: Stretch,
    at: NDArray[np.int64],
    keep: NDArray[np.bool_],
) -> FilteredChunk:
    """Filter a stretch around the samples ``at``; of these the rows are the ones to
    keep."""
    motion, smooth = filters.around(part, at)
    since = at[keep] - at[0]
    local = since // filters.stride + filters.coarse.half
    coarse = since // filters.smooth_stride + filters.smooth.half
    states = Motion(
        motion.t[local],
        motion.q[local],
        motion.dq[local],
        motion.ddq[local],
    )
    return FilteredChunk(
        motion,
        Decimator(filters.coarse, local),
        smooth,
        Decimator(filters.smooth, coarse),
        states,
        filters.torque(part, at[keep]),
    )


@dataclass(frozen=True)
class FilteredRuns:
    """Measurements behind filters, ``settings`` resolved, run by run."""

    measurements: Measurements
    settings: Preprocessing
    runs: tuple[FilteredRun, ...]

    @classmethod
    def of(cls, measurements: Measurements, settings: Preprocessing) -> FilteredRuns:
        """Runs behind their filters.

        Parameters
        ----------
        measurements : Measurements
            The runs.
        settings : Preprocessing
            The filters' settings. Numbers that are not given are chosen from the measurements.

        Returns
        -------
        FilteredRuns
            The filtered runs; rows are computed when they are used.
        """
        settings = settings.resolve(measurements)
        return cls(
            measurements,
            settings,
            tuple(FilteredRun(r, settings) for r in measurements.runs()),
        )


def joined(pieces: Iterable[Motion]) -> Motion:
    """Join the states of several motions.

    Parameters
    ----------
    pieces
        The motions, in order.

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
