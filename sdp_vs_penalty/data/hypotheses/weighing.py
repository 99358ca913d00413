"""What a column is, as hypotheses: each has a prior from names, units and metadata, and
evidence from the values; one function weighs them.

A unit of angles, a unit of time, which of several torques: where the file does not say it,
there are several answers. Whoever knows the arm can weigh the same hypotheses by its
torques.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sdp_vs_penalty import formatting
from sdp_vs_penalty.data.hypotheses.arm import N_PARTS, ChannelFit
from sdp_vs_penalty.data.log import ROWS_JUDGED
from sdp_vs_penalty.data.words import table
from sdp_vs_penalty.data.words.units import LARGEST_PERCENT, UNITS
from sdp_vs_penalty.robot.arrays import Array, Arrays

#: Words of loggers.toml for units that the values show: of angles, of a clock, and of
#: servos, whose drivers write degrees or per cent of each joint's range.
ANGLE, CLOCK, SERVO = "angle", "clock", "servo"
#: ... and of a clock whose name says no unit.
TIME = "time"
#: Odds from which a reading is certain.
CERTAIN = 1e3
#: The unit of positions that may be either.
DEGREES_OR_PERCENT = "degrees or per cent of each joint's range"
#: Angles beyond two turns are in degrees [rad].
_TWO_TURNS = 4.0 * np.pi
#: Steps of a clock are mostly shorter [s].
_SLOWEST_STEP = 0.1
#: Usual speed of the joint that moves most [rad/s, m/s].
_USUAL_SPEED = 0.5
#: How far sizes are from the usual one: the standard deviation [powers of ten].
_DECADES = 0.5
#: Share of logs whose positions are larger numbers than radians.
_OTHER_UNIT = 3e-3
#: Seconds since 1970 in the years 2001 and 2128: stamps in between are plausible [s].
_EARLIEST_STAMP, _LATEST_STAMP = 1e9, 5e9
#: Steps of a clock in seconds are longer: no arm is logged at 50 kHz [s].
_SHORTEST_STEP = 2e-5
#: From this share of repeated stamps on, a clock is rounded to more than a row.
_ROUNDED = 0.5
#: An arm that leaves more than this share of each torque explains none: positions, or the
#: clock, are in another unit.
EXPLAINS_NONE = 0.3
#: A measured torque carries noise; less than this share of its scatter is a model's, or
#: the rounding of one, beside a torque with ten times as much.
_LEAST_NOISE = 1e-3
#: ... and with an arm: less than this share of the friction in another channel.
_LEAST_FRICTION = 1.0 / 3.0
#: Steps of a clock that differ by less than this factor from the unit's are in it.
_NEAR = 1.5
#: No robot measures a larger number, and its square would overflow.
_LARGEST_SQUARABLE = 1e100


@dataclass(frozen=True)
class ColumnHypothesis:
    """One answer to what a column is."""

    #: The answer: a unit, or the first and last column.
    answer: str
    #: Share of logs with such names of which it is true; 1 where the file says it.
    prior: float
    #: The reason, as a phrase.
    why: str = ""
    #: How much more likely the values are under it than under another answer.
    evidence: float = 1.0

    @property
    def weight(self) -> float:
        """Its odds, but for a factor that all answers share."""
        return self.prior * self.evidence


def weigh(hypotheses: Sequence[ColumnHypothesis]) -> ColumnHypothesis:
    """Return the most probable of several answers to one question, the first of equals.
    A fact ends the question."""
    fact = next((x for x in hypotheses if x.prior == 1.0), None)
    return fact or max(hypotheses, key=lambda x: x.weight)


def unit_of_angles(values: Array, kind: str = ANGLE) -> ColumnHypothesis:
    """Return the unit of angles: degrees beyond two turns (4 pi), else radians.

    Those of a servo up to 100 may be degrees or per cent of each joint's range, and are
    taken as they are.
    """
    largest = float(np.abs(values).max(initial=0.0))
    if kind == SERVO and _TWO_TURNS < largest <= LARGEST_PERCENT:
        why = "which the file does not say: `convert --units q=deg` takes degrees"
        return ColumnHypothesis(DEGREES_OR_PERCENT, 0.5, why)
    unit = "deg" if largest > _TWO_TURNS else "rad"
    return ColumnHypothesis(unit, 0.5, f"it reaches {largest:.3g}")


def unit_of_clock(
    stamps: Array, rate: float | None = None, way: float = 0.0, *, kind: str = CLOCK
) -> ColumnHypothesis:
    """Return the unit of a clock with stamps (N,): "s", "ms", "us" or "ns".

    The usual step is that of the rate [Hz] at which dq is the derivative of q; logs have
    10 to 20 000 rows a second; and joints move at half a radian a second, or a few times
    more or less. A clock without a unit counts seconds, unless others are a hundred times
    likelier; that of libfranka (CLOCK) milliseconds as well, in which it stands still.

    Parameters
    ----------
    rate : float, optional
        What velocities say of the rate [Hz].
    way : float
        Mean step of the joint that moves most [rad or m]; 0 where it is not known.
    """
    steps = np.diff(stamps)
    is_rounded = np.mean(steps == 0.0) > _ROUNDED
    steps = steps[(steps > 0.0) | (is_rounded & (steps == 0.0))]
    if not steps.any():
        return ColumnHypothesis(
            "ms" if kind == CLOCK else "s", 0.5, "as it stands still"
        )
    step = float(np.mean(steps) if is_rounded else np.median(steps))
    answers = list[ColumnHypothesis]()
    for unit in ("s", "ms", "us", "ns"):
        seconds = step * UNITS[unit]
        is_usual = unit == "s" or (unit == "ms" and kind == CLOCK)
        beyond = max(seconds / _SLOWEST_STEP, _SHORTEST_STEP / seconds, 1.0)
        evidence = _likelihood(beyond)
        why = f"its steps are {step:.3g}"
        if way > 0.0:
            ratio = way / seconds / _USUAL_SPEED
            least = _OTHER_UNIT if ratio > 1.0 else 0.0  # positions may be in degrees
            evidence *= max(_likelihood(ratio), least)
        if rate is not None and 1.0 / _NEAR < rate * seconds < _NEAR:
            evidence, why = 1e3 * evidence, f"dq is the derivative of q at {rate:g} Hz"
        answers.append(
            ColumnHypothesis(unit, 0.5 if is_usual else 0.005, why, evidence)
        )
    return weigh(answers)


def _likelihood(ratio: float) -> float:
    """Return how likely a size is, relative to the usual size, that is ``ratio`` times
    the usual one."""
    return float(np.exp(-0.5 * (np.log10(ratio) / _DECADES) ** 2))


def unit_of_dates(stamps: Array) -> ColumnHypothesis | None:
    """Return the unit of a clock whose stamps (N,) count from a calendar date, else None.

    The first stamp tells: counted as a program of the table does, it is a moment between
    2001 and 2128. A clock of seconds may by chance show such a number of days. It is
    one of days only if, in seconds, it would step faster than any arm is logged.
    """
    if len(stamps) == 0 or not np.isfinite(stamps[0]):
        return None
    steps = np.diff(stamps)
    steps = steps[steps > 0.0]
    may_be_days = len(steps) > 0 and float(np.median(steps)) < _SHORTEST_STEP
    for unit, stamp_of_1970, since in table()["epochs"]:
        seconds = UNITS[unit] * (float(stamps[0]) - stamp_of_1970)
        is_dated = _EARLIEST_STAMP < seconds < _LATEST_STAMP
        if is_dated and (unit != "day" or may_be_days):
            return ColumnHypothesis(unit, 1.0, f"it counts since {since}")
    return None


def which_torque(
    channels: Arrays, torques: Collection[str], fits: Mapping[str, ChannelFit]
) -> list[ColumnHypothesis]:
    """Return the hypotheses that each of several channels (N, n), the likeliest by its name
    first, is the joints' torque.

    Where an arm was fitted to each, what it leaves of them is the evidence. A measured
    torque carries noise, and mostly the joints' friction. Where one of ``torques``, the
    channels that are no currents by their words, does and another channel does not, a
    model has made that one: without friction the arm leaves nothing of it. A channel that
    is another one times a constant is a conversion of it.
    """
    noise = {name: _noise(x) for name, x in channels.items()}
    largest = max((noise[x] for x in torques if noise[x] < np.inf), default=0.0)
    friction = max((abs(fits[x].friction) for x in torques if x in fits), default=0.0)
    most = max((fits[x].share for x in torques if x in fits), default=0.0)

    def is_model(name: str) -> bool:
        fit, is_quiet = fits.get(name), 10.0 * noise[name] < largest
        if fit is None:
            return is_quiet and noise[name] < _LEAST_NOISE < largest
        is_quiet = is_quiet or 3.0 * fit.share < most
        return is_quiet and abs(fit.friction) < _LEAST_FRICTION * friction

    models = [x for x in channels if is_model(x)]
    shares = {x: fit.share for x, fit in fits.items() if x not in models}
    if min(shares.values(), default=0.0) > EXPLAINS_NONE:
        shares = {}
    out = list[ColumnHypothesis]()
    for k, (name, values) in enumerate(channels.items(), 1):
        reasons = ["a model's: smooth"] if name in models else []
        for other, x in channels.items():
            ratio = _ratio(values, x)
            if other != name and ratio > 1.0:
                reasons = [f"{ratio:.3g} times {other.split(' to ')[0]}"]
        evidence = 1e-30 if name in models else 1.0
        if name in fits:
            left = formatting.percent(fits[name].share, 2)
            reasons.append(f"the arm leaves {left} of it")
        if name in shares:
            evidence = (min(shares.values()) / shares[name]) ** N_PARTS
        why = "; ".join(reasons)
        out.append(ColumnHypothesis(name, 0.5**k, why, evidence))
    return out


def _noise(values: Array) -> float:
    """Return the share of noise in the scatter of channels (N, n): the median over the
    channels.

    The noise of a channel is the size of its fourth differences that nine in ten do not
    exceed, so that repeated values and a few jumps do not count.
    """
    if len(values) <= 4:
        return np.inf
    scatter = np.std(values, axis=0)
    repeated = np.mean(np.diff(values, axis=0) == 0.0, axis=0)
    if np.median(repeated) > 0.1 or not scatter.any():
        return np.inf  # it is constant, or slower than the log
    # Fourth differences of white noise have sqrt(70) times its deviation.
    fourth = np.quantile(np.abs(np.diff(values, 4, axis=0)), 0.9, axis=0)
    shares = fourth / (1.645 * 70.0**0.5) / np.where(scatter > 0.0, scatter, np.nan)
    return float(np.nanmedian(shares))


def _ratio(values: Array, other: Array) -> float:
    """Return the size of the first of channels (N, n) over that of another one where
    each is the other times a constant, else 0."""
    if values.shape != other.shape:
        return 0.0
    product = np.sum(values * other, axis=0)
    norms = np.sum(values**2, axis=0), np.sum(other**2, axis=0)
    is_same = np.all(product**2 >= (1.0 - 1e-6) * norms[0] * norms[1])
    return float(product[0] / norms[1][0]) if is_same and norms[1][0] > 0.0 else 0.0


def rate_from_velocities(q: Array, dq: Array) -> float | None:
    """Estimate the sampling rate to three digits [Hz] at which velocities (N, n) are the
    derivative of positions (N, n): by least squares, step = mean dq / rate.

    None where steps and velocities have a squared correlation below 0.9.
    """
    steps, velocities = np.diff(q, axis=0), 0.5 * (dq[1:] + dq[:-1])
    usable = np.all(np.isfinite(steps) & np.isfinite(velocities), axis=1)
    steps, velocities = steps[usable], velocities[usable]
    largest = max(np.abs(x).max(initial=0.0) for x in (steps, velocities))
    if largest > _LARGEST_SQUARABLE:
        return None
    sizes = np.max(np.abs(steps), axis=1)
    usual = sizes <= 10.0 * np.median(sizes) if len(sizes) else sizes > 0.0
    if usual.sum() > 2:  # without the step over a pause
        steps, velocities = steps[usual], velocities[usual]
    for _ in range(2):  # the second time without steps over lost rows
        vv, ss = float(np.sum(velocities**2)), float(np.sum(steps**2))
        sv = float(np.sum(steps * velocities))
        if not vv * ss > 0.0 or sv <= 0.0 or sv**2 < 0.9 * vv * ss:
            return None
        wrong = np.max(np.abs(steps - sv / vv * velocities), axis=1)
        usual = wrong <= 10.0 * np.median(wrong)
        steps, velocities = steps[usual], velocities[usual]
    return float(f"{vv / sv:.3g}")


#: Units that velocities are logged in beside positions in SI, by their factors.
VELOCITY_UNITS = {
    1.0: "SI",
    UNITS["deg"]: "deg/s",
    UNITS["rpm"]: "rpm",
    UNITS["turns"]: "turns/s",
    UNITS["mm"]: "mm/s or mrad/s",
}
#: Velocities in such a unit are the derivative of positions to this share; units differ by
#: more from each other, and from the ratios of clocks.
_EXACT = 0.03
#: Step over which positions are differenced, if rows are nearer [s].
_DIFFERENCED = 0.01


def in_one_unit(
    t: Array, groups: Arrays, own: Sequence[float]
) -> tuple[dict[str, Array], list[str]]:
    """Bring velocities and their commands, (N, n) among groups, to the unit of positions
    along t (N,) [s], in SI, where these tell that they are in another one; and say so.

    own : (n,) factors that made SI of the positions: velocities mostly have their unit.
    """
    said = list[str]()
    groups = dict(groups)
    for group in {"dq", "dqcmd"} & {*groups}:
        if told := _unit_of_velocities(t, groups["q"], groups[group], own):
            factors, words = told
            groups[group] = groups[group] * factors
            said.append(f"{group} in {words}, as the derivative of q tells")
    return groups, said


def _unit_of_velocities(
    t: Array, q: Array, dq: Array, own: Sequence[float]
) -> tuple[Array, str] | None:
    """Return the factors (n,) to SI of velocities and the names of their units; None where
    they are in SI, or in no known unit.

    Beside counted positions any unit is possible. A factor of a thousand in all joints is
    not taken, unless positions have it: it may be the clock's.
    """
    step = float(np.median(np.diff(t[:ROWS_JUDGED]))) if len(t) > 1 else 0.0
    if not 0.0 < step < np.inf:
        return None
    thinned = max(1, int(_DIFFERENCED / step))
    q, dq = (x[:ROWS_JUDGED:thinned] for x in (q, dq))
    rates = {j: rate_from_velocities(q[:, [j]], dq[:, [j]]) for j in range(q.shape[1])}
    ratios = {j: x * thinned * step for j, x in rates.items() if x is not None}
    usual = float(np.median([*ratios.values()])) if ratios else 1.0
    counted = [] if {*own} <= {*UNITS.values()} else [1.0 / usual]
    found = dict[int, float]()
    for j, ratio in ratios.items():
        known = (1.0, own[j], *VELOCITY_UNITS, *counted)
        found[j] = next((x for x in known if abs(ratio * x - 1.0) < _EXACT), 0.0)
    units = {*found.values()}
    if 0.0 in units or units <= {1.0} or (units == {UNITS["mm"]} != {*own}):
        return None
    # Joints at rest tell no unit: they have the most frequent one.
    most_frequent = max(units, key=[*found.values()].count)
    factors = [found.get(j, most_frequent) for j in range(q.shape[1])]
    words = dict.fromkeys(VELOCITY_UNITS.get(x, f"steps of {x:.3g}") for x in factors)
    return np.array(factors), " and ".join(words)


def is_in_one_unit(values: Array, others: Array) -> bool:
    """Return whether two channel groups (N, n), such as positions and their commands, are
    in the same unit by their size, before any is converted."""
    sizes = [np.nanmax(np.abs(x[:ROWS_JUDGED]), initial=0.0) for x in (values, others)]
    return bool(min(sizes) > max(sizes) / _NEAR)
