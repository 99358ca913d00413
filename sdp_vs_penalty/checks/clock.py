"""Facts about the clock of a run."""

from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

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
    q, (least, most) = g.run.q[:, g.moving], _STEPS
    fits = {
        name: UNITS[u]
        for name, u in _UNITS.items()
        if least <= g.step * UNITS[u] <= most
    }
    if least <= g.step <= most or not fits:
        return
    speed = float(np.median(np.quantile(np.abs(q[10:] - q[:-10]), 0.9, axis=0))) / (
        10.0 * g.step
    )
    unit, factor = min(fits.items(), key=lambda fit: abs(np.log(speed / fit[1])))
    yield Issue(
        kind="time unit",
        severity="error",
        where="column t",
        what=f"time is in {unit}, not in seconds (it advances by {g.step:.4g} from row to"
        " row).",
        certainty=f"likely: in seconds it were one row in {g.step:.3g} s of a motion at"
        f" {speed:.2g} rad/s",
        remedy=f"multiply t by {factor:g}",
        repair=lambda r: replace(r, t=r.t * factor),
        figures={"factor": factor},
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
    step = 0.0
    how = "the rows there do not continue the motion"
    remedy = "delete the rows whose time lies before that of an earlier row"
    if np.all(np.diff(bad, prepend=0, append=len(g.run.t) - 1) > RUN):
        step = max(1.0, 50.0 * g.step)
        how = "several runs are in the file"
        remedy = (
            "let each begin a second after the end of the one before (or write a file"
            " each)"
        )
        if _goes_on(g, bad).all():
            step = g.step
            how = "the motion continues without a break"
            remedy = CONTINUE

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
        kind="time runs backwards",
        severity="error",
        where=rows_text(bad + 3),
        what=what,
        certainty=READ,
        remedy=remedy,
        repair=repair,
        figures=figures,
    )


def coarse_stamps(g: RunSummary) -> Iterator[Issue]:
    """Equal stamps whose values go on: a clock that was printed with too few digits.

    The rows are taken to be even between two gaps, and none is lost.
    """
    same = g.steps == 0.0
    moved = np.any(np.diff(g.run.q, axis=0)[same] != 0.0, axis=1)
    if not g.step or same.mean() < MOST_REPEATED or moved.mean() < 0.5:
        return
    step = float(np.mean(g.steps[g.steps < TIMES * g.step]))

    def evened(r: Measurements) -> Measurements:
        steps = np.diff(r.t)
        pause = TIMES * max(g.step, float(np.quantile(steps, 0.97)))
        edges = np.flatnonzero(steps > pause) + 1
        return replace(r, t=np.concatenate([_even(x) for x in np.split(r.t, edges)]))

    yield Issue(
        kind="coarse time stamps",
        severity="error",
        where="column t",
        what=f"{same.sum()} rows have the time of the row before, and other values: the"
        f" clock was written in steps of {g.step:.3g} s, and samples come every"
        f" {step:.3g} s.",
        certainty=READ,
        remedy="space the rows evenly (and log the time with more digits)",
        repair=evened,
        figures={"rows": int(same.sum()), "step": step},
    )


def _even(t: Array) -> Array:
    """(N,) evenly spaced times, by least squares through rounded ones."""
    k = np.arange(len(t)) - 0.5 * (len(t) - 1)
    slope = float(k @ t / max(float(k @ k), 1e-300))
    return np.asarray(np.mean(t) + slope * k) if len(t) > 2 else t


def repeated_time(g: RunSummary) -> Iterator[Issue]:
    """Single rows with the time of the row before."""
    bad = np.concatenate([[False], g.steps == 0.0])
    same = bool(np.all(np.diff(g.run.q, axis=0)[bad[1:]] == 0.0))
    how = "are copies of the row before" if same else "differ from the row before"
    what = f"{{rows}} rows with a repeated time; the values {how}."
    first = "keep the first of each"
    yield from g.deleted("repeated time", bad, what, remedy=first, unusable=True)


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
    steps = g.steps
    q = g.run.q[:, g.moving]
    pause = TIMES * max(
        g.step, float(np.quantile(steps, 0.97))
    )  # packets, too, may come in bursts
    even = (steps[1:] < pause) & (steps[:-1] < pause)
    usual = steps[steps < pause]
    spread = float(np.std(usual) / np.mean(usual))
    if spread < 1 / RUN or np.count_nonzero(even) < RUN:
        return
    share = (steps[:-1] / (g.run.t[2:] - g.run.t[:-2]))[:, None]
    rough_time = np.sqrt(
        np.mean((q[1:-1] - (q[:-2] * (1.0 - share) + q[2:] * share))[even] ** 2, axis=0)
    )
    rough_rows = np.sqrt(
        np.mean((q[1:-1] - (q[:-2] * (1.0 - 0.5) + q[2:] * 0.5))[even] ** 2, axis=0)
    )
    if (ratio := float(np.median(rough_time / np.maximum(rough_rows, 1e-300)))) < TIMES:
        return

    def evened(r: Measurements) -> Measurements:
        parts = np.split(r.t, np.flatnonzero(np.diff(r.t) > pause) + 1)
        return replace(
            r, t=np.concatenate([np.linspace(x[0], x[-1], len(x)) for x in parts])
        )

    yield Issue(
        kind="jittered time stamps",
        severity="warning",
        where="column t",
        what=f"the time steps vary by {100.0 * spread:.0f} %, but samples are evenly spaced:"
        f" they are {ratio:.0f} times smoother over the row number than over these"
        " times.",
        certainty="likely: if the sampling itself jittered, q would be smoother over the recorded"
        " times",
        remedy="space the time stamps evenly (and log the samples' own time)",
        repair=evened,
        figures={"percent": 100.0 * spread, "ratio": ratio},
    )


def jumps(g: RunSummary) -> Iterator[Issue]:
    """Steps that are no jitter: of a clock that was set where the motion goes on,
    otherwise gaps."""
    is_long = g.steps > max(TIMES * g.step, 0.02)
    for issue in change_of_rate(g):
        a, b = issue.figures["rows"]
        is_long[a - 2 : b - 2] = False
    long = np.flatnonzero(is_long)
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
            CONTINUE,
        ),
        (
            long[~is_set],
            "gap in time",
            (
                "{count} gaps of up to {most:.3g} s (the usual step is "
                "{step:.3g} s); in all {total:.3g} s are missing."
            ),
            READ,
            (
                "no action needed: the run is split there, and the filters lose a"
                " second on either side"
            ),
        ),
    ):
        if len(rows):
            wrong = np.isin(np.arange(len(g.steps)), rows)
            most = float(g.steps[rows].max())
            what = text.format(
                count=len(rows), most=most, step=g.step, total=g.steps[rows].sum()
            )
            where = f"t = {g.run.t[rows[0]]:.4g} s, {rows_text(rows + 3)}"
            figures = {"rows": (rows + 3)[:100].tolist(), "seconds": most}
            mend = partial(stepping, where=wrong, steps=g.step)
            repair = mend if remedy == CONTINUE else None
            yield Issue(
                kind=kind,
                severity="warning",
                where=where,
                what=what,
                certainty=sure,
                remedy=remedy,
                repair=repair,
                figures=figures,
            )
