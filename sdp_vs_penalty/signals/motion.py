"""Which motion a model has been trained on, and how much of another one is new to it.

A model judged on motion that it was trained on shows its repeatability, not how it does
elsewhere. So a model keeps a record of its training motion: the path of (q, dq), behind
the filters, each coordinate in units of its spread. Motion is new where some joint's
position or velocity is farther than ``distance`` spreads from every point of that path.
The path is kept as straight lines between few points, and what comes back is kept once;
both stay far below the distance, so that neither makes a repeated motion new.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy

from sdp_vs_penalty.data.store import PART
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.records import JsonRecord
from sdp_vs_penalty.robot.arrays import Array, Mask
from sdp_vs_penalty.signals.filtered import FilteredRuns
from sdp_vs_penalty.signals.runs import interpolated, spans

#: Motion is new beyond so many spreads of the training motion. A path of more than
#: ``_LARGEST_RECORD`` numbers is kept with twice the distance, then four times; then not
#: at all.
DISTANCE = 0.1
_LARGEST_RECORD = 100_000
#: Numbers of the points on the lines that are looked up: 50 times those of the largest
#: record, 40 MB.
_LARGEST_PATH = 50 * _LARGEST_RECORD
#: Tolerance in units of the distance: a row this near to the lines is kept already,
#: lines pass the rows that they stand for this near, and points that are looked up on
#: the lines lie this near to each other.
_NEAR = 0.2
#: Rows of a path that are compared with the record at once, at least.
_FEWEST_ROWS_AT_ONCE = 200


@dataclass(frozen=True)
class MotionRecord(JsonRecord):
    """The path of a training motion."""

    #: (2 n,) centre of the positions [rad or m] and velocities [rad/s or m/s].
    centre: Array
    #: (2 n,) scale of the positions [rad or m] and velocities [rad/s or m/s].
    scale: Array
    #: Stretches (K, 2 n) of points on the path, less the centre, over the scale.
    lines: tuple[Array, ...]
    #: Distance from the path beyond which motion is new, in units of the scale.
    distance: float

    def __post_init__(self) -> None:
        """Raise InputError for a record, read from a file, that no recording makes."""
        remedy = "identify the model again"
        rows = [self.centre[None], self.scale[None], *self.lines]
        width = np.shape(self.centre)[-1:]
        is_table = all(x.ndim == 2 and x.shape[1:] == width for x in rows)
        if not (self.lines and is_table and np.all(np.isfinite(np.concatenate(rows)))):
            raise InputError("not numbers for each joint", remedy)
        if not (np.all(self.scale > 0.0) and self.distance >= DISTANCE):
            what = f"the scale is not above 0, or the distance is below {DISTANCE}"
            raise InputError(what, remedy)
        if _is_too_long(self.lines, self.distance):
            raise InputError("the path is longer than any recording's", remedy)

    def new_share(self, runs: FilteredRuns) -> float | None:
        """Return the share of the runs' filtered rows whose motion is new to the
        record.

        Parameters
        ----------
        runs : FilteredRuns
            Runs of the same robot.

        Returns
        -------
        float or None
            Share, from 0 to 1, of rows that are not within ``distance`` of any point of
            the path, in every coordinate; None where the filters leave no row.
        """
        tree = _tree(self.lines, self.distance)
        is_known = []
        for path in _paths(runs):
            scaled = (path - self.centre) / self.scale
            is_known.append(_near(tree, scaled, self.distance))
        if not is_known:
            return None
        return 1.0 - float(np.mean(np.concatenate(is_known)))

    def joined(self, other: MotionRecord) -> MotionRecord | None:
        """Return the record of the motion of both, in units of this one's spread; None
        where that is too much to keep."""
        of_other = [
            (line * other.scale + other.centre - self.centre) / self.scale
            for line in other.lines
        ]
        distance = max(self.distance, other.distance)
        lines = [*self.lines, *of_other]
        return _record(self.centre, self.scale, lambda: lines, distance)


def record_motion(runs: FilteredRuns) -> MotionRecord | None:
    """Record the motion of runs as a path of positions and velocities (q, dq).

    Each of the 2 n coordinates is measured from its mean, in units of its standard
    deviation, so that distances of joints compare. Two passes over the rows: the first
    for mean and deviation, the second for the path.

    Parameters
    ----------
    runs : FilteredRuns
        The training runs; they are read piece by piece.

    Returns
    -------
    MotionRecord or None
        None where the filters leave no row, or where there is more motion than a record
        can hold.
    """
    count = 0
    n = runs.measurements.n
    first = np.zeros(2 * n)
    # Sums of displacements from the first row and of their squares.
    total = np.zeros(2 * n)
    square = np.zeros(2 * n)
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
    # A joint that hardly moves is measured in DISTANCE times the largest joint's spread:
    # its noise is no motion.
    smallest = DISTANCE * spread.max(axis=1, keepdims=True)
    scale = np.maximum(spread, smallest).ravel()
    centre = first + total / count
    if not np.all(scale > 0.0):
        return None

    return _record(
        centre,
        scale,
        lambda: ((path - centre) / scale for path in _paths(runs)),
        DISTANCE,
    )


def _paths(runs: FilteredRuns) -> Iterator[Array]:
    """Yield the paths (M, 2 n), M > 0, of positions and velocities (q, dq) at filtered
    rows.

    A path ends where rows are missing: at a time step of more than 1.5 usual ones. Runs
    of which the filters leave no row are skipped.
    """
    for run in runs.runs:
        with suppress(InputError):  # no rows
            longest_step = 1.5 * run.step * run.filters.dt
            for motion in run.states():
                gaps = np.flatnonzero(np.diff(motion.t) > longest_step) + 1
                yield from np.split(np.hstack([motion.q, motion.dq]), gaps)


def _record(
    centre: Array, scale: Array, paths: Callable[[], Iterable[Array]], distance: float
) -> MotionRecord | None:
    """Return the record of paths (in units of the scale), with twice and four times the
    distance if it is too large; None if it is too large even so."""
    while distance <= 4.0 * DISTANCE:
        lines = _thinned(paths(), distance)
        if lines is not None and not _is_too_long(lines, distance):
            # To a hundredth of the smallest distance; + 0.0 makes -0 to 0.
            rounded = tuple(np.round(line, 3) + 0.0 for line in lines)
            return MotionRecord(centre, scale, rounded, distance)
        distance *= 2.0
    return None


def _is_too_long(lines: Sequence[Array], distance: float) -> bool:
    """Return whether the points that are looked up on lines (K, 2 n), _NEAR times the
    distance apart, are more than _LARGEST_PATH numbers."""
    lengths = [np.abs(np.diff(x, axis=0)).max(axis=1).sum() for x in lines]
    n_points = sum(lengths) / (_NEAR * distance)
    return bool(n_points * lines[0].shape[1] > _LARGEST_PATH)


def _thinned(paths: Iterable[Array], distance: float) -> list[Array] | None:
    """Thin paths (M, 2 n) of positions and velocities to polygonal lines (K, 2 n).

    Rows that are near a line already (within _NEAR times the distance) are left out, so
    that repeated motion is kept once; the other rows become lines of few points. None
    if the lines have more numbers than _LARGEST_RECORD.
    """
    lines = list[Array]()
    n_read = 0
    for path in paths:
        start = 0
        while not start or start < len(path):
            # As many rows at once as a quarter of all before: a long path needs few
            # look-ups, and lines of its first periods serve the later ones. One row more
            # joins the next part.
            n_at_once = min(max(_FEWEST_ROWS_AT_ONCE, n_read // 4), PART)
            rows = path[start : start + n_at_once + 1]
            start = start + n_at_once
            n_read = n_read + n_at_once
            fresh = np.ones(len(rows), bool)
            if lines:
                fresh = ~_near(_tree(lines, distance), rows, _NEAR * distance)
            for first, end in spans(fresh):
                # With the row before and the row behind, so that lines join.
                piece = rows[max(first - 1, 0) : end + 1]
                lines.append(_straight(piece, _NEAR * distance))
            if sum(line.size for line in lines) > _LARGEST_RECORD:
                return None
    return lines


def _tree(lines: Iterable[Array], distance: float) -> Any:
    """Return a k-d tree of points on all lines, _NEAR times the distance apart or less,
    to look up the nearest."""
    points = []
    for line in lines:
        steps = np.abs(np.diff(line, axis=0))
        longest = steps.max(axis=1, initial=0.0)
        n_points = np.maximum(np.ceil(longest / (_NEAR * distance)), 1.0)
        ends = np.append(0.0, np.cumsum(n_points))
        places = np.arange(ends[-1] + 1.0)
        points.append(interpolated(places, ends, line))
    return scipy.spatial.cKDTree(np.concatenate(points))


def _near(tree: Any, rows: Array, reach: float) -> Mask:
    """Return which rows (M, d) are nearer than ``reach`` to some point of a tree, in
    every coordinate (maximum norm), (M,)."""
    # The distance is infinite where no point is within the bound.
    distance, _ = tree.query(rows, p=np.inf, distance_upper_bound=reach)
    return np.isfinite(distance)


def _straight(rows: Array, tolerance: float) -> Array:
    """Return some of the rows (M, d) of a path, so that straight lines between them
    pass all other rows within ``tolerance`` in every coordinate.

    Intervals that are too coarse are halved until they are not.
    """
    index = np.arange(float(len(rows)))
    knots = np.unique([0, len(rows) - 1])
    while len(knots) > 1:
        line = interpolated(index, knots, rows[knots])
        too_far = np.flatnonzero(np.abs(rows - line).max(axis=1) > tolerance)
        if not len(too_far):
            break
        coarse = np.unique(np.searchsorted(knots, too_far))  # intervals, by their end
        middle = (knots[coarse - 1] + knots[coarse] + 1) // 2
        knots = np.sort(np.append(knots, middle))
    return rows[knots]
