"""Facts about the rows of a run: those that are no measurements."""

from collections.abc import Iterator
from functools import partial

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from sdp_vs_penalty.checks.constants import RUN, SPIKE, STUCK, STUCK_SECONDS, TIMES
from sdp_vs_penalty.checks.glance import READ, Rows, RunSummary, mask_of, stepping
from sdp_vs_penalty.checks.issue import Issue, rows_text
from sdp_vs_penalty.data.measurements import LARGEST_VALUE, Measurements
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.encoder import lattice_step
from sdp_vs_penalty.signals.runs import spans


def missing(g: RunSummary) -> Iterator[Issue]:
    """Rows in which some channel is no number, or one that no robot measures."""
    channels = {
        "t": g.run.t[:, None],
        **g.run.groups,
    }
    is_usable = np.ones(len(g.run.t), bool)
    for name, x in channels.items():
        # What is no number compares false.
        is_usable &= np.all(np.abs(x) <= LARGEST_VALUE[name], axis=1)
    what = (
        "{rows} rows with values that are not finite numbers, or that no robot"
        " measures."
    )
    yield from g.deleted("missing numbers", ~is_usable, what, unusable=True)


def repeated_run(g: RunSummary) -> Iterator[Issue]:
    """Rows that come a second time, all at the same distance and one after the other.

    Where a motion repeats and its columns are coarse, single rows are equal by chance.
    """
    number = g.row_numbers
    first = np.unique(number, return_index=True)[1][number]
    lags = np.arange(len(number)) - first
    lags = lags[lags > RUN]
    if not len(lags):
        return
    lag = int(np.argmax(np.bincount(lags)))
    is_same = np.concatenate(
        [
            np.zeros(lag, bool),
            number[lag:] == number[:-lag],
        ]
    )
    again = mask_of(len(is_same), [p for p in spans(is_same) if p[1] - p[0] >= RUN])
    if not again.any():
        return
    # One pose, held by a simulator without noise, is no copy.
    travel = np.ptp(g.run.q[again], axis=0).max()
    if travel < 0.05 * np.ptp(g.run.q, axis=0).max():
        return
    what = (
        "{rows} rows are copies, bit by bit, of rows {lag} earlier: a part of the run is"
        " in the file twice, and would count as a repetition without noise."
    )
    yield from g.deleted("repeated run", again, what, lag=lag)


def held_rows(g: RunSummary) -> Iterator[Issue]:
    """Rows that are copies of the one before: frozen packets, or single doubled rows."""
    is_held = np.concatenate(
        [
            [False],
            np.diff(g.row_numbers) == 0,
        ]
    )
    frozen = _frozen_packets(g, is_held)
    which = "all channels repeat"
    if not frozen.any():
        frozen = _frozen_measurements(g)
        which = "positions and torques repeat"
    what = f"{which} one row for up to {{seconds:.3g}} s, {{parts}} times: no packets came."
    yield from g.deleted("frozen packets", frozen, what)
    # With its own stamps a logger a little faster than its source holds samples, too.
    is_even = bool(g.step) and np.ptp(g.steps) <= 1e-3 * g.step
    if is_even and not frozen.any():
        yield from _doubled_rows(g, is_held & g.movement.moves)


def _frozen_measurements(g: RunSummary) -> Rows:
    """(N,) rows that repeat all positions and torques of the one before for long, while
    a logged velocity says that its joint moves on."""
    frozen = _frozen_packets(g, g.repeats_measured)
    moving_joints = np.flatnonzero(g.moving).tolist()
    parts = [
        (a, b)
        for a, b in spans(frozen)
        if any(
            _velocity_goes_on(
                g.run.dq,
                j,
                a,
                b - 1,
            )
            for j in moving_joints
        )
    ]
    return mask_of(len(frozen), parts)


def _frozen_packets(g: RunSummary, is_held: Rows) -> Rows:
    """(N,) rows that repeat the one before for long, after which a joint has come
    farther than in its usual step."""
    parts = spans(is_held)
    lengths = np.diff(parts)[:, 0]
    steps = np.abs(np.diff(g.run.q, axis=0))
    far = 4.0 * np.median(steps, axis=0)
    usual = float(np.median(lengths)) if len(parts) > 2 * STUCK else 1.0
    is_long = lengths >= max(STUCK, TIMES * usual)
    frozen_parts = [
        (a, b)
        for a, b in parts[is_long].tolist()
        if b < len(g.run.q) and np.any(steps[b - 1] > far)
    ]
    return mask_of(len(g.run.q), frozen_parts)


def _doubled_rows(g: RunSummary, same: Rows) -> Iterator[Issue]:
    """Single copies of the row before, while the arm moves under an even clock; the
    motion goes on behind them, or skips ahead."""
    span = 2 * STUCK
    at = np.flatnonzero(same[span:-span]) + span
    at = at[~same[at - 1] & ~same[at + 1]]
    if not 0.1 / RUN <= same.mean() <= 0.8 or not len(at):
        return
    q = g.run.q
    near = np.linalg.norm(q[at + 1] - q[at - 1], axis=1)
    far = np.linalg.norm(q[at + span] - q[at - span], axis=1) / span
    skips = bool(np.median(near / np.maximum(far, 1e-300)) > 0.75)
    # From half of the rows on the source is slower than the logger.
    if skips and not 1 / RUN < same.mean() < 0.5:
        return
    if skips:
        after = "skips ahead"
        how = "packets were lost, the last one was written again"
        remedy = "delete the copies"
    else:
        after = "does not skip ahead"
        how = "rows were doubled and the clock was made again"
        remedy = "delete the copies and their time"
    yield Issue(
        kind="doubled rows",
        severity="warning",
        where=rows_text(np.flatnonzero(same) + 2),
        what=f"{same.sum()} rows are copies of the row before, and the motion {after}"
        f" after them: {how}.",
        certainty=READ,
        remedy=remedy,
        repair=partial(_without_copies, same=same, keeps_time=skips),
        figures={"rows": int(same.sum())},
    )


def _without_copies(run: Measurements, same: Rows, keeps_time: bool) -> Measurements:
    """The run without the copies; they keep their time where packets were lost."""
    timed = run if keeps_time else stepping(run, same[1:], 0.0)
    return timed.rows(~same)


def end_stops(g: RunSummary) -> Iterator[Issue]:
    """Rows in which a joint is told to go beyond its range and does not: its stop holds
    it, whose torque no model has. Where it follows the command, the range is not where
    the stop is."""
    low = np.array([joint.lower for joint in g.robot.joints])
    high = np.array([joint.upper for joint in g.robot.joints])
    command = g.run.commanded.get("qcmd", g.run.q)
    beyond = np.maximum(low - g.run.q, g.run.q - high)
    commanded_beyond = np.maximum(low - command, command - high)
    bad = {}
    for j in range(g.run.n):
        held = [
            (a, b)
            for a, b in spans(commanded_beyond[:, j] > 0.0)
            if beyond[a:b, j].max() * TIMES < commanded_beyond[a:b, j].max()
        ]
        is_pushed = np.abs(beyond[:, j]) * TIMES < commanded_beyond[:, j]
        bad[f"q{j + 1}"] = is_pushed & mask_of(len(is_pushed), held)
    what = (
        "{named} lies against its end stop for up to {seconds:.3g} s: its command goes"
        " beyond it."
    )
    sure = "certain: the drive pushes against its stop"
    yield from g.deleted("end stop", bad, what, sure)


def interpolated_rows(g: RunSummary) -> Iterator[Issue]:
    """Rows that lie on straight lines in every channel: a gap that was filled in."""
    if not g.run.torque_logged:
        return  # coarse positions alone lie on straight lines by themselves
    is_straight = _on_lines(g)
    if not is_straight.any():
        return
    inside = np.concatenate([[False], is_straight, [False]])
    edges = spans(inside)
    # A converter that interpolates every row makes lines everywhere; a gap is far
    # longer than those.
    usual = float(np.median(np.diff(edges))) if inside.mean() > 0.3 else 0.0
    moves = g.movement.moves
    parts = [
        (a, b)
        for a, b in edges
        if b - a >= max(STUCK, TIMES * usual) and moves[a:b].mean() > 0.5
    ]
    what = (
        "{rows} rows lie on straight lines in every channel: a gap was filled by"
        " interpolation."
    )
    yield from g.deleted(
        "interpolated rows",
        mask_of(len(inside), parts),
        what,
    )


def _on_lines(g: RunSummary) -> Rows:
    """(N - 2,) inner rows in which no channel changes its slope, and some changes."""
    is_straight = np.ones(len(g.steps) - 1, bool)
    changes = np.zeros(len(g.steps) - 1, bool)
    for _, _, x in reversed(g.channels):
        span = np.ptp(x)
        if span > 0.0:
            slope = np.diff(x) / np.maximum(g.steps, 1e-300)
            size = np.maximum(np.abs(slope[1:]), np.abs(slope[:-1]))
            rounding = 1e-6 * size + 1e-9 * span / g.steps[1:]
            is_straight &= np.abs(np.diff(slope)) <= rounding
            changes |= size > 0.0
        if not is_straight.any():
            break
    return is_straight & changes


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
    if not np.any(x == 0.0):
        return np.zeros(len(x), bool)
    changes = np.abs(np.diff(x))
    usual = float(np.median(changes[changes > 0.0]))
    threshold = max(6.0 * usual, 3.0 * lattice_step(x[x != 0.0]))
    # The stretches in which it does not change, but for the first and the last.
    edges = np.flatnonzero(changes > 0.0) + 1
    starts = edges[:-1]
    ends = edges[1:]
    before = x[starts - 1] - x[starts]
    after = x[ends] - x[starts]
    comes_back = (before * after > 0.0) & (
        np.minimum(np.abs(before), np.abs(after)) > threshold
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
        usual_span = float(np.ptp(np.quantile(x, [1 / RUN, 1.0 - 1 / RUN])))
        threshold = SPIKE[1] * usual_span + 1e-9
        # Without such a step no sample can be that far from the median.
        if not g.moving[j] or np.abs(np.diff(x)).max() <= threshold / 3.0:
            continue
        neighbours = sliding_window_view(np.pad(x, 3, "edge"), 7)
        off = np.abs(x - np.median(neighbours, axis=1))
        is_far = off > max(SPIKE[0] * np.quantile(off, 0.9), threshold)
        is_far &= moves(t - 0.5) & moves(t) & moves(t + 0.5)
        bad[name] = is_far & (is_far.mean() <= 1 / RUN)
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
    comes_anew = np.any(np.diff(q, axis=0) != 0.0, axis=1)
    fresh = np.flatnonzero(np.concatenate([[True], comes_anew]))
    if len(fresh) < RUN or q.shape[1] < 2:
        return
    steps = np.diff(g.run.t[fresh])
    speed = np.abs(np.diff(q[fresh], axis=0)) / np.maximum(steps, 1e-300)[:, None]
    scatter = 3.0 * np.quantile(np.abs(np.diff(speed, axis=0)), 0.9, axis=0)
    near = (*range(-5, 0), *range(1, 6))
    usual = np.mean(
        [
            np.roll(
                speed,
                k,
                axis=0,
            )
            for k in near
        ],
        axis=0,
    )
    can_tell = usual > scatter
    places = _skips(speed, usual, can_tell)
    places = places[steps[places] < 3.0 * np.median(steps)]
    if not len(places):
        return
    # By the fast ones.
    weights = (can_tell / scatter)[places]
    times = (speed[places] * weights).sum(axis=1) / (usual[places] * weights).sum(
        axis=1
    )
    lost = np.round(times - 1.0)
    rows = fresh[places + 1] - 1
    added = np.zeros(len(g.steps))
    added[rows] = lost * np.median(steps)
    yield Issue(
        kind="lost rows",
        severity="warning",
        where=rows_text(rows + 3),
        what=f"at {len(rows)} places every joint skips ahead within one time step: about"
        f" {lost.sum():.0f} rows are missing and the clock was made again.",
        certainty="certain: all joints skip by the same time",
        remedy="put the missing time back",
        repair=partial(_with_time, added=added),
        figures={"rows": (rows + 3)[:100].tolist(), "missing": lost[:100].tolist()},
    )


def _skips(
    speed: Array,
    usual: Array,
    can_tell: Rows,
) -> NDArray[np.intp]:
    """Steps in which nearly all joints that can tell (K, n) come more than twice as far
    as in those around them."""
    ratio = np.divide(
        speed,
        usual,
        out=np.full_like(speed, np.nan),
        where=can_tell,
    )
    n_skip = np.sum(np.round(ratio) > 2.0, axis=1)
    n_tell = can_tell.sum(axis=1)
    are_enough = n_tell >= max(2, (speed.shape[1] + 1) // 2)
    return np.flatnonzero(are_enough & (n_skip > 0.74 * n_tell))


def _with_time(run: Measurements, added: Array) -> Measurements:
    """The run with time (N - 1,) [s] put between rows."""
    return stepping(
        run,
        added > 0.0,
        np.diff(run.t) + added,
    )


def frozen(
    g: RunSummary,
    word: str,
    name: str,
) -> Iterator[Issue]:
    """Channels that repeat a value bit by bit while the arm moves, and did not slow
    down before."""
    is_position = name == "q"
    bad = {
        channel: _stuck(g, j, x, is_position)
        for channel, j, x in g.channels
        if channel[0] == name and (g.moving[j] or not is_position) and np.ptp(x) > 0.0
    }
    what = (
        "{named} repeats one value for {seconds:.3g} s, {parts} times, while the arm"
        " moves: the channel was frozen."
    )
    sure = "certain: elsewhere it never repeats for nearly as long"
    yield from g.deleted(f"frozen {word}", bad, what, sure)


def _stuck(
    g: RunSummary,
    j: int,
    x: Array,
    is_position: bool,
) -> Rows:
    """(N,) where a channel of joint j is frozen: the same number for long, and then not
    the next one."""
    pauses = _long_pauses(g, x)
    if not pauses:
        return np.zeros(len(x), bool)
    steps = np.abs(np.diff(x))
    level = 3.0 * lattice_step(x)
    frozen_parts = []
    for a, b in pauses:
        if x[a] in (x.min(), x.max()):
            continue  # clipped there
        if is_position and _velocity_goes_on(g.run.dq, j, a, b):
            is_frozen = True
        elif b == len(x) - 1:
            # No value comes after it.
            is_frozen = not is_position and _joint_goes_round(g.run.q[:, j], a, b)
        elif steps[b] < level:
            is_frozen = False
        elif is_position:
            is_frozen = not _comes_to_rest(x, steps, a, steps[b])
        elif _arm_rests(g, a, b):
            is_frozen = False
        else:
            is_frozen = not _is_constant_friction(g.run.q[:, j], steps, level, a, b)
        if is_frozen:
            frozen_parts.append((a, b + 1))
    return mask_of(len(x), frozen_parts)


def _velocity_goes_on(
    dq: Array | None,
    j: int,
    a: int,
    b: int,
) -> bool:
    """Whether joint j's logged velocity is as large from row a to b as elsewhere."""
    if dq is None:
        return False
    square = dq[:, j] ** 2
    elsewhere = np.delete(square, slice(a, b + 1))
    return bool(square[a : b + 1].mean() > 0.1 * elsewhere.mean())


def _joint_goes_round(q: Array, a: int, b: int) -> bool:
    """Whether a joint moves from row a to b, not a little, and turns round.

    Friction keeps a coarse torque constant only as long as the joint does not turn.
    """
    part = q[a : b + 1]
    way = float(np.ptp(part))
    returns = way - abs(float(part[-1] - part[0]))
    return bool(way > 0.1 * np.ptp(q) and returns > 0.1 * way)


def _arm_rests(g: RunSummary, a: int, b: int) -> bool:
    """Whether no joint moves from row a to b by more than its resolution."""
    for q in g.run.q[:, g.moving].T:
        finest = max(3.0 * lattice_step(q), 1e-3 * float(np.ptp(q)))
        if np.ptp(q[a : b + 1]) > finest:
            return False
    return True


def _long_pauses(g: RunSummary, x: Array) -> list[list[int]]:
    """First and last row of stretches in which a channel does not change, far longer
    than its others: freezes must not hide each other."""
    parts = spans(np.diff(x) == 0.0)
    lengths = np.diff(parts)[:, 0]
    longest = lengths.max(initial=0)
    if longest < STUCK:
        return []
    parts = parts[lengths * TIMES > longest]
    seconds = np.diff(g.run.t[parts])[:, 0]
    pauses: list[list[int]] = parts[seconds >= 2.0 * STUCK_SECONDS].tolist()
    return pauses


def _comes_to_rest(
    x: Array,
    steps: Array,
    a: int,
    jump: float,
) -> bool:
    """Whether a position slows down before it stays, and starts again slowly."""
    usual = float(np.median(steps[steps > 0.0]))
    slows = abs(x[a] - x[max(a - STUCK, 0)])
    return bool(jump < 4.0 * usual and slows < 0.5 * STUCK * usual)


def _is_constant_friction(
    q: Array,
    steps: Array,
    level: float,
    a: int,
    b: int,
) -> bool:
    """Whether a torque may be constant: dry friction is until its joint turns, and hides
    in a coarse channel's step."""
    usual = float(np.median(steps[steps > 0.0]))
    before = q[b] - q[max(b - STUCK, 0)]
    after = q[min(b + STUCK, len(q) - 1)] - q[b]
    return bool(usual < level and after * before <= 0.0)
