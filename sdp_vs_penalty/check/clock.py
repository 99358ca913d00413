"""The clock column: numbers that are not there, repeats, steps back, steps forward, gaps, jitter."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty import show
from sdp_vs_penalty.check import stamps
from sdp_vs_penalty.check.issue import Issue, rows_text
from sdp_vs_penalty.check.stamps import LONG
from sdp_vs_penalty.data.measurements import LARGEST_VALUE, Measurements
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.runs import moving_joints


def find(run: Measurements) -> Iterator[Issue]:
    """Problems of the clock and of missing numbers, in the order in which they must be mended."""
    gaps = _missing(run)
    if gaps is not None:
        yield gaps
        run = run.rows(_finite(run))
    if len(run.t) < 3:
        return
    for step in (_time_unit, _backwards, _repeats, stamps.bursts, _clock_step, _gap, stamps.jitter):
        issue = step(run)
        if issue is not None:
            yield issue
            if issue.repair is not None:
                run = issue.repair(run)


def _finite(run: Measurements) -> NDArray[np.bool_]:
    parts = {"t": run.t[:, None], **run.groups}.items()
    # What is not a number compares false.
    with np.errstate(invalid="ignore"):
        return np.all([np.all(np.abs(x) <= LARGEST_VALUE[name], axis=1) for name, x in parts], axis=0)


def _row(index: int) -> int:
    """Row number in the file: the header is row 1."""
    return int(index) + 2


def _missing(run: Measurements) -> Issue | None:
    bad = np.flatnonzero(~_finite(run))
    if not len(bad):
        return None
    return Issue(
        "missing numbers", "error", rows_text(_row(bad[0]), len(bad)),
        f"{show.count(len(bad), 'row')} with values that are not finite numbers, or that no "
        "robot measures.", "certain: read from the file", "delete those rows",
        lambda r: r.rows(_finite(r)), {"rows": [_row(k) for k in bad[:100]]},
    )  # fmt: skip


#: Fewest rows of a run that follows another in one file.
_RUN = 50
#: Units of time that loggers write, in seconds.
_TIME_UNITS = {"seconds": 1.0, "milliseconds": 1e-3, "microseconds": 1e-6, "nanoseconds": 1e-9}
#: Ratios of a velocity channel to the velocity in rad/s that have nothing to do with time.
_VELOCITY_UNITS = np.array([1.0, 180.0 / np.pi, 30.0 / np.pi])
#: Time steps [s] and speeds [rad/s or m/s] of a log that somebody would identify from.
_STEPS, _SPEEDS = (2e-5, 0.5), (3e-3, 100.0)


def _time_unit(run: Measurements) -> Issue | None:
    """A clock that does not count seconds: taken for seconds, it makes the motion far too slow."""
    steps = np.diff(run.t)
    moving = moving_joints(run)
    if not np.any(steps > 0.0) or not moving.any():
        return None
    step, speed = float(np.median(steps[steps > 0.0])), float(np.median(_speeds(run)[moving]))
    ratio, name, sure = _speed_ratio(run, moving), None, ""
    if ratio is not None:
        name = _unit_by_velocity(ratio)
        sure = f"certain: dq is {ratio:.4g} times the derivative of q by this clock"
    if name is None:
        name = _unit_by_size(step, speed)
        sure = (
            f"likely: if it were in seconds, there would be one row in {step:.3g} s of a motion "
            f"at {speed:.2g} rad/s (or m/s)"
        )
    if name == "seconds":
        return None
    unit = _TIME_UNITS[name]
    return Issue(
        "time unit", "error", "column t",
        f"time is in {name}, not in seconds (it advances by {step:.4g} from row to row).", sure,
        f"multiply t by {unit:g}", lambda r: replace(r, t=r.t * unit),
        {"unit": name, "median_step": step},
    )  # fmt: skip


def _unit_by_velocity(ratio: float) -> str | None:
    """The unit of time that explains the ratio of velocity channels to the derivative of positions."""
    off = {
        name: float(np.abs(np.log(ratio * unit / _VELOCITY_UNITS)).min())
        for name, unit in _TIME_UNITS.items()
    }
    name = min(off, key=lambda key: off[key])
    return name if off[name] < 0.1 else None


def _unit_by_size(step: float, speed: float) -> str:
    """Seconds unless another unit alone makes sampling and motion those of a robot.

    Of several such units, the one whose speeds are nearest to 1 rad/s.
    """
    possible = {
        name: abs(float(np.log(speed / unit)))
        for name, unit in _TIME_UNITS.items()
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


def _speed_ratio(run: Measurements, moving: NDArray[np.bool_]) -> float | None:
    """The velocity channels over the derivative of the positions, where most joints agree on it."""
    if run.dq is None:
        return None
    measured = np.quantile(np.abs(run.dq), 0.9, axis=0)
    ratios = np.log(measured[moving] / np.maximum(_speeds(run)[moving], 1e-300) + 1e-300)
    middle = float(np.median(ratios))
    agree = np.mean(np.abs(ratios - middle) < 0.1)
    return float(np.exp(middle)) if agree > 0.5 else None


def _backwards(run: Measurements) -> Issue | None:
    """Rows whose time lies before that of an earlier row."""
    steps = np.diff(run.t)
    bad = np.flatnonzero(steps < 0.0)
    if not len(bad):
        return None
    typical = float(np.median(steps[steps > 0.0])) if np.any(steps > 0.0) else 0.0
    repair = _only_forward
    if typical > 0.0 and _anew(run.t, bad):
        what = f"the clock begins anew {show.count(len(bad), 'time')}: several runs are in the file."
        remedy = "let each begin a second after the end of the one before (or write a file each)"
        repair = partial(_run_on, step=max(1.0, 50.0 * typical))
    elif typical > 0.0 and all(_continues(run, int(k)) for k in bad):
        what = (
            f"the clock is set back {show.count(len(bad), 'time')}, by up to {-steps[bad].min():.3g} "
            "s, while the motion continues without a break."
        )
        remedy = "continue the time at the usual step there"
        repair = partial(_run_on, step=typical)
    else:
        what = (
            f"time runs backwards {show.count(len(bad), 'time')}, and the rows there do not "
            "continue the motion."
        )
        remedy = "delete the rows whose time lies before that of an earlier row"
    return Issue(
        "time runs backwards", "error", rows_text(_row(bad[0] + 1), len(bad)), what,
        "certain: read from the file", remedy, repair,
        {"rows": [_row(k + 1) for k in bad[:100]], "largest_s": float(-steps[bad].min())},
    )  # fmt: skip


def _only_forward(run: Measurements) -> Measurements:
    latest = np.maximum.accumulate(run.t)
    keep = np.concatenate([[True], run.t[1:] > latest[:-1]])
    return run.rows(keep)


def _anew(t: Array, back: NDArray[np.intp]) -> bool:
    """Whether every step back leads to the start of the clock, or before it, and a run follows."""
    long = np.diff(back, prepend=0, append=len(t) - 1) > _RUN
    return bool(np.all(long) and np.all(t[back + 1] - t[0] < 0.05 * (t[back] - t[0])))


def _run_on(run: Measurements, step: float) -> Measurements:
    """Steps back replaced by ``step`` [s]: the usual one, or a gap, at which runs are split."""
    steps = np.diff(run.t)
    return stamps.with_steps(run, np.where(steps < 0.0, step, steps))


def _repeats(run: Measurements) -> Issue | None:
    bad = np.flatnonzero(np.diff(run.t) == 0.0)
    if not len(bad):
        return None
    same = all(np.array_equal(run.q[k], run.q[k + 1]) for k in bad)
    kind = "are copies of the row before" if same else "differ from the row before with the same time"
    return Issue(
        "repeated time", "error", rows_text(_row(bad[0] + 1), len(bad)),
        f"{show.count(len(bad), 'row')} with a repeated time; the values {kind}.",
        "certain: read from the file", "keep the first of each",
        lambda r: r.rows(np.concatenate([[True], np.diff(r.t) != 0.0])),
        {"rows": [_row(k + 1) for k in bad[:100]]},
    )  # fmt: skip


def _continues(run: Measurements, k: int) -> bool:
    """Whether q moves from row k to k + 1 as in one ordinary step of time, not as in none or many."""
    around = slice(max(k - 5, 0), k + 7)
    moves = np.abs(np.diff(run.q[around], axis=0))
    here = np.abs(run.q[k + 1] - run.q[k])
    usual = np.median(moves, axis=0)
    return bool(np.all(here <= 5.0 * usual + 1e-3 * np.ptp(run.q, axis=0)))


def _long_steps(run: Measurements) -> tuple[NDArray[np.intp], float]:
    steps = np.diff(run.t)
    typical = float(np.median(steps))
    return np.flatnonzero(steps > max(LONG * typical, 0.02)), typical


def _speed(run: Measurements, k: int, width: int = 20) -> Array:
    """(n,) speed around row k without the step itself."""
    before, after = max(k - width, 0), min(k + 1 + width, len(run.t) - 1)
    parts = []
    for a, b in ((before, k), (k + 1, after)):
        if run.t[b] > run.t[a]:
            parts.append((run.q[b] - run.q[a]) / (run.t[b] - run.t[a]))
    return np.asarray(np.mean(parts, axis=0) if parts else np.zeros(run.n), float)


def _expected_travel(run: Measurements, k: int) -> tuple[float, float]:
    """Travel in a long step: found, and expected if time really passed, in shares of the range."""
    size = np.maximum(np.ptp(run.q, axis=0), 1e-12)
    here = (run.q[k + 1] - run.q[k]) / size
    expected = _speed(run, k) * (run.t[k + 1] - run.t[k]) / size
    return float(np.linalg.norm(here)), float(np.linalg.norm(expected))


def _clock_step(run: Measurements) -> Issue | None:
    """The clock jumps ahead, the arm does not: stamps are wrong, no sample is missing."""
    long, typical = _long_steps(run)
    jumps = []
    for k in long:
        here, expected = _expected_travel(run, int(k))
        ordinary = expected * typical / (run.t[k + 1] - run.t[k])
        if expected > 10.0 * ordinary and expected > 1e-3 and here < 0.2 * expected:
            jumps.append(int(k))
    if not jumps:
        return None
    steps = np.diff(run.t)[jumps]

    def repair(given: Measurements) -> Measurements:
        wrong = np.isin(np.arange(len(given.t) - 1), jumps)
        return stamps.with_steps(given, np.where(wrong, typical, np.diff(given.t)))

    return Issue(
        "clock step", "warning",
        f"t = {run.t[jumps[0]]:.4g} s, {rows_text(_row(jumps[0] + 1), len(jumps))}",
        f"the clock jumps ahead by up to {steps.max():.3g} s while the moving arm does not: the "
        "clock was set, and no sample is missing.",
        "likely: the distance travelled is that of one usual step",
        "continue the time at the usual step there", repair,
        {"rows": [_row(k + 1) for k in jumps], "seconds": steps.tolist()},
    )  # fmt: skip


def _gap(run: Measurements) -> Issue | None:
    long, typical = _long_steps(run)
    if not len(long):
        return None
    steps = np.diff(run.t)[long]
    return Issue(
        "gap in time", "warning",
        f"t = {run.t[long[0]]:.4g} s, {rows_text(_row(long[0] + 1), len(long))}",
        f"{show.count(len(long), 'gap')} of up to {steps.max():.3g} s (the usual step is "
        f"{typical:.3g} s); in all {steps.sum():.3g} s are missing.", "certain: read from the file",
        "no action needed: the run is split there, and the filters lose a second on either side",
        None, {"rows": [_row(k + 1) for k in long[:100]], "seconds": steps[:100].tolist()},
    )  # fmt: skip
