"""Facts about the clock of a run."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty import formatting
from sdp_vs_penalty.checks.constants import MOST_REPEATED, RUN, TIMES
from sdp_vs_penalty.checks.glance import CONTINUE, READ, Rows, RunSummary, stepping
from sdp_vs_penalty.checks.issue import Issue, rows_text
from sdp_vs_penalty.data.formats.units import UNITS
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.robot.arrays import Array, nonzero_or_one
from sdp_vs_penalty.signals.runs import spans

#: Time steps [s] of a log that somebody would identify from.
_STEPS = (2e-5, 0.5)


#: Units of time that loggers write.
_UNITS = {"milliseconds": "ms", "microseconds": "us", "nanoseconds": "ns"}


def time_unit(g: RunSummary) -> Iterator[Issue]:
    """A clock that does not count seconds, and in another unit is that of a robot's
    motion."""
    shortest, longest = _STEPS
    factors = {name: UNITS[unit] for name, unit in _UNITS.items()}
    fits = {
        name: factor
        for name, factor in factors.items()
        if shortest <= g.step * factor <= longest
    }
    if shortest <= g.step <= longest or not fits:
        return
    q = g.run.q[:, g.moving]
    travel = np.quantile(
        np.abs(q[10:] - q[:-10]),
        0.9,
        axis=0,
    )
    speed = float(np.median(travel)) / (10.0 * g.step)
    unit = min(fits, key=lambda name: abs(np.log(speed / fits[name])))
    factor = fits[unit]
    yield Issue(
        kind="time unit",
        severity="error",
        where="column t",
        what=f"time is in {unit}, not in seconds (it advances by {g.step:.4g} from row"
        " to row).",
        certainty=f"likely: in seconds it were one row in {g.step:.3g} s of a motion at"
        f" {speed:.2g} rad/s",
        remedy=f"multiply t by {factor:g}",
        repair=lambda r: replace(r, t=r.t * factor),
        apply=f"time:{_UNITS[unit]}",
        figures={"factor": factor},
    )


def _goes_on(g: RunSummary, rows: NDArray[np.intp]) -> Rows:
    """(K,) whether the moving arm comes no farther in steps of the clock than in those
    around them."""
    scaled = g.run.q / nonzero_or_one(np.ptp(g.run.q, axis=0))
    travel = np.linalg.norm(np.diff(scaled, axis=0), axis=1)
    usual = [float(np.median(travel[max(k - 10, 0) : k + 11])) for k in rows]
    return np.asarray(travel[rows] < 3.0 * np.array(usual) + 1e-3)


def backwards(g: RunSummary) -> Iterator[Issue]:
    """Rows whose time lies before that of an earlier row."""
    bad = np.flatnonzero(g.steps < 0.0)
    if not len(bad):
        return
    lengths = np.diff(
        bad,
        prepend=0,
        append=len(g.run.t) - 1,
    )
    repair: Callable[[Measurements], Measurements]
    if np.any(lengths <= RUN):
        how = "the rows there do not continue the motion"
        remedy = "delete the rows whose time lies before that of an earlier row"
        repair = _without_rows_before
    elif _goes_on(g, bad).all():
        how = "the motion continues without a break"
        remedy = CONTINUE
        repair = partial(_stepping_on, step=g.step)
    else:
        how = "several runs are in the file"
        remedy = (
            "let each begin a second after the end of the one before (or write a file"
            " each)"
        )
        repair = partial(_stepping_on, step=max(1.0, 50.0 * g.step))
    seconds = float(-g.steps[bad].min())
    yield Issue(
        kind="time runs backwards",
        severity="error",
        where=rows_text(bad + 3),
        what=f"the clock is set back {len(bad)} times, by up to {seconds:.3g} s: {how}.",
        certainty=READ,
        remedy=remedy,
        repair=repair,
        figures={"rows": (bad + 3)[:100].tolist(), "seconds": seconds},
    )


def _without_rows_before(run: Measurements) -> Measurements:
    """The rows whose time lies after that of all earlier rows."""
    latest = np.maximum.accumulate(run.t)
    return run.rows(np.concatenate([[True], run.t[1:] > latest[:-1]]))


def _stepping_on(run: Measurements, step: float) -> Measurements:
    """The run with a step [s] wherever the clock is set back."""
    return stepping(run, np.diff(run.t) < 0.0, step)


def coarse_stamps(g: RunSummary) -> Iterator[Issue]:
    """Equal stamps whose values go on: a clock that was printed with too few digits.

    The rows are taken to be even between two gaps, and none is lost.
    """
    is_same = g.steps == 0.0
    changes = np.diff(g.run.q, axis=0)[is_same]
    moved = np.any(changes != 0.0, axis=1)
    if not g.step or is_same.mean() < MOST_REPEATED or moved.mean() < 0.5:
        return
    step = float(np.mean(g.steps[g.steps < TIMES * g.step]))
    yield Issue(
        kind="coarse time stamps",
        severity="error",
        where="column t",
        what=f"{is_same.sum()} rows have the time of the row before, and other values:"
        f" the clock was written in steps of {g.step:.3g} s, and samples come every"
        f" {step:.3g} s.",
        certainty=READ,
        remedy="space the rows evenly (and log the time with more digits)",
        repair=partial(_spaced_evenly, step=g.step),
        figures={"rows": int(is_same.sum()), "step": step},
    )


def _spaced_evenly(run: Measurements, step: float) -> Measurements:
    """The run with even stamps between two gaps; step [s] : of the clock."""
    steps = np.diff(run.t)
    pause = TIMES * max(step, float(np.quantile(steps, 0.97)))
    edges = np.flatnonzero(steps > pause) + 1
    parts = [_even(t) for t in np.split(run.t, edges)]
    return replace(run, t=np.concatenate(parts))


def _even(t: Array) -> Array:
    """(N,) evenly spaced times, by least squares through rounded ones."""
    if len(t) <= 2:
        return t
    k = np.arange(len(t)) - 0.5 * (len(t) - 1)
    slope = float(k @ t / max(float(k @ k), 1e-300))
    return np.asarray(np.mean(t) + slope * k)


def repeated_time(g: RunSummary) -> Iterator[Issue]:
    """Single rows with the time of the row before."""
    bad = np.concatenate([[False], g.steps == 0.0])
    same = bool(np.all(np.diff(g.run.q, axis=0)[bad[1:]] == 0.0))
    how = "are copies of the row before" if same else "differ from the row before"
    what = f"{{rows}} rows with a repeated time; the values {how}."
    first = "keep the first of each"
    yield from g.deleted(
        "repeated time",
        bad,
        what,
        remedy=first,
        unusable=True,
    )


def change_of_rate(g: RunSummary) -> Iterator[Issue]:
    """A stretch in which the rows are several times farther apart, and the motion goes
    on: the logger wrote every so manieth row."""
    if not g.step:
        return
    times = g.steps / g.step
    slow = (times > TIMES) & (np.abs(times - np.round(times)) < 0.05 * times)
    for a, b in spans(slow):
        ratio = float(np.median(times[a:b]))
        steady = np.all(np.abs(times[a:b] - ratio) < 0.1 * ratio)
        if b - a < 5 or not steady:
            continue
        yield Issue(
            kind="change of rate",
            severity="warning",
            where=f"rows {a + 2} to {b + 2}",
            what=f"rows {a + 2} to {b + 2} are {ratio:.3g} times as far apart as the"
            f" others ({ratio * g.step:.3g} s instead of {g.step:.3g} s): the logger"
            " changed its rate.",
            certainty=READ,
            remedy="log at one rate; the run is split there",
            figures={"rows": [int(a) + 2, int(b) + 2], "times": ratio},
        )


def uneven(g: RunSummary) -> Iterator[Issue]:
    """Stamps that jitter, or come in bursts, although the samples were taken evenly: q
    is smoother over the row number."""
    # Packets, too, may come in bursts.
    pause = TIMES * max(g.step, float(np.quantile(g.steps, 0.97)))
    is_inner = (g.steps[1:] < pause) & (g.steps[:-1] < pause)
    usual = g.steps[g.steps < pause]
    spread = float(np.std(usual) / np.mean(usual))
    if spread < 1 / RUN or np.count_nonzero(is_inner) < RUN:
        return
    over_time = g.steps[:-1] / (g.run.t[2:] - g.run.t[:-2])
    rough_in_time = _roughness(g, over_time, is_inner)
    rough_in_rows = _roughness(
        g,
        np.full(len(over_time), 0.5),
        is_inner,
    )
    ratio = float(np.median(rough_in_time / np.maximum(rough_in_rows, 1e-300)))
    if ratio < TIMES:
        return
    yield Issue(
        kind="jittered time stamps",
        severity="warning",
        where="column t",
        what=f"the time steps vary by {100.0 * spread:.0f} %, but samples are evenly"
        f" spaced: they are {ratio:.0f} times smoother over the row number than over"
        " these times.",
        certainty="likely: if the sampling itself jittered, q would be smoother over"
        " the recorded times",
        remedy="space the time stamps evenly (and log the samples' own time)",
        repair=partial(_evened, pause=pause),
        figures={"percent": 100.0 * spread, "ratio": ratio},
    )


def _roughness(g: RunSummary, share: Array, is_inner: Rows) -> Array:
    """(n,) RMS by which positions leave the line between those before and after, at a
    share (N - 2,) of the way."""
    q = g.run.q[:, g.moving]
    on_line = q[:-2] * (1.0 - share)[:, None] + q[2:] * share[:, None]
    off = (q[1:-1] - on_line)[is_inner]
    return np.asarray(np.sqrt(np.mean(off**2, axis=0)))


def _evened(run: Measurements, pause: float) -> Measurements:
    """The run with even stamps between two pauses [s]."""
    edges = np.flatnonzero(np.diff(run.t) > pause) + 1
    parts = np.split(run.t, edges)
    even = [
        np.linspace(
            part[0],
            part[-1],
            len(part),
        )
        for part in parts
    ]
    return replace(run, t=np.concatenate(even))


def jumps(g: RunSummary) -> Iterator[Issue]:
    """Steps that are no jitter: of a clock that was set where the motion goes on,
    otherwise gaps."""
    is_long = g.steps > max(TIMES * g.step, 0.02)
    for issue in change_of_rate(g):
        first, last = issue.figures["rows"]
        is_long[first - 2 : last - 2] = False
    long = np.flatnonzero(is_long)
    moves = g.movement.moves
    in_motion = [bool(moves[max(k - 10, 0) : k + 11].all()) for k in long]
    is_set = np.array(in_motion, bool) & _goes_on(g, long)
    is_set &= g.steps[long] > 2.0 * TIMES * g.step
    if is_set.any():
        yield _clock_step(g, long[is_set])
    if not is_set.all():
        yield _gap(g, long[~is_set])


def _clock_step(g: RunSummary, rows: NDArray[np.intp]) -> Issue:
    """A clock that was set ahead after some rows."""
    is_wrong = np.isin(np.arange(len(g.steps)), rows)
    return Issue(
        kind="clock step",
        severity="warning",
        where=_place(g, rows),
        what=f"the clock jumps ahead by up to {g.steps[rows].max():.3g} s while the"
        " moving arm does not: the clock was set, and no sample is missing.",
        certainty="likely: the distance travelled is that of one usual step",
        remedy=CONTINUE,
        repair=partial(stepping, where=is_wrong, steps=g.step),
        figures=_rows_and_seconds(g, rows),
    )


def _gap(g: RunSummary, rows: NDArray[np.intp]) -> Issue:
    """Samples that are missing after some rows."""
    steps = g.steps[rows]
    return Issue(
        kind="gap in time",
        severity="warning",
        where=_place(g, rows),
        what=f"{formatting.count(len(rows), 'gap')} of up to {steps.max():.3g} s (the"
        f" usual step is {g.step:.3g} s); in all {steps.sum():.3g} s are missing.",
        certainty=READ,
        remedy="no action needed: the run is split there, and the filters lose a second"
        " on either side",
        figures=_rows_and_seconds(g, rows),
    )


def _place(g: RunSummary, rows: NDArray[np.intp]) -> str:
    return f"t = {g.run.t[rows[0]]:.4g} s, {rows_text(rows + 3)}"


def _rows_and_seconds(g: RunSummary, rows: NDArray[np.intp]) -> dict[str, object]:
    seconds = float(g.steps[rows].max())
    return {
        "rows": (rows + 3)[:100].tolist(),
        "seconds": seconds,
    }
