"""The rules about rows and clock, each on the run as those before have mended it, and
those about what channels can show: idle joints, dead and clipped torque, coarse steps,
rates."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from sdp_vs_penalty.checks import constants as c
from sdp_vs_penalty.checks.constants import RUN, SPIKE, STUCK, STUCK_SECONDS, TIMES
from sdp_vs_penalty.checks.issue import EXPLANATION, Issue, rows_text
from sdp_vs_penalty.data.formats.recognition import UNITS
from sdp_vs_penalty.data.measurements import LARGEST_VALUE, Measurements
from sdp_vs_penalty.data.plausibility import beside_range
from sdp_vs_penalty.effects.effect import Motion
from sdp_vs_penalty.robot.arrays import Array, nonzero_or_one
from sdp_vs_penalty.robot.robot import Robot
from sdp_vs_penalty.signals.encoder import lattice_step
from sdp_vs_penalty.signals.preprocessing import Preprocessing
from sdp_vs_penalty.signals.runs import Movement, moving_joints, spans
from sdp_vs_penalty.signals.spectrum import highest_harmonic

Rows = NDArray[np.bool_]
#: Time steps [s] of a log that somebody would identify from.
_STEPS = (2e-5, 0.5)
#: Units of time that loggers write.
_UNITS = {"milliseconds": "ms", "microseconds": "us", "nanoseconds": "ns"}
_READ, _CONTINUE = (
    "certain: read from the file",
    "continue the time at the usual step there",
)


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
        t, q = self.run.t, self.run.q[:, j]
        before, after = (np.abs(np.interp(t + s, t, q) - q) for s in (-0.25, 0.25))
        far = np.maximum(before, after)
        return np.asarray(far <= self.standstill * far.max())

    @cached_property
    def row_numbers(self) -> NDArray[np.int64]:
        """(N,) equal numbers for rows that are the same, bit by bit, in every column
        but t."""
        rows = np.ascontiguousarray(np.column_stack([*self.run.groups.values()]))
        packed = rows.view(
            np.dtype((np.void, rows.dtype.itemsize * rows.shape[1]))
        ).ravel()
        return np.unique(packed, return_inverse=True)[1].ravel()

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
        sure: str = _READ,
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
        gone, t = np.any([*channels.values()], axis=0), self.run.t
        places, named = spans(gone), ", ".join(filter(None, channels))
        seconds = float(
            max(t[min(b, len(t)) - 1] - t[max(a - 1, 0)] for a, b in places)
        )
        figures |= {
            "seconds": seconds,
            "parts": len(places),
            "rows": int(gone.sum()),
            "named": named,
        }
        figures |= {
            "joints": sorted({int(name.lstrip("qtau")) for name in channels if name})
        }
        where = ", ".join(filter(None, (named, rows_text(np.flatnonzero(gone) + 2))))
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

    def _lost_share(self, channels: Mapping[str, Rows], gone: Rows) -> float:
        """The share of the rows that are no measurements, or of a channel's energy
        about its median that they make up: the larger."""
        shares = [float(gone.mean())]
        for name, _, x in self.channels:
            if name in channels:
                size = np.abs(x - np.median(x))
                energy = np.square(size / nonzero_or_one(size.max()))
                shares.append(
                    float(energy[channels[name]].sum() / nonzero_or_one(energy.sum()))
                )
        return max(shares)


def stepping(run: Measurements, where: Rows, steps: float | Array) -> Measurements:
    """The same rows, there (N - 1,) so far apart [s]."""
    apart = np.where(where, steps, np.diff(run.t))
    return replace(run, t=run.t[0] + np.concatenate([[0.0], np.cumsum(apart)]))


def _mask(count: int, parts: Any) -> Rows:
    """(count,) which rows lie in parts, each from its first to before its second
    number."""
    out = np.zeros(count, bool)
    for a, b in parts:
        out[int(a) : int(b)] = True
    return out


def missing(g: RunSummary) -> Iterator[Issue]:
    parts = {"t": g.run.t[:, None], **g.run.groups}.items()  # nan compares false
    finite = np.all(
        [np.all(np.abs(x) <= LARGEST_VALUE[k], axis=1) for k, x in parts], axis=0
    )
    what = (
        "{rows} rows with values that are not finite numbers, or that no robot"
        " measures."
    )
    yield from g.deleted("missing numbers", ~finite, what, unusable=True)


def time_unit(g: RunSummary) -> Iterator[Issue]:
    """A clock that does not count seconds, and in another unit is that of a robot's
    motion."""
    q, (shortest, longest) = g.run.q[:, g.moving], _STEPS
    fits = {
        name: UNITS[u]
        for name, u in _UNITS.items()
        if shortest <= g.step * UNITS[u] <= longest
    }
    if shortest <= g.step <= longest or not fits:
        return
    speed = float(np.median(np.quantile(np.abs(q[10:] - q[:-10]), 0.9, axis=0))) / (
        10.0 * g.step
    )
    unit, factor = min(fits.items(), key=lambda fit: abs(np.log(speed / fit[1])))
    yield Issue(
        "time unit",
        "error",
        "column t",
        f"time is in {unit}, not in seconds (it advances by {g.step:.4g} from row to"
        " row).",
        f"likely: in seconds it were one row in {g.step:.3g} s of a motion at"
        f" {speed:.2g} rad/s",
        f"multiply t by {factor:g}",
        lambda r: replace(r, t=r.t * factor),
        {"factor": factor},
    )


def _goes_on(g: RunSummary, rows: NDArray[np.intp]) -> Rows:
    """(K,) whether the moving arm comes no farther in steps of the clock than in those
    around them."""
    travel = np.linalg.norm(
        np.diff(g.run.q / nonzero_or_one(np.ptp(g.run.q, axis=0)), axis=0), axis=1
    )
    usual = np.array([np.median(travel[max(k - 10, 0) : k + 11]) for k in rows])
    return np.asarray(travel[rows] < 3.0 * usual + 1e-3)


def backwards(g: RunSummary) -> Iterator[Issue]:
    """Rows whose time lies before that of an earlier row."""
    bad = np.flatnonzero(g.steps < 0.0)
    if not len(bad):
        return
    step, how = 0.0, "the rows there do not continue the motion"
    remedy = "delete the rows whose time lies before that of an earlier row"
    if np.all(np.diff(bad, prepend=0, append=len(g.run.t) - 1) > RUN):
        step, how = max(1.0, 50.0 * g.step), "several runs are in the file"
        remedy = (
            "let each begin a second after the end of the one before (or write a file"
            " each)"
        )
        if _goes_on(g, bad).all():
            step, how, remedy = (
                g.step,
                "the motion continues without a break",
                _CONTINUE,
            )

    def repair(r: Measurements) -> Measurements:
        if not step:
            return r.rows(
                np.concatenate([[True], r.t[1:] > np.maximum.accumulate(r.t)[:-1]])
            )
        return stepping(r, np.diff(r.t) < 0.0, step)

    seconds = float(-g.steps[bad].min())
    what = f"the clock is set back {len(bad)} times, by up to {seconds:.3g} s: {how}."
    figures = {"rows": (bad + 3)[:100].tolist(), "seconds": seconds}
    yield Issue(
        "time runs backwards",
        "error",
        rows_text(bad + 3),
        what,
        _READ,
        remedy,
        repair,
        figures,
    )


def repeated_time(g: RunSummary) -> Iterator[Issue]:
    bad = np.concatenate([[False], g.steps == 0.0])
    same = bool(np.all(np.diff(g.run.q, axis=0)[bad[1:]] == 0.0))
    how = "are copies of the row before" if same else "differ from the row before"
    what = f"{{rows}} rows with a repeated time; the values {how}."
    first = "keep the first of each"
    yield from g.deleted("repeated time", bad, what, remedy=first, unusable=True)


def uneven(g: RunSummary) -> Iterator[Issue]:
    """Stamps that jitter, or come in bursts, although the samples were taken evenly: q
    is smoother over the row number."""
    steps, q = g.steps, g.run.q[:, g.moving]
    pause = TIMES * max(
        g.step, float(np.quantile(steps, 0.97))
    )  # packets, too, may come in bursts
    even, usual = (steps[1:] < pause) & (steps[:-1] < pause), steps[steps < pause]
    spread = float(np.std(usual) / np.mean(usual))
    if spread < 1 / RUN or np.count_nonzero(even) < RUN:
        return
    share = (steps[:-1] / (g.run.t[2:] - g.run.t[:-2]))[:, None]
    rough_time, rough_rows = (
        np.sqrt(
            np.mean((q[1:-1] - (q[:-2] * (1.0 - s) + q[2:] * s))[even] ** 2, axis=0)
        )
        for s in (share, 0.5)
    )
    if (ratio := float(np.median(rough_time / np.maximum(rough_rows, 1e-300)))) < TIMES:
        return

    def evened(r: Measurements) -> Measurements:
        parts = np.split(r.t, np.flatnonzero(np.diff(r.t) > pause) + 1)
        return replace(
            r, t=np.concatenate([np.linspace(x[0], x[-1], len(x)) for x in parts])
        )

    yield Issue(
        "jittered time stamps",
        "warning",
        "column t",
        f"the time steps vary by {100.0 * spread:.0f} %, but samples are evenly spaced:"
        f" they are {ratio:.0f} times smoother over the row number than over these"
        " times.",
        "likely: if the sampling itself jittered, q would be smoother over the recorded"
        " times",
        "space the time stamps evenly (and log the samples' own time)",
        evened,
        {"percent": 100.0 * spread, "ratio": ratio},
    )


def jumps(g: RunSummary) -> Iterator[Issue]:
    """Steps that are no jitter: of a clock that was set where the motion goes on,
    otherwise gaps."""
    long = np.flatnonzero(g.steps > max(TIMES * g.step, 0.02))
    moves = [g.movement.moves[max(k - 10, 0) : k + 11].all() for k in long]
    is_set = (
        np.array(moves, bool)
        & (g.steps[long] > 2.0 * TIMES * g.step)
        & _goes_on(g, long)
    )
    for rows, kind, text, sure, remedy in (
        (
            long[is_set],
            "clock step",
            (
                "the clock jumps ahead by up to {most:.3g} s while the moving "
                "arm does not: the clock was set, and no sample is missing."
            ),
            "likely: the distance travelled is that of one usual step",
            _CONTINUE,
        ),
        (
            long[~is_set],
            "gap in time",
            (
                "{count} gaps of up to {most:.3g} s (the usual step is "
                "{step:.3g} s); in all {total:.3g} s are missing."
            ),
            _READ,
            (
                "no action needed: the run is split there, and the filters lose a"
                " second on either side"
            ),
        ),
    ):
        if len(rows):
            wrong, largest = (
                np.isin(np.arange(len(g.steps)), rows),
                float(g.steps[rows].max()),
            )
            what = text.format(
                count=len(rows), most=largest, step=g.step, total=g.steps[rows].sum()
            )
            where = f"t = {g.run.t[rows[0]]:.4g} s, {rows_text(rows + 3)}"
            figures = {"rows": (rows + 3)[:100].tolist(), "seconds": largest}
            mend = partial(stepping, where=wrong, steps=g.step)
            repair = mend if remedy == _CONTINUE else None
            yield Issue(kind, "warning", where, what, sure, remedy, repair, figures)


def wrapped(g: RunSummary) -> Iterator[Issue]:
    """A revolute position that jumps by a turn from one row to the next."""
    steps = np.abs(np.diff(g.run.q, axis=0))
    turns = np.any(np.abs(steps - 2.0 * np.pi) < 0.3, axis=0) & (
        np.median(steps, axis=0) < 0.3
    )
    turns &= [joint.kind == "revolute" for joint in g.robot.joints]
    if turns.any():
        what = (
            "the position of {where} jumps by a full turn between two rows: the angle"
            " is wrapped."
        )
        unwrap = lambda r: replace(r, q=np.where(turns, np.unwrap(r.q, axis=0), r.q))  # noqa: E731
        joints = np.flatnonzero(turns)
        yield Issue.of(
            "wrapped angle", "error", joints, what, _READ, "unwrap the angle", unwrap
        )


def repeated_run(g: RunSummary) -> Iterator[Issue]:
    """Rows that come a second time, all at the same distance and one after the other.

    Where a motion repeats and its columns are coarse, single rows are equal by chance.
    """
    number = g.row_numbers
    lag = np.arange(len(number)) - np.unique(number, return_index=True)[1][number]
    if not len(lag := lag[lag > RUN]):
        return
    commonest_lag = int(np.argmax(np.bincount(lag)))
    same = np.concatenate(
        [
            np.zeros(commonest_lag, bool),
            number[commonest_lag:] == number[:-commonest_lag],
        ]
    )
    again = _mask(len(same), [p for p in spans(same) if p[1] - p[0] >= RUN])
    # One pose, held by a simulator without noise, is no copy.
    if (
        again.any()
        and np.ptp(g.run.q[again], axis=0).max() >= 0.05 * np.ptp(g.run.q, axis=0).max()
    ):
        what = (
            "{rows} rows are copies, bit by bit, of rows {lag} earlier: a part of the"
            " run is in the file twice, and would count as a repetition without noise."
        )
        yield from g.deleted("repeated run", again, what, lag=commonest_lag)


def held_rows(g: RunSummary) -> Iterator[Issue]:
    """Rows that are copies of the one before. Frozen packets: for long, and a joint has
    then come farther than in its usual step. Doubled rows: single ones while the arm
    moves, under an even clock; the motion goes on behind them, or skips ahead."""
    held = np.concatenate([[False], np.diff(g.row_numbers) == 0])
    parts, q = spans(held), g.run.q
    lengths, steps = np.diff(parts)[:, 0], np.abs(np.diff(q, axis=0))
    usual = float(np.median(lengths)) if len(parts) > 2 * STUCK else 1.0
    smallest_step = 4.0 * np.median(steps, axis=0)
    long = [
        (a, b)
        for a, b in parts[lengths >= max(STUCK, TIMES * usual)].tolist()
        if b < len(q)
    ]
    frozen = _mask(
        len(q), [(a, b) for a, b in long if np.any(steps[b - 1] > smallest_step)]
    )
    what = (
        "all channels repeat one row for up to {seconds:.3g} s, {parts} times: no"
        " packets came."
    )
    yield from g.deleted("frozen packets", frozen, what)
    if frozen.any() or not g.step or np.ptp(g.steps) > 1e-3 * g.step:
        # own stamps: a logger a little faster than its source holds samples, too
        return
    same, span = held & g.movement.moves, 2 * STUCK
    at = np.flatnonzero(same[span:-span]) + span
    at = at[~same[at - 1] & ~same[at + 1]]
    if not 0.1 * 1 / RUN <= same.mean() <= 0.8 or not len(at):
        return
    near, far = (np.linalg.norm(q[at + k] - q[at - k], axis=1) / k for k in (1, span))
    skips = bool(np.median(near / np.maximum(far, 1e-300)) > 0.75)
    if (
        skips and not 1 / RUN < same.mean() < 0.5
    ):  # from half of the rows on the source is slower
        return
    how, after = "rows were doubled and the clock was made again", "does not skip ahead"
    if skips:
        how, after = "packets were lost, the last one was written again", "skips ahead"
    yield Issue(
        "doubled rows",
        "warning",
        rows_text(np.flatnonzero(same) + 2),
        f"{same.sum()} rows are copies of the row before, and the motion {after} after"
        f" them: {how}.",
        _READ,
        f"delete the copies{'' if skips else ' and their time'}",
        lambda r: (r if skips else stepping(r, same[1:], 0.0)).rows(~same),
        {"rows": int(same.sum())},
    )


def end_stops(g: RunSummary) -> Iterator[Issue]:
    """Rows in which a joint is told to go beyond its range and does not: its stop holds
    it, whose torque no model has. Where it follows the command, the range is not where
    the stop is."""
    low, high = np.transpose([(joint.lower, joint.upper) for joint in g.robot.joints])
    command = g.run.commanded.get("qcmd", g.run.q)
    beyond, beyond_of_command = (
        np.maximum(low - x, x - high) for x in (g.run.q, command)
    )
    bad = (np.abs(beyond) * TIMES < beyond_of_command).T
    for rows, b, a in zip(bad, beyond.T, beyond_of_command.T, strict=True):
        held = [
            p for p in spans(a > 0.0) if b[slice(*p)].max() * TIMES < a[slice(*p)].max()
        ]
        rows &= _mask(len(rows), held)
    what = (
        "{named} lies against its end stop for up to {seconds:.3g} s: its command goes"
        " beyond it."
    )
    sure = "certain: the drive pushes against its stop"
    yield from g.deleted(
        "end stop", {f"q{j + 1}": x for j, x in enumerate(bad)}, what, sure
    )


def interpolated_rows(g: RunSummary) -> Iterator[Issue]:
    """Rows that lie on straight lines in every channel: a gap that was filled in."""
    if not g.run.torque_logged:
        return  # coarse positions alone lie on straight lines by themselves
    straight, changes = np.full((2, len(g.steps) - 1), [[True], [False]])
    for _, _, x in reversed(g.channels):
        slope, span = np.diff(x) / np.maximum(g.steps, 1e-300), np.ptp(x)
        size = np.maximum(np.abs(slope[1:]), np.abs(slope[:-1]))
        if span > 0.0:
            straight &= ~(
                np.abs(np.diff(slope)) > 1e-6 * size + 1e-9 * span / g.steps[1:]
            )
            changes |= size > 0.0
        if not straight.any():
            return
    inside = np.concatenate([[False], straight & changes, [False]])
    edges, moves = spans(inside), g.movement.moves
    # A converter that interpolates every row makes lines everywhere; a gap is far
    # longer than those.
    fewest_rows = max(
        STUCK, TIMES * float(np.median(np.diff(edges))) if inside.mean() > 0.3 else 0.0
    )
    parts = [
        p
        for p in edges
        if p[1] - p[0] >= fewest_rows and moves[p[0] : p[1]].mean() > 0.5
    ]
    what = (
        "{rows} rows lie on straight lines in every channel: a gap was filled by"
        " interpolation."
    )
    yield from g.deleted("interpolated rows", _mask(len(inside), parts), what)


def zeros(g: RunSummary) -> Iterator[Issue]:
    """Exact zeros that a logger filled in because it had no sample: its joint moves, the
    channel comes back to where it was before, on the same side, and no other value of
    it does so.

    A torque that changes its sign passes through zero, in steps of its drive's
    resolution exactly; a joint at rest, with its brake on, may need none; noise returns
    to other values as often.
    """
    bad = {}
    for name, j, x in g.channels:
        if g.moving[j] and np.count_nonzero(x) >= RUN and np.ptp(x) > 0.0:
            filled = _filled(x)
            bad[name] = filled if name.startswith("q") else filled & ~g.rests(j)
    what = (
        "{rows} rows of {named} are exactly zero, and jump there and back: nothing was"
        " measured."
    )
    sure = "certain: the channel jumps to no other value and back"
    yield from g.deleted("zeros", bad, what, sure)


def _filled(x: Array) -> Rows:
    """(N,) rows of zeros between samples far from zero on one side of it."""
    changes = np.abs(np.diff(x))
    fewest_rows = max(
        6.0 * float(np.median(changes[changes > 0.0])),
        3.0 * lattice_step(x[x != 0.0]),
    )
    same = spans(np.concatenate([np.diff(x) == 0.0, [False]]))
    held = [(a, b + 1) for a, b in same]
    single = np.flatnonzero((changes[1:] > 0.0) & (changes[:-1] > 0.0)) + 1
    parts = [*held, *((int(k), int(k) + 1) for k in single)]
    filled, elsewhere = [], 0
    for a, b in parts:
        if a == 0 or b >= len(x):
            continue
        before, after = x[a - 1] - x[a], x[b] - x[a]
        if before * after <= 0.0 or min(abs(before), abs(after)) <= fewest_rows:
            continue
        if x[a] != 0.0:
            elsewhere += 1
        else:
            filled.append((a, b))
    return _mask(len(x), [] if elsewhere * TIMES > len(filled) else filled)


def spikes(g: RunSummary) -> Iterator[Issue]:
    """Single samples far from the median of seven: bits turned, packets torn. Half a
    second off every start and stop of the arm."""
    moves, t, bad = g.movement.at, g.run.t, {}
    for name, j, x in g.channels:
        smallest = (
            SPIKE[1] * float(np.ptp(np.quantile(x, [1 / RUN, 1.0 - 1 / RUN]))) + 1e-9
        )
        # Without such a step no sample can be that far from the median.
        if g.moving[j] and np.abs(np.diff(x)).max() > smallest / 3.0:
            off = np.abs(
                x - np.median(sliding_window_view(np.pad(x, 3, "edge"), 7), axis=1)
            )
            far = off > max(SPIKE[0] * np.quantile(off, 0.9), smallest)
            far &= moves(t - 0.5) & moves(t) & moves(t + 0.5)
            bad[name] = far & (far.mean() <= 1 / RUN)
    what = "{rows} samples of {named} lie far from the samples on both sides."
    yield from g.deleted("spikes", bad, what, "certain: no joint moves like that")


def lost_rows(g: RunSummary) -> Iterator[Issue]:
    """All joints skip ahead within one step of an even clock: rows are missing that it
    does not show.

    A position that comes again is a packet repeated, and makes up for the skip behind
    it: each counts once, from its first stamp to that of the next. Only joints that
    move well above their own scatter can tell, three in four of them have to, and one
    row could be noise.
    """
    q = g.run.q[:, g.moving]
    fresh = np.flatnonzero(
        np.concatenate([[True], np.any(np.diff(q, axis=0) != 0.0, axis=1)])
    )
    steps = np.diff(g.run.t[fresh])
    if len(fresh) < RUN or q.shape[1] < 2:
        return
    speed = np.abs(np.diff(q[fresh], axis=0)) / np.maximum(steps, 1e-300)[:, None]
    smallest = 3.0 * np.quantile(np.abs(np.diff(speed, axis=0)), 0.9, axis=0)
    usual = np.mean(
        [np.roll(speed, k, axis=0) for k in (*range(-5, 0), *range(1, 6))], axis=0
    )
    tells = usual > smallest
    ratio = np.divide(speed, usual, out=np.full_like(speed, np.nan), where=tells)
    skips, n_telling = np.sum(np.round(ratio) > 2.0, axis=1), tells.sum(axis=1)
    rows = (n_telling >= max(2, (q.shape[1] + 1) // 2)) & (skips > 0.74 * n_telling)
    rows = np.flatnonzero(rows & (steps < 3.0 * np.median(steps)))
    if len(rows):
        far, one = (
            np.sum((x / smallest * tells)[rows], axis=1) for x in (speed, usual)
        )
        lost = np.round(far / one - 1.0)  # by the fast ones
        added, rows = np.zeros(len(g.steps)), fresh[rows + 1] - 1
        added[rows] = lost * np.median(steps)
        yield Issue(
            "lost rows",
            "warning",
            rows_text(rows + 3),
            f"at {len(rows)} places every joint skips ahead within one time step: about"
            f" {lost.sum():.0f} rows are missing and the clock was made again.",
            "certain: all joints skip by the same time",
            "put the missing time back",
            lambda r: stepping(r, added > 0.0, np.diff(r.t) + added),
            {"rows": (rows + 3)[:100].tolist(), "missing": lost[:100].tolist()},
        )


def frozen(g: RunSummary, word: str, name: str) -> Iterator[Issue]:
    """Channels that repeat a value bit by bit while the arm moves, and did not slow
    down before."""
    channels = [
        x for x in g.channels if x[0][0] == name and g.moving[x[1]] | (name == "t")
    ]
    bad = {
        channel: _stuck(g, j, x, name == "q")
        for channel, j, x in channels
        if np.ptp(x) > 0.0
    }
    what = (
        "{named} repeats one value for {seconds:.3g} s, {parts} times, while the arm"
        " moves: "
    )
    sure = "certain: elsewhere it never repeats for nearly as long"
    yield from g.deleted(f"frozen {word}", bad, what + "the channel was frozen.", sure)


def _stuck(g: RunSummary, j: int, x: Array, position: bool) -> Rows:
    """(N,) where a channel of joint j is frozen: the same number for long, and then not
    the next one."""
    parts = spans(np.diff(x) == 0.0)
    lengths = np.diff(parts)[:, 0]
    # Freezes must not hide each other.
    parts = parts[
        (lengths * TIMES > lengths.max(initial=STUCK - 1))
        & (lengths.max(initial=0) >= STUCK)
    ]
    parts = parts[np.diff(g.run.t[parts])[:, 0] >= 2.0 * STUCK_SECONDS]
    if not len(parts):
        return np.zeros(len(x), bool)
    step, q, stuck_rows = np.abs(np.diff(x)), g.run.q[:, j], []
    usual, level = float(np.median(step[step > 0.0])), 3.0 * lattice_step(x)
    for a, b in parts.tolist():
        jump, slows = step[min(b, len(step) - 1)], abs(x[a] - x[max(a - STUCK, 0)])
        if position:  # comes to rest, and starts again
            by_itself = jump < 4.0 * usual and slows < 0.5 * STUCK * usual
        else:  # dry friction is constant until its joint turns, and hides in a coarse channel's step
            after = q[min(b + STUCK, len(q) - 1)] - q[b]
            by_itself = usual < level and after * (q[b] - q[max(b - STUCK, 0)]) <= 0.0
        if (
            not by_itself and jump >= level and x[a] not in (x.min(), x.max())
        ):  # clipped at its end
            stuck_rows.append((a, b + 1))
    return _mask(len(x), stuck_rows)


def idle(g: RunSummary) -> Iterator[Issue]:
    """Joints that never move, or all of them."""
    sure, joints = (
        "certain: the positions change by noise only",
        np.flatnonzero(~g.moving),
    )
    if not g.moving.any():
        what = (
            "no joint moves: these data contain only static friction and the weight in"
            " one pose."
        )
        remedy = "record a motion of all joints"
        yield Issue.of(
            "no motion", "error", joints, what, sure, remedy, where="all joints"
        )
    elif len(joints):
        what = (
            "{where} never moves: friction and inertia about that axis are not"
            " identifiable, and the torque there is stiction."
        )
        remedy = "move every joint, or add a run that does"
        yield Issue.of("idle joints", "warning", joints, what, sure, remedy)


def beside(g: RunSummary) -> Iterator[Issue]:
    if joints := beside_range(g.robot, g.run.q):
        yield Issue.of(
            "encoder offset",
            "warning",
            joints,
            "{where}: positions outside the range all or part of the time.",
            "certain: outside what the joint can reach",
            "correct the zeros of these joints: the travel fits the range",
        )


def torques(g: RunSummary) -> Iterator[Issue]:
    """Channels that never change, that stay exactly at their largest value while they
    are never constant elsewhere, or that lost their sign: whenever these come near
    zero, by a fifth of the largest, they come within a usual step of it: by chance with
    odds of step to fifth."""
    unsigned = []
    for j, x in enumerate(g.run.tau.T):
        name, unit, parts = (
            f"tau{j + 1}",
            g.robot.torque_units[j],
            spans(np.diff(x) == 0.0),
        )
        if not np.ptp(x):
            what = f"{name} is {x[0]:g} {unit} in every row."
            remedy = "find out why the logger wrote a constant"
            # Of a joint that rests, nothing else is to be expected.
            severity = "error" if g.moving[j] else "note"
            yield Issue.of(
                "dead channel", severity, [j], what, _READ, remedy, where=name
            )
            continue
        lengths, values = np.diff(parts)[:, 0] + 1, x[parts[:, 0]]
        ends = np.isin(values, (x.min(), x.max()))
        elsewhere, longest = (int(lengths[k].max(initial=1)) for k in (~ends, ends))
        if longest >= max(TIMES * elsewhere, STUCK):
            value = values[np.argmax(lengths * ends)]
            yield Issue.of(
                "saturation",
                "warning",
                [j],
                f"{name} is stuck at {value:.6g} {unit} for up to {longest} consecutive"
                f" samples ({np.sum(x == value)} in total): the channel is clipped.",
                f"likely: elsewhere it is never constant for more than {elsewhere}"
                " samples",
                "record again with a larger range, or slower; delete those rows until"
                " then",
                where=name,
                limit=float(value),
            )
        if g.moving[j] and 0.0 <= x.min() <= 0.01 * x.max():
            steps, near = np.abs(np.diff(x)), 0.2 * x.max()
            step = min(float(np.median(steps[steps > 0.0])), near)
            lowest = np.array([x[a:b].min() for a, b in spans(x < near)])
            chance = np.sum((lowest > 0.0) & (lowest < step)) * np.log(near / step)
            unsigned += [j] * bool(chance > c.ODDS)
    if unsigned:
        yield Issue.of(
            "torque magnitude",
            "warning",
            unsigned,
            "{where} never changes sign: the logger wrote magnitudes.",
            "likely: a torque that is as near to zero as often is below it, too",
            "log the torque with its sign",
            where=", ".join(f"tau{j + 1}" for j in unsigned),
            nature=EXPLANATION,
        )


def coarse(g: RunSummary, motion: Motion, settings: Preprocessing) -> Iterator[Issue]:
    """Whether the motion's fastest part is sampled often enough to be differentiated
    twice, in positions fine enough for the accelerations of a motion behind the filter
    of these settings. Rounding errors renew themselves when the level changes; the part
    below the cut-off stays, and a second derivative weighs its power with (2 pi f)^4.
    """
    rate, highest, cutoff = 1.0 / g.step, highest_harmonic(g.run), settings.state_cutoff
    if rate < (needed := c.SAMPLES_A_PERIOD * highest):
        yield Issue.of(
            "low sample rate",
            "warning",
            (),
            f"the motion reaches {highest:.3g} Hz, and {rate:.3g} samples per second"
            f" are too few to differentiate it twice: {needed:.0f} Hz are needed.",
            "certain: from the spectrum of the positions",
            "log faster, or move slower",
            where="column t",
            rate_hz=rate,
            needed=needed,
        )
    assert cutoff is not None
    for j, (x, size) in enumerate(zip(g.run.q.T, motion.ddq.std(axis=0), strict=True)):
        step, lasts = (
            lattice_step(x),
            g.step * len(x) / max(int(np.count_nonzero(np.diff(x))), 1),
        )
        noise = (
            (2.0 * np.pi * cutoff) ** 2
            * step
            / np.sqrt(60.0 * max(1.0, 0.5 / (cutoff * lasts)))
        )
        if g.moving[j] and noise > c.TYPICAL["link"] * size > 0.0:
            yield Issue.of(
                "quantisation",
                "warning",
                [j],
                f"q{j + 1} is quantised in steps of {step:.3g}"
                f" {g.robot.position_units[j]}: noise of about"
                f" {100.0 * noise / size:.0f} % of the acceleration below"
                f" {cutoff:.3g} Hz.",
                "likely: the steps are read from the file, the noise is estimated",
                "log more digits, or move faster",
                where=f"q{j + 1}",
                step=step,
            )


#: In the order of mending; all but the first ask of RUN rows in which something moves.
RULES: tuple[Callable[[RunSummary], Iterator[Issue]], ...] = (
    missing,
    time_unit,
    backwards,
    repeated_time,
    uneven,
    jumps,
    wrapped,
    held_rows,
    repeated_run,
    end_stops,
    interpolated_rows,
    zeros,
    spikes,
    lost_rows,
    partial(frozen, word="position", name="q"),
    partial(frozen, word="torque", name="t"),
)


def mended(
    run: Measurements, robot: Robot, standstill: float
) -> tuple[list[Issue], Measurements, Measurements]:
    """The issues of a run's rows and clock; the run with all of them mended, and with
    the certain ones."""
    issues: list[Issue] = []
    fixed, glance = run, RunSummary(run, robot, standstill)
    for rule in RULES:
        if rule is not missing and (len(glance.run.t) < RUN or not glance.moving.any()):
            break
        for issue in rule(glance):
            issues.append(issue)
            if issue.repair is not None:
                # What is only likely is mended for the rules that follow, and deletes
                # no row.
                fixed = issue.repair(fixed) if issue.mends else fixed
                glance = RunSummary(issue.repair(glance.run), robot, standstill)
    return issues, glance.run, fixed
