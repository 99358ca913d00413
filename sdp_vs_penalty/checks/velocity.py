"""Facts about the logged velocity: is it the derivative of the logged position?

dq / dt tells the factor of the clock, or of a unit of velocity, to a per cent, and its
lag to a sample, whatever the arm: it is the first evidence, before any dynamics.
"""

from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import numpy as np

from sdp_vs_penalty.checks.constants import RUN, TIMES
from sdp_vs_penalty.checks.glance import READ, RunSummary
from sdp_vs_penalty.checks.issue import Issue
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.robot.arrays import Array

#: Ratios of joints that are one: they differ by no more than this share.
_SAME = 0.05
#: A ratio of all joints that is nearer to one (natural logarithm) is that of filters.
_CLOCK = 0.1
#: The same of one joint alone.
_OF_ONE_JOINT = 0.3
#: Units that velocities are logged in, as multiples of rad/s.
_UNITS = {"degrees a second": 180.0 / np.pi, "turns a minute": 30.0 / np.pi}
#: A velocity whose correlation with the derivative is lower is of something else.
_PROPORTIONAL = 0.8
#: Lags that are tried, to either side [samples]; of one sample nothing is said.
_LARGEST_LAG = 50
#: So many rows tell a lag.
_ROWS_OF_LAG = 16384


def velocity(g: RunSummary) -> Iterator[Issue]:
    """The logged velocity against the derivative of the position.

    One factor in every joint is that of the clock, or of the unit of velocity. A joint
    of its own is a velocity of its own.
    """
    if g.run.dq is None or len(g.run.t) < 2 * RUN:
        return
    lag = velocity_lag(g)
    dq = np.roll(
        g.run.dq,
        -round(lag or 0.0),
        axis=0,
    )
    ratios = velocity_ratios(replace(g, run=replace(g.run, dq=dq)))
    known = np.flatnonzero(np.isfinite(ratios))
    if not len(known):
        return
    ratio = float(np.median(ratios[known]))
    n_alike = int(np.sum(np.abs(ratios[known] / ratio - 1.0) < _SAME))
    is_common = ratio > 0.0 and n_alike >= 0.75 * len(known)
    if is_common and abs(np.log(ratio)) > _CLOCK:
        yield _in_another_unit(ratio) or _against_the_clock(ratio, n_alike, len(known))
        return
    for j in known.tolist():
        yield from _of_one_joint(j, float(ratios[j]))
    if lag is not None and abs(lag) >= 2.0:
        yield _late(g, lag)


def _in_another_unit(ratio: float) -> Issue | None:
    """A velocity in degrees or turns; None where no unit fits. Positions and clock are
    right then."""
    for unit, factor in _UNITS.items():
        if abs(ratio / factor - 1.0) < 0.02:
            return Issue(
                kind="velocity unit",
                severity="note",
                where="columns dq",
                what=f"the logged velocities are in {unit}: {ratio:.4g} times the"
                " derivative of the position.",
                certainty=READ,
                remedy="no action needed: velocities are taken from the positions",
                figures={"factor": ratio},
            )
    return None


def _against_the_clock(ratio: float, n_alike: int, n_known: int) -> Issue:
    """A clock, or a velocity, that is off by the same factor in all joints."""
    times = f"{max(ratio, 1.0 / ratio):.3g} times too"
    wrong = f"{times} fast" if ratio < 1.0 else f"{times} slow"
    return Issue(
        kind="clock against velocity",
        severity="warning",
        where="columns t and dq",
        what=f"the logged velocity is {ratio:.3g} times the derivative of the position,"
        f" in {n_alike} of {n_known} joints alike: time runs {wrong}, or velocities are"
        " in another unit.",
        certainty="certain: read from the file; which of the two, it does not say",
        remedy=f"find out the log's rate: multiply t by {1.0 / ratio:.3g}, or divide dq"
        f" by {ratio:.3g}",
        repair=partial(_stretched, factor=1.0 / ratio),
        apply="clock:t",
        figures={"factor": 1.0 / ratio},
    )


def _stretched(run: Measurements, factor: float) -> Measurements:
    """The run, so many times as long."""
    return replace(run, t=run.t[0] + (run.t - run.t[0]) * factor)


def _of_one_joint(j: int, ratio: float) -> Iterator[Issue]:
    """A note about a joint (from 0) whose velocity is another one's."""
    if ratio > 0.0 and abs(np.log(ratio)) <= _OF_ONE_JOINT:
        return
    yield Issue.of(
        kind="velocity of one joint",
        severity="note",
        joints=[j],
        what=f"dq{j + 1} is {ratio:.3g} times the derivative of q{j + 1}.",
        certainty=READ,
        remedy="no action needed: velocities are taken from the positions",
        where=f"dq{j + 1}",
        factor=ratio,
    )


def _late(g: RunSummary, lag: float) -> Issue:
    """A note about velocities that come some samples after the positions' derivative,
    as behind a filter."""
    later = "later" if lag > 0.0 else "earlier"
    return Issue(
        kind="velocity lag",
        severity="note",
        where="columns dq",
        what=f"the logged velocities come {abs(lag):.0f} samples"
        f" ({1e3 * abs(lag) * g.step:.3g} ms) {later} than the derivative of the"
        " positions: they are filtered, or from another source.",
        certainty=READ,
        remedy="no action needed: velocities are taken from the positions; whether"
        " torques come late as well, `check` tells from the dynamics",
        figures={"samples": lag, "seconds": lag * g.step},
    )


def velocity_ratios(g: RunSummary) -> Array:
    """(n,) logged velocity over the derivative of the position, by least squares on
    means of a few rows; nan where the two are not proportional."""
    width = int(max(4, len(g.run.t) // 2000))
    count = len(g.steps) // width
    steps = g.steps[: count * width].reshape(count, width)
    seconds = steps.sum(axis=1)
    usual = np.all(steps < 10.0 * g.step, axis=1) & (seconds > 0.0)
    out = np.full(g.run.n, np.nan)
    for j in np.flatnonzero(g.moving).tolist():
        travel = np.diff(g.run.q[:, j])[: count * width].reshape(count, width)
        logged = _between_rows(g, j)[: count * width].reshape(count, width) * steps
        rate = (travel.sum(axis=1) / seconds)[usual]
        speed = (logged.sum(axis=1) / seconds)[usual]
        out[j] = _ratio(rate, speed)
    return out


def _between_rows(g: RunSummary, j: int) -> Array:
    """(N - 1,) logged velocity of joint j halfway between rows."""
    assert g.run.dq is not None
    return np.asarray(0.5 * (g.run.dq[1:, j] + g.run.dq[:-1, j]))


def _ratio(rate: Array, speed: Array) -> float:
    """Of two proportional signals (K,), whichever is the noisier; nan for others."""
    xx = float(rate @ rate)
    yy = float(speed @ speed)
    xy = float(rate @ speed)
    if xx * yy <= 0.0 or xy * xy <= _PROPORTIONAL * xx * yy:
        return np.nan
    return float(np.sign(xy) * np.sqrt(yy / xx))


def velocity_lag(g: RunSummary) -> float | None:
    """By how many samples the logged velocity is behind the derivative of the position,
    where the two correlate most; None where joints that move do not agree."""
    even = (g.steps < TIMES * g.step)[:_ROWS_OF_LAG]
    largest_lag = min(_LARGEST_LAG, len(even) // 4)
    tried = np.arange(-largest_lag, largest_lag + 1)
    lags = []
    for j in np.flatnonzero(g.moving).tolist():
        rate = even * np.diff(g.run.q[: len(even) + 1, j])
        speed = even * _between_rows(g, j)[: len(even)]
        length = 2 * len(even)
        spectrum = np.fft.rfft(speed, length) * np.fft.rfft(rate, length).conj()
        match = np.fft.irfft(spectrum, length)[tried]
        lags.append(float(tried[np.argmax(match)]))
    if not lags:
        return None
    lag = float(np.median(lags))
    spread = float(np.median(np.abs(np.array(lags) - lag)))
    return lag if spread <= 1.0 else None
