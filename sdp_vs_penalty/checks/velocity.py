"""Facts about the logged velocity: is it the derivative of the logged position?

Velocity over the derivative of the position is the factor of the clock, or of a unit of
velocity. It is known to a per cent, and the velocity's lag to a sample, whatever the arm is:
this is the first evidence, before any dynamics.
"""

from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import numpy as np

from sdp_vs_penalty.checks.certainty import READ, likely, possible
from sdp_vs_penalty.checks.constants import GAP, RUN
from sdp_vs_penalty.checks.glance import RunSummary
from sdp_vs_penalty.checks.issue import Issue, Left, make_issue
from sdp_vs_penalty.data.hypotheses.weighing import CERTAIN, VELOCITY_UNITS
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.data.words.units import UNITS
from sdp_vs_penalty.race.kinds.clock_rate import stamps_text
from sdp_vs_penalty.robot.arrays import Array

#: Joints have the same ratio if theirs differ by no more than this share.
_SAME = 0.05
#: A ratio of all joints differs from one (natural logarithm) by so much at least, and by so
#: many times as much as joints differ from it: filters weaken each joint by another share.
_CLOCK, _OVER_SCATTER = 0.02, 3.0
#: The same of one joint alone.
_OF_ONE_JOINT = 0.3
#: Units that positions are logged in, by their names, in radians.
_OF_POSITIONS = {"radians": 1.0, "degrees": UNITS["deg"], "turns": UNITS["turns"]}
#: Positions beyond are in another unit than radians, whatever their names say [rad].
_TWO_TURNS = 4.0 * np.pi
#: Ratios of a clock in another unit, or at another rate, from the derivative's.
_OF_CLOCKS = (0.5, 2.0, *(10.0**k for k in (-6, -3, -2, -1, 1, 2, 3, 6)))
#: Natural logarithms: how exactly a known ratio is measured (standard deviation); how far
#: ratios of filters or other rates are from 1 (half width of a Cauchy distribution: rarely
#: they are any); over what range the ratio of an encoder's counts may lie.
_EXACT, _OF_FILTERS, _OF_COUNTS = 0.01, 0.1, 28.0
#: Leading digits of the rates that programs sample at [1/s]; 10 is for rates just below.
_ROUND_RATES = np.array(
    (1.0, 1.2, 1.25, 1.5, 2.0, 2.4, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0)
)
#: Relative distance from a usual rate of one that was set, and of one that the velocity's
#: ratio yields.
_OF_A_SET_RATE, _OF_A_RATIO = 1e-3, 0.01
#: A velocity whose squared correlation with the derivative is lower is of something else.
_PROPORTIONAL = 0.8
#: Lags that are tried, to either side [samples].
_LARGEST_LAG = 50
#: Rows that a lag is measured in, at most.
_ROWS_OF_LAG = 16384


_note = partial(
    make_issue,
    severity="note",
    remedy="velocities are taken from the positions",
    needs_action=False,
)


def find_wrong_velocities(glance: RunSummary) -> Iterator[Issue]:
    """Yield issues where the logged velocity is not the derivative of the position.

    A factor that all joints share is that of the clock, or of the unit of velocity. A
    joint whose factor is another one has a wrong velocity.
    """
    if glance.run.dq is None or len(glance.run.t) < 2 * RUN:
        return
    # A lag would lower the correlation: ratios are measured with it undone.
    lag = velocity_lag(glance)
    dq = np.roll(glance.run.dq, -round(lag or 0.0), axis=0)
    ratios = velocity_ratios(replace(glance, run=replace(glance.run, dq=dq)))
    known = np.flatnonzero(np.isfinite(ratios))
    if not len(known):
        return
    ratio = float(np.median(ratios[known]))
    n_alike = int(np.sum(np.abs(ratios[known] / ratio - 1.0) < _SAME))
    is_common = n_alike >= 0.75 * len(known)
    alike = (
        f"the logged velocity is {ratio:.3g} times the derivative of the position,"
        f" in {n_alike} of {len(known)} joints alike."
    )
    if is_common and ratio < 0.0:
        yield _note(
            kind="velocity sign",
            where="columns dq",
            what=alike,
            cause="the rows are in reverse order, or velocities have the other sign",
            figures={"factor": ratio},
        )
        return
    if is_common and abs(np.log(ratio)) > _scatter_allowed(ratios[known] / ratio):
        largest = np.abs(glance.run.q).max()
        is_unit_said = not glance.run.unit_command and largest < _TWO_TURNS
        by_unit = _in_another_unit(ratio, is_unit_said)
        yield by_unit or _against_the_clock(glance, ratio, alike)
        return
    for j in known.tolist():
        yield from _of_one_joint(j, float(ratios[j]))


def _scatter_allowed(ratios: Array) -> float:
    """Return by how much (natural logarithm) the ratio of all joints may differ from one
    where filters make it; ratios (k,) : of each joint over it."""
    of_joints = np.abs(ratios - 1.0)
    # A single joint has none to differ from.
    scatter = float(of_joints[of_joints < _SAME].max()) if len(ratios) > 1 else _SAME
    return max(_CLOCK, _OVER_SCATTER * scatter)


def _in_another_unit(ratio: float, is_unit_said: bool) -> Issue | None:
    """Return the note that velocities are in another unit than positions, by the ratio to
    the derivative of the position; None where a clock or a filter is as likely.

    A pair of units has one exact ratio, and so has a clock in another unit. Filters and
    other rates have any ratio, mostly near one. An encoder's counts have any ratio, if no
    name says the unit of positions. The likeliest pair of units is certain if its odds
    against all other explanations are high enough.
    """
    pairs = {
        (velocity, position): radians / per_second
        for per_second, velocity in VELOCITY_UNITS.items()
        for position, radians in _OF_POSITIONS.items()
        if radians != per_second
    }
    of_units = {x: _density(ratio, exact) / len(pairs) for x, exact in pairs.items()}
    counts = "another unit than the positions", "radians"
    of_units[counts] = 0.0 if is_unit_said else 1.0 / _OF_COUNTS
    of_clocks = sum(_density(ratio, x) for x in _OF_CLOCKS) / len(_OF_CLOCKS)
    distance = np.log(ratio) / _OF_FILTERS
    of_filters = 1.0 / (np.pi * _OF_FILTERS * (1.0 + distance**2))
    (of_velocity, of_position), best = max(of_units.items(), key=lambda x: x[1])
    if best <= max(of_clocks, of_filters):
        return None
    others = sum(of_units.values()) - best + of_clocks + of_filters
    beside = (
        "" if of_position == "radians" else f", where positions are in {of_position}"
    )
    odds = best / others
    of_odds = likely(f"{odds:.2g} times as likely as a clock, a filter or counts")
    return _note(
        kind="velocity unit",
        where="columns dq",
        what=f"the logged velocities are in {of_velocity}{beside}: {ratio:.4g} times the"
        " derivative of the position.",
        certainty=READ if odds > CERTAIN else of_odds,
        is_velocity_unusable=True,
        figures={"factor": ratio},
    )


def _density(ratio: float, exact: float) -> float:
    """Return the probability density of a measured ratio's logarithm, if the exact ratio
    is known: a normal one of standard deviation _EXACT."""
    distance = np.log(ratio / exact) / _EXACT
    return float(np.exp(-0.5 * distance**2) / (np.sqrt(2.0 * np.pi) * _EXACT))


def _against_the_clock(glance: RunSummary, ratio: float, alike: str) -> Issue:
    """Return the issue that the clock or the velocity is off by one factor.

    Programs sample at usual rates. If only the logged rate is a usual one, the clock is
    right, and a note about the velocity is left. If only the corrected rate is, the clock is
    repaired. Otherwise both are possible and nothing is repaired here: inertia beside weight
    shows a clock at another rate.

    ratio : velocity over the derivative of the position; alike : the sentence that says
    in how many joints.
    """
    rate = 1.0 / glance.usual_step
    is_usual = _is_round(rate, _OF_A_SET_RATE)
    would_be_usual = _is_round(rate * ratio, _OF_A_RATIO)
    if is_usual and not would_be_usual:
        return _note(
            kind="velocity scale",
            where="columns dq",
            what=f"{alike} The clock is right: {rate:.4g} samples a second are a usual rate.",
            cause="a filter, a gear or another unit of the velocity",
            figures={"factor": ratio},
        )
    remedy = f"multiply t by {1.0 / ratio:.3g}, or divide dq by {ratio:.3g}"
    issue = make_issue(
        kind="clock against velocity",
        in_doubt="clock against velocity",
        where="columns t and dq",
        what=alike,
        certainty=possible(
            "a velocity in another unit, of a filter or gear, has it too"
        ),
        cause=f"{stamps_text(1.0 / ratio)}, or velocities are in another unit or filtered",
        remedy=f"find out the log's rate: {remedy}",
        left=Left.FACTS,
        figures={"factor": 1.0 / ratio},
    )
    if is_usual or not would_be_usual:
        return issue
    usual = f"it makes the rate a usual one: {rate * ratio:.4g} samples a second"
    return replace(
        issue,
        certainty=likely(usual),
        repair=partial(_stretched, factor=1.0 / ratio),
        apply="clock:t",
    )


def _is_round(rate: float, tolerance: float) -> bool:
    """Return whether a rate is one that programs sample at, to a share of it."""
    digits = 10.0 ** (np.log10(rate) % 1.0)
    return bool(np.min(np.abs(digits / _ROUND_RATES - 1.0)) < tolerance)


def _stretched(run: Measurements, factor: float) -> Measurements:
    """Return the run with its clock slowed: ``factor`` times as long, from the same
    first instant."""
    return replace(run, t=run.t[0] + (run.t - run.t[0]) * factor)


def _of_one_joint(j: int, ratio: float) -> Iterator[Issue]:
    """Yield a note where the velocity of joint j (from 0) is not the derivative of its
    position: it is negative, or off by a third or more."""
    if ratio > 0.0 and abs(np.log(ratio)) <= _OF_ONE_JOINT:
        return
    yield _note(
        kind="velocity of one joint",
        joints=[j],
        what=f"dq{j + 1} is {ratio:.3g} times the derivative of q{j + 1}.",
        where=f"dq{j + 1}",
        figures={"factor": ratio},
    )


def velocity_ratio(glance: RunSummary) -> float | None:
    """Return the median ratio of the logged velocity to the derivative of the position;
    None where none is logged, or none is proportional to it."""
    if glance.run.dq is None:
        return None
    ratios = velocity_ratios(glance)
    known = ratios[np.isfinite(ratios)]
    return float(np.median(known)) if len(known) else None


def velocity_ratios(glance: RunSummary) -> Array:
    """Return the ratio (n,) [-] of the logged velocity to the derivative of the
    position.

    Both are averaged over windows of a few rows; time steps ten times as long as usual
    are left out. The ratio is nan for joints at rest, and where the two are not
    proportional.
    """
    width = int(max(4, len(glance.run.t) // 2000))  # rows: 2000 windows at most
    count = len(glance.steps) // width
    steps = glance.steps[: count * width].reshape(count, width)
    seconds = steps.sum(axis=1)
    usual = np.all(steps < 10.0 * glance.usual_step, axis=1) & (seconds > 0.0)
    ratios = np.full(glance.run.n, np.nan)
    for j in np.flatnonzero(glance.moving).tolist():
        travel = np.diff(glance.run.q[:, j])[: count * width].reshape(count, width)
        logged = _between_rows(glance, j)[: count * width].reshape(count, width) * steps
        rate = (travel.sum(axis=1) / seconds)[usual]
        speed = (logged.sum(axis=1) / seconds)[usual]
        ratios[j] = _ratio(rate, speed)
    return ratios


def _between_rows(glance: RunSummary, j: int) -> Array:
    """Return the logged velocity (N - 1,) of joint j halfway between rows, the mean of
    both."""
    assert glance.run.dq is not None
    return 0.5 * (glance.run.dq[1:, j] + glance.run.dq[:-1, j])


def _ratio(rate: Array, speed: Array) -> float:
    """Return the ratio of ``speed`` to ``rate`` (K,), two proportional signals.

    It is the ratio of their root mean squares, which noise in either biases alike (a
    least-squares slope would trust one of them); nan where they are not proportional.
    """
    rates, speeds = float(rate @ rate), float(speed @ speed)
    common = float(rate @ speed)
    if rates * speeds <= 0.0 or common * common <= _PROPORTIONAL * rates * speeds:
        return np.nan
    return float(np.sign(common) * np.sqrt(speeds / rates))


def velocity_lag(glance: RunSummary) -> float | None:
    """Return by how many samples the logged velocity lags behind the derivative of the
    position.

    It is the median over the moving joints of the lag at which the two correlate most,
    with either sign; None where the joints differ by more than a sample.

    Returns
    -------
    float or None
        Lag [samples]; negative where the velocity comes before.
    """
    # Steps across gaps count 0.
    is_no_gap = (glance.steps < GAP * glance.usual_step)[:_ROWS_OF_LAG]
    n_steps = len(is_no_gap)
    largest_lag = min(_LARGEST_LAG, n_steps // 4)
    lags_tried = np.arange(-largest_lag, largest_lag + 1)
    lags = []
    for j in np.flatnonzero(glance.moving).tolist():
        travel = is_no_gap * np.diff(glance.run.q[: n_steps + 1, j])
        speed = is_no_gap * _between_rows(glance, j)[:n_steps]
        # Cross-correlation by FFT; zeros behind the rows keep it from wrapping round. Its
        # entry k is that of lag k: negative lags stand at the end, as negative indices do.
        length = 2 * n_steps
        spectrum = np.fft.rfft(speed, length) * np.fft.rfft(travel, length).conj()
        correlation = np.abs(np.fft.irfft(spectrum, length)[lags_tried])
        lags.append(float(lags_tried[np.argmax(correlation)]))
    if not lags:
        return None
    lag = float(np.median(lags))
    if abs(lag) == largest_lag:
        return None  # the best lag may lie beyond those tried
    spread = float(np.median(np.abs(np.array(lags) - lag)))
    return lag if spread <= 1.0 else None
