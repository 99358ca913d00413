"""What rows and channels give away before any arm is fitted: stuck, torn, doubled, made-up samples."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty import show
from sdp_vs_penalty.check import zeros
from sdp_vs_penalty.check.issue import Issue, Repair, joints_text, rows_text
from sdp_vs_penalty.check.stamps import with_steps
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.robot import Robot
from sdp_vs_penalty.signals.runs import movement, moving_joints, spans

#: A stuck channel stays for so long [s], and this many times longer than it is constant elsewhere; the
#: rows before, over which a joint that comes to rest has slowed down.
_STUCK_SECONDS, _STUCK_TIMES, _SLOWING = 0.2, 3.0, 10
_MOVES = 0.9  # share of those rows in which another joint moves
#: A spike leaves its neighbours by so many times their usual scatter, and this share of the range.
_SPIKE, _SPIKE_RANGE = 40.0, 0.25
_WIDTH = 7  # samples of the median that spikes are measured from
_FEW = 0.02  # share of the rows: more is no spike but a signal
#: Rows in a row that lie on straight lines in every channel, or come a second time, are no chance.
_STRAIGHT, _AGAIN = 8, 50
#: From this share of the rows on, straight lines are how the log was resampled; gaps are longer then.
_RESAMPLED, _GAP_TIMES = 0.3, 5.0
#: Over a doubled row the arm seems to move at half its speed, over one held by a fast logger at its own.
_SLOWER = 0.75
#: A step between rows this many times the neighbours' is a hole behind a clock that was made again.
_TORN = 2.5


def find(run: Measurements, robot: Robot, standstill: float) -> Iterator[Issue]:
    """In the order of mending; each on the run as the ones before have mended it."""
    for search in (_wrapped, _repeated_run, _doubled, _interpolated, zeros.find, _spikes, _torn, _stale):
        for issue in search(run, robot, standstill):
            yield issue
            if issue.repair is not None:
                run = issue.repair(run)


def _wrapped(run: Measurements, robot: Robot, standstill: float) -> Iterator[Issue]:
    """A revolute position that jumps by a turn from one row to the next."""
    joints = []
    for j, joint in enumerate(robot.joints):
        steps = np.abs(np.diff(run.q[:, j]))
        usual = float(np.median(steps))
        if joint.kind == "revolute" and usual < 0.3 and np.any(np.abs(steps - 2.0 * np.pi) < 0.3):
            joints.append(j)
    if not joints:
        return

    def repair(r: Measurements) -> Measurements:
        q = r.q.copy()
        q[:, joints] = np.unwrap(q[:, joints], axis=0)
        return replace(r, q=q)

    named = ", ".join(f"q{j + 1}" for j in joints)
    yield Issue(
        "wrapped angle", "error", joints_text(joints),
        f"the position of {joints_text(joints)} jumps by a full turn between two rows: the angle is "
        "wrapped.",
        "certain: read from the file", f"unwrap {named}", repair, {"joints": [j + 1 for j in joints]},
    )  # fmt: skip


def _row_numbers(run: Measurements) -> NDArray[np.int64]:
    """(N,) equal numbers for rows with the same positions and torques, bit by bit."""
    rows = np.ascontiguousarray(np.column_stack([run.q, run.tau]))
    packed = rows.view(np.dtype((np.void, rows.dtype.itemsize * rows.shape[1]))).ravel()
    return np.asarray(np.unique(packed, return_inverse=True)[1].ravel())


def _repeated_run(run: Measurements, robot: Robot, standstill: float) -> Iterator[Issue]:
    """Rows that come a second time, all at the same distance."""
    number = _row_numbers(run)
    first = np.full(int(number.max(initial=-1)) + 1, -1)
    first[number[::-1]] = np.arange(len(number))[::-1]
    lag = np.arange(len(number)) - first[number]
    lags, counts = np.unique(lag[lag > _AGAIN], return_counts=True)
    if not len(lags) or counts.max() < _AGAIN:
        return
    most = int(lags[np.argmax(counts)])
    again = lag == most
    share = float(np.ptp(run.q[again], axis=0).max()) / max(float(np.ptp(run.q, axis=0).max()), 1e-300)
    if share < 0.05:
        return  # one pose held, by a simulator without noise

    rows = np.flatnonzero(again)
    yield Issue(
        "repeated run", "error", f"row {rows[0] + 2} and {len(rows) - 1} more",
        f"{len(rows)} rows are copies, bit by bit, of rows {most} earlier: a part of the run is in the "
        "file twice, and would count as a repetition without noise.",
        "certain: read from the file", "delete the copies",
        lambda r: r.rows(~again), {"rows": len(rows), "lag": most},
    )  # fmt: skip


def _doubled(run: Measurements, robot: Robot, standstill: float) -> Iterator[Issue]:
    """Rows that are copies of the one before while the arm moves, under a clock that counts them."""
    steps = np.diff(run.t)
    if np.ptp(steps) > 1e-3 * float(np.median(steps)):
        return  # a recorder's own stamps: a logger a little faster than its source holds samples, too
    same = np.concatenate([[False], np.diff(_row_numbers(run)) == 0])
    same &= movement(run, standstill).moves
    if same.mean() < 0.002 or same.mean() > 0.8:
        return
    at = np.flatnonzero(same)
    at = at[(at > 2) & (at < len(run.t) - 3)]
    at = at[~same[at - 1] & ~same[at + 1]]
    if not len(at):
        return
    span = 20
    at = at[(at > span) & (at < len(run.t) - span - 1)]
    if not len(at):
        return

    def speed(reach: int) -> Array:
        away = np.linalg.norm(run.q[at + reach] - run.q[at - reach], axis=1)
        return np.asarray(away / np.maximum(run.t[at + reach] - run.t[at - reach], 1e-300))

    if np.median(speed(1) / np.maximum(speed(span), 1e-300)) > _SLOWER:
        return

    def repair(r: Measurements) -> Measurements:
        return with_steps(r, np.where(same[1:], 0.0, np.diff(r.t))).rows(~same)

    count = int(same.sum())
    yield Issue(
        "doubled rows", "error", f"row {int(np.flatnonzero(same)[0]) + 2} and {count - 1} more",
        f"{show.count(count, 'row')} are copies of the row before, and the motion does not skip ahead "
        "after them: rows were doubled and the clock was made again.",
        "certain: read from the file", "delete the copies and their time", repair, {"rows": count},
    )  # fmt: skip


def _interpolated(run: Measurements, robot: Robot, standstill: float) -> Iterator[Issue]:
    """Rows that lie on straight lines in every channel: a gap that was filled in."""
    x = np.column_stack([run.q, run.tau])
    x = x[:, np.ptp(x, axis=0) > 0.0]
    steps = np.diff(run.t)[:, None]
    slope = np.diff(x, axis=0) / np.maximum(steps, 1e-300)
    size = np.maximum(np.abs(slope[1:]), np.abs(slope[:-1]))
    bends = np.abs(np.diff(slope, axis=0)) > 1e-6 * size + 1e-9 * np.ptp(x, axis=0) / steps[1:]
    straight = ~np.any(bends, axis=1) & np.any(size > 0.0, axis=1)
    inside = np.concatenate([[False], straight, [False]])
    edges = spans(inside)
    # A converter that interpolates every row makes lines everywhere; a gap is far longer than those.
    usual = float(np.median(np.diff(edges)[:, 0])) if inside.mean() > _RESAMPLED else 0.0
    least = max(_STRAIGHT, _GAP_TIMES * usual)
    parts = [(int(a), int(b)) for a, b in edges if b - a >= least]
    parts = [(a, b) for a, b in parts if movement(run, standstill).moves[a:b].mean() > 0.5]
    if not parts:
        return
    gone = np.zeros(len(run.t), bool)
    for a, b in parts:
        gone[a:b] = True
    count = int(gone.sum())
    a, b = max(parts, key=lambda p: p[1] - p[0])
    yield Issue(
        "interpolated rows", "error",
        f"rows {a + 2} to {b + 1}" + (f" and {len(parts) - 1} more parts" if len(parts) > 1 else ""),
        f"{count} rows lie on straight lines in every channel: a gap was filled by interpolation.",
        "certain: read from the file", "delete these rows; the run is split there",
        lambda r: r.rows(~gone), {"rows": count},
    )  # fmt: skip


def _spikes(run: Measurements, robot: Robot, standstill: float) -> Iterator[Issue]:
    """Single samples far from their neighbours on both sides: bits turned, packets torn."""
    if len(run.t) < 4 * _WIDTH:
        return
    found: dict[str, NDArray[np.bool_]] = {}
    # Rows at rest are not used, and drives click when they start and stop.
    motion = movement(run, standstill)
    moves = motion.at(run.t - 0.5) & motion.moves & motion.at(run.t + 0.5)
    for name, values in (("q", run.q), ("tau", run.tau)):
        for j in np.flatnonzero(moving_joints(run)).tolist():
            x = values[:, j]
            low, high = np.quantile(x, [0.02, 0.98])
            least = _SPIKE_RANGE * (high - low) + 1e-9
            if np.abs(np.diff(x)).max() <= least / (_WIDTH // 2):
                continue  # the median of the window cannot be that far
            around = np.lib.stride_tricks.sliding_window_view(np.pad(x, _WIDTH // 2, "edge"), _WIDTH)
            off = np.abs(x - np.median(around, axis=1))
            least = max(_SPIKE * np.quantile(off, 0.9), least)
            bad = (off > least) & moves
            if 0 < bad.sum() <= _FEW * len(x):
                found[f"{name}{j + 1}"] = bad
    if not found:
        return

    count = sum(int(bad.sum()) for bad in found.values())
    first = min(int(np.argmax(bad)) for bad in found.values())
    joints = sorted({int(name.lstrip("qtau")) for name in found})
    yield Issue(
        "spikes", "error",
        f"{', '.join(found)}, {rows_text(first + 2, count)}",
        f"{show.count(count, 'sample')} of {', '.join(found)} lie far from the samples on both sides.",
        "certain: no joint moves like that", "replace them by interpolation",
        lambda r: zeros.interpolated(r, found),
        {"channels": list(found), "joints": joints, "samples": count},
    )  # fmt: skip


def _torn(run: Measurements, robot: Robot, standstill: float) -> Iterator[Issue]:
    """All joints skip ahead within one step of an even clock: rows are missing that it does not show."""
    moves = moving_joints(run)
    if len(run.t) < 50 or not moves.any():
        return
    steps = np.diff(run.t)
    speed = np.abs(np.diff(run.q[:, moves], axis=0)) / np.maximum(steps, 1e-300)[:, None]
    pad = np.pad(speed, ((5, 5), (0, 0)), "edge")
    windows = np.lib.stride_tricks.sliding_window_view(pad, 11, axis=0)
    # Three in four of the joints that tell have to skip; a skip is above the median of its window.
    least = max(2, (int(moves.sum()) + 1) // 2)
    slower = sum((pad[k : k + len(speed)] < speed / _TORN).astype(np.int8) for k in range(11))
    rows = np.flatnonzero(np.sum(slower > 5, axis=1) >= least - 1 - (least - 1) // 4)
    rows = rows[steps[rows] < 3.0 * np.median(steps)]
    if not len(rows):
        return
    usual = np.median(windows[rows], axis=2)
    rough = np.quantile(windows[rows], 0.9, axis=2)
    # Only joints that move well above their own scatter there can tell.
    lattice = np.quantile(np.abs(np.diff(speed, axis=0)), 0.9, axis=0)
    tells = (usual > 3.0 * lattice) & (rough < 2.0 * usual)
    telling = tells.sum(axis=1)
    low, high, middle = np.zeros((3, len(rows)))
    ratio = speed[rows] / np.maximum(usual, 1e-300)
    for count in np.unique(telling[telling >= least]):  # nanquantile takes the rows one by one
        k = np.flatnonzero(telling == count)
        known = ratio[k][tells[k]].reshape(-1, count)
        low[k], middle[k], high[k] = np.quantile(known, [0.25, 0.5, 0.75], axis=1)
    found = (low > _TORN) & (high < 2.0 * low + 1.0)
    torn = rows[found]
    if not len(torn) or len(torn) > _FEW * len(steps):
        return
    missing = np.round(middle[found] - 1.0)
    added = np.zeros(len(steps))
    added[torn] = missing * np.median(steps)

    yield Issue(
        "lost rows", "error", rows_text(torn[0] + 3, len(torn)),
        f"at {show.count(len(torn), 'place')} every joint skips ahead within one time step: about "
        f"{missing.sum():.0f} rows are missing and the clock was made again.",
        "certain: all joints skip by the same time", "put the missing time back",
        lambda r: with_steps(r, np.diff(r.t) + added),
        {"rows": (torn + 3).tolist()[:100], "missing": missing.tolist()[:100]},
    )  # fmt: skip


def _stale(run: Measurements, robot: Robot, standstill: float) -> Iterator[Issue]:
    """A channel that repeats its value bit by bit while the arm moves, and did not slow down before."""
    moving = np.concatenate([[0], np.cumsum(movement(run, standstill).moves)])
    idle = ~moving_joints(run)
    for name, values in (("q", run.q), ("tau", run.tau)):
        for j in range(run.n):
            x = values[:, j]
            if np.ptp(x) == 0.0 or (name == "q" and idle[j]):
                continue
            parts = spans(np.diff(x) == 0.0)
            parts = parts[np.diff(moving[parts])[:, 0] > _MOVES * np.diff(parts)[:, 0]]
            if not len(parts):
                continue
            lengths = np.sort(parts[:, 1] - parts[:, 0])[::-1]
            a, b = parts[int(np.argmax(parts[:, 1] - parts[:, 0]))]
            seconds = float(run.t[b] - run.t[a])
            elsewhere = int(lengths[1]) if len(lengths) > 1 else 1
            at_an_end = x[a] in (x.min(), x.max())
            if seconds < _STUCK_SECONDS or lengths[0] < _STUCK_TIMES * elsewhere or lengths[0] < 10:
                continue
            # A joint that comes to rest slows down first, and does not jump when it starts again; a
            # channel that freezes does. Over several rows: a slow joint's encoder counts one by one.
            step, width = np.abs(np.diff(x)), min(_SLOWING, len(x) - 1)
            usual = float(np.median(step[step > 0.0]))
            travel = np.abs(x[width:] - x[:-width])
            jump, before = float(step[min(b, len(step) - 1)]), float(abs(x[a] - x[max(a - width, 0)]))
            slowed = before < 0.5 * float(np.median(travel[travel > 0.0]))
            if at_an_end or (name == "q" and jump < 4.0 * usual and slowed):
                continue
            word = "position" if name == "q" else "torque"

            yield Issue(
                f"frozen {word}", "error", f"{name}{j + 1}, rows {a + 2} to {b + 2}",
                f"the {word} of joint {j + 1} repeats one value for {seconds:.3g} s while the arm "
                "moves: the channel was frozen.",
                f"certain: elsewhere it never repeats for more than {elsewhere} rows",
                "delete these rows", _deleted(int(a), int(b)), {"joints": [j + 1], "seconds": seconds},
            )  # fmt: skip


def _deleted(first: int, last: int) -> Repair:
    return lambda run: run.rows(np.r_[0:first, last + 1 : len(run.t)])
