"""Facts about the clock of a run."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from sdp_vs_penalty import formatting
from sdp_vs_penalty.checks.certainty import likely, told_by
from sdp_vs_penalty.checks.constants import GAP, MOST_REPEATED, RUN
from sdp_vs_penalty.checks.glance import CONTINUE, Rows, RunSummary, with_time_steps
from sdp_vs_penalty.checks.issue import Issue, Left, make_issue, rows_text
from sdp_vs_penalty.checks.velocity import velocity_ratio
from sdp_vs_penalty.data.files import is_last_row_first
from sdp_vs_penalty.data.hypotheses.weighing import unit_of_dates
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.data.stretches.gaps import (
    goes_on,
    is_set_back,
    order_of_time,
    spaced_evenly,
    stray_rows,
)
from sdp_vs_penalty.data.words.units import UNITS
from sdp_vs_penalty.robot.arrays import Array, Indices
from sdp_vs_penalty.signals.runs import spans

#: Time steps [s] of a log that somebody would identify from.
_STEPS = (2e-5, 0.5)


#: Units of time that loggers write; spreadsheets and MATLAB's datenum count days.
_UNITS = {
    "milliseconds": "ms",
    "microseconds": "us",
    "nanoseconds": "ns",
    "hundreds of nanoseconds": "100ns",
    "minutes": "min",
    "hours": "h",
    "days": "day",
}
#: The usual time step of logs [s]: between that of 8 rows a second and of 8000 (logarithm).
_USUAL = 4e-3
#: Logged velocities confirm a factor of the clock that they match to this share: 60 and
#: 180 / pi differ by more than twice as much.
_CONFIRMED = 0.02


def find_time_unit(glance: RunSummary) -> Iterator[Issue]:
    """Yield an error where the clock counts another unit than seconds.

    Time steps outside those of any log in seconds are an error. Of the units that bring
    the steps inside, the one is named in which the stamps are dates of today, or else
    that makes the steps nearest to usual ones.
    """
    shortest, longest = _STEPS
    t = glance.run.t
    found = unit_of_dates(t)
    # Clocks that count hundreds of nanoseconds count dates.
    possible_units = [unit for unit in _UNITS.values() if unit != "100ns"]
    if found:
        possible_units = [found.answer]
    fits = {  # units [s] that bring the steps inside, by their names
        name: UNITS[unit]
        for name, unit in _UNITS.items()
        if unit in possible_units
        and shortest <= glance.usual_step * UNITS[unit] <= longest
    }
    if not fits:
        return
    is_usual_step = shortest <= glance.usual_step <= longest
    is_usual_on_the_whole = shortest <= (t[-1] - t[0]) / len(t) <= longest
    # Stamps come in bursts, or were written with too few digits, where on the whole the
    # clock counts seconds.
    if is_usual_step or is_usual_on_the_whole:
        return
    unit = min(fits, key=lambda x: abs(np.log(glance.usual_step * fits[x] / _USUAL)))
    factor = fits[unit]
    ratio = velocity_ratio(glance)
    if ratio is not None and abs(ratio - 1.0) < _CONFIRMED:
        return  # in seconds they are the derivative of the positions
    # The unit of the clock by the logged velocities, over that of the best name.
    share = None if ratio is None else 1.0 / (ratio * factor)
    certainty = likely(f"in seconds it were one row in {glance.usual_step:.3g} s")
    if share is not None and abs(share - 1.0) < _CONFIRMED:
        step = share * factor * glance.usual_step
        of_velocities = f"the logged velocities give {step:.5g} s from row to row"
        certainty = told_by(certainty.why, of_velocities)
    yield make_issue(
        kind="time unit",
        severity="error",
        where="column t",
        what=f"time is in {unit}, not in seconds (it advances by {glance.usual_step:.4g} from row"
        " to row).",
        certainty=certainty,
        remedy=f"multiply t by {factor:g}",
        repair=lambda r: replace(r, t=r.t * factor),
        apply=f"time:{_UNITS[unit]}",
        figures={"factor": factor},
    )


def find_time_backwards(glance: RunSummary) -> Iterator[Issue]:
    """Yield an error about rows whose time lies before that of an earlier row, and a
    warning where the clock was set back, or several runs are in the file: each stretch
    is then a run.
    """
    bad = np.flatnonzero(glance.steps < 0.0)
    if not len(bad):
        return
    severity, how = "error", ""
    repair: Callable[[Measurements], Measurements]
    order = order_of_time(glance.run.t, glance.run.q)
    seconds = float(-glance.steps[bad].min())
    what = f"time goes back {formatting.times(len(bad))}, by up to {formatting.number(seconds)} s."
    if is_last_row_first(glance.steps):
        how = "the last row comes first"
        remedy = "turn the order of the rows round"
        repair = partial(_in_order, order=np.arange(len(glance.run.t))[::-1])
    elif order is not None:
        how = (
            "rows were exchanged, for the motion is smooth in the order of their stamps"
        )
        remedy = "put the rows in the order of their stamps"
        repair = partial(_in_order, order=order)
    elif not is_set_back(glance.run.t):
        how = "the rows there do not continue the motion"
        remedy = "delete the rows whose time lies before that of an earlier row"
        repair = _without_rows_before
    else:
        severity = "warning"
        seen = "The motion continues without a break: the clock was set back."
        otherwise, step = CONTINUE, glance.usual_step
        if not goes_on(glance.run.q, bad).all():
            seen = "The motion breaks there: several runs are in the file."
            otherwise = "let each begin a second after the end of the one before"
            step = max(1.0, 50.0 * step)
        what = f"{what} {seen}"
        remedy = f"a run begins there (or {otherwise})"
        repair = partial(with_time_steps, where=glance.steps < 0.0, steps=step)
    yield make_issue(
        kind="time runs backwards",
        severity=severity,
        where=rows_text(glance.run, bad + 1),
        what=what,
        cause=how,
        remedy=remedy,
        needs_action=severity == "error",
        repair=repair,
        figures={
            "rows": glance.run.rows_of_file(bad[:100] + 1).tolist(),
            "seconds": seconds,
        },
    )


def _in_order(run: Measurements, order: Indices) -> Measurements:
    """Return the run with its rows in another order (N,), each with its own time."""
    return run.rows(order)


def _without_rows_before(run: Measurements) -> Measurements:
    """Return the run without the rows whose time is not after that of all earlier
    rows."""
    latest = np.maximum.accumulate(run.t)
    return run.rows(np.concatenate([[True], run.t[1:] > latest[:-1]]))


def find_coarse_stamps(glance: RunSummary) -> Iterator[Issue]:
    """Yield an error where many rows have the time of the row before, and other values:
    the clock was printed with too few digits.

    The repair spaces the rows evenly between two gaps, so that none is lost.
    """
    is_same = glance.steps == 0.0
    changes = np.diff(glance.run.q, axis=0)[is_same]
    moved = np.any(changes != 0.0, axis=1)
    if not glance.usual_step or is_same.mean() < MOST_REPEATED or moved.mean() < 0.5:
        return
    repair = partial(_spaced_evenly, step=glance.usual_step)
    step = float(np.median(np.diff(repair(glance.run).t)))
    yield make_issue(
        kind="coarse time stamps",
        severity="error",
        where="column t",
        what=f"{is_same.sum()} rows have the time of the row before, and other values.",
        cause=f"the clock was written in steps of {glance.usual_step:.3g} s, and samples"
        f" come every {step:.3g} s",
        remedy="space the rows evenly (and log the time with more digits)",
        repair=repair,
        figures={"rows": int(is_same.sum()), "step": step},
    )


def _spaced_evenly(run: Measurements, step: float) -> Measurements:
    """Return the run with stamps written in ``step`` [s] spaced evenly between gaps."""
    return replace(run, t=spaced_evenly(run.t, step))


def find_repeated_time(glance: RunSummary) -> Iterator[Issue]:
    """Yield an error about single rows with the time of the row before."""
    bad = np.concatenate([[False], glance.steps == 0.0])
    same = bool(np.all(np.diff(glance.run.q, axis=0)[bad[1:]] == 0.0))
    how = "are copies of the row before" if same else "differ from the row before"
    what = f"{{row_count}} with a repeated time; the values {how}."
    first = "keep the first of each"
    yield from glance.delete_rows(
        "repeated time", bad, what, remedy=first, unusable=True
    )


def find_stray_stamps(glance: RunSummary) -> Iterator[Issue]:
    """Yield an issue about a few rows that lie farther from the others than the others
    last together: rows of another clock, as where a recorder starts inside a packet.
    """
    bad = stray_rows(glance.run.t)
    if glance.run.episode is not None or not bad.any():
        return
    t = glance.run.t
    distance = float(max(np.abs(t[~bad] - x).min() for x in t[bad]))
    yield from glance.delete_rows(
        "stray rows",
        bad,
        f"the time of {formatting.count(int(bad.sum()), 'row')} is up to"
        f" {formatting.number(distance)} s from that of all others: another clock's.",
        distance=distance,
    )


#: Fewest long steps in a row that are another rate, and not gaps.
_SHORTEST_CHANGE_OF_RATE = 5
#: A slower rate is one whose steps are more than so many usual ones: shorter steps are rows
#: that were lost here and there.
_SLOWER_RATE = 3.0


def find_changes_of_rate(glance: RunSummary) -> Iterator[Issue]:
    """Yield a warning for each stretch in which the rows are a whole number of times
    farther apart, steadily: the logger wrote every second or third row only.
    """
    usual = glance.usual_step
    for a, b, times in _slower_stretches(glance):
        first, last = glance.run.rows_of_file([a, b]).tolist()
        yield make_issue(
            kind="change of rate",
            where=f"rows {first} to {last}",
            what=f"rows {first} to {last} are {times:.3g} times as far apart as the"
            f" others ({times * usual:.3g} s instead of {usual:.3g} s).",
            cause="the logger changed its rate",
            left=Left.FACTS,
            remedy="log at one rate; the run is split there",
            figures={"rows": [first, last], "times": times},
        )


def _slower_stretches(glance: RunSummary) -> Iterator[tuple[int, int, float]]:
    """Yield the first step of each stretch at a slower rate, the one behind its last, and
    how many times as long as usual its steps are."""
    ratios = glance.steps / (glance.usual_step or np.inf)
    is_whole = np.abs(ratios - np.round(ratios)) < 0.05 * ratios
    for a, b in spans((ratios > _SLOWER_RATE) & is_whole):
        times = float(np.median(ratios[a:b]))
        is_steady = np.all(np.abs(ratios[a:b] - times) < 0.1 * times)
        if b - a >= _SHORTEST_CHANGE_OF_RATE and is_steady:
            yield a, b, times


#: Stamps jitter where positions are so many times rougher over them than over the row
#: numbers: noise makes them equally rough over both.
_ROUGHER_OVER_TIME = 3.0


def find_uneven_stamps(glance: RunSummary) -> Iterator[Issue]:
    """Yield a warning where stamps jitter, or come in bursts, although the samples were
    taken evenly: positions are smoother over the row number than over time.
    """
    # Steps longer than this are gaps; packets may come in bursts of many short steps.
    pause = GAP * max(glance.usual_step, float(np.quantile(glance.steps, 0.97)))
    is_inner = (glance.steps[1:] < pause) & (glance.steps[:-1] < pause)
    usual = glance.steps[glance.steps < pause]
    spread = float(np.std(usual) / np.mean(usual))
    if spread < 1 / RUN or np.count_nonzero(is_inner) < RUN:
        return
    over_time = glance.steps[:-1] / (glance.run.t[2:] - glance.run.t[:-2])
    rough_in_time = _roughness(glance, over_time, is_inner)
    rough_in_rows = _roughness(glance, np.full(len(over_time), 0.5), is_inner)
    ratio = float(np.median(rough_in_time / np.maximum(rough_in_rows, 1e-300)))
    if ratio < _ROUGHER_OVER_TIME:
        return
    yield make_issue(
        kind="jittered time stamps",
        where="column t",
        what=f"the time steps vary by {100.0 * spread:.0f} %, but samples are evenly"
        f" spaced: they are {ratio:.0f} times smoother over the row number than over"
        " these times.",
        certainty=likely(
            "if the sampling itself jittered, q would be smoother over"
            " the recorded times"
        ),
        remedy="space the time stamps evenly (and log the samples' own time)",
        repair=partial(_spaced_evenly, step=glance.usual_step),
        figures={"percent": 100.0 * spread, "ratio": ratio},
    )


def _roughness(glance: RunSummary, share: Array, is_inner: Rows) -> Array:
    """Return the roughness (n_moving,) of positions [rad, m]: the root mean square
    distance from the line between the rows before and after.

    share (N - 2,) : place on that line, 0 at the row before and 1 at the row after;
    is_inner (N - 2,) : rows that count, away from gaps.
    """
    q = glance.run.q[:, glance.moving]
    on_line = q[:-2] * (1.0 - share)[:, None] + q[2:] * share[:, None]
    distance = (q[1:-1] - on_line)[is_inner]
    return np.sqrt(np.mean(distance**2, axis=0))


def find_time_jumps(glance: RunSummary) -> Iterator[Issue]:
    """Yield warnings about long time steps. Where the motion goes on, the clock was set
    ahead; elsewhere samples are missing.
    """
    shortest_pause = 0.02  # s
    is_long = glance.steps > max(GAP * glance.usual_step, shortest_pause)
    for first, end, _ in _slower_stretches(glance):
        is_long[first:end] = False
    if glance.run.episode is not None:
        # The reader made the step between two recordings.
        is_long &= np.diff(glance.run.episode) == 0
    long = np.flatnonzero(is_long)
    moves = glance.movement.moves
    in_motion = [bool(moves[max(k - 10, 0) : k + 11].all()) for k in long]
    is_set = np.array(in_motion, bool) & goes_on(glance.run.q, long)
    is_set &= glance.steps[long] > 2.0 * GAP * glance.usual_step
    if is_set.any():
        yield _clock_step(glance, long[is_set])
    if not is_set.all():
        yield _gap(glance, long[~is_set])


def _clock_step(glance: RunSummary, rows: Indices) -> Issue:
    """Return the warning that the clock was set ahead after some rows (numbers from
    0)."""
    is_wrong = np.isin(np.arange(len(glance.steps)), rows)
    return _about_steps(
        glance,
        rows,
        kind="clock step",
        what="the clock jumps ahead by up to"
        f" {formatting.number(glance.steps[rows].max())} s while the moving arm does not:"
        " the clock was set, and no sample is missing.",
        certainty=likely("the distance travelled is that of one usual step"),
        remedy=f"the run is split there (or {CONTINUE})",
        needs_action=False,
        repair=partial(with_time_steps, where=is_wrong, steps=glance.usual_step),
    )


def _gap(glance: RunSummary, rows: Indices) -> Issue:
    """Return the warning that samples are missing after some rows (numbers from 0)."""
    steps = glance.steps[rows]
    return _about_steps(
        glance,
        rows,
        kind="gap in time",
        what=f"{formatting.count(len(rows), 'gap')} of up to"
        f" {formatting.number(steps.max())} s (the usual step is {glance.usual_step:.3g} s),"
        f" {formatting.number(steps.sum())} s in all.",
        cause="samples are missing",
        remedy="the run is split there, and the filters lose a second on either side",
        needs_action=False,
    )


def _about_steps(glance: RunSummary, rows: Indices, **said: Any) -> Issue:
    """Return an issue about the long steps after some rows (numbers from 0), with the rows
    behind them as a file numbers them (a hundred at most), and the longest step [s]."""
    return make_issue(
        where=f"t = {glance.run.t[rows[0]]:.4g} s, {rows_text(glance.run, rows + 1)}",
        figures={
            "rows": glance.run.rows_of_file(rows[:100] + 1).tolist(),
            "seconds": float(glance.steps[rows].max()),
        },
        **said,
    )
