"""Stamps as seconds: text with or without a date, and numbers in several parts."""

import datetime
import re
import tomllib
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.robot.arrays import Array

_TABLE = tomllib.loads(Path(__file__).with_name("words.toml").read_text("utf-8"))
#: Words that the second part of a stamp ends with, by its unit [s].
SECOND_PARTS: dict[str, float] = _TABLE["second_parts"]
#: Words of the columns of a time of day: hours, minutes and seconds, in this order.
_TIMES_OF_DAY: tuple[tuple[str, ...], ...] = tuple(
    tuple(_TABLE["times_of_day"][name]) for name in ("hour", "minute", "second")
)
#: Units of these columns [s].
_UNITS_OF_DAY = (3600.0, 60.0, 1.0)
#: Words that the first part ends with.
FIRST_PARTS = ("sec", "secs", "seconds", "s")
_DAY = 86_400.0
_DATE = (
    r"\d{4}[-/.]\d{1,2}[-/.]\d{1,2}|\d{1,2}[-/.]\d{1,2}[-/.]\d{2,4}"
    # With the month in letters: 01-May-2024, and Wed May 1 before the time of day.
    r"|\d{1,2}[-/. ][A-Za-z]{3,9}\.?[-/. ]\d{2,4}|(?:[A-Za-z]{3},? )?[A-Za-z]{3} +\d{1,2}"
)
#: Hours, minutes and seconds; minutes and seconds with a fraction, as spreadsheets show.
_CLOCK = r"\d{1,2}:\d{2}(?::\d{2}(?:[.,:]\d+)?)?|\d{1,3}:\d{2}[.,]\d+"
#: Dates and times without marks, 20240501T120000.5: they need the T between them.
_PLAIN = r"\d{8}T\d{6}(?:[.,]\d+)?"
#: A zone's letters other than UTC's are those of the place: its offset is not known.
_ZONE = r"Z|UTC|GMT|[+-]\d{2}(?::?\d{2})?|[A-Z]{3,4}"
_STAMP = re.compile(
    rf"(?:(?:(?P<date>{_DATE})(?:[T/_]|,? +)|(?P<days>\d+) days?,? +)?(?P<clock>{_CLOCK})"
    rf"|(?P<plain>{_PLAIN}))"
    rf"(?: ?(?P<half>[AaPp]\.?[Mm]\.?))?(?: ?(?P<zone>{_ZONE}))?(?:\[[\w/+-]+\])?(?: \d{{4}})?"
)


def is_stamp(text: str) -> bool:
    """Return whether a cell holds a time of day, with or without a date and a zone.

    Returns
    -------
    bool
        True for ISO 8601 and the forms that spreadsheets write.
    """
    return _STAMP.fullmatch(text.strip()) is not None


def has_fraction(text: str) -> bool:
    """Return whether a stamp says more than whole seconds.

    Returns
    -------
    bool
        True for 12:00:00.005, False for 12:00:00.
    """
    match = _STAMP.fullmatch(text.strip())
    clock = "" if match is None else match["clock"] or match["plain"]
    return bool(re.search(r"[.,]\d+$|:\d+:\d+:\d+$", clock))


def fraction_column(names: Sequence[str]) -> str | None:
    """Find the column that continues stamps of whole seconds: "ms", "Millisecond".

    Returns
    -------
    str | None
        The name; None without such a column.
    """
    parts = {name: _stem_and_word(name) for name in names}
    return next(
        (
            name
            for name, (stem, word) in parts.items()
            if not stem and word in SECOND_PARTS
        ),
        None,
    )


def find_two_parts(names: Sequence[str]) -> tuple[str, str] | None:
    """Find the two columns of a stamp that is split into seconds and a fraction of a
    second.

    Returns
    -------
    tuple[str, str] | None
        Names of the seconds' and of the fraction's column, such as "stamp.sec" and
        "stamp.nanosec"; None without such a pair.
    """
    name_by_parts = {_stem_and_word(name): name for name in names}
    for (stem, word), name in name_by_parts.items():
        if word not in SECOND_PARTS:
            continue
        for word_of_seconds in FIRST_PARTS:
            if (stem, word_of_seconds) in name_by_parts:
                return name_by_parts[stem, word_of_seconds], name
    return None


def find_time_of_day(names: Sequence[str]) -> tuple[str, ...] | None:
    """Find the columns of a time of day: hours, minutes and seconds, side by side.

    A column with the fraction of a second can follow. Side by side they tell minutes
    from months, which are both written "MM".

    Parameters
    ----------
    names : Sequence[str]
        Names of the columns, in the file's order.

    Returns
    -------
    tuple[str, ...] | None
        Names of three or four columns, such as ("hour", "minute", "second"); None
        without such columns.
    """
    parts = [_stem_and_word(name) for name in names]
    for k in range(len(parts) - 2):
        stems = {stem for stem, _ in parts[k : k + 3]}
        words = [word for _, word in parts[k : k + 3]]
        pairs = zip(words, _TIMES_OF_DAY, strict=True)
        if len(stems) > 1 or not all(word in known for word, known in pairs):
            continue
        has_fraction = parts[k + 3 : k + 4] and parts[k + 3][1] in SECOND_PARTS
        return tuple(names[k : k + 4 if has_fraction else k + 3])
    return None


def units_of_parts(names: Sequence[str]) -> tuple[float, ...]:
    """Return the units of the columns whose sum is a clock.

    Parameters
    ----------
    names : Sequence[str]
        Names of the columns: one; two of a stamp in seconds and a fraction; three or
        four of a time of day in hours, minutes, seconds and a fraction. None without a
        clock.

    Returns
    -------
    tuple[float, ...]
        Units [s], one a column. That of one column is 1, for only its name or its
        values say it; a fraction is in nanoseconds where its name does not say it.
    """
    whole = _UNITS_OF_DAY if len(names) > 2 else (1.0,)[: len(names)]
    fractions = names[len(whole) :]
    return (*whole, *(_unit_of_fraction(name) for name in fractions))


def _unit_of_fraction(name: str) -> float:
    """Return the unit [s] of the column that holds a fraction of a second, by its
    name."""
    return SECOND_PARTS.get(_stem_and_word(name)[1], 1e-9)


def _stem_and_word(name: str) -> tuple[str, str]:
    """Split a name before its last word: ("stamp", "nanosec") for "stampNanoSec"."""
    words = re.findall(r"[A-Z]?[a-z]+|[A-Z]+|[0-9]+", name.strip())
    words = [word.lower() for word in words]
    if len(words) > 1 and words[-2] + words[-1] in SECOND_PARTS:
        words[-2:] = [words[-2] + words[-1]]
    return "".join(words[:-1]), words[-1] if words else ""


def seconds_of(texts: Sequence[str]) -> Array:
    """Convert time stamps in words to seconds.

    Parameters
    ----------
    texts : sequence of str
        N times of day, all with a date or all without.

    Returns
    -------
    Array
        (N,) seconds [s] since 1970 where dates begin with the year (UTC, unless a zone
        is written). Otherwise seconds since midnight, which :func:`past_midnight`
        continues: other dates do not say whether the day or the month comes first.

    Raises
    ------
    InputError
        A text that is no time stamp.
    """
    texts = [text.strip() for text in texts]
    seconds = _seconds_by_arrow(texts)
    if seconds is not None:
        return seconds
    matches = [_match(text) for text in texts]
    times_of_day = np.array([_time_of_day(match) for match in matches])
    dates = [_date_of(match) for match in matches]
    has_dates = bool(matches) and None not in dates
    if has_dates:
        return times_of_day + _seconds_since_1970(dates)
    return times_of_day


def past_midnight(clock: Array) -> Array:
    """Continue times of day past midnight.

    Parameters
    ----------
    clock : Array
        (N,) times of day [s].

    Returns
    -------
    Array
        (N,) times [s], one day more after each midnight.
    """
    if len(clock) < 2:
        return clock
    is_next_day = np.diff(clock) < -0.5 * _DAY
    n_days = np.concatenate([[0], np.cumsum(is_next_day)])
    return clock + _DAY * n_days


def _seconds_by_arrow(texts: Sequence[str]) -> Array | None:
    """Convert ISO time stamps with dates to seconds [s] since 1970 by PyArrow, which is
    fast.

    Returns (N,) seconds; None where a stamp has no date or a form that PyArrow does not
    read.
    """
    import pyarrow as arrow
    from pyarrow import compute

    if not texts or not all("-" in text[:5] for text in texts):
        return None
    is_zoned = bool(re.search(r"(Z|[+-]\d{2}:?\d{2})$", texts[0][10:]))
    kind = arrow.timestamp("ns", "UTC" if is_zoned else None)
    try:
        stamps = compute.cast(arrow.array(texts), kind)
    except arrow.ArrowException:
        return None  # a comma before the fraction, or another variety of the standard
    return 1e-9 * np.array(stamps.cast("int64").to_pylist(), float)


def _match(text: str) -> re.Match[str]:
    """Match a text with the pattern of time stamps; raise InputError where it is
    none."""
    match = _STAMP.fullmatch(text)
    if match is None:
        remedy = "write stamps like 2025-05-01T12:00:00.005"
        raise InputError(f"{text[:40]!r} is no time", remedy)
    return match


def _time_of_day(match: re.Match[str]) -> float:
    """Return the seconds since midnight [s] of a matched time stamp, in UTC where it
    has a zone."""
    clock = match["clock"] or _with_marks(match["plain"])
    parts = re.split(r"[:.,]", clock)
    if re.fullmatch(r"\d+:\d+[.,]\d+", clock):
        parts = ["0", *parts]  # minutes and seconds
    hours, minutes = int(parts[0]), int(parts[1])
    seconds = float(parts[2]) if len(parts) > 2 else 0.0
    fraction = float(f"0.{parts[3]}") if len(parts) > 3 else 0.0
    days = int(match["days"] or 0)
    if match["half"]:
        hours = hours % 12 + (12 if match["half"][0] in "Pp" else 0)
    if hours > 23 or minutes > 59 or seconds > 60.0:
        remedy = "write stamps like 2025-05-01T12:00:00.005"
        raise InputError(f"{match[0][:40]!r} is no time", remedy)
    time_of_day = 3600.0 * hours + 60.0 * minutes + seconds + fraction
    return _DAY * days + time_of_day - _offset(match["zone"])


def _with_marks(plain: str) -> str:
    """Return the time of day of a stamp without marks, "20240501T120000.5", with them."""
    clock = plain[9:]
    return f"{clock[:2]}:{clock[2:4]}:{clock[4:]}"


def _offset(zone: str | None) -> float:
    """Return how far a zone's clock, such as "+02:00", is ahead of UTC [s]."""
    if not zone or zone[0] not in "+-":
        return 0.0
    digits = zone[1:].replace(":", "").ljust(4, "0")
    offset = 3600.0 * int(digits[:2]) + 60.0 * int(digits[2:])
    return -offset if zone[0] == "-" else offset


def _date_of(match: re.Match[str]) -> datetime.date | None:
    """Return the date of a matched time stamp that begins with the year; None
    otherwise."""
    date = match["date"] or ""
    if match["plain"]:
        date = f"{match['plain'][:4]}-{match['plain'][4:6]}-{match['plain'][6:8]}"
    if not re.match(r"\d{4}", date):
        return None
    year, month, day = map(int, re.split(r"[-/.]", date))
    try:
        return datetime.date(year, month, day)
    except ValueError:
        remedy = "write stamps like 2025-05-01T12:00:00.005"
        raise InputError(f"{match[0][:40]!r} is no time", remedy) from None


def _seconds_since_1970(dates: Sequence[datetime.date | None]) -> Array:
    """Return the seconds (N,) [s] from 1970 to the beginnings of N dates."""
    first = datetime.date(1970, 1, 1)
    return np.array([_DAY * (date - first).days for date in dates if date is not None])
