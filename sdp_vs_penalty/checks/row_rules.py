"""Rules about rows and single channels: what no arm measures, whatever it is made of."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from sdp_vs_penalty import show
from sdp_vs_penalty.checks.glance import (
    Glance,
    constant_parts,
    interpolated,
    lattice_step,
    with_steps,
)
from sdp_vs_penalty.checks.issue import Issue, joints_text, rows_text
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.runs import spans

_READ = "certain: read from the file"
#: A frozen channel or packet stays for so long [s] (packets for less are a warning), so many rows, and
#: this many times longer than it keeps its value elsewhere, or stays within one step of it; the rows
#: before, over which a joint that comes to rest has slowed down.
_STUCK_SECONDS, _STUCK_ROWS, _STUCK_TIMES, _SLOWING = 0.1, 10, 3.0, 10
#: More freezes than this are a coarse sensor.
_FREEZES = 20
#: A spike leaves its neighbours by so many times their usual scatter, and this share of the range; the
#: samples of the median that it is measured from; and the share of rows above which it is a signal.
_SPIKE, _SPIKE_RANGE, _WIDTH, _FEW = 40.0, 0.25, 7, 0.02
#: Rows in a row that lie on straight lines in every channel, or come a second time, are no chance.
_STRAIGHT, _AGAIN = 8, 50
#: Chance makes short stretches of equal rows: those may hold this share of the rows in long ones.
_BY_CHANCE = 0.1
#: From this share on, straight lines are how the log was resampled, and gaps are so many times longer.
_RESAMPLED, _GAP_TIMES = 0.3, 5.0
#: Over a doubled row the arm seems to move at half its speed, over one held by a fast logger at its own.
_SLOWER = 0.75
#: A share of rows that repeat the one before: a lost packet now and then; from half on the log is faster
#: than its source.
_HELD = (0.02, 0.5)
#: A step between rows this many times the neighbours' is a hole behind a clock that was made again.
_TORN = 2.5
#: A zero that no measurement made jumps so many times the channel's usual step, both into and out of it;
#: levels to either side tell how often to expect a zero, and longer parts [s] are deleted.
_JUMP, _LEVELS, _SHORT = 6.0, 20, 0.02


def wrapped(g: Glance) -> Issue | None:
    """A revolute position that jumps by a turn from one row to the next."""
    joints = []
    for j, joint in enumerate(g.robot.joints):
        steps = np.abs(np.diff(g.run.q[:, j]))
        turns = np.any(np.abs(steps - 2.0 * np.pi) < 0.3)
        if joint.kind == "revolute" and float(np.median(steps)) < 0.3 and turns:
            joints.append(j)
    if not joints:
        return None

    def repair(r: Measurements) -> Measurements:
        q = r.q.copy()
        q[:, joints] = np.unwrap(q[:, joints], axis=0)
        return replace(r, q=q)

    return Issue(
        "wrapped angle", "error", joints_text(joints),
        f"the position of {joints_text(joints)} jumps by a full turn between two rows: the angle is "
        "wrapped.", _READ, f"unwrap {', '.join(f'q{j + 1}' for j in joints)}", repair,
        {"joints": [j + 1 for j in joints]},
    )  # fmt: skip


def repeated_run(g: Glance) -> Issue | None:
    """Rows that come a second time, all at the same distance and one after the other.

    Where a motion repeats and its columns are coarse, single rows are equal by chance.
    """
    number = g.row_numbers
    first = np.full(int(number.max(initial=-1)) + 1, -1)
    first[number[::-1]] = np.arange(len(number))[::-1]
    lag = np.arange(len(number)) - first[number]
    lags, counts = np.unique(lag[lag > _AGAIN], return_counts=True)
    if not len(lags) or counts.max() < _AGAIN:
        return None
    most = int(lags[np.argmax(counts)])
    again = np.concatenate([np.zeros(most, bool), number[most:] == number[:-most]])
    parts = spans(again)
    short = np.diff(parts)[:, 0] < _AGAIN
    by_chance = int(np.diff(parts[short]).sum())
    for a, b in parts[short]:
        again[a:b] = False
    if by_chance > _BY_CHANCE * again.sum() or not again.any():
        return None
    share = float(np.ptp(g.run.q[again], axis=0).max()) / max(
        float(np.ptp(g.run.q, axis=0).max()), 1e-300
    )
    if share < 0.05:
        return None  # one pose held, by a simulator without noise
    rows = np.flatnonzero(again)
    return Issue(
        "repeated run", "error", f"row {rows[0] + 2} and {len(rows) - 1} more",
        f"{len(rows)} rows are copies, bit by bit, of rows {most} earlier: a part of the run is in the "
        "file twice, and would count as a repetition without noise.", _READ, "delete the copies",
        lambda r: r.rows(~again), {"rows": len(rows), "lag": most},
    )  # fmt: skip


def frozen_packets(g: Glance) -> Issue | None:
    """Stretches in which every channel repeats one row while the arm moves: no packet came."""
    parts = spans(g.held)
    if not len(parts):
        return None
    lengths = parts[:, 1] - parts[:, 0]
    usual = float(np.quantile(lengths, 0.5)) if len(parts) > _FREEZES else 1.0
    long = lengths >= max(_STUCK_ROWS, _STUCK_TIMES * usual)
    gone = np.zeros(len(g.run.t), bool)
    for a, b in parts[long]:
        gone[a:b] = g.run.q.shape[0] > b and _leaps(g, int(a) - 1, int(b) - 1)
    if not gone.any():
        return None
    rows, found = np.flatnonzero(gone), len(spans(gone))
    longest = max(float(g.run.t[b - 1] - g.run.t[a - 1]) for a, b in spans(gone))
    return Issue(
        "frozen packets", "error" if longest >= _STUCK_SECONDS else "warning",
        f"rows {rows[0] + 2} to {spans(gone)[0][1] + 1}"
        + (f" and {found - 1} more parts" if found > 1 else ""),
        f"all channels repeat one row for up to {longest:.3g} s, {show.count(found, 'time')}, while "
        f"the arm "
        "moves on: no packets came.", _READ, "delete these rows",
        lambda r: r.rows(~gone), {"rows": int(gone.sum()), "parts": found},
    )  # fmt: skip


def _leaps(g: Glance, a: int, b: int) -> bool:
    """Whether some joint, still from row a to row b, has then come farther than in its usual step and
    by more than its encoder's, and had not slowed down before."""
    q, after = g.run.q, min(b + 1, len(g.run.t) - 1)
    usual = np.median(np.abs(np.diff(q, axis=0)), axis=0) + 1e-12
    jump = np.abs(q[after] - q[b])
    before = np.abs(q[a] - q[max(a - _SLOWING, 0)]) / _SLOWING
    leaps = (jump > 4.0 * usual) | (before > 2.0 * usual) & (jump > before)
    return any(jump[j] > 2.5 * lattice_step(q[:, j]) for j in np.flatnonzero(leaps))


def doubled(g: Glance) -> Issue | None:
    """Rows that are copies of the one before while the arm moves, under an even clock."""
    if not g.step or np.ptp(g.steps) > 1e-3 * g.step:
        return (
            None  # a recorder's own stamps: a logger a little faster than its source holds samples, too
        )
    same = g.held & g.movement.moves
    span, share = 20, float(same.mean())
    at = np.flatnonzero(same[span:-span]) + span if len(same) > 2 * span else np.zeros(0, int)
    at = at[~same[at - 1] & ~same[at + 1]] if len(at) else at
    if share < 0.002 or share > 0.8 or not len(at):
        return None

    def speed(reach: int) -> Array:
        away = np.linalg.norm(g.run.q[at + reach] - g.run.q[at - reach], axis=1)
        return np.asarray(away / np.maximum(g.run.t[at + reach] - g.run.t[at - reach], 1e-300))

    count, first = int(same.sum()), int(np.flatnonzero(same)[0])
    where = rows_text(first + 2, count)
    if np.median(speed(1) / np.maximum(speed(span), 1e-300)) <= _SLOWER:
        return Issue(
            "doubled rows", "error", where,
            f"{show.count(count, 'row')} are copies of the row before, and the motion does not skip "
            f"ahead "
            "after them: rows were doubled and the clock was made again.", _READ,
            "delete the copies and their time",
            lambda r: with_steps(r, np.where(same[1:], 0.0, np.diff(r.t))).rows(~same), {"rows": count},
        )  # fmt: skip
    if not _HELD[0] < share < _HELD[1]:
        return None
    return Issue(
        "repeated packets", "warning", where,
        f"{100.0 * share:.0f} % of the rows repeat the one before, and the motion skips ahead after "
        f"them: "
        "packets were lost, and the logger wrote the last one again.", _READ, "delete the copies",
        lambda r: r.rows(~same), {"rows": count, "share": share},
    )  # fmt: skip


def interpolated_rows(g: Glance) -> Issue | None:
    """Rows that lie on straight lines in every channel: a gap that was filled in."""
    x = np.column_stack([g.run.q, g.run.tau])
    x = x[:, np.ptp(x, axis=0) > 0.0]
    steps = g.steps[:, None]
    slope = np.diff(x, axis=0) / np.maximum(steps, 1e-300)
    size = np.maximum(np.abs(slope[1:]), np.abs(slope[:-1]))
    bends = np.abs(np.diff(slope, axis=0)) > 1e-6 * size + 1e-9 * np.ptp(x, axis=0) / steps[1:]
    straight = ~np.any(bends, axis=1) & np.any(size > 0.0, axis=1)
    inside = np.concatenate([[False], straight, [False]])
    edges = spans(inside)
    # A converter that interpolates every row makes lines everywhere; a gap is far longer than those.
    usual = float(np.median(np.diff(edges)[:, 0])) if inside.mean() > _RESAMPLED else 0.0
    least = max(_STRAIGHT, _GAP_TIMES * usual)
    moves = g.movement.moves
    parts = [(int(a), int(b)) for a, b in edges if b - a >= least and moves[a:b].mean() > 0.5]
    if not parts:
        return None
    gone = np.zeros(len(g.run.t), bool)
    for a, b in parts:
        gone[a:b] = True
    a, b = max(parts, key=lambda p: p[1] - p[0])
    return Issue(
        "interpolated rows", "error",
        f"rows {a + 2} to {b + 1}" + (f" and {len(parts) - 1} more parts" if len(parts) > 1 else ""),
        f"{int(gone.sum())} rows lie on straight lines in every channel: a gap was filled by "
        f"interpolation.",
        _READ, "delete these rows; the run is split there",
        lambda r: r.rows(~gone), {"rows": int(gone.sum())},
    )  # fmt: skip


def zeros(g: Glance) -> Issue | None:
    """Exact zeros in channels of fine steps: rows that a logger filled in because it had no sample."""
    found = {}
    for name, j, x in g.channels:
        bad = _filled(x) & g.inside if g.moving[j] else np.zeros(len(x), bool)
        # One torque at zero is an outlier as any other, and harms no fit; one position does.
        if bad.sum() > (name[0] == "t"):
            found[name] = bad
    if not found:
        return None
    steps, long = np.gradient(g.run.t), np.zeros(len(g.run.t), bool)
    for bad in found.values():
        for a, b in spans(bad):
            long[a:b] |= steps[a:b].sum() > _SHORT
    rows = np.flatnonzero(np.any(list(found.values()), axis=0))
    named, be = ", ".join(found), "is" if len(found) == 1 else "are"
    return Issue(
        "zeros", "error", f"{named}, {rows_text(int(rows[0]) + 2, len(rows))}",
        f"{named} {be} exactly zero in {show.count(len(rows), 'row')}, and jumps there and back: "
        f"nothing "
        "was measured.", "certain: the channel hardly ever takes any other value near zero",
        "replace single rows by interpolation, delete longer parts",
        lambda r: interpolated(r, found).rows(~long),
        {"channels": list(found), "joints": _joints(found), "rows": len(rows)},
    )  # fmt: skip


def _filled(x: Array) -> NDArray[np.bool_]:
    """(N,) which samples of a channel are zeros that it does not pass through.

    A channel in steps of d passes through zero about as often as through any other level near it. A zero
    between a sample below and one above it is a passage, however coarse the steps; a fill leaves one
    side and comes back to it.
    """
    zero, bad = np.abs(x) < 1e-300, np.zeros(len(x), bool)
    parts, other = spans(zero), np.flatnonzero(~zero)
    changes = np.abs(np.diff(x))
    if not len(parts) or len(other) < 2 * _LEVELS or not changes.any():
        return bad
    usual, step = float(np.median(changes[changes > 0.0])), lattice_step(x[other])
    for a, b in parts:
        if a == 0 or b == len(x):
            continue
        before, after = x[a - 1], x[b]
        least = max(_JUMP * usual, 3.0 * step)
        same_side = before * after > 0.0
        bad[a:b] = min(abs(before), abs(after)) > (least if same_side else 3.0 * least)
    near = other[np.abs(x[other]) <= _LEVELS * step]
    near = near[(near > 0) & (near < len(x) - 1)]
    far = np.minimum(changes[near - 1], changes[near]) > _JUMP * usual  # few can jump at all
    by_chance = float(far.sum()) / (2 * _LEVELS)
    return bad if bad.sum() > 10.0 * by_chance else np.zeros(len(x), bool)


def spikes(g: Glance) -> Issue | None:
    """Single samples far from their neighbours on both sides: bits turned, packets torn."""
    if len(g.run.t) < 4 * _WIDTH:
        return None
    found = {}
    for name, j, x in g.channels:
        low, high = np.quantile(x, [0.02, 0.98])
        least = _SPIKE_RANGE * (high - low) + 1e-9
        if not g.moving[j] or np.abs(np.diff(x)).max() <= least / (_WIDTH // 2):
            continue  # the median of the window cannot be that far
        around = sliding_window_view(np.pad(x, _WIDTH // 2, "edge"), _WIDTH)
        off = np.abs(x - np.median(around, axis=1))
        bad = (off > max(_SPIKE * np.quantile(off, 0.9), least)) & g.inside
        if 0 < bad.sum() <= _FEW * len(x):
            found[name] = bad
    if not found:
        return None
    count, first = (
        sum(int(b.sum()) for b in found.values()),
        min(int(np.argmax(b)) for b in found.values()),
    )
    return Issue(
        "spikes", "error", f"{', '.join(found)}, {rows_text(first + 2, count)}",
        f"{show.count(count, 'sample')} of {', '.join(found)} lie far from the samples on both sides.",
        "certain: no joint moves like that", "replace them by interpolation",
        partial(interpolated, found=found),
        {"channels": list(found), "joints": _joints(found), "samples": count},
    )  # fmt: skip


def _joints(found: dict[str, NDArray[np.bool_]]) -> list[int]:
    return sorted({int(name.lstrip("qtau")) for name in found})


def lost_rows(g: Glance) -> Issue | None:
    """All joints skip ahead within one step of an even clock: rows are missing that it does not show.

    A position that comes again is a packet repeated, and makes up for the skip behind it: each counts
    once, from its first stamp to that of the next.
    """
    q = g.run.q[:, g.moving]
    fresh = np.flatnonzero(np.concatenate([[True], np.any(np.diff(q, axis=0) != 0.0, axis=1)]))
    q, steps = q[fresh], np.diff(g.run.t[fresh])
    if len(fresh) < 50 or q.shape[1] < 2:
        return None
    speed = np.abs(np.diff(q, axis=0)) / np.maximum(steps, 1e-300)[:, None]
    pad = np.pad(speed, ((5, 5), (0, 0)), "edge")
    windows = sliding_window_view(pad, 11, axis=0)
    # Three in four of the joints that tell have to skip; a skip is above the median of its window.
    least = max(2, (q.shape[1] + 1) // 2)
    slower = sum((pad[k : k + len(speed)] < speed / _TORN).astype(np.int8) for k in range(11))
    rows = np.flatnonzero(np.sum(slower > 5, axis=1) >= least - 1 - (least - 1) // 4)
    rows = rows[steps[rows] < 3.0 * np.median(steps)]
    if not len(rows):
        return None
    usual, rough = np.median(windows[rows], axis=2), np.quantile(windows[rows], 0.9, axis=2)
    # Only joints that move well above their own scatter there can tell.
    scatter = np.quantile(np.abs(np.diff(speed, axis=0)), 0.9, axis=0)
    tells = (usual > 3.0 * scatter) & (rough < 2.0 * usual)
    rows, tells, usual = (x[tells.sum(axis=1) >= least] for x in (rows, tells, usual))
    if not len(rows):
        return None
    ratio = np.where(tells, speed[rows] / np.maximum(usual, 1e-300), np.nan)
    low, middle, high = np.nanquantile(ratio, [0.25, 0.5, 0.75], axis=1)
    found = (low > _TORN) & (high < 2.0 * low + 1.0)
    torn, missing = rows[found], np.round(middle[found] - 1.0)
    if not len(torn) or len(torn) > _FEW * len(steps):
        return None
    torn, added = fresh[torn + 1] - 1, np.zeros(len(g.steps))
    added[torn] = missing * np.median(steps)
    return Issue(
        "lost rows", "error", rows_text(int(torn[0]) + 3, len(torn)),
        f"at {show.count(len(torn), 'place')} every joint skips ahead within one time step: about "
        f"{missing.sum():.0f} rows are missing and the clock was made again.",
        "certain: all joints skip by the same time", "put the missing time back",
        lambda r: with_steps(r, np.diff(r.t) + added),
        {"rows": (torn + 3).tolist()[:100], "missing": missing.tolist()[:100]},
    )  # fmt: skip


def frozen_position(g: Glance) -> Issue | None:
    return _frozen(g, "position", [c for c in g.channels if c[0][0] == "q" and g.moving[c[1]]])


def frozen_torque(g: Glance) -> Issue | None:
    return _frozen(g, "torque", [c for c in g.channels if c[0][0] == "t"])


def _frozen(g: Glance, word: str, channels: list[tuple[str, int, Array]]) -> Issue | None:
    """Channels that repeat a value bit by bit while the arm moves, and did not slow down before."""
    found = {}
    for name, j, x in channels:
        if np.ptp(x) > 0.0 and (bad := _stuck(g, j, x, word == "position")).any():
            found[name] = j, bad
    if not found:
        return None
    gone = np.any([bad for _, bad in found.values()], axis=0)
    parts, joints = spans(gone), sorted({j for j, _ in found.values()})
    seconds = float(np.max(g.run.t[parts[:, 1] - 1] - g.run.t[parts[:, 0]]))
    times = "" if len(parts) == 1 else f", {len(parts)} times,"
    return Issue(
        f"frozen {word}", "error", f"{', '.join(found)}, rows {parts[0][0] + 2} to {parts[0][1] + 1}"
        + (f" and {len(parts) - 1} more parts" if len(parts) > 1 else ""),
        f"the {word} of {joints_text(joints)} repeats one value for {seconds:.3g} s{times} while the "
        f"arm "
        "moves: the channel was frozen.", "certain: elsewhere it never repeats for nearly as long",
        "delete these rows", lambda r: r.rows(~gone),
        {"joints": [j + 1 for j in joints], "seconds": seconds},
    )  # fmt: skip


def _stuck(g: Glance, j: int, x: Array, position: bool) -> NDArray[np.bool_]:
    """(N,) rows in which a channel of joint j is frozen."""
    bad, moved = np.zeros(len(x), bool), np.concatenate([[0], np.cumsum(g.movement.moves)])
    parts = constant_parts(x)
    parts = parts[np.diff(moved[parts])[:, 0] > 0.9 * np.diff(parts)[:, 0]]
    if not len(parts):
        return bad
    lengths = parts[:, 1] - parts[:, 0]
    alike = lengths * _STUCK_TIMES > lengths.max()  # several freezes must not hide each other
    if alike.sum() > _FREEZES or lengths.max() < _STUCK_ROWS:
        return bad
    step, width = np.abs(np.diff(x)), min(_SLOWING, len(x) - 1)
    # A coarse channel keeps its value by itself, and then goes on by one level.
    usual, level = float(np.median(step[step > 0.0])), 3.0 * lattice_step(x)
    travel = np.abs(x[width:] - x[:-width])
    usually = 0.5 * float(np.median(travel[travel > 0.0])) if travel.any() else 0.0
    for a, b in parts[alike]:
        jump, before = step[min(b, len(step) - 1)], abs(x[a] - x[max(a - width, 0)])
        if position:
            by_itself = jump < 4.0 * usual and before < usually
        else:  # dry friction is constant until its joint turns, and hides in a coarse channel's step
            after, now = g.run.q[min(b + width, len(x) - 1), j], g.run.q[b, j]
            by_itself = usual < level and (after - now) * (now - g.run.q[max(b - width, 0), j]) <= 0.0
        seconds = float(g.run.t[b] - g.run.t[a])
        # A clipped channel stays at its end.
        clipped = x[a] in (x.min(), x.max())
        if seconds < 2.0 * _STUCK_SECONDS or clipped or jump < level or by_itself:
            continue
        bad[a : b + 1] = True
    width = int(lengths[alike].min() / _STUCK_TIMES)
    if bad.any() and _keeps(g, x, width, parts[alike]):
        bad[:] = False
    return bad


def _keeps(g: Glance, x: Array, width: int, apart: NDArray[np.intp]) -> bool:
    """Whether elsewhere, off its ends, a channel stays within one step for so many rows of motion."""
    free = g.movement.moves & (x > x.min()) & (x < x.max())
    for a, b in apart:
        free[a : b + 1] = False
    within = 1.5 * lattice_step(x)
    for a, b in spans(free):
        if b - a > width and (np.ptp(sliding_window_view(x[a:b], width + 1), axis=1) <= within).any():
            return True
    return False


#: In the order of mending; each sees the run as those before have mended it.
ROW_RULES = (
    wrapped, repeated_run, frozen_packets, doubled, interpolated_rows, zeros, spikes, lost_rows,
    frozen_position, frozen_torque,
)  # fmt: skip
