"""The table of rules about rows and clock, each on the run as those before have mended it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from typing import Any

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
from sdp_vs_penalty.checks.issue import Finding, Issue, Rule, joints_text, rows_text
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


def _listed(rows: NDArray[np.intp]) -> str:
    return rows_text(int(rows[0]), len(rows))


def _rows(rows: NDArray[np.intp]) -> dict[str, Any]:
    return {"count": len(rows), "rows": rows[:100].tolist()}


def missing(g: Glance) -> Iterator[Finding]:
    bad = np.flatnonzero(~g.finite)
    if len(bad):
        yield _listed(bad + 2), lambda r: r.rows(g.finite), _rows(bad + 2)


def time_unit(g: Glance) -> Iterator[Finding]:
    """A clock that does not count seconds: taken for seconds, it makes the motion far too slow."""
    if g.step <= 0.0 or not g.moving.any():
        return
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
    if (unit := _UNITS[name]) != 1.0:
        figures = {"unit": name, "factor": unit, "step": g.step, "sure": sure}
        yield "column t", lambda r: replace(r, t=r.t * unit), figures


def _speeds(run: Measurements, half: int = 5) -> Array:
    """(n,) nearly the largest speed of each joint, from positions some rows apart."""
    span = run.t[2 * half :] - run.t[: -2 * half]
    rows = span > 0.0
    if not rows.any():
        return np.zeros(run.n)
    travel = np.abs(run.q[2 * half :] - run.q[: -2 * half])[rows]
    return np.asarray(np.quantile(travel / span[rows, None], 0.9, axis=0))


def backwards(g: Glance) -> Iterator[Finding]:
    """Rows whose time lies before that of an earlier row."""
    bad = np.flatnonzero(g.steps < 0.0)
    if not len(bad):
        return
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

    seconds = float(-g.steps[bad].min())
    yield _listed(bad + 3), repair, _rows(bad + 3) | {"seconds": seconds, "how": how, "remedy": remedy}


def repeated_time(g: Glance) -> Iterator[Finding]:
    bad = np.flatnonzero(g.steps == 0.0)
    if len(bad):
        same = bool(np.all(g.run.q[bad] == g.run.q[bad + 1]))
        how = "are copies of the row before" if same else "differ from the row before"
        repair = lambda r: r.rows(np.concatenate([[True], np.diff(r.t) != 0.0]))  # noqa: E731
        yield _listed(bad + 3), repair, _rows(bad + 3) | {"how": how}


def uneven(g: Glance) -> Iterator[Finding]:
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
        return
    share = (steps[:-1] / (g.run.t[2:] - g.run.t[:-2]))[:, None]
    over_time = q[1:-1] - (q[:-2] * (1.0 - share) + q[2:] * share)
    over_rows = q[1:-1] - 0.5 * (q[:-2] + q[2:])
    rough_time, rough_rows = (np.sqrt(np.mean(x[even] ** 2, axis=0)) for x in (over_time, over_rows))
    ratio = float(np.median(rough_time / np.maximum(rough_rows, 1e-300)))
    if ratio >= 3.0:
        grave = {"severity": "error"} if spread > 1.0 else {}
        figures = {"percent": 100.0 * spread, "ratio": ratio, **grave}
        yield "column t", lambda r: evened(r, pause), figures


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


def clock_step(g: Glance) -> Iterator[Finding]:
    """The clock jumps ahead, the arm does not: stamps are wrong, no sample is missing."""
    long, moved = _long_steps(g)
    jumps = long[~moved]
    wrong = np.isin(np.arange(len(g.steps)), jumps)
    if len(jumps):
        repair = lambda r: with_steps(r, np.where(wrong, g.step, np.diff(r.t)))  # noqa: E731
        where = f"t = {g.run.t[jumps[0]]:.4g} s, {_listed(jumps + 3)}"
        yield where, repair, _rows(jumps + 3) | {"seconds": float(g.steps[jumps].max())}


def gap(g: Glance) -> Iterator[Finding]:
    long, _ = _long_steps(g)
    if len(long):
        steps = g.steps[long]
        sizes = {"seconds": float(steps.max()), "step": g.step, "total": float(steps.sum())}
        where = f"t = {g.run.t[long[0]]:.4g} s, {_listed(long + 3)}"
        yield where, None, _rows(long + 3) | sizes


def wrapped(g: Glance) -> Iterator[Finding]:
    """A revolute position that jumps by a turn from one row to the next."""
    steps = np.abs(np.diff(g.run.q, axis=0))
    turns = np.any(np.abs(steps - 2.0 * np.pi) < 0.3, axis=0) & (np.median(steps, axis=0) < 0.3)
    joints = [j for j in np.flatnonzero(turns).tolist() if g.robot.joints[j].kind == "revolute"]

    def repair(r: Measurements) -> Measurements:
        q = r.q.copy()
        q[:, joints] = np.unwrap(q[:, joints], axis=0)
        return replace(r, q=q)

    if joints:
        yield joints_text(joints), repair, {"joints": [j + 1 for j in joints]}


def repeated_run(g: Glance) -> Iterator[Finding]:
    """Rows that come a second time, all at the same distance and one after the other.

    Where a motion repeats and its columns are coarse, single rows are equal by chance.
    """
    number = g.row_numbers
    first = np.full(int(number.max(initial=-1)) + 1, -1)
    first[number[::-1]] = np.arange(len(number))[::-1]
    lag = np.arange(len(number)) - first[number]
    lags, counts = np.unique(lag[lag > _RUN], return_counts=True)
    if not len(lags) or counts.max() < _RUN:
        return
    most = int(lags[np.argmax(counts)])
    same = np.concatenate([np.zeros(most, bool), number[most:] == number[:-most]])
    again = _only(same, [p for p in spans(same) if p[1] - p[0] >= _RUN])
    by_chance = int(same.sum() - again.sum())
    if by_chance > 0.1 * again.sum() or not again.any():
        return
    # One pose, held by a simulator without noise, is no copy.
    if np.ptp(g.run.q[again], axis=0).max() >= 0.05 * np.ptp(g.run.q, axis=0).max():
        rows = np.flatnonzero(again)
        yield _listed(rows + 2), lambda r: r.rows(~again), {"rows": len(rows), "lag": most}


def _only(like: Rows, parts: list[Array]) -> Rows:
    out = np.zeros(len(like), bool)
    for a, b in parts:
        out[int(a) : int(b)] = True
    return out


def frozen_packets(g: Glance) -> Iterator[Finding]:
    """Stretches in which every channel repeats one row while the arm moves: no packet came."""
    parts = spans(g.held)
    if not len(parts):
        return None
    lengths = np.diff(parts)[:, 0]
    usual = float(np.median(lengths)) if len(parts) > _FREEZES else 1.0
    long = parts[lengths >= max(STUCK_ROWS, STUCK_TIMES * usual)]
    found = [p for p in long if p[1] < len(g.run.t) and _leaps(g, int(p[0]) - 1, int(p[1]) - 1)]
    for where, repair, figures in _deleted(g, "", [], found):
        short = {"severity": "warning"} if figures["seconds"] < STUCK_SECONDS else {}
        yield where, repair, figures | short


def _deleted(g: Glance, named: str, joints: list[int], parts: list[Array]) -> Iterator[Finding]:
    """Parts of the rows that are no measurements."""
    if not len(parts):
        return
    gone = _only(np.zeros(len(g.run.t), bool), parts)
    places = spans(gone)
    seconds = float(max(g.run.t[min(b, len(g.run.t)) - 1] - g.run.t[max(a - 1, 0)] for a, b in places))
    more = f" and {len(places) - 1} more parts" if len(places) > 1 else ""
    where = f"{named}{', ' if named else ''}rows {places[0][0] + 2} to {places[0][1] + 1}{more}"
    figures = {"seconds": seconds, "parts": len(places), "rows": int(gone.sum())}
    yield where, lambda r: r.rows(~gone), {"named": named, "joints": joints, **figures}


def _leaps(g: Glance, a: int, b: int) -> bool:
    """Whether some joint, still from row a to row b, has then come farther than in its usual step and
    by more than its encoder's, and had not slowed down before."""
    q, after = g.run.q, min(b + 1, len(g.run.t) - 1)
    usual = np.median(np.abs(np.diff(q, axis=0)), axis=0) + 1e-12
    jump = np.abs(q[after] - q[b])
    before = np.abs(q[a] - q[max(a - _SLOWING, 0)]) / _SLOWING
    leaps = (jump > 4.0 * usual) | (before > 2.0 * usual) & (jump > before)
    return any(jump[j] > 2.5 * lattice_step(q[:, j]) for j in np.flatnonzero(leaps))


def _copies(g: Glance) -> tuple[Rows, bool] | None:
    """Rows that are copies of the one before while the arm moves, under an even clock, and whether the
    motion skips ahead after them."""
    if not g.step or np.ptp(g.steps) > 1e-3 * g.step:
        return None  # own stamps: a logger a little faster than its source holds samples, too
    same, span = g.held & g.movement.moves, 20
    at = np.flatnonzero(same)
    at = at[(at >= span) & (at < len(same) - span)]
    at = at[~same[at - 1] & ~same[at + 1]]
    if not 0.002 <= same.mean() <= 0.8 or not len(at):
        return None

    def speed(reach: int) -> Array:
        away = np.linalg.norm(g.run.q[at + reach] - g.run.q[at - reach], axis=1)
        return np.asarray(away / np.maximum(g.run.t[at + reach] - g.run.t[at - reach], 1e-300))

    return same, bool(np.median(speed(1) / np.maximum(speed(span), 1e-300)) > 0.75)


def doubled(g: Glance) -> Iterator[Finding]:
    found = _copies(g)
    if found is not None and not found[1]:
        same = found[0]
        repair = lambda r: with_steps(r, np.where(same[1:], 0.0, np.diff(r.t))).rows(~same)  # noqa: E731
        yield _listed(np.flatnonzero(same) + 2), repair, {"rows": int(same.sum())}


def repeated_packets(g: Glance) -> Iterator[Finding]:
    """From half of the rows on a log is faster than its source."""
    found = _copies(g)
    if found is not None and found[1] and _FEW < found[0].mean() < 0.5:
        same = found[0]
        yield _listed(np.flatnonzero(same) + 2), lambda r: r.rows(~same), {"rows": int(same.sum())}


def interpolated_rows(g: Glance) -> Iterator[Finding]:
    """Rows that lie on straight lines in every channel: a gap that was filled in."""
    if not g.run.torque_logged:
        return  # coarse positions alone lie on straight lines by themselves
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
    yield from _deleted(g, "", [], parts)


def zeros(g: Glance) -> Iterator[Finding]:
    """Exact zeros in channels of fine steps: rows that a logger filled in because it had no sample."""
    found = {}
    for name, j, x in g.channels:
        bad = _filled(x) & g.inside if g.moving[j] else np.zeros(len(x), bool)
        # One torque at zero is an outlier as any other, and harms no fit; one position does.
        if bad.sum() > (name[0] == "t"):
            found[name] = bad
    if not found:
        return
    steps, long = np.gradient(g.run.t), np.zeros(len(g.run.t), bool)
    for bad in found.values():
        long |= _only(bad, [p for p in spans(bad) if steps[p[0] : p[1]].sum() > 0.02])
    rows = np.flatnonzero(np.any(list(found.values()), axis=0))
    named = ", ".join(found) + (" is" if len(found) == 1 else " are")
    figures = {"named": named, "joints": _joints(found), "rows": len(rows)}
    where = f"{', '.join(found)}, {_listed(rows + 2)}"
    yield where, lambda r: interpolated(r, found).rows(~long), figures


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


def spikes(g: Glance) -> Iterator[Finding]:
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
    if found:
        count, first = sum(int(b.sum()) for b in found.values()), min(map(np.argmax, found.values()))
        named = ", ".join(found)
        figures = {"named": named, "joints": _joints(found), "samples": count}
        yield f"{named}, {rows_text(int(first) + 2, count)}", partial(interpolated, found=found), figures


def _joints(found: dict[str, Rows]) -> list[int]:
    return sorted({int(name.lstrip("qtau")) for name in found})


def lost_rows(g: Glance) -> Iterator[Finding]:
    """All joints skip ahead within one step of an even clock: rows are missing that it does not show.

    A position that comes again is a packet repeated, and makes up for the skip behind it: each counts
    once, from its first stamp to that of the next.
    """
    q = g.run.q[:, g.moving]
    fresh = np.flatnonzero(np.concatenate([[True], np.any(np.diff(q, axis=0) != 0.0, axis=1)]))
    q, steps = q[fresh], np.diff(g.run.t[fresh])
    if len(fresh) < 50 or q.shape[1] < 2:
        return
    speed = np.abs(np.diff(q, axis=0)) / np.maximum(steps, 1e-300)[:, None]
    # Three in four of the joints that tell have to skip; a skip is above the median of its window.
    pad, least = np.pad(speed, ((5, 5), (0, 0)), "edge"), max(2, (q.shape[1] + 1) // 2)
    slower = sum((pad[k : k + len(speed)] < speed / TORN).astype(np.int8) for k in range(11))
    rows = np.flatnonzero(np.sum(slower > 5, axis=1) >= least - 1 - (least - 1) // 4)
    rows = rows[steps[rows] < 3.0 * np.median(steps)]
    if not len(rows):
        return
    windows = sliding_window_view(pad, 11, axis=0)[rows]
    usual, rough = np.median(windows, axis=2), np.quantile(windows, 0.9, axis=2)
    # Only joints that move well above their own scatter there can tell.
    scatter = np.quantile(np.abs(np.diff(speed, axis=0)), 0.9, axis=0)
    tells = (usual > 3.0 * scatter) & (rough < 2.0 * usual)
    rows, tells, usual = (x[tells.sum(axis=1) >= least] for x in (rows, tells, usual))
    if not len(rows):
        return
    ratio = np.where(tells, speed[rows] / np.maximum(usual, 1e-300), np.nan)
    low, middle, high = np.nanquantile(ratio, [0.25, 0.5, 0.75], axis=1)
    torn = (low > TORN) & (high < 2.0 * low + 1.0)
    rows, lost = fresh[rows[torn] + 1] - 1, np.round(middle[torn] - 1.0)
    if not len(rows) or len(rows) > _FEW * len(steps):
        return
    added = np.zeros(len(g.steps))
    added[rows] = lost * np.median(steps)
    figures = {"lost": lost.sum(), "missing": lost.tolist()[:100], **_rows(rows + 3)}
    yield _listed(rows + 3), lambda r: with_steps(r, np.diff(r.t) + added), figures


def frozen(g: Glance, word: str) -> Iterator[Finding]:
    """Channels that repeat a value bit by bit while the arm moves, and did not slow down before."""
    position = word == "position"
    asked = [(j, x) for name, j, x in g.channels if (name[0] == "q") == position and np.ptp(x) > 0.0]
    stuck = {j: _stuck(g, j, x, position) for j, x in asked if g.moving[j] or not position}
    joints = [j for j, parts in stuck.items() if parts]
    parts = [part for j in joints for part in stuck[j]]
    yield from _deleted(g, joints_text(joints) if joints else "", [j + 1 for j in joints], parts)


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


_READ = "certain: read from the file"

#: In the order of mending; each sees the run as those before have mended it. Those of MOTION are about
#: a motion.
CLOCK = (
    Rule(
        "missing numbers", "error", "{count} rows with values that are not finite numbers, or "
        "that no robot measures.", _READ, "delete those rows", missing,
    ),
    Rule(
        "time unit", "error", "time is in {unit}, not in seconds (it advances by {step:.4g} from "
        "row to row).", "{sure}", "multiply t by {factor:g}", time_unit,
    ),
    Rule(
        "time runs backwards", "error", "the clock is set back {count} times, by up to "
        "{seconds:.3g} s: {how}.", _READ, "{remedy}", backwards,
    ),
    Rule(
        "repeated time", "error", "{count} rows with a repeated time; the values {how}.", _READ,
        "keep the first of each", repeated_time,
    ),
    Rule(
        "jittered time stamps", "warning", "the time steps vary by {percent:.0f} %, but the "
        "positions are {ratio:.0f} times smoother over the row number than over these times: the "
        "samples are evenly spaced, the time stamps are not.", "likely: if the sampling itself "
        "jittered, the motion would be smoother over the recorded times", "space the time stamps "
        "evenly (and log the samples' own time)", uneven,
    ),
    Rule(
        "clock step", "warning", "the clock jumps ahead by up to {seconds:.3g} s while the moving "
        "arm does not: the clock was set, and no sample is missing.", "likely: the distance "
        "travelled is that of one usual step", "continue the time at the usual step there",
        clock_step,
    ),
    Rule(
        "gap in time", "warning", "{count} gaps of up to {seconds:.3g} s (the usual step is "
        "{step:.3g} s); in all {total:.3g} s are missing.", _READ, "no action needed: the run is "
        "split there, and the filters lose a second on either side", gap,
    ),
)  # fmt: skip
MOTION = (
    Rule(
        "wrapped angle", "error", "the position of {where} jumps by a full turn between two rows: "
        "the angle is wrapped.", _READ, "unwrap the angle", wrapped,
    ),
    Rule(
        "repeated run", "error", "{rows} rows are copies, bit by bit, of rows {lag} earlier: a "
        "part of the run is in the file twice, and would count as a repetition without noise.",
        _READ, "delete the copies", repeated_run,
    ),
    Rule(
        "frozen packets", "error", "all channels repeat one row for up to {seconds:.3g} s, "
        "{parts} times, while the arm moves on: no packets came.", _READ, "delete these rows",
        frozen_packets,
    ),
    Rule(
        "doubled rows", "error", "{rows} rows are copies of the row before, and the motion does "
        "not skip ahead after them: rows were doubled and the clock was made again.", _READ,
        "delete the copies and their time", doubled,
    ),
    Rule(
        "repeated packets", "warning", "{rows} rows repeat the one before, and the motion skips "
        "ahead after them: packets were lost, and the logger wrote the last one again.", _READ,
        "delete the copies", repeated_packets,
    ),
    Rule(
        "interpolated rows", "error", "{rows} rows lie on straight lines in every channel: a gap "
        "was filled by interpolation.", _READ, "delete these rows; the run is split there",
        interpolated_rows,
    ),
    Rule(
        "zeros", "error", "{named} exactly zero in {rows} rows, and jumps there and back: nothing "
        "was measured.", "certain: the channel hardly ever takes any other value near zero",
        "replace single rows by interpolation, delete longer parts", zeros,
    ),
    Rule(
        "spikes", "error", "{samples} samples of {named} lie far from the samples on both sides.",
        "certain: no joint moves like that", "replace them by interpolation", spikes,
    ),
    Rule(
        "lost rows", "error", "at {count} places every joint skips ahead within one time step: "
        "about {lost:.0f} rows are missing and the clock was made again.", "certain: all joints "
        "skip by the same time", "put the missing time back", lost_rows,
    ),
    Rule(
        "frozen position", "error", "the position of {named} repeats one value for {seconds:.3g} "
        "s, {parts} times, while the arm moves: the channel was frozen.", "certain: elsewhere it "
        "never repeats for nearly as long", "delete these rows", partial(frozen, word="position"),
    ),
    Rule(
        "frozen torque", "error", "the torque of {named} repeats one value for {seconds:.3g} s, "
        "{parts} times, while the arm moves: the channel was frozen.", "certain: elsewhere it "
        "never repeats for nearly as long", "delete these rows", partial(frozen, word="torque"),
    ),
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
    for k, rule in enumerate((*CLOCK, *MOTION)):
        rows, motion = len(glance.run.t), k >= len(CLOCK)
        if k and (rows < _FEWEST or (motion and (rows < _MOTION or not glance.moving.any()))):
            break
        for issue in rule(glance):
            issues.append(issue)
            if issue.repair is not None:
                # What is only likely is mended for the rules that follow, whose rows are counted there.
                fixed = issue.repair(fixed) if issue.mends and len(fixed.t) == rows else fixed
                glance = Glance(issue.repair(glance.run), robot, standstill)
    return issues, glance.run, fixed
