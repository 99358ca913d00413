"""The table of rules about rows and clock, each on the run as those before have mended it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from sdp_vs_penalty.checks.constants import LONG, SPIKE, STUCK_ROWS, STUCK_SECONDS, STUCK_TIMES, TORN
from sdp_vs_penalty.checks.glance import (
    Glance,
    constant_parts,
    evened,
    interpolated,
    lattice_step,
    with_steps,
)  # fmt: skip
from sdp_vs_penalty.checks.issue import Issue, joints_text, rows_text
from sdp_vs_penalty.checks.words import said
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.robot import Robot
from sdp_vs_penalty.signals.runs import spans

Rows = NDArray[np.bool_]
#: Units of time that loggers write, in seconds.
_UNITS = {"seconds": 1.0, "milliseconds": 1e-3, "microseconds": 1e-6, "nanoseconds": 1e-9}
#: Ratios of a velocity channel to the velocity in rad/s that have nothing to do with time.
_VELOCITY_UNITS = np.array([1.0, 180.0 / np.pi, 30.0 / np.pi])
#: Time steps [s] and speeds [rad/s or m/s] of a log that somebody would identify from.
_STEPS, _SPEEDS = (2e-5, 0.5), (3e-3, 100.0)
#: Fewest rows of a run that follows another in one file, or that come a second time.
_RUN = 50
#: Rows in a row that lie on straight lines in every channel are no chance.
_STRAIGHT = 8
#: The samples of the median that a spike is measured from; and the share of rows from which on it is a
#: signal, and a row that repeats the one before no accident.
_WIDTH, _FEW = 7, 0.02
#: Rows over which a joint that comes to rest slows down.
_SLOWING = 10
#: More freezes than this are a coarse sensor.
_FREEZES = 20


def missing(g: Glance) -> Issue | None:
    bad = np.flatnonzero(~g.finite)
    return None if not len(bad) else said(
        "missing numbers", rows_text(int(bad[0]) + 2, len(bad)), lambda r: r.rows(g.finite),
        count=len(bad), rows=(bad[:100] + 2).tolist(),
    )  # fmt: skip


def time_unit(g: Glance) -> Issue | None:
    """A clock that does not count seconds: taken for seconds, it makes the motion far too slow."""
    if g.step <= 0.0 or not g.moving.any():
        return None
    speeds, name, sure = _speeds(g.run)[g.moving], None, ""
    if g.run.dq is not None:
        measured = np.quantile(np.abs(g.run.dq), 0.9, axis=0)[g.moving]
        logs = np.log(measured / np.maximum(speeds, 1e-300) + 1e-300)
        ratio = float(np.exp(np.median(logs)))
        off = {k: np.abs(np.log(ratio * u / _VELOCITY_UNITS)).min() for k, u in _UNITS.items()}
        best = min(off, key=lambda k: off[k])
        if np.mean(np.abs(logs - np.log(ratio)) < 0.1) > 0.5 and off[best] < 0.1:
            name, sure = best, f"certain: dq is {ratio:.4g} times the derivative of q by this clock"
    if name is None:
        speed = float(np.median(speeds))
        possible = {
            k: abs(float(np.log(speed / u)))
            for k, u in _UNITS.items()
            if _STEPS[0] <= g.step * u <= _STEPS[1] and _SPEEDS[0] <= speed / u <= _SPEEDS[1]
        }
        # Seconds, unless another unit alone makes sampling and motion those of a robot.
        known = "seconds" in possible or not possible
        name = "seconds" if known else min(possible, key=lambda k: possible[k])
        sure = f"likely: in seconds it were one row in {g.step:.3g} s of a motion at {speed:.2g} rad/s"
    unit = _UNITS[name]
    return None if unit == 1.0 else said(
        "time unit", "column t", lambda r: replace(r, t=r.t * unit),
        unit=name, factor=unit, step=g.step, sure=sure,
    )  # fmt: skip


def _speeds(run: Measurements, half: int = 5) -> Array:
    """(n,) nearly the largest speed of each joint, from positions some rows apart."""
    span = run.t[2 * half :] - run.t[: -2 * half]
    rows = span > 0.0
    if not rows.any():
        return np.zeros(run.n)
    travel = np.abs(run.q[2 * half :] - run.q[: -2 * half])[rows]
    return np.asarray(np.quantile(travel / span[rows, None], 0.9, axis=0))


def backwards(g: Glance) -> Issue | None:
    """Rows whose time lies before that of an earlier row."""
    bad = np.flatnonzero(g.steps < 0.0)
    if not len(bad):
        return None
    t, q = g.run.t, g.run.q
    long = np.diff(bad, prepend=0, append=len(t) - 1) > _RUN
    near = np.abs(np.diff(q, axis=0))
    usual = [np.median(near[max(k - 5, 0) : k + 6], axis=0) for k in bad]
    on = near[bad] <= 5.0 * np.array(usual) + 1e-3 * np.ptp(q, axis=0)
    if g.step > 0.0 and np.all(long) and np.all(t[bad + 1] - t[0] < 0.05 * (t[bad] - t[0])):
        how, step = "several runs are in the file", max(1.0, 50.0 * g.step)
        remedy = "let each begin a second after the end of the one before (or write a file each)"
    elif g.step > 0.0 and on.all():
        how, step = "the motion continues without a break", g.step
        remedy = "continue the time at the usual step there"
    else:
        how, step = "the rows there do not continue the motion", 0.0
        remedy = "delete the rows whose time lies before that of an earlier row"

    def repair(r: Measurements) -> Measurements:
        if not step:
            return r.rows(np.concatenate([[True], r.t[1:] > np.maximum.accumulate(r.t)[:-1]]))
        steps = np.diff(r.t)
        return with_steps(r, np.where(steps < 0.0, step, steps))

    return said(
        "time runs backwards", rows_text(int(bad[0]) + 3, len(bad)), repair, count=len(bad),
        seconds=float(-g.steps[bad].min()), how=how, remedy=remedy, rows=(bad[:100] + 3).tolist(),
    )  # fmt: skip


def repeated_time(g: Glance) -> Issue | None:
    bad = np.flatnonzero(g.steps == 0.0)
    if not len(bad):
        return None
    same = bool(np.all(g.run.q[bad] == g.run.q[bad + 1]))
    return said(
        "repeated time", rows_text(int(bad[0]) + 3, len(bad)),
        lambda r: r.rows(np.concatenate([[True], np.diff(r.t) != 0.0])), count=len(bad),
        how="are copies of the row before" if same else "differ from the row before",
        rows=(bad[:100] + 3).tolist(),
    )  # fmt: skip


def uneven(g: Glance) -> Issue | None:
    """Stamps that jitter, or come in bursts, although the samples were taken evenly: q is smoother over
    the row number."""
    steps, q = g.steps, g.run.q[:, g.moving]
    pause = LONG * g.step
    long = np.flatnonzero(steps > pause)
    if 10 <= len(long) <= 0.5 * len(steps) and np.median(np.diff(long)) < _RUN:  # of packets
        pause = LONG * float(np.median(steps[long]))
    even = (steps[1:] < pause) & (steps[:-1] < pause)
    spread = float(np.std(steps[steps < pause]) / np.mean(steps[steps < pause])) if even.any() else 0.0
    if spread < 0.02 or not q.shape[1] or np.count_nonzero(even) < _RUN:
        return None
    share = (steps[:-1] / (g.run.t[2:] - g.run.t[:-2]))[:, None]
    over_time = q[1:-1] - (q[:-2] * (1.0 - share) + q[2:] * share)
    over_rows = q[1:-1] - 0.5 * (q[:-2] + q[2:])
    rough_time, rough_rows = (np.sqrt(np.mean(x[even] ** 2, axis=0)) for x in (over_time, over_rows))
    ratio = float(np.median(rough_time / np.maximum(rough_rows, 1e-300)))
    return None if ratio < 3.0 else said(
        "jittered time stamps", "column t", lambda r: evened(r, pause),
        "error" if spread > 1.0 else "", percent=100.0 * spread, ratio=ratio,
    )  # fmt: skip


def _long_steps(g: Glance) -> tuple[NDArray[np.intp], Rows]:
    """Steps that are no jitter, and whether the moving arm moved on meanwhile."""
    long = np.flatnonzero(g.steps > max(LONG * g.step, 0.02))
    q, t, size = g.run.q, g.run.t, np.maximum(np.ptp(g.run.q, axis=0), 1e-12)
    moved = np.ones(len(long), bool)
    for i, k in enumerate(long.tolist()):
        ends = ((max(k - 20, 0), k), (k + 1, min(k + 21, len(t) - 1)))
        with np.errstate(over="ignore"):  # a velocity of 1e300 is another rule's
            parts = [(q[b] - q[a]) / (t[b] - t[a]) for a, b in ends if t[b] > t[a]]
            speed = float(np.linalg.norm(np.mean(parts, axis=0) / size)) if parts else 0.0
            here = float(np.linalg.norm((q[k + 1] - q[k]) / size))
        expected = speed * float(g.steps[k])
        moved[i] = not (g.steps[k] > 10.0 * g.step and expected > 1e-3 and here < 0.2 * expected)
    return long, moved


def clock_step(g: Glance) -> Issue | None:
    """The clock jumps ahead, the arm does not: stamps are wrong, no sample is missing."""
    long, moved = _long_steps(g)
    jumps = long[~moved]
    wrong = np.isin(np.arange(len(g.steps)), jumps)
    return None if not len(jumps) else said(
        "clock step", f"t = {g.run.t[jumps[0]]:.4g} s, {rows_text(int(jumps[0]) + 3, len(jumps))}",
        lambda r: with_steps(r, np.where(wrong, g.step, np.diff(r.t))),
        seconds=float(g.steps[jumps].max()), rows=(jumps[:100] + 3).tolist(),
    )  # fmt: skip


def gap(g: Glance) -> Issue | None:
    long, _ = _long_steps(g)
    return None if not len(long) else said(
        "gap in time", f"t = {g.run.t[long[0]]:.4g} s, {rows_text(int(long[0]) + 3, len(long))}",
        count=len(long), seconds=float(g.steps[long].max()), step=g.step,
        total=float(g.steps[long].sum()), rows=(long[:100] + 3).tolist(),
    )  # fmt: skip


def wrapped(g: Glance) -> Issue | None:
    """A revolute position that jumps by a turn from one row to the next."""
    steps = np.abs(np.diff(g.run.q, axis=0))
    turns = np.any(np.abs(steps - 2.0 * np.pi) < 0.3, axis=0) & (np.median(steps, axis=0) < 0.3)
    joints = [j for j in np.flatnonzero(turns).tolist() if g.robot.joints[j].kind == "revolute"]

    def repair(r: Measurements) -> Measurements:
        q = r.q.copy()
        q[:, joints] = np.unwrap(q[:, joints], axis=0)
        return replace(r, q=q)

    where = joints_text(joints) if joints else ""
    return said("wrapped angle", where, repair, joints=[j + 1 for j in joints]) if joints else None


def repeated_run(g: Glance) -> Issue | None:
    """Rows that come a second time, all at the same distance and one after the other.

    Where a motion repeats and its columns are coarse, single rows are equal by chance.
    """
    number = g.row_numbers
    first = np.full(int(number.max(initial=-1)) + 1, -1)
    first[number[::-1]] = np.arange(len(number))[::-1]
    lag = np.arange(len(number)) - first[number]
    lags, counts = np.unique(lag[lag > _RUN], return_counts=True)
    if not len(lags) or counts.max() < _RUN:
        return None
    most = int(lags[np.argmax(counts)])
    same = np.concatenate([np.zeros(most, bool), number[most:] == number[:-most]])
    again = _only(same, [p for p in spans(same) if p[1] - p[0] >= _RUN])
    by_chance = int(same.sum() - again.sum())
    if by_chance > 0.1 * again.sum() or not again.any():
        return None
    if np.ptp(g.run.q[again], axis=0).max() < 0.05 * np.ptp(g.run.q, axis=0).max():
        return None  # one pose, held by a simulator without noise
    rows = np.flatnonzero(again)
    return said(
        "repeated run", rows_text(int(rows[0]) + 2, len(rows)), lambda r: r.rows(~again),
        rows=len(rows), lag=most,
    )  # fmt: skip


def _only(like: Rows, parts: list[Array]) -> Rows:
    out = np.zeros(len(like), bool)
    for a, b in parts:
        out[int(a) : int(b)] = True
    return out


def frozen_packets(g: Glance) -> Issue | None:
    """Stretches in which every channel repeats one row while the arm moves: no packet came."""
    parts = spans(g.held)
    if not len(parts):
        return None
    lengths = np.diff(parts)[:, 0]
    usual = float(np.median(lengths)) if len(parts) > _FREEZES else 1.0
    long = parts[lengths >= max(STUCK_ROWS, STUCK_TIMES * usual)]
    found = [p for p in long if p[1] < len(g.run.t) and _leaps(g, int(p[0]) - 1, int(p[1]) - 1)]
    return _deleted(g, "frozen packets", "", [], found)


def _deleted(g: Glance, kind: str, named: str, joints: list[int], parts: list[Array]) -> Issue | None:
    """Parts of the rows that are no measurements."""
    if not len(parts):
        return None
    gone = _only(np.zeros(len(g.run.t), bool), parts)
    places = spans(gone)
    seconds = float(max(g.run.t[min(b, len(g.run.t)) - 1] - g.run.t[max(a - 1, 0)] for a, b in places))
    more = f" and {len(places) - 1} more parts" if len(places) > 1 else ""
    where = f"{named}{', ' if named else ''}rows {places[0][0] + 2} to {places[0][1] + 1}{more}"
    short = kind == "frozen packets" and seconds < STUCK_SECONDS
    return said(
        kind, where, lambda r: r.rows(~gone), "warning" if short else "", named=named, joints=joints,
        seconds=seconds, parts=len(places), rows=int(gone.sum()),
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
        return None  # own stamps: a logger a little faster than its source holds samples, too
    same, span = g.held & g.movement.moves, 20
    share, at = float(same.mean()), np.flatnonzero(same)
    at = at[(at >= span) & (at < len(same) - span)]
    at = at[~same[at - 1] & ~same[at + 1]]
    if not 0.002 <= share <= 0.8 or not len(at):
        return None

    def speed(reach: int) -> Array:
        away = np.linalg.norm(g.run.q[at + reach] - g.run.q[at - reach], axis=1)
        return np.asarray(away / np.maximum(g.run.t[at + reach] - g.run.t[at - reach], 1e-300))

    where = rows_text(int(np.flatnonzero(same)[0]) + 2, int(same.sum()))
    if np.median(speed(1) / np.maximum(speed(span), 1e-300)) <= 0.75:
        return said(
            "doubled rows", where,
            lambda r: with_steps(r, np.where(same[1:], 0.0, np.diff(r.t))).rows(~same),
            rows=int(same.sum()),
        )  # fmt: skip
    if not _FEW < share < 0.5:  # from half on the log is faster than its source
        return None
    return said("repeated packets", where, lambda r: r.rows(~same), rows=int(same.sum()))


def interpolated_rows(g: Glance) -> Issue | None:
    """Rows that lie on straight lines in every channel: a gap that was filled in."""
    if not g.run.torque_logged:
        return None  # coarse positions alone lie on straight lines by themselves
    x = np.column_stack([g.run.q, g.run.tau])
    x = x[:, np.ptp(x, axis=0) > 0.0]
    steps = g.steps[:, None]
    slope = np.diff(x, axis=0) / np.maximum(steps, 1e-300)
    size = np.maximum(np.abs(slope[1:]), np.abs(slope[:-1]))
    bends = np.abs(np.diff(slope, axis=0)) > 1e-6 * size + 1e-9 * np.ptp(x, axis=0) / steps[1:]
    inside = np.concatenate([[False], ~np.any(bends, axis=1) & np.any(size > 0.0, axis=1), [False]])
    edges, moves = spans(inside), g.movement.moves
    # A converter that interpolates every row makes lines everywhere; a gap is far longer than those.
    usual = float(np.median(np.diff(edges))) if inside.mean() > 0.3 else 0.0
    least = max(_STRAIGHT, 5.0 * usual)
    parts = [p for p in edges if p[1] - p[0] >= least and moves[p[0] : p[1]].mean() > 0.5]
    return _deleted(g, "interpolated rows", "", [], parts)


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
        long |= _only(bad, [p for p in spans(bad) if steps[p[0] : p[1]].sum() > 0.02])
    rows = np.flatnonzero(np.any(list(found.values()), axis=0))
    named = ", ".join(found) + (" is" if len(found) == 1 else " are")
    return said(
        "zeros", f"{', '.join(found)}, {rows_text(int(rows[0]) + 2, len(rows))}",
        lambda r: interpolated(r, found).rows(~long), named=named, joints=_joints(found), rows=len(rows),
    )  # fmt: skip


def _filled(x: Array) -> Rows:
    """(N,) which samples of a channel are zeros that it does not pass through.

    A zero between a sample below and one above it is a passage, however coarse the steps; a fill leaves
    one side and comes back to it, by far more than the channel's usual step, and more often than other
    levels near zero are reached so.
    """
    zero, bad = np.abs(x) < 1e-300, np.zeros(len(x), bool)
    parts, other = spans(zero), np.flatnonzero(~zero)
    changes = np.abs(np.diff(x))
    if not len(parts) or len(other) < 40 or not changes.any():
        return bad
    usual, step = float(np.median(changes[changes > 0.0])), lattice_step(x[other])
    for a, b in parts:
        if a > 0 and b < len(x):
            least = max(6.0 * usual, 3.0 * step) * (1.0 if x[a - 1] * x[b] > 0.0 else 3.0)
            bad[a:b] = min(abs(x[a - 1]), abs(x[b])) > least
    near = other[np.abs(x[other]) <= 20.0 * step]
    near = near[(near > 0) & (near < len(x) - 1)]
    by_chance = np.sum(np.minimum(changes[near - 1], changes[near]) > 6.0 * usual) / 40.0
    return bad if bad.sum() > 10.0 * by_chance else np.zeros(len(x), bool)


def spikes(g: Glance) -> Issue | None:
    """Single samples far from their neighbours on both sides: bits turned, packets torn."""
    found = {}
    for name, j, x in g.channels:
        low, high = np.quantile(x, [0.02, 0.98])
        least = SPIKE[1] * (high - low) + 1e-9
        if not g.moving[j] or np.abs(np.diff(x)).max() <= least / (_WIDTH // 2):
            continue  # the median of the window cannot be that far
        around = sliding_window_view(np.pad(x, _WIDTH // 2, "edge"), _WIDTH)
        off = np.abs(x - np.median(around, axis=1))
        bad = (off > max(SPIKE[0] * np.quantile(off, 0.9), least)) & g.inside
        if 0 < bad.sum() <= _FEW * len(x):
            found[name] = bad
    if not found:
        return None
    count, first = (
        sum(int(b.sum()) for b in found.values()),
        min(int(np.argmax(b)) for b in found.values()),
    )
    return said(
        "spikes", f"{', '.join(found)}, {rows_text(first + 2, count)}",
        partial(interpolated, found=found),
        named=", ".join(found), joints=_joints(found), samples=count,
    )  # fmt: skip


def _joints(found: dict[str, Rows]) -> list[int]:
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
    # Three in four of the joints that tell have to skip; a skip is above the median of its window.
    pad, least = np.pad(speed, ((5, 5), (0, 0)), "edge"), max(2, (q.shape[1] + 1) // 2)
    slower = sum((pad[k : k + len(speed)] < speed / TORN).astype(np.int8) for k in range(11))
    rows = np.flatnonzero(np.sum(slower > 5, axis=1) >= least - 1 - (least - 1) // 4)
    rows = rows[steps[rows] < 3.0 * np.median(steps)]
    if not len(rows):
        return None
    windows = sliding_window_view(pad, 11, axis=0)[rows]
    usual, rough = np.median(windows, axis=2), np.quantile(windows, 0.9, axis=2)
    # Only joints that move well above their own scatter there can tell.
    scatter = np.quantile(np.abs(np.diff(speed, axis=0)), 0.9, axis=0)
    tells = (usual > 3.0 * scatter) & (rough < 2.0 * usual)
    rows, tells, usual = (x[tells.sum(axis=1) >= least] for x in (rows, tells, usual))
    if not len(rows):
        return None
    ratio = np.where(tells, speed[rows] / np.maximum(usual, 1e-300), np.nan)
    low, middle, high = np.nanquantile(ratio, [0.25, 0.5, 0.75], axis=1)
    torn = (low > TORN) & (high < 2.0 * low + 1.0)
    rows, lost = fresh[rows[torn] + 1] - 1, np.round(middle[torn] - 1.0)
    if not len(rows) or len(rows) > _FEW * len(steps):
        return None
    added = np.zeros(len(g.steps))
    added[rows] = lost * np.median(steps)
    return said(
        "lost rows", rows_text(int(rows[0]) + 3, len(rows)),
        lambda r: with_steps(r, np.diff(r.t) + added),
        count=len(rows), lost=lost.sum(), missing=lost.tolist()[:100], rows=(rows + 3).tolist()[:100],
    )  # fmt: skip


def frozen(g: Glance, word: str) -> Issue | None:
    """Channels that repeat a value bit by bit while the arm moves, and did not slow down before."""
    parts: list[Array] = []
    named: list[int] = []
    for name, j, x in g.channels:
        if (
            (name[0] == "q") == (word == "position")
            and (word == "torque" or g.moving[j])
            and np.ptp(x) > 0
        ):
            stuck = _stuck(g, j, x, word == "position")
            parts, named = parts + stuck, named + [j] * bool(stuck)
    return _deleted(
        g, f"frozen {word}", joints_text(named) if named else "", [j + 1 for j in named], parts
    )


def _stuck(g: Glance, j: int, x: Array, position: bool) -> list[Array]:
    """First row and the one after the last of parts in which a channel of joint j is frozen."""
    moved, parts = np.concatenate([[0], np.cumsum(g.movement.moves)]), constant_parts(x)
    parts = parts[np.diff(moved[parts])[:, 0] > 0.9 * np.diff(parts)[:, 0]] if len(parts) else parts
    lengths = np.diff(parts)[:, 0] if len(parts) else np.zeros(0)
    alike = parts[lengths * STUCK_TIMES > lengths.max(initial=0)]  # freezes must not hide each other
    if len(alike) > _FREEZES or lengths.max(initial=0) < STUCK_ROWS:
        return []
    step, width = np.abs(np.diff(x)), min(_SLOWING, len(x) - 1)
    # A coarse channel keeps its value by itself, and then goes on by one level.
    usual, level = float(np.median(step[step > 0.0])), 3.0 * lattice_step(x)
    travel = np.abs(x[width:] - x[:-width])
    usually, bad = 0.5 * float(np.median(travel[travel > 0.0])) if travel.any() else 0.0, []
    for a, b in alike:
        jump, before = step[min(b, len(step) - 1)], abs(x[a] - x[max(a - width, 0)])
        if position:
            by_itself = jump < 4.0 * usual and before < usually
        else:  # dry friction is constant until its joint turns, and hides in a coarse channel's step
            after, now = g.run.q[min(b + width, len(x) - 1), j], g.run.q[b, j]
            by_itself = usual < level and (after - now) * (now - g.run.q[max(b - width, 0), j]) <= 0.0
        clipped = x[a] in (x.min(), x.max())  # stays at its end
        short = g.run.t[b] - g.run.t[a] < 2.0 * STUCK_SECONDS
        if not (short or clipped or jump < level or by_itself):
            bad.append(np.array([a, b + 1]))
    # Elsewhere, off its ends, it may stay within one step for as long in motion.
    free = g.movement.moves & (x > x.min()) & (x < x.max())
    width = int(np.diff(alike).min() / STUCK_TIMES)
    free &= ~_only(free, [np.array([a, b + 1]) for a, b in alike])
    for a, b in spans(free) if bad else ():
        if b - a > width and np.ptp(sliding_window_view(x[a:b], width + 1), axis=1).min() <= level / 2.0:
            return []
    return bad


#: In the order of mending; each sees the run as those before have mended it. Those of MOTION are about
#: a motion.
CLOCK = (missing, time_unit, backwards, repeated_time, uneven, clock_step, gap)
MOTION = (
    wrapped, repeated_run, frozen_packets, doubled, interpolated_rows, zeros, spikes, lost_rows,
    partial(frozen, word="position"), partial(frozen, word="torque"),
)  # fmt: skip
#: Rows below which nothing but missing numbers is looked for, and those for rules about a motion.
_FEWEST, _MOTION = 3, 30


def mended(
    run: Measurements, robot: Robot, standstill: float
) -> tuple[list[Issue], Measurements, Measurements]:
    """The issues of a run's rows and clock; the run with all of them mended, and with the certain
    ones."""
    issues: list[Issue] = []
    fixed, glance = run, Glance(run, robot, standstill)
    rules: tuple[Callable[[Glance], Issue | None], ...] = (*CLOCK, *MOTION)
    for k, rule in enumerate(rules):
        rows, motion = len(glance.run.t), k >= len(CLOCK)
        if k and (rows < _FEWEST or (motion and (rows < _MOTION or not glance.moving.any()))):
            break
        issue = rule(glance)
        if issue is None:
            continue
        issues.append(issue)
        if issue.repair is not None:
            # What is only likely is mended for the rules that follow, whose rows are counted there.
            fixed = issue.repair(fixed) if issue.mends and len(fixed.t) == rows else fixed
            glance = Glance(issue.repair(glance.run), robot, standstill)
    return issues, glance.run, fixed
