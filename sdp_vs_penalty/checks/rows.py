"""Facts about the rows of a run: those that are no measurements."""

from collections.abc import Iterator

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from sdp_vs_penalty.checks.constants import RUN, SPIKE, STUCK, STUCK_SECONDS, TIMES
from sdp_vs_penalty.checks.glance import READ, Rows, RunSummary, mask_of, stepping
from sdp_vs_penalty.checks.issue import Issue, rows_text
from sdp_vs_penalty.data.measurements import LARGEST_VALUE
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.encoder import lattice_step
from sdp_vs_penalty.signals.runs import spans


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


def repeated_run(g: RunSummary) -> Iterator[Issue]:
    """Rows that come a second time, all at the same distance and one after the other.

    Where a motion repeats and its columns are coarse, single rows are equal by chance.
    """
    number = g.row_numbers
    lag = np.arange(len(number)) - np.unique(number, return_index=True)[1][number]
    if not len(lag := lag[lag > RUN]):
        return
    most = int(np.argmax(np.bincount(lag)))
    same = np.concatenate([np.zeros(most, bool), number[most:] == number[:-most]])
    again = mask_of(len(same), [p for p in spans(same) if p[1] - p[0] >= RUN])
    # One pose, held by a simulator without noise, is no copy.
    if (
        again.any()
        and np.ptp(g.run.q[again], axis=0).max() >= 0.05 * np.ptp(g.run.q, axis=0).max()
    ):
        what = (
            "{rows} rows are copies, bit by bit, of rows {lag} earlier: a part of the"
            " run is in the file twice, and would count as a repetition without noise."
        )
        yield from g.deleted("repeated run", again, what, lag=most)


def held_rows(g: RunSummary) -> Iterator[Issue]:
    """Rows that are copies of the one before. Frozen packets: for long, and a joint has
    then come farther than in its usual step. Doubled rows: single ones while the arm
    moves, under an even clock; the motion goes on behind them, or skips ahead."""
    held = np.concatenate([[False], np.diff(g.row_numbers) == 0])
    parts = spans(held)
    q = g.run.q
    lengths = np.diff(parts)[:, 0]
    steps = np.abs(np.diff(q, axis=0))
    usual = float(np.median(lengths)) if len(parts) > 2 * STUCK else 1.0
    least = 4.0 * np.median(steps, axis=0)
    long = [
        (a, b)
        for a, b in parts[lengths >= max(STUCK, TIMES * usual)].tolist()
        if b < len(q)
    ]
    frozen = mask_of(len(q), [(a, b) for a, b in long if np.any(steps[b - 1] > least)])
    what = (
        "all channels repeat one row for up to {seconds:.3g} s, {parts} times: no"
        " packets came."
    )
    yield from g.deleted("frozen packets", frozen, what)
    if frozen.any() or not g.step or np.ptp(g.steps) > 1e-3 * g.step:
        # own stamps: a logger a little faster than its source holds samples, too
        return
    same = held & g.movement.moves
    span = 2 * STUCK
    at = np.flatnonzero(same[span:-span]) + span
    at = at[~same[at - 1] & ~same[at + 1]]
    if not 0.1 * 1 / RUN <= same.mean() <= 0.8 or not len(at):
        return
    near = np.linalg.norm(q[at + 1] - q[at - 1], axis=1) / 1
    far = np.linalg.norm(q[at + span] - q[at - span], axis=1) / span
    skips = bool(np.median(near / np.maximum(far, 1e-300)) > 0.75)
    if (
        skips and not 1 / RUN < same.mean() < 0.5
    ):  # from half of the rows on the source is slower
        return
    how = "rows were doubled and the clock was made again"
    after = "does not skip ahead"
    if skips:
        how = "packets were lost, the last one was written again"
        after = "skips ahead"
    yield Issue(
        kind="doubled rows",
        severity="warning",
        where=rows_text(np.flatnonzero(same) + 2),
        what=f"{same.sum()} rows are copies of the row before, and the motion {after} after"
        f" them: {how}.",
        certainty=READ,
        remedy=f"delete the copies{'' if skips else ' and their time'}",
        repair=lambda r: (r if skips else stepping(r, same[1:], 0.0)).rows(~same),
        figures={"rows": int(same.sum())},
    )


def end_stops(g: RunSummary) -> Iterator[Issue]:
    """Rows in which a joint is told to go beyond its range and does not: its stop holds
    it, whose torque no model has. Where it follows the command, the range is not where
    the stop is."""
    low, high = np.transpose([(joint.lower, joint.upper) for joint in g.robot.joints])
    told = g.run.commanded.get("qcmd", g.run.q)
    beyond = np.maximum(low - g.run.q, g.run.q - high)
    asked = np.maximum(low - told, told - high)
    bad = (np.abs(beyond) * TIMES < asked).T
    for rows, b, a in zip(bad, beyond.T, asked.T, strict=True):
        held = [
            p for p in spans(a > 0.0) if b[slice(*p)].max() * TIMES < a[slice(*p)].max()
        ]
        rows &= mask_of(len(rows), held)
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
        slope = np.diff(x) / np.maximum(g.steps, 1e-300)
        span = np.ptp(x)
        size = np.maximum(np.abs(slope[1:]), np.abs(slope[:-1]))
        if span > 0.0:
            straight &= ~(
                np.abs(np.diff(slope)) > 1e-6 * size + 1e-9 * span / g.steps[1:]
            )
            changes |= size > 0.0
        if not straight.any():
            return
    inside = np.concatenate([[False], straight & changes, [False]])
    edges = spans(inside)
    moves = g.movement.moves
    # A converter that interpolates every row makes lines everywhere; a gap is far
    # longer than those.
    least = max(
        STUCK, TIMES * float(np.median(np.diff(edges))) if inside.mean() > 0.3 else 0.0
    )
    parts = [
        p for p in edges if p[1] - p[0] >= least and moves[p[0] : p[1]].mean() > 0.5
    ]
    what = (
        "{rows} rows lie on straight lines in every channel: a gap was filled by"
        " interpolation."
    )
    yield from g.deleted("interpolated rows", mask_of(len(inside), parts), what)


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
    usual = float(np.median(changes[changes > 0.0]))
    least = max(6.0 * usual, 3.0 * lattice_step(x[x != 0.0]))
    # The stretches in which it does not change, but for the first and the last.
    edges = np.flatnonzero(changes > 0.0) + 1
    starts = edges[:-1]
    ends = edges[1:]
    before = x[starts - 1] - x[starts]
    after = x[ends] - x[starts]
    comes_back = (before * after > 0.0) & (
        np.minimum(np.abs(before), np.abs(after)) > least
    )
    is_zero = comes_back & (x[starts] == 0.0)
    n_elsewhere = np.count_nonzero(comes_back & (x[starts] != 0.0))
    if n_elsewhere * TIMES > np.count_nonzero(is_zero):
        return np.zeros(len(x), bool)
    return mask_of(len(x), np.column_stack([starts, ends])[is_zero])


def spikes(g: RunSummary) -> Iterator[Issue]:
    """Single samples far from the median of seven: bits turned, packets torn. Half a
    second off every start and stop of the arm."""
    moves = g.movement.at
    t = g.run.t
    bad = {}
    for name, j, x in g.channels:
        least = (
            SPIKE[1] * float(np.ptp(np.quantile(x, [1 / RUN, 1.0 - 1 / RUN]))) + 1e-9
        )
        # Without such a step no sample can be that far from the median.
        if g.moving[j] and np.abs(np.diff(x)).max() > least / 3.0:
            off = np.abs(
                x - np.median(sliding_window_view(np.pad(x, 3, "edge"), 7), axis=1)
            )
            far = off > max(SPIKE[0] * np.quantile(off, 0.9), least)
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
    least = 3.0 * np.quantile(np.abs(np.diff(speed, axis=0)), 0.9, axis=0)
    usual = np.mean(
        [np.roll(speed, k, axis=0) for k in (*range(-5, 0), *range(1, 6))], axis=0
    )
    tells = usual > least
    ratio = np.divide(speed, usual, out=np.full_like(speed, np.nan), where=tells)
    skips = np.sum(np.round(ratio) > 2.0, axis=1)
    told = tells.sum(axis=1)
    rows = (told >= max(2, (q.shape[1] + 1) // 2)) & (skips > 0.74 * told)
    rows = np.flatnonzero(rows & (steps < 3.0 * np.median(steps)))
    if len(rows):
        far = np.sum((speed / least * tells)[rows], axis=1)
        one = np.sum((usual / least * tells)[rows], axis=1)
        lost = np.round(far / one - 1.0)  # by the fast ones
        added = np.zeros(len(g.steps))
        rows = fresh[rows + 1] - 1
        added[rows] = lost * np.median(steps)
        yield Issue(
            kind="lost rows",
            severity="warning",
            where=rows_text(rows + 3),
            what=f"at {len(rows)} places every joint skips ahead within one time step: about"
            f" {lost.sum():.0f} rows are missing and the clock was made again.",
            certainty="certain: all joints skip by the same time",
            remedy="put the missing time back",
            repair=lambda r: stepping(r, added > 0.0, np.diff(r.t) + added),
            figures={"rows": (rows + 3)[:100].tolist(), "missing": lost[:100].tolist()},
        )


def frozen(g: RunSummary, word: str, name: str) -> Iterator[Issue]:
    """Channels that repeat a value bit by bit while the arm moves, and did not slow
    down before."""
    asked = [
        x for x in g.channels if x[0][0] == name and g.moving[x[1]] | (name == "t")
    ]
    bad = {
        channel: _stuck(g, j, x, name == "q")
        for channel, j, x in asked
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
    step = np.abs(np.diff(x))
    q = g.run.q[:, j]
    found = []
    usual = float(np.median(step[step > 0.0]))
    level = 3.0 * lattice_step(x)
    for a, b in parts.tolist():
        jump = step[min(b, len(step) - 1)]
        slows = abs(x[a] - x[max(a - STUCK, 0)])
        if position:  # comes to rest, and starts again
            by_itself = jump < 4.0 * usual and slows < 0.5 * STUCK * usual
        else:  # dry friction is constant until its joint turns, and hides in a coarse channel's step
            after = q[min(b + STUCK, len(q) - 1)] - q[b]
            by_itself = usual < level and after * (q[b] - q[max(b - STUCK, 0)]) <= 0.0
        if (
            not by_itself and jump >= level and x[a] not in (x.min(), x.max())
        ):  # clipped at its end
            found.append((a, b + 1))
    return mask_of(len(x), found)
