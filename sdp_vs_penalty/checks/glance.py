"""What the rules about a run's rows, clock and channels look at."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.checks import constants as c
from sdp_vs_penalty.checks.issue import Issue, rows_text
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.robot.arrays import Array, nonzero_or_one
from sdp_vs_penalty.robot.robot import Robot
from sdp_vs_penalty.signals.runs import Movement, moving_joints, spans

Rows = NDArray[np.bool_]


READ = "certain: read from the file"
CONTINUE = "continue the time at the usual step there"


@dataclass(frozen=True)
class RunSummary:
    """A run, the robot it is of, and the share of its speed below which the robot
    stands still."""

    run: Measurements
    robot: Robot
    standstill: float

    @cached_property
    def steps(self) -> Array:
        """(N - 1,) time steps [s]."""
        return np.diff(self.run.t)

    @cached_property
    def step(self) -> float:
        """The usual one, 0 where time does not advance."""
        forward = self.steps[self.steps > 0.0]
        return float(np.median(forward)) if len(forward) else 0.0

    @cached_property
    def moving(self) -> Rows:
        return moving_joints(self.run)

    @cached_property
    def movement(self) -> Movement:
        return Movement(self.run, self.standstill)

    def rests(self, j: int) -> Rows:
        """(N,) where joint j hardly moves a quarter of a second before and after: by
        less than a share of the farthest that it comes in that time."""
        t = self.run.t
        q = self.run.q[:, j]
        before = np.abs(np.interp(t + -0.25, t, q) - q)
        after = np.abs(np.interp(t + 0.25, t, q) - q)
        far = np.maximum(before, after)
        return np.asarray(far <= self.standstill * far.max())

    @cached_property
    def row_numbers(self) -> NDArray[np.int64]:
        """(N,) equal numbers for rows that are the same, bit by bit, in every column
        but t."""
        return _numbers_of_rows([*self.run.groups.values()])

    @cached_property
    def repeats_measured(self) -> Rows:
        """(N,) whether positions and torques are those of the row before, bit by bit,
        whatever else is logged."""
        measured = [self.run.q]
        if self.run.torque_logged:
            measured.append(self.run.tau)
        bits = _bits(measured)
        is_same = np.all(bits[1:] == bits[:-1], axis=1)
        return np.concatenate([[False], is_same])

    @property
    def channels(self) -> list[tuple[str, int, Array]]:
        """Name, joint and values of each position and torque."""
        pairs = (
            ("q", self.run.q),
            *([("tau", self.run.tau)] if self.run.torque_logged else []),
        )
        return [
            (f"{name}{j + 1}", j, x[:, j])
            for name, x in pairs
            for j in range(self.run.n)
        ]

    def deleted(
        self,
        kind: str,
        bad: Mapping[str, Rows] | Rows,
        what: str,
        sure: str = READ,
        unusable: bool = False,
        remedy: str = "delete these rows",
        **figures: Any,
    ) -> Iterator[Issue]:
        """Rows that are no measurements (of these channels): they go.

        An error where identification cannot read them (``unusable``), or where they are
        a large share of what was measured: otherwise a warning."""
        channels = bad if isinstance(bad, Mapping) else {"": bad}
        channels = {name: rows for name, rows in channels.items() if rows.any()}
        if not channels:
            return
        gone = np.any([*channels.values()], axis=0)
        t = self.run.t
        places = spans(gone)
        named = ", ".join(filter(None, channels))
        first = np.maximum(places[:, 0] - 1, 0)
        last = np.minimum(places[:, 1], len(t)) - 1
        figures |= {
            "seconds": float(np.max(t[last] - t[first])),
            "parts": len(places),
            "rows": int(gone.sum()),
            "named": named,
            "joints": sorted({int(name.lstrip("qtau")) for name in channels if name}),
        }
        rows = rows_text(np.flatnonzero(gone) + 2)
        where = f"{named}, {rows}" if named else rows
        refuses = unusable or self._lost_share(channels, gone) > c.MOST_LOST
        yield Issue(
            kind=kind,
            severity="error" if refuses else "warning",
            where=where,
            what=what.format(**figures),
            certainty=sure,
            remedy=remedy,
            repair=lambda r: r.rows(~gone),
            figures=figures,
        )

    def _lost_share(
        self,
        channels: Mapping[str, Rows],
        gone: Rows,
    ) -> float:
        """The share of the rows that are no measurements, or of a channel's energy
        about its median that they make up: the larger."""
        shares = [float(gone.mean())]
        for name, _, x in self.channels:
            if name not in channels:
                continue
            size = np.abs(x - np.median(x))
            energy = np.square(size / nonzero_or_one(size.max()))
            of_rows = energy[channels[name]].sum()
            shares.append(float(of_rows / nonzero_or_one(energy.sum())))
        return max(shares)


def _numbers_of_rows(columns: Sequence[Array]) -> NDArray[np.int64]:
    """(N,) equal numbers for rows of columns (N, k) that are the same, bit by bit."""
    bits = _bits(columns)
    # Odd factors, modulo 2^64: different rows share a hash once in 10^10 long runs.
    factors = np.random.default_rng(0).integers(1, 1 << 62, bits.shape[1]) * 2 + 1
    return np.unique(bits @ factors, return_inverse=True)[1].ravel()


def _bits(columns: Sequence[Array]) -> NDArray[np.int64]:
    """(N, k) bit patterns of columns of 64-bit numbers."""
    rows = np.ascontiguousarray(np.column_stack(columns), float)
    return rows.view(np.int64)


def stepping(
    run: Measurements,
    where: Rows,
    steps: float | Array,
) -> Measurements:
    """The same rows, there (N - 1,) so far apart [s]."""
    apart = np.where(where, steps, np.diff(run.t))
    since_start = np.concatenate([[0.0], np.cumsum(apart)])
    return replace(run, t=run.t[0] + since_start)


def mask_of(count: int, parts: Any) -> Rows:
    """(count,) which rows lie in parts, each from its first to before its second
    number."""
    out = np.zeros(count, bool)
    for a, b in parts:
        out[int(a) : int(b)] = True
    return out
