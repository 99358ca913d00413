"""Rules about the clock: numbers that are not there, its unit, repeats, steps, bursts, gaps, jitter."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty import show
from sdp_vs_penalty.checks.glance import LONG, Glance, evened, with_steps
from sdp_vs_penalty.checks.issue import Issue, rows_text
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.runs import spans

_READ = "certain: read from the file"
#: Units of time that loggers write, in seconds.
_UNITS = {"seconds": 1.0, "milliseconds": 1e-3, "microseconds": 1e-6, "nanoseconds": 1e-9}
#: Ratios of a velocity channel to the velocity in rad/s that have nothing to do with time.
_VELOCITY_UNITS = np.array([1.0, 180.0 / np.pi, 30.0 / np.pi])
#: Time steps [s] and speeds [rad/s or m/s] of a log that somebody would identify from.
_STEPS, _SPEEDS = (2e-5, 0.5), (3e-3, 100.0)
#: Fewest rows of a run that follows another in one file.
_RUN = 50
#: In bursts the usual step is at most this share of the mean one.
_BURST = 0.1
#: Stamps jitter for no reason if q is this many times rougher over them than over the row number.
_ROUGHER = 3.0


def missing(g: Glance) -> Issue | None:
    bad = np.flatnonzero(~g.finite)
    if not len(bad):
        return None
    keep = g.finite
    return Issue(
        "missing numbers", "error", rows_text(int(bad[0]) + 2, len(bad)),
        f"{show.count(len(bad), 'row')} with values that are not finite numbers, or that no robot "
        "measures.", _READ, "delete those rows", lambda r: r.rows(keep),
        {"rows": (bad[:100] + 2).tolist()},
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
        if np.mean(np.abs(logs - np.log(ratio)) < 0.1) > 0.5:
            off = {k: np.abs(np.log(ratio * u / _VELOCITY_UNITS)).min() for k, u in _UNITS.items()}
            name = min(off, key=lambda k: off[k])
            name = name if off[name] < 0.1 else None
            sure = f"certain: dq is {ratio:.4g} times the derivative of q by this clock"
    speed = float(np.median(speeds))
    if name is None:
        name = _unit_by_size(g.step, speed)
        sure = (
            f"likely: if it were in seconds, there would be one row in {g.step:.3g} s of a motion at "
            f"{speed:.2g} rad/s (or m/s)"
        )
    if name == "seconds":
        return None
    unit = _UNITS[name]
    return Issue(
        "time unit", "error", "column t",
        f"time is in {name}, not in seconds (it advances by {g.step:.4g} from row to row).", sure,
        f"multiply t by {unit:g}", lambda r: replace(r, t=r.t * unit),
        {"unit": name, "median_step": g.step},
    )  # fmt: skip


def _unit_by_size(step: float, speed: float) -> str:
    """Seconds unless another unit alone makes sampling and motion those of a robot."""
    possible = {
        name: abs(float(np.log(speed / unit)))
        for name, unit in _UNITS.items()
        if _STEPS[0] <= step * unit <= _STEPS[1] and _SPEEDS[0] <= speed / unit <= _SPEEDS[1]
    }
    if "seconds" in possible or not possible:
        return "seconds"
    return min(possible, key=lambda key: possible[key])


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
    repair = _only_forward
    if g.step > 0.0 and _anew(g.run.t, bad):
        what = f"the clock begins anew {show.count(len(bad), 'time')}: several runs are in the file."
        remedy = "let each begin a second after the end of the one before (or write a file each)"
        repair = partial(_run_on, step=max(1.0, 50.0 * g.step))
    elif g.step > 0.0 and all(_continues(g.run, int(k)) for k in bad):
        what = (
            f"the clock is set back {show.count(len(bad), 'time')}, by up to "
            f"{-g.steps[bad].min():.3g} s, while the motion continues without a break."
        )
        remedy = "continue the time at the usual step there"
        repair = partial(_run_on, step=g.step)
    else:
        what = (
            f"time runs backwards {show.count(len(bad), 'time')}, and the rows there do not "
            "continue the motion."
        )
        remedy = "delete the rows whose time lies before that of an earlier row"
    return Issue(
        "time runs backwards", "error", rows_text(int(bad[0]) + 3, len(bad)), what, _READ, remedy,
        repair, {"rows": (bad[:100] + 3).tolist(), "largest_s": float(-g.steps[bad].min())},
    )  # fmt: skip


def _only_forward(run: Measurements) -> Measurements:
    latest = np.maximum.accumulate(run.t)
    return run.rows(np.concatenate([[True], run.t[1:] > latest[:-1]]))


def _anew(t: Array, back: NDArray[np.intp]) -> bool:
    """Whether every step back leads to the start of the clock, or before it, and a run follows."""
    long = np.diff(back, prepend=0, append=len(t) - 1) > _RUN
    return bool(np.all(long) and np.all(t[back + 1] - t[0] < 0.05 * (t[back] - t[0])))


def _run_on(run: Measurements, step: float) -> Measurements:
    """Steps back replaced by ``step`` [s]: the usual one, or a gap, at which runs are split."""
    steps = np.diff(run.t)
    return with_steps(run, np.where(steps < 0.0, step, steps))


def _continues(run: Measurements, k: int) -> bool:
    """Whether q moves from row k to k + 1 as in one ordinary step of time, not as in none or many."""
    moves = np.abs(np.diff(run.q[max(k - 5, 0) : k + 7], axis=0))
    here = np.abs(run.q[k + 1] - run.q[k])
    return bool(np.all(here <= 5.0 * np.median(moves, axis=0) + 1e-3 * np.ptp(run.q, axis=0)))


def repeated_time(g: Glance) -> Issue | None:
    bad = np.flatnonzero(g.steps == 0.0)
    if not len(bad):
        return None
    same = bool(np.all(g.run.q[bad] == g.run.q[bad + 1]))
    kind = "are copies of the row before" if same else "differ from the row before with the same time"
    return Issue(
        "repeated time", "error", rows_text(int(bad[0]) + 3, len(bad)),
        f"{show.count(len(bad), 'row')} with a repeated time; the values {kind}.", _READ,
        "keep the first of each", lambda r: r.rows(np.concatenate([[True], np.diff(r.t) != 0.0])),
        {"rows": (bad[:100] + 3).tolist()},
    )  # fmt: skip


def bursts(g: Glance) -> Issue | None:
    """Stamps of packets: many rows at once, then a pause, although the motion goes on evenly."""
    pauses = np.flatnonzero(g.steps > LONG * g.step)
    if len(pauses) < 10 or len(pauses) > 0.5 * len(g.steps):
        return None
    pause = float(np.median(g.steps[pauses]))
    per = float(np.median(np.diff(pauses)))
    if g.step > _BURST * pause / per or np.mean(g.steps[pauses] < LONG * pause) < 0.9:
        return None
    even = pause / per
    return Issue(
        "burst stamps", "error", "column t",
        f"rows come in bursts of {per:.0f}, {g.step:.2g} s apart, every {pause:.3g} s: these are the "
        "times of packets, not of samples.", _READ,
        f"space the time stamps evenly, {even:.3g} s apart (and log the samples' own time)",
        lambda r: evened(r, LONG * pause), {"rows_a_burst": per, "seconds": pause},
    )  # fmt: skip


def late_packet(g: Glance) -> Issue | None:
    """Some rows at once, then a pause that makes up for them: stamped when their packet came."""
    parts = [
        (int(a), int(b))
        for a, b in spans(g.steps < _BURST * g.step)
        if b - a >= 5 and b < len(g.steps) and 0.5 < g.steps[b] / (g.step * (b - a)) < 2.0
    ]
    if not parts:
        return None
    rows = sum(b - a for a, b in parts)

    def repair(r: Measurements) -> Measurements:
        t = r.t.copy()
        for a, b in parts:
            t[a : b + 2] = np.linspace(t[a], t[b + 1], b + 2 - a)
        return replace(r, t=t)

    return Issue(
        "burst stamps", "warning", rows_text(parts[0][0] + 2, rows),
        f"{rows} rows carry one time, {show.count(len(parts), 'time')}, and a pause follows that "
        f"makes up for "
        "them: they were stamped when their packet came.", _READ, "space these time stamps "
        "evenly", repair,
        {"rows": rows},
    )  # fmt: skip


def clock_step(g: Glance) -> Issue | None:
    """The clock jumps ahead, the arm does not: stamps are wrong, no sample is missing."""
    long, jumps = _long_steps(g), []
    size = np.maximum(np.ptp(g.run.q, axis=0), 1e-12)
    for k in long.tolist():
        with np.errstate(over="ignore"):  # a velocity of 1e300 is another rule's
            here = float(np.linalg.norm((g.run.q[k + 1] - g.run.q[k]) / size))
            speed = float(np.linalg.norm(_speed(g.run, k) / size))
        expected = speed * float(g.steps[k])
        if g.steps[k] > 10.0 * g.step and expected > 1e-3 and here < 0.2 * expected:
            jumps.append(k)
    if not jumps:
        return None
    wrong = np.isin(np.arange(len(g.steps)), jumps)
    return Issue(
        "clock step", "warning", f"t = {g.run.t[jumps[0]]:.4g} s, {rows_text(jumps[0] + 3, len(jumps))}",
        f"the clock jumps ahead by up to {g.steps[jumps].max():.3g} s while the moving arm does not: "
        f"the "
        "clock was set, and no sample is missing.",
        "likely: the distance travelled is that of one usual step",
        "continue the time at the usual step there",
        lambda r: with_steps(r, np.where(wrong, g.step, np.diff(r.t))),
        {"rows": [k + 3 for k in jumps], "seconds": g.steps[jumps].tolist()},
    )  # fmt: skip


def _long_steps(g: Glance) -> NDArray[np.intp]:
    return np.flatnonzero(g.steps > max(LONG * g.step, 0.02))


def _speed(run: Measurements, k: int, width: int = 20) -> Array:
    """(n,) speed around row k without the step itself."""
    ends = ((max(k - width, 0), k), (k + 1, min(k + 1 + width, len(run.t) - 1)))
    parts = [(run.q[b] - run.q[a]) / (run.t[b] - run.t[a]) for a, b in ends if run.t[b] > run.t[a]]
    return np.asarray(np.mean(parts, axis=0) if parts else np.zeros(run.n), float)


def gap(g: Glance) -> Issue | None:
    long = _long_steps(g)
    if not len(long):
        return None
    steps = g.steps[long]
    return Issue(
        "gap in time", "warning", f"t = {g.run.t[long[0]]:.4g} s, "
        f"{rows_text(int(long[0]) + 3, len(long))}",
        f"{show.count(len(long), 'gap')} of up to {steps.max():.3g} s (the usual step is "
        f"{g.step:.3g} s); "
        f"in all {steps.sum():.3g} s are missing.", _READ,
        "no action needed: the run is split there, and the filters lose a second on either side",
        None, {"rows": (long[:100] + 3).tolist(), "seconds": steps[:100].tolist()},
    )  # fmt: skip


def jitter(g: Glance) -> Issue | None:
    """Stamps that jitter although the samples were taken evenly: q is smoother over the row number."""
    steps, q = g.steps, g.run.q
    even = np.all(np.stack([steps[1:], steps[:-1]]) < LONG * g.step, axis=0)
    spread = float(np.std(steps[steps < LONG * g.step])) / g.step if g.step else 0.0
    moving = np.ptp(q, axis=0) > 0.0
    if spread < 0.02 or not moving.any() or np.count_nonzero(even) < _RUN:
        return None
    share = (steps[:-1] / (g.run.t[2:] - g.run.t[:-2]))[:, None]
    over_time = q[1:-1] - (q[:-2] * (1.0 - share) + q[2:] * share)
    over_rows = q[1:-1] - 0.5 * (q[:-2] + q[2:])
    rough_time, rough_rows = (np.sqrt(np.mean(x[even] ** 2, axis=0)) for x in (over_time, over_rows))
    ratio = float(np.median((rough_time / np.maximum(rough_rows, 1e-300))[moving]))
    if ratio < _ROUGHER:
        return None
    return Issue(
        "jittered time stamps", "warning", "column t",
        f"the time steps vary by {100.0 * spread:.0f} %, but the positions are {ratio:.0f} times "
        f"smoother "
        "over the row number than over these times: the samples are evenly spaced, the time stamps are "
        "not.",
        "likely: if the sampling itself jittered, the motion would be smoother over the recorded times",
        f"space the time stamps evenly, {g.step:.6g} s apart",
        lambda r: evened(r, LONG * float(np.median(np.diff(r.t)))),
        {"jitter_percent": 100.0 * spread, "roughness_ratio": ratio},
    )  # fmt: skip


#: In the order of mending; each sees the run as those before have mended it.
CLOCK_RULES = (
    missing, time_unit, backwards, repeated_time, bursts, late_packet, clock_step, gap, jitter,
)  # fmt: skip
