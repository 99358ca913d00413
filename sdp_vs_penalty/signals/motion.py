"""Which motion a model has been trained on, and how much of another one is new to it.

A model judged on motion that it was trained on shows its repeatability, not how it does elsewhere. So a
model keeps a record of its training motion: the path of (q, dq), behind the filters, each coordinate in
units of its spread. Motion is new where some joint's position or velocity is farther than ``distance``
spreads from every point of that path. The path is kept as straight lines between few points, and what
comes back is kept once; both stay far below the distance, so that neither makes a repeated motion new.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.data.store import parts
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.files import Plain
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.filtered import FilteredRun, FilteredRuns

#: Motion is new beyond so many spreads of the training motion. A path of more than ``_MOST`` numbers is
#: kept more coarsely, with a distance that grows alike; beyond the last distance, not at all.
DISTANCE, _COARSEST, _MOST = 0.1, 0.4, 100_000
#: In units of the distance: how far the lines may pass beside a row, how near a row counts as there
#: already, and the spacing at which lines are looked up.
_NEAR = 0.2
#: Rows of a path that are compared with the record at a time, at least; a quarter of all before, so that
#: a long path takes few looks, and its first periods are enough for the later ones.
_CHUNK = 200


@dataclass(frozen=True)
class MotionRecord(Plain):
    """The path of a training motion.

    centre, scale (2 n,) of q [rad or m] and dq; lines : stretches (K, 2 n) of points on the path, less
    the centre, over the scale; distance : beyond which motion is new, in units of the scale.
    """

    centre: Array
    scale: Array
    lines: tuple[Array, ...]
    distance: float

    @property
    def points(self) -> int:
        """How many states are kept."""
        return sum(len(line) for line in self.lines)

    def new_share(self, q: Array, dq: Array) -> float:
        """Share of the rows q, dq (M, n) that are new: not within the distance of any point."""
        both = (np.hstack([x, dq[k : k + len(x)]]) for k, x in parts(q))
        rows = ((x - self.centre) / self.scale for x in both)
        return 1.0 - float(np.mean(np.concatenate([_near(self._path, x, self.distance) for x in rows])))

    def new_share_of(self, runs: FilteredRuns) -> float | None:
        """The same of runs' filtered rows. None where none are left."""
        paths = [path for run in runs.runs for path in _paths(run)]
        if not paths:
            return None
        q, dq = np.split(np.concatenate(paths), 2, axis=1)
        return self.new_share(q, dq)

    @cached_property
    def _path(self) -> Array:
        return _filled(self.lines, _NEAR * self.distance)

    def joined(self, other: MotionRecord) -> MotionRecord | None:
        """The motion of both, in units of this one's spread; None where that is too much to keep."""
        there = [(line * other.scale + other.centre - self.centre) / self.scale for line in other.lines]
        distance = max(self.distance, other.distance)
        return _record(self.centre, self.scale, [*self.lines, *there], distance)

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Self:
        """Raises KeyError, TypeError or ValueError for a field that is missing or of another kind."""
        found = super().from_dict(data)
        rows = np.concatenate([found.centre[None], found.scale[None], *found.lines])
        if not (found.lines and np.all(np.isfinite(rows))):
            raise ValueError("training_motion: not numbers for each joint")
        if not (np.all(found.scale > 0.0) and found.distance > 0.0):
            raise ValueError("training_motion: a scale is not above 0")
        return found


def record_motion(runs: FilteredRuns) -> MotionRecord | None:
    """The record of the runs' rows.

    None where the filters leave no row, or where there is more motion than a record can keep.
    """
    paths = [path for run in runs.runs for path in _paths(run)]
    if not paths:
        return None
    rows = np.concatenate(paths)
    n = runs.measurements.n
    spread = rows.std(axis=0).reshape(2, n)
    # A coordinate that stays within that distance of the largest one's is measured in it instead: the
    # noise of a joint that hardly moves is no motion.
    scale = np.maximum(spread, DISTANCE * spread.max(axis=1, keepdims=True)).ravel()
    centre = rows.mean(axis=0)
    if not np.all(scale > 0.0):
        return None
    return _record(centre, scale, [(path - centre) / scale for path in paths], DISTANCE)


def _paths(run: FilteredRun) -> list[Array]:
    """Uninterrupted paths (M, 2 n) of a run's filtered rows."""
    try:
        motion, _ = run.low_passed()
    except InputError:  # none
        return []
    t, states = motion.t, np.hstack([motion.q, motion.dq])
    apart = np.diff(t)
    return np.split(states, np.flatnonzero(apart > 1.5 * apart.min(initial=np.inf)) + 1)


def _record(centre: Array, scale: Array, paths: Sequence[Array], distance: float) -> MotionRecord | None:
    """Paths (in units of the scale), thinned until the record is small enough."""
    while distance <= _COARSEST:
        lines = _thinned(paths, distance)
        if lines is not None:
            return MotionRecord(centre, scale, tuple(np.round(x, 3) + 0.0 for x in lines), distance)
        distance *= 2.0
    return None


def _thinned(paths: Iterable[Array], distance: float) -> list[Array] | None:
    """Few points of each path, and only where it has not been before; None for too many."""
    lines: list[Array] = []
    before = 0
    for path in paths:
        start = 0
        while start < len(path):
            count = max(_CHUNK, before // 4)
            rows = path[start : start + count + 1]  # one more, which the next piece begins with
            start, before = start + count, before + count
            fresh = np.ones(len(rows), bool)
            if lines:
                fresh = ~_near(_filled(lines, _NEAR * distance), rows, _NEAR * distance)
            for piece in np.split(np.arange(len(rows)), np.flatnonzero(np.diff(fresh)) + 1):
                if fresh[piece[0]]:
                    around = slice(max(piece[0] - 1, 0), piece[-1] + 2)
                    lines.append(_straight(rows[around], _NEAR * distance))
            if sum(line.size for line in lines) > _MOST:
                return None
    return lines


def _near(points: Array, rows: Array, reach: float) -> NDArray[np.bool_]:
    """(M,) whether rows (M, d) are less than ``reach`` from some point (K, d) in every coordinate."""
    from scipy.spatial import cKDTree

    return np.isfinite(cKDTree(points).query(rows, p=np.inf, distance_upper_bound=reach)[0])


def _straight(rows: Array, beside: float) -> Array:
    """Rows between which straight lines pass all the others within ``beside``: halved until they do."""
    each, knots = np.arange(len(rows)), np.unique([0, len(rows) - 1])
    while len(knots) > 1:
        at, steps = np.interp(each, knots, np.arange(len(knots))), np.diff(rows[knots], axis=0)
        left = np.minimum(at.astype(int), len(steps) - 1)
        line = rows[knots[left]] + (at - left)[:, None] * steps[left]
        off = np.flatnonzero(np.abs(rows - line).max(axis=1) > beside)
        if not len(off):
            break
        far = np.unique(np.searchsorted(knots, off))
        knots = np.sort(np.append(knots, (knots[far - 1] + knots[far] + 1) // 2))
    return rows[knots]


def _filled(lines: Iterable[Array], spacing: float) -> Array:
    """Points (K, 2 n) at most ``spacing`` apart on all lines."""
    out = []
    for line in lines:
        steps = np.diff(line, axis=0)
        count = np.maximum(np.ceil(np.abs(steps).max(axis=1, initial=0.0) / spacing), 1).astype(int)
        index = np.repeat(np.arange(len(steps)), count)
        within = np.arange(len(index)) - np.repeat(np.cumsum(count) - count, count)
        out += [line[index] + steps[index] * (within / count[index])[:, None], line[-1:]]
    return np.concatenate(out)
