"""What the rules about a run's rows, clock and channels look at."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty import formatting
from sdp_vs_penalty.checks import constants as c
from sdp_vs_penalty.checks.certainty import READ
from sdp_vs_penalty.checks.issue import Issue, make_issue, rows_text
from sdp_vs_penalty.data.measurements import MOST_LOST, Measurements
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.results.issue import Certainty
from sdp_vs_penalty.robot.arrays import Array, Mask, nonzero_or_one
from sdp_vs_penalty.robot.robot import Robot
from sdp_vs_penalty.signals.filtered import FilteredRun
from sdp_vs_penalty.signals.filtered import Rows as FilteredRows
from sdp_vs_penalty.signals.runs import Movement, moving_joints, spans

#: Which rows: (N,).
Rows = Mask

#: Shortest time [s] in which a joint is said to rest.
_QUARTER_SECOND = 0.25
#: A prismatic joint that travels this share of its range moves [-].
_OF_RANGE = 0.1
#: Witness against rows that the arm does not explain.
_BY_ARM = "the arm that explains the other rows does not explain these"
#: What to do about a clock that jumps.
CONTINUE = "continue the time at the usual step there"


@dataclass(frozen=True)
class RunSummary:
    """What the rules about rows, clock and channels know of a run of N rows and n
    joints."""

    #: The run as logged.
    run: Measurements
    #: Of the robot of n joints that was logged; its filters say when the arm moves, and
    #: its arm what a torque that does not change may be.
    problem: Problem

    @property
    def robot(self) -> Robot:
        """The robot that was logged."""
        return self.problem.robot

    @property
    def standstill(self) -> float:
        """Share of its usual speed below which the robot stands still [-]."""
        return self.problem.preprocessing.standstill

    @cached_property
    def steps(self) -> Array:
        """(N - 1,) time steps [s]."""
        return np.diff(self.run.t)

    @cached_property
    def usual_step(self) -> float:
        """Median time step [s] of those above 0; 0 where time never advances."""
        forward = self.steps[self.steps > 0.0]
        return float(np.median(forward)) if len(forward) else 0.0

    @cached_property
    def moving(self) -> Rows:
        """(n,) which joints move in this run at all. A prismatic joint moves if it travels a
        tenth of its range: its metres are few beside other joints' radians."""
        joints = self.robot.joints
        lengths = [
            x.upper - x.lower if x.kind == "prismatic" else np.inf for x in joints
        ]
        is_far = np.ptp(self.run.q, axis=0) > _OF_RANGE * np.array(lengths)
        return moving_joints(self.run) | is_far

    @cached_property
    def movement(self) -> Movement:
        """At which instants the arm moves."""
        return Movement(self.run, self.standstill)

    def is_at_rest(self, j: int, first: int, end: int) -> bool:
        """Whether joint j rests in the rows from ``first`` to before ``end``.

        Its travel there is compared with its largest travel in as many rows: at rest it is
        at most the standstill share of that. Fewer rows than a quarter of a second are
        widened to one that begins or ends with them.
        """
        q = self.run.q[:, j]
        step = float(np.median(np.diff(self.run.t)))
        n_steps = min(max(end - first, round(_QUARTER_SECOND / step)), len(q) - 1)
        travels = np.abs(q[n_steps:] - q[:-n_steps])
        ends_with_rows = max(end - 1 - n_steps, 0)
        begins_with_rows = min(first, len(q) - 1 - n_steps)
        least = min(
            np.ptp(q[begin : begin + n_steps + 1])
            for begin in (ends_with_rows, begins_with_rows)
        )
        return bool(least <= self.standstill * travels.max())

    @cached_property
    def arm_rows(self) -> FilteredRows | None:
        """The filtered rows with the columns of the arm's model; None for a run that is
        too short for the filters."""
        run = self.filtered
        return None if run is None else run.all_rows(self.problem.model())

    @cached_property
    def filtered(self) -> FilteredRun | None:
        """The run behind its filters; None for a run that is too short for them."""
        try:
            settings = self.problem.preprocessing.resolve(self.run)
            run = FilteredRun(self.run, settings, self.movement)
            return run if run.filters else None
        except InputError:
            return None

    def one_arm_is_worse(self, j: int, at: Rows) -> float | None:
        """Return by how many times the error of joint j's equations grows if they have to
        explain the rows ``at`` (N,) as well.

        The equations are fitted, all parameters free, to all rows, and to the other rows
        alone. The error of the first fit (root mean square, the larger one of these rows
        and of the others) is divided by that of the second. It is near 1 if the rows are of
        the same arm (Chow's test).

        Returns
        -------
        float or None
            None for few rows, and where the arm leaves half of the torque elsewhere.
        """
        rows = self.arm_rows if at.any() else None
        if rows is None:
            return None
        nearest = np.searchsorted(self.run.t, rows.motion.t).clip(max=len(at) - 1)
        inside = at[nearest]
        columns, torque = rows.columns[j].columns, rows.torque[:, j]
        n_others = np.count_nonzero(~inside)
        are_few = n_others < c.ROWS_A_COLUMN * columns.shape[1]
        if are_few or np.count_nonzero(inside) < c.STUCK:
            return None
        usual = _rms(_left_by(columns[~inside], torque[~inside]))
        left = _left_by(columns, torque)
        if not 0.0 < usual < 0.5 * float(np.std(torque[~inside])):
            return None
        return max(_rms(left[inside]), _rms(left[~inside])) / usual

    def holds_torque(self, j: int, at: Rows) -> bool | None:
        """Whether the channel of joint j holds the joint's torque in the rows ``at`` (N,),
        by the arm that explains the other rows; None where that is not known."""
        times = self.one_arm_is_worse(j, at)
        return None if times is None else times < c.OUTLYING

    def second_witness(self, bad: Mapping[str, Rows], of_positions: str = "") -> str:
        """Return what else speaks against bad rows (N,) of channels, each by its name: of
        positions what is given, of torques the arm that explains the other rows; "" where
        one has no such witness."""
        witnesses = list[str]()
        for name, rows in bad.items():
            if rows.any() and name[0] == "q":
                witnesses.append(of_positions)
            elif rows.any():
                is_denied = self.holds_torque(int(name[3:]) - 1, rows) is False
                witnesses.append(_BY_ARM if is_denied else "")
        return "; ".join(dict.fromkeys(witnesses)) if all(witnesses) else ""

    @property
    def channels(self) -> list[tuple[str, int, Array]]:
        """Name ("q1"), joint (from 0) and values (N,) of each position, and of each
        torque where torques were logged."""
        groups = [("q", self.run.q)]
        if self.run.torque_logged:
            groups.append(("tau", self.run.tau))
        return [
            (f"{name}{j + 1}", j, values[:, j])
            for name, values in groups
            for j in range(self.run.n)
        ]

    def delete_rows(
        self,
        kind: str,
        bad: Mapping[str, Rows] | Rows,
        what: str,
        sure: Certainty = READ,
        unusable: bool = False,
        remedy: str = "delete these rows",
        cause: str = "",
        **figures: Any,
    ) -> Iterator[Issue]:
        """Yield one issue about rows that are no measurements; its repair deletes them.

        It is an error if identification cannot read the rows, or they are a large share
        of what was measured; else a warning. Nothing is yielded where no row is bad.

        Parameters
        ----------
        bad : mapping of str to (N,) bool array, or such an array
            Bad rows of each channel, by its name ("q1"); or bad rows of all channels.
        what : str
            The sentence, with places for ``{row_count}`` ("2 rows"), ``{named}``
            (channels), ``{seconds}`` (the longest part) and ``{times}`` (how many parts);
            ``{are}`` and ``{s}`` follow the number of channels.
        sure : str
            How certain it is, and why.
        unusable : bool
            Whether identification cannot read the rows.
        cause : str
            What most likely made them, in words.
        **figures
            Further numbers for the sentence and JSON.
        """
        by_channel = bad if isinstance(bad, Mapping) else {}
        channels = {name: rows for name, rows in by_channel.items() if rows.any()}
        gone = np.zeros(len(self.run.t), bool) if isinstance(bad, Mapping) else bad
        for rows in channels.values():
            gone = gone | rows
        if not gone.any():
            return
        t = self.run.t
        places = spans(gone)  # (parts, 2) first and end row
        named = ", ".join(channels)
        first = np.maximum(places[:, 0] - 1, 0)
        last = np.minimum(places[:, 1], len(t)) - 1
        figures |= {
            "seconds": float(np.max(t[last] - t[first])),
            "parts": len(places),
            "rows": int(gone.sum()),
            "named": named,
        }
        joints = sorted({int(name.lstrip("qtau")) - 1 for name in channels})
        where = rows_text(self.run, np.flatnonzero(gone))
        refuses = unusable or self._lost_share(channels, gone) > MOST_LOST
        yield make_issue(
            kind=kind,
            severity="error" if refuses else "warning",
            where=f"{named}, {where}" if named else where,
            what=what.format(
                **figures,
                row_count=formatting.count(figures["rows"], "row"),
                times=formatting.times(len(places)),
                are="are" if len(channels) > 1 else "is",
                s="" if len(channels) > 1 else "s",
            ),
            certainty=sure,
            remedy=remedy,
            repair=lambda r: r.rows(~gone),
            cause=cause,
            joints=joints,
            figures=figures,
        )

    def _lost_share(self, channels: Mapping[str, Rows], gone: Rows) -> float:
        """Return the share of the measurements that is lost with some rows.

        It is the largest of: the share of all rows, and of each channel the share of
        its squares about its median.
        """
        shares = [float(gone.mean())]
        for name, _, x in self.channels:
            if name not in channels:
                continue
            size = np.abs(x - np.median(x))
            energy = np.square(size / nonzero_or_one(size.max()))
            of_rows = energy[channels[name]].sum()
            shares.append(float(of_rows / nonzero_or_one(energy.sum())))
        return max(shares)


def _left_by(columns: Array, torque: Array) -> Array:
    """Return what columns (M, p) leave of a torque (M,) in the least squares."""
    scaled = columns / nonzero_or_one(np.linalg.norm(columns, axis=0))
    theta = np.linalg.lstsq(scaled, torque, c.SEEN_DIRECTIONS)[0]
    return torque - scaled @ theta


def _rms(x: Array) -> float:
    """Return the root mean square of x (K,)."""
    return float(np.sqrt(np.mean(x**2)))


def numbers_of_rows(columns: Sequence[Array]) -> NDArray[np.int64]:
    """Return a number (N,) for each row of columns (N, k): the same for rows that are
    equal, bit by bit."""
    bits = _bits(columns)
    # Hash of a row: the sum of odd factors times its bit patterns, modulo 2^64. Different
    # rows share a hash once in 10^10 long runs.
    factors = np.random.default_rng(0).integers(1, 1 << 62, bits.shape[1]) * 2 + 1
    hashes = bits @ factors
    return np.unique(hashes, return_inverse=True)[1].ravel()


def repeat_row_before(columns: Sequence[Array]) -> Rows:
    """Return which rows (N,) of columns (N, k) repeat the row before, bit by bit."""
    bits = _bits(columns)
    return np.concatenate([[False], np.all(bits[1:] == bits[:-1], axis=1)])


def _bits(columns: Sequence[Array]) -> NDArray[np.int64]:
    """Return the bit patterns (N, k) of columns of 64-bit numbers, so that NaN equals
    NaN and -0 differs from 0."""
    rows = np.ascontiguousarray(np.column_stack(columns), float)
    return rows.view(np.int64)


def with_time_steps(
    run: Measurements, where: Rows, steps: float | Array
) -> Measurements:
    """Return the run with other time steps [s] where ``where`` (N - 1,) says so; later
    rows move with them."""
    apart = np.where(where, steps, np.diff(run.t))
    since_start = np.concatenate([[0.0], np.cumsum(apart)])
    return replace(run, t=run.t[0] + since_start)


def mask_of(count: int, parts: Any) -> Rows:
    """Return which of ``count`` rows lie in some parts, each a pair: its first row, and
    the row behind its last."""
    mask = np.zeros(count, bool)
    for first, end in parts:
        mask[int(first) : int(end)] = True
    return mask
