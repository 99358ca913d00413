"""Stamps as seconds: text as ISO 8601 writes it, and numbers in two parts."""

import datetime
import re
import tomllib
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.robot.arrays import Array

#: Words that the second part of a stamp ends with, by its unit [s].
SECOND_PARTS: dict[str, float] = tomllib.loads(
    Path(__file__).with_name("words.toml").read_text()
)["second_parts"]
#: Words that the first part ends with.
FIRST_PARTS = ("sec", "secs", "seconds", "s")


def find_two_parts(names: Sequence[str]) -> tuple[str, str] | None:
    """The columns of a stamp in two parts, seconds and a fraction of one; None without."""
    parts = {_stem_and_word(name): name for name in names}
    for (stem, word), name in parts.items():
        for first in FIRST_PARTS:
            if word in SECOND_PARTS and (stem, first) in parts:
                return parts[stem, first], name
    return None


def second_part_unit(name: str) -> float:
    """What the second part of a stamp counts in [s]; nanoseconds where no name says."""
    return SECOND_PARTS.get(_stem_and_word(name)[1], 1e-9)


def _stem_and_word(name: str) -> tuple[str, str]:
    """A name's last word and what comes before it."""
    stem, word = re.fullmatch(r"(.*?)([A-Za-z]*)\W*", name.strip().lower()).groups()  # type: ignore[union-attr]
    return re.sub(r"\W|_", "", stem), word


def seconds_of(texts: Sequence[str]) -> Array:
    """(N,) seconds since 1970 (UTC without a zone), or since midnight where a stamp has
    no date; InputError for what is no stamp."""
    import pyarrow as arrow
    from pyarrow import compute

    texts = [text.strip() for text in texts]
    has_date = all("-" in text[:5] for text in texts)
    if has_date and texts:
        zoned = bool(re.search(r"(Z|[+-]\d{2}:?\d{2})$", texts[0][10:]))
        kind = arrow.timestamp("ns", "UTC" if zoned else None)
        try:
            stamps = compute.cast(arrow.array(texts), kind)
            return 1e-9 * np.array(stamps.cast("int64").to_pylist(), float)
        except arrow.ArrowException:
            pass  # a comma before the fraction, or another variety of the standard
    return np.array([_seconds(text) for text in texts])


def _seconds(text: str) -> float:
    """The same of one stamp."""
    # From 3.11 on Python reads any number of digits, but keeps six.
    digits = re.search(r"[.,](\d+)", text)
    fraction = float(f"0.{digits[1]}") if digits else 0.0
    whole_seconds = re.sub(r"[.,]\d+", "", text)
    try:
        if "-" in text[:5]:
            at = datetime.datetime.fromisoformat(whole_seconds)
            at = at if at.tzinfo else at.replace(tzinfo=datetime.UTC)
            return at.timestamp() + fraction
        clock = datetime.time.fromisoformat(whole_seconds)
    except ValueError:
        remedy = "write stamps like 2025-05-01T12:00:00.005"
        raise InputError(f"{text[:40]!r} is no time", remedy) from None
    return 3600.0 * clock.hour + 60.0 * clock.minute + clock.second + fraction
