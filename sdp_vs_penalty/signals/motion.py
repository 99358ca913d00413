"""Which motion a model has been trained on, and how much of another one is new to it.

A model judged on motion that it was trained on shows its repeatability, not how it does
elsewhere. So a model keeps a record of its training motion: the path of (q, dq), behind
the filters, each coordinate in units of its spread. Motion is new where some joint's
position or velocity is farther than ``distance`` spreads from every point of that path.
The path is kept as straight lines between few points, and what comes back is kept once;
both stay far below the distance, so that neither makes a repeated motion new.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from sdp_vs_penalty.data.store import PART
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.files import JsonRecord
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.filtered import FilteredRuns
from sdp_vs_penalty.signals.runs import interpolated, spans

#: Motion is new beyond so many spreads of the training motion. A path of more than
#: ``_MOST`` numbers is kept more coarsely, with a distance that grows alike, twice and
#: four times as far; then not at all.
DISTANCE = 0.1
_MOST = 100_000
#: In units of the distance: how far the lines may pass beside a row, how near a row
#: counts as there already, and the spacing at which lines are looked up.
_NEAR = 0.2


@dataclass(frozen=True)
class MotionRecord(JsonRecord):
    """The path of a training motion.

    centre, scale (2 n,) of q [rad or m] and dq; lines : stretches (K, 2 n) of points on
    the path, less the centre, over the scale; distance : beyond which motion is new, in
    units of the scale.
    """

    centre: Array
    scale: Array
    lines: tuple[Array, ...]
    distance: float

    def __post_init__(self) -> None:
        rows = np.concatenate(
            [
                self.centre[None],
                self.scale[None],
                *self.lines,
            ]
        )
        if not (self.lines and np.all(np.isfinite(rows))):
            raise ValueError("training_motion: not numbers for each joint")
        if not (np.all(self.scale > 0.0) and self.distance > 0.0):
            raise ValueError("training_motion: a scale is not above 0")

    def new_share(self, runs: FilteredRuns) -> float | None:
        """Share of the runs' filtered rows that are new: not within the distance of any
        point. None where the filters leave none."""
        tree = _tree(self.lines, self.distance)
        near = [
            _near(
                tree,
                (x - self.centre) / self.scale,
                self.distance,
            )
            for x in _paths(runs)
        ]
        if not near:
            return None
        return 1.0 - float(np.mean(np.concatenate(near)))

    def joined(self, other: MotionRecord) -> MotionRecord | None:
        """The motion of both, in units of this one's spread; None where that is too
        much to keep."""
        there = [
            (line * other.scale + other.centre - self.centre) / self.scale
            for line in other.lines
        ]
        distance = max(self.distance, other.distance)
        lines = [*self.lines, *there]
        return _record(self.centre, self.scale, lambda: lines, distance)


def record_motion(runs: FilteredRuns) -> MotionRecord | None:
    """The record of the runs' rows, in the memory of a part of them.

    None where the filters leave no row, or where there is more motion than a record can
    keep.
    """
    count = 0
    n = runs.measurements.n
    first = total = square = np.zeros(2 * n)
    for rows in _paths(runs):
        first = first if count else rows[0]
        count = count + len(rows)
        displacement = rows - first
        total = total + displacement.sum(axis=0)
        square = square + np.sum(displacement**2, axis=0)
    if not count:
        return None
    variance = square / count - (total / count) ** 2
    spread = np.sqrt(np.maximum(variance, 0.0)).reshape(2, n)
    # A coordinate that stays within that distance of the largest one's is measured in
    # it instead: the noise of a joint that hardly moves is no motion.
    smallest = DISTANCE * spread.max(axis=1, keepdims=True)
    scale = np.maximum(spread, smallest).ravel()
    centre = first + total / count
    if not np.all(scale > 0.0):
        return None

    def scaled_paths() -> Iterator[Array]:
        return ((x - centre) / scale for x in _paths(runs))

    return _record(centre, scale, scaled_paths, DISTANCE)


def _paths(runs: FilteredRuns) -> Iterator[Array]:
    """Of the runs' filtered rows consecutive ones (M, 2 n), M > 0, of q and dq."""
    for run in runs.runs:
        with suppress(InputError):  # no rows
            longest_step = 1.5 * run.step * run.filters.dt
            for motion in run.states():
                gaps = np.flatnonzero(np.diff(motion.t) > longest_step) + 1
                yield from np.split(np.hstack([motion.q, motion.dq]), gaps)


def _record(
    centre: Array,
    scale: Array,
    paths: Callable[[], Iterable[Array]],
    distance: float,
) -> MotionRecord | None:
    """Paths (in units of the scale), thinned until the record is small enough."""
    while distance <= 4.0 * DISTANCE:
        lines = _thinned(paths(), distance)
        if lines is not None:
            rounded = tuple(np.round(x, 3) + 0.0 for x in lines)
            return MotionRecord(centre, scale, rounded, distance)
        distance *= 2.0
    return None


def _thinned(paths: Iterable[Array], distance: float) -> list[Array] | None:
    """Few points of each path, and only where it has not been before; None for too
    many."""
    lines = list[Array]()
    n_read = 0
    for path in paths:
        start = 0
        while not start or start < len(path):
            # A quarter of all before is looked up at a time, so that a long path takes
            # few looks and its first periods are enough for the later ones; and one row
            # more, to the next part.
            n_picked = min(max(200, n_read // 4), PART)
            rows = path[start : start + n_picked + 1]
            start = start + n_picked
            n_read = n_read + n_picked
            fresh = np.ones(len(rows), bool)
            if lines:
                fresh = ~_near(_tree(lines, distance), rows, _NEAR * distance)
            for first, end in spans(fresh):
                piece = rows[max(first - 1, 0) : end + 1]
                lines.append(_straight(piece, _NEAR * distance))
            if sum(line.size for line in lines) > _MOST:
                return None
    return lines


def _tree(lines: Iterable[Array], distance: float) -> Any:
    """Points on all lines, so close that none between is missed, to look for the
    nearest."""

    points = []
    for line in lines:
        steps = np.abs(np.diff(line, axis=0))
        longest = steps.max(axis=1, initial=0.0)
        n_points = np.maximum(np.ceil(longest / (_NEAR * distance)), 1.0)
        ends = np.append(0.0, np.cumsum(n_points))
        at = np.arange(ends[-1] + 1.0)
        points.append(interpolated(at, ends, line))
    return scipy.spatial.cKDTree(np.concatenate(points))


def _near(
    tree: Any,
    rows: Array,
    reach: float,
) -> NDArray[np.bool_]:
    """(M,) whether rows (M, d) are less than ``reach`` from some point in every
    coordinate."""
    distance, _ = tree.query(
        rows,
        p=np.inf,
        distance_upper_bound=reach,
    )
    return np.isfinite(distance)


def _straight(rows: Array, tolerance: float) -> Array:
    """Rows between which straight lines pass all the others within ``tolerance``: halved
    until they do."""
    index = np.arange(float(len(rows)))
    knots = np.unique([0, len(rows) - 1])
    while len(knots) > 1:
        line = interpolated(index, knots, rows[knots])
        off = np.flatnonzero(np.abs(rows - line).max(axis=1) > tolerance)
        if not len(off):
            break
        far = np.unique(np.searchsorted(knots, off))
        middle = (knots[far - 1] + knots[far] + 1) // 2
        knots = np.sort(np.append(knots, middle))
    return rows[knots]
