"""Units that the values show, where a logger writes one or the other: degrees or
radians, milliseconds or seconds.

The first cells give a first answer; when the file is read, all its rows decide.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from sdp_vs_penalty.data.formats.units import LARGEST_PERCENT, UNITS
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.robot.arrays import Array

#: Words of loggers.toml for units that the values show.
ANGLE = "angle"
CLOCK = "clock"
#: ... of servos, whose drivers write degrees or per cent of each joint's range.
SERVO = "servo"
#: The unit of positions that may be either.
DEGREES_OR_PERCENT = "degrees or per cent of each joint's range"
#: Angles beyond two turns are in degrees [rad].
_TWO_TURNS = 4.0 * np.pi
#: Steps of a clock that are longer count milliseconds [s].
_SLOWEST_STEP = 0.1
#: Geometric mean of a step in milliseconds and one in seconds, in seconds.
_BETWEEN_MS_AND_S = 1000.0**0.5
#: Seconds since 1970 in the years 2001 and 2128: stamps in between are plausible [s].
_EARLIEST_STAMP = 1e9
_LATEST_STAMP = 5e9
#: Units of clocks that count from a date, the stamp of 1970 in that unit, and since when
#: they count: Unix, Windows and .NET, spreadsheets, MATLAB, astronomers, Matplotlib.
_EPOCHS = (
    ("ms", 0.0, "1970"),
    ("us", 0.0, "1970"),
    ("ns", 0.0, "1970"),
    ("100ns", 116_444_736_000_000_000.0, "1601"),
    ("100ns", 621_355_968_000_000_000.0, "the year 1"),
    ("day", 25_569.0, "1900"),
    ("day", 719_529.0, "the year 0"),
    ("day", 2_440_587.5, "4713 BC"),
    ("day", 0.0, "1970"),
)
#: Steps of a clock in seconds are longer: no arm is logged at 50 kHz [s].
_SHORTEST_STEP = 2e-5
#: From so many rows the units and the rate of a long file are judged.
ROWS_JUDGED = 100_000


def unit_of_angles(values: Array) -> tuple[str, str]:
    """Return the unit of angles, "deg" or "rad", and the reason as a phrase.

    Values beyond two turns (4 pi) are degrees.

    Returns
    -------
    unit, reason : str
        The unit and a phrase.
    """
    largest = float(np.abs(values).max(initial=0.0))
    unit = "deg" if largest > _TWO_TURNS else "rad"
    return unit, f"it reaches {largest:.3g}"


def unit_of_servo(values: Array) -> tuple[str, str]:
    """Return the unit of a servo's positions, and the reason as a phrase.

    Values within two turns are radians, values beyond 100 are degrees. Between the two
    they may be degrees or per cent of each joint's range, and are taken as they are.

    Returns
    -------
    unit, reason : str
        The unit and a phrase.
    """
    largest = float(np.abs(values).max(initial=0.0))
    if not _TWO_TURNS < largest <= LARGEST_PERCENT:
        return unit_of_angles(values)
    return (
        DEGREES_OR_PERCENT,
        "which the file does not say: `check` weighs them by the torques, `convert"
        " --units q=deg` takes degrees",
    )


def unit_of_clock(stamps: Array, rate: float | None = None) -> tuple[str, str]:
    """Return the unit of a clock, "ms" or "s", and the reason as a phrase.

    Where velocities tell the rate, the unit is the one in which the steps fit it.
    Otherwise a median step of 0.1 or more counts milliseconds: no arm is logged at only
    10 Hz. A clock that does not move counts milliseconds, in which libfranka writes it.

    Parameters
    ----------
    stamps : (N,) array
        Time stamps in the clock's unit. Repeated ones are left out.
    rate : float, optional
        Rate at which the logged velocities are the derivative of the positions [Hz].

    Returns
    -------
    unit, reason : str
        The unit and a phrase.
    """
    steps = np.diff(stamps)
    steps = steps[steps > 0.0]
    if not len(steps):
        return "ms", "as libfranka writes it"
    median_step = float(np.median(steps))
    if rate is not None:
        unit = "ms" if median_step * rate > _BETWEEN_MS_AND_S else "s"
        return unit, f"dq is the derivative of q at {rate:g} Hz"
    unit = "ms" if median_step >= _SLOWEST_STEP else "s"
    return unit, f"its steps are {median_step:.3g}"


def unit_of_dates(stamps: Array) -> tuple[str, str] | None:
    """Return the unit of a clock whose stamps are dates in it, and the reason.

    The first stamp is a day between 2001 and 2128 in one of the units in which programs
    count, from the day from which they do. Days are taken only where seconds would be
    tens of thousands of rows a second.

    Parameters
    ----------
    stamps : (N,) array
        Time stamps in the clock's unit.

    Returns
    -------
    unit, reason : str, or None
        The unit and a phrase; None where the stamps are no dates in such a unit.
    """
    if len(stamps) == 0 or not np.isfinite(stamps[0]):
        return None
    steps = np.diff(stamps)
    steps = steps[steps > 0.0]
    may_be_days = len(steps) > 0 and float(np.median(steps)) < _SHORTEST_STEP
    for unit, stamp_of_1970, since in _EPOCHS:
        seconds = UNITS[unit] * (float(stamps[0]) - stamp_of_1970)
        is_dated = _EARLIEST_STAMP < seconds < _LATEST_STAMP
        if is_dated and (unit != "day" or may_be_days):
            return unit, f"it counts since {since}"
    return None


def decide_units(
    run: Measurements,
    inferred: Mapping[str, str],
    scale: Mapping[str, float],
    rate: float | None,
) -> tuple[Measurements, dict[str, tuple[str, str]]]:
    """Decide by the rows of a run the units that its first cells suggested.

    Of a long run the first ROWS_JUDGED rows decide.

    Parameters
    ----------
    run : Measurements
        The run, in SI units as the first cells suggested.
    inferred : mapping of str to str
        ANGLE, SERVO or CLOCK by channel group (t, q, qcmd).
    scale : mapping of str to float
        Factors to SI by our column names (t, q, q1 ...), by which the run was
        multiplied; 1 where a name is missing.
    rate : float or None
        Rate at which the logged velocities are the derivative of the positions [Hz].

    Returns
    -------
    run : Measurements
        In the units that all rows show.
    units : dict of str to (str, str)
        Unit and reason by channel group.
    """
    present = {
        group: scale.get(group, scale.get(f"{group}1", 1.0))
        for group in ("q", *inferred)
    }
    angles = run.q[:ROWS_JUDGED] / present["q"]
    units = dict[str, tuple[str, str]]()
    for group, kind in inferred.items():
        if kind == CLOCK:
            units[group] = unit_of_clock(run.t[:ROWS_JUDGED] / present[group], rate)
        else:  # commanded angles are in the unit of measured ones
            unit_of = unit_of_servo if kind == SERVO else unit_of_angles
            units[group] = unit_of(angles)
        unit = units[group][0]
        if unit == DEGREES_OR_PERCENT and group != "q" and run.torque_logged:
            # Commands may be in per cent of other ranges.
            commanded = {k: x for k, x in run.commanded.items() if k != group}
            run = replace(run, commanded=commanded)
            units[group] = unit, "of ranges of its own: it is left out"
            continue
        factor = UNITS.get(unit, 1.0) / present[group]
        if factor == 1.0:
            continue
        if group in ("t", "q"):
            run = replace(run, **{group: getattr(run, group) * factor})
        elif group in run.commanded:
            commanded = {**run.commanded, group: run.commanded[group] * factor}
            run = replace(run, commanded=commanded)
    return run, units
