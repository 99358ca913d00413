"""Which motion a model has been trained on, and how much of another one is new to it.

A model judged on motion that it was trained on shows its repeatability, not how it does elsewhere. So a
model keeps a record of its training motion: the path of (q, dq), behind the filters, each coordinate in
units of its spread. Motion is new where some joint's position or velocity is farther than ``distance``
spreads from every point of that path. The path is kept as straight lines between few points, and what
comes back is kept once; both stay far below the distance, so that neither makes a repeated motion new.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from itertools import groupby
from operator import itemgetter
from typing import Any, Self, TypeAlias

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.data.store import PART, parts
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.files import Plain
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.filtered import FilteredRuns

#: Motion is new beyond so many spreads of the training motion. A path of more than ``_MOST`` numbers is
#: kept more coarsely, with a distance that grows alike; beyond the last distance, not at all.
DISTANCE, _COARSEST, _MOST = 0.1, 0.4, 100_000
#: In units of the distance: how far the lines may pass beside a row, how near a row counts as there
#: already, and the spacing at which lines are looked up.
_NEAR = 0.2
#: Rows of a path that are compared with the record at a time, at least; a quarter of all before, so that
#: a long path takes few looks, and its first periods are enough for the later ones; at most a part.
_CHUNK = 200

#: Consecutive rows (M, 2 n), M > 0, each with the number of the uninterrupted path that they are of.
Pieces: TypeAlias = Iterator[tuple[int, Array]]


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
        each = [(len(x), self.new_share(*np.hsplit(x, 2))) for _, x in _pieces(runs)]
        return sum(k * x for k, x in each) / sum(k for k, _ in each) if each else None

    @cached_property
    def _path(self) -> Any:
        return _tree(self.lines, self.distance)

    def joined(self, other: MotionRecord) -> MotionRecord | None:
        """The motion of both, in units of this one's spread; None where that is too much to keep."""
        there = [(line * other.scale + other.centre - self.centre) / self.scale for line in other.lines]
        distance = max(self.distance, other.distance)
        return _record(self.centre, self.scale, lambda: enumerate([*self.lines, *there]), distance)

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
    """The record of the runs' rows, in the memory of a part of them.

    None where the filters leave no row, or where there is more motion than a record can keep.
    """
    count, n = 0, runs.measurements.n
    first = total = square = np.zeros(2 * n)
    for _, rows in _pieces(runs):
        first = first if count else rows[0]
        count, away = count + len(rows), rows - first
        total, square = total + away.sum(axis=0), square + np.sum(away**2, axis=0)
    if not count:
        return None
    spread = np.sqrt(np.maximum(square / count - (total / count) ** 2, 0.0)).reshape(2, n)
    # A coordinate that stays within that distance of the largest one's is measured in it instead: the
    # noise of a joint that hardly moves is no motion.
    scale = np.maximum(spread, DISTANCE * spread.max(axis=1, keepdims=True)).ravel()
    centre = first + total / count
    if not np.all(scale > 0.0):
        return None

    def pieces() -> Pieces:
        return ((path, (rows - centre) / scale) for path, rows in _pieces(runs))

    return _record(centre, scale, pieces, DISTANCE)


def _pieces(runs: FilteredRuns) -> Pieces:
    """Of the runs' filtered rows."""
    path = 0
    for run in runs.runs:
        last = -np.inf
        with suppress(InputError):  # none
            for motion in run.states():
                starts = np.flatnonzero(np.diff(motion.t, prepend=last) > 1.5 * run.interval)
                for k, part in enumerate(np.split(np.hstack([motion.q, motion.dq]), starts)):
                    path += k > 0
                    if len(part):
                        yield path, part
                last = motion.t[-1]


def _record(
    centre: Array, scale: Array, pieces: Callable[[], Pieces], distance: float
) -> MotionRecord | None:
    """Paths (in units of the scale), thinned until the record is small enough."""
    while distance <= _COARSEST:
        lines = _thinned(pieces(), distance)
        if lines is not None:
            return MotionRecord(centre, scale, tuple(np.round(x, 3) + 0.0 for x in lines), distance)
        distance *= 2.0
    return None


def _parts(pieces: Pieces, count: Callable[[], int]) -> Iterator[Array]:
    """The rows of each path, so many at a time and one more, which the next part begins with."""
    for _, path in groupby(pieces, key=itemgetter(0)):
        each, ahead, ended = (rows for _, rows in path), np.zeros((0, 0)), False
        while not ended or len(ahead):
            most = count()
            while len(ahead) <= most and not ended:
                more = next(each, ahead[:0])
                ahead, ended = np.concatenate([ahead, more]) if len(ahead) else more, not len(more)
            yield ahead[: most + 1]
            ahead = ahead[most:]


def _thinned(pieces: Pieces, distance: float) -> list[Array] | None:
    """Few points of each path, and only where it has not been before; None for too many."""
    lines: list[Array] = []
    before = count = 0

    def ahead() -> int:
        nonlocal before, count
        before += count
        count = min(max(_CHUNK, before // 4), PART)
        return count

    for rows in _parts(pieces, ahead):
        fresh = np.ones(len(rows), bool)
        if lines:
            fresh = ~_near(_tree(lines, distance), rows, _NEAR * distance)
        for piece in np.split(np.arange(len(rows)), np.flatnonzero(np.diff(fresh)) + 1):
            if fresh[piece[0]]:
                around = slice(max(piece[0] - 1, 0), piece[-1] + 2)
                lines.append(_straight(rows[around], _NEAR * distance))
        if sum(line.size for line in lines) > _MOST:
            return None
    return lines


def _tree(lines: Iterable[Array], distance: float) -> Any:
    """Points on all lines, to look for the nearest."""
    from scipy.spatial import cKDTree

    return cKDTree(_filled(lines, _NEAR * distance))


def _near(tree: Any, rows: Array, reach: float) -> NDArray[np.bool_]:
    """(M,) whether rows (M, d) are less than ``reach`` from some point in every coordinate."""
    return np.isfinite(tree.query(rows, p=np.inf, distance_upper_bound=reach)[0])


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
