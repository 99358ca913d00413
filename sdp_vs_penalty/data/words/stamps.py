"""Stamps as seconds: text with or without a date, and numbers in several parts."""

import datetime
import re
from collections.abc import Sequence

import numpy as np

from sdp_vs_penalty.data.words import table
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.robot.arrays import Array

#: Words that the second part of a stamp ends with, by its unit [s].
_SECOND_PARTS: dict[str, float] = table()["second_parts"]
#: Words of the columns of a time of day, in this order, and their units [s].
_TIMES_OF_DAY = [table()["times_of_day"][x] for x in ("hour", "minute", "second")]
_UNITS_OF_DAY = (3600.0, 60.0, 1.0)
#: Words that the first part ends with.
_FIRST_PARTS = ("sec", "secs", "seconds", "s")
_DAY = 86_400.0
_DATE = (
    r"\d{4}[-/.]\d{1,2}[-/.]\d{1,2}|\d{1,2}[-/.]\d{1,2}[-/.]\d{2,4}"
    # With the month in letters: 01-May-2024, and Wed May 1 before the time of day.
    r"|\d{1,2}[-/. ][A-Za-z]{3,9}\.?[-/. ]\d{2,4}|(?:[A-Za-z]{3},? )?[A-Za-z]{3} +\d{1,2}"
)
#: Hours, minutes and seconds; minutes and seconds with a fraction, as spreadsheets show.
_CLOCK = r"\d{1,2}:\d{2}(?::\d{2}(?:[.,:;]\d+)?)?|\d{1,3}:\d{2}[.,]\d+"
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
    """Return whether a cell holds a time of day, with or without a date and a zone, in
    the forms of ISO 8601 and of spreadsheets."""
    return _STAMP.fullmatch(text.strip()) is not None


def has_fraction(text: str) -> bool:
    """Return whether a stamp says more than whole seconds: 12:00:00.005."""
    match = _STAMP.fullmatch(text.strip())
    clock = "" if match is None else match["clock"] or match["plain"]
    return bool(re.search(r"[.,;]\d+$|:\d+:\d+:\d+$", clock))


def fraction_column(names: Sequence[str]) -> str | None:
    """Find the column that continues stamps of whole seconds: "ms", "Millisecond"."""
    parts = {name: _stem_and_word(name) for name in names}
    found = (
        n for n, (stem, word) in parts.items() if not stem and word in _SECOND_PARTS
    )
    return next(found, None)


def find_two_parts(names: Sequence[str]) -> tuple[str, ...]:
    """Find the two columns of a stamp in seconds and a fraction of a second, such as
    "stamp.sec" and "stamp.nanosec"; empty without such a pair."""
    name_by_parts = {_stem_and_word(name): name for name in names}
    for (stem, word), name in name_by_parts.items():
        for seconds in _FIRST_PARTS if word in _SECOND_PARTS else ():
            if (stem, seconds) in name_by_parts:
                return name_by_parts[stem, seconds], name
    return ()


def find_time_of_day(names: Sequence[str]) -> tuple[str, ...]:
    """Find the columns of a time of day: hours, minutes and seconds, and perhaps a
    fraction of a second; empty without them.

    Side by side they tell minutes from months, which are both written "MM".
    """
    parts = [_stem_and_word(name) for name in names]
    for k in range(len(parts) - 2):
        stems = {stem for stem, _ in parts[k : k + 3]}
        pairs = zip(parts[k : k + 3], _TIMES_OF_DAY, strict=True)
        if len(stems) == 1 and all(word in known for (_, word), known in pairs):
            has_fraction = parts[k + 3 : k + 4] and parts[k + 3][1] in _SECOND_PARTS
            return tuple(names[k : k + 4 if has_fraction else k + 3])
    return ()


def units_of_parts(names: Sequence[str]) -> tuple[float, ...]:
    """Return the units [s] of the columns whose sum is a clock.

    The columns are one clock (unit 1: its name or its values say the true one), seconds
    and a fraction, or a time of day in three or four. A fraction is in nanoseconds
    unless its name says another unit.
    """
    whole = _UNITS_OF_DAY if len(names) > 2 else (1.0,)[: len(names)]
    fractions = (
        _SECOND_PARTS.get(_stem_and_word(x)[1], 1e-9) for x in names[len(whole) :]
    )
    return (*whole, *fractions)


def _stem_and_word(name: str) -> tuple[str, str]:
    """Split a name before its last word: ("stamp", "nanosec") for "stampNanoSec"."""
    words = re.findall(r"[A-Z]?[a-z]+|[A-Z]+|[0-9]+", name.strip())
    words = [word.lower() for word in words]
    if len(words) > 1 and words[-2] + words[-1] in _SECOND_PARTS:
        words[-2:] = [words[-2] + words[-1]]
    return "".join(words[:-1]), words[-1] if words else ""


def seconds_of(texts: Sequence[str]) -> Array:
    """Convert N stamps in words, all with a date or all without, to seconds (N,) [s].

    They count since 1970 where dates begin with the year (UTC, unless a zone is
    written), otherwise since midnight, which :func:`past_midnight` continues: other
    dates do not say whether the day or the month comes first. Raises InputError for a
    text that is no stamp.
    """
    texts = [text.strip() for text in texts]
    seconds = _seconds_by_arrow(texts)
    if seconds is not None:
        return seconds
    parsed = [_parse(text) for text in texts]
    has_dates = all(date is not None for date, _ in parsed)
    epoch = datetime.date(1970, 1, 1)
    return np.array(
        [
            time + (_DAY * (date - epoch).days if has_dates and date else 0.0)
            for date, time in parsed
        ]
    )


def past_midnight(clock: Array) -> Array:
    """Continue times of day (N,) [s] past midnight: one day more after each."""
    is_next_day = np.diff(clock, prepend=clock[:1]) < -0.5 * _DAY
    return clock + _DAY * np.cumsum(is_next_day)


def _seconds_by_arrow(texts: Sequence[str]) -> Array | None:
    """Convert ISO stamps with dates to seconds [s] since 1970 by PyArrow, which is fast;
    None where one has no date, or a form that PyArrow does not read."""
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


def _parse(text: str) -> tuple[datetime.date | None, float]:
    """Return the date, where it begins with the year, and the seconds since midnight [s]
    in UTC; raise InputError for a text that is no stamp."""
    wrong = InputError(
        f"{text[:40]!r} is no time", "write stamps like 2025-05-01T12:00:00.005"
    )
    match = _STAMP.fullmatch(text)
    if match is None:
        raise wrong
    date, clock, plain = match["date"] or "", match["clock"], match["plain"]
    if plain:  # without marks: 20250501T120000.005
        date = f"{plain[:4]}-{plain[4:6]}-{plain[6:8]}"
        clock = f"{plain[9:11]}:{plain[11:13]}:{plain[13:]}"
    parts = re.split(r"[:;.,]", clock)
    if re.fullmatch(r"\d+:\d+[.,]\d+", clock):
        parts = ["0", *parts]  # minutes and seconds
    # Seconds may be missing; a fourth part is the fraction of a second.
    hours, minutes, seconds = (float(x) for x in (*parts, "0")[:3])
    fraction = float(f"0.{parts[3]}") if len(parts) > 3 else 0.0
    if match["half"]:
        hours = hours % 12 + (12 if match["half"][0] in "Pp" else 0)
    if hours > 23 or minutes > 59 or seconds > 60.0:
        raise wrong
    time = 3600.0 * hours + 60.0 * minutes + seconds + fraction
    time += _DAY * int(match["days"] or 0)
    zone = match["zone"] or ""
    if zone[:1] in ("+", "-"):  # how far its clock is ahead of UTC
        digits = zone[1:].replace(":", "").ljust(4, "0")
        ahead = 3600.0 * int(digits[:2]) + 60.0 * int(digits[2:])
        time -= -ahead if zone[0] == "-" else ahead
    if not re.match(r"\d{4}", date):
        return None, time
    try:
        return datetime.date(*map(int, re.split(r"[-/.]", date))), time
    except ValueError:
        raise wrong from None
