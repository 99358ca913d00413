"""Names as words and numbers."""

import re
import unicodedata
from collections.abc import Sequence

#: What marks a name as that of a function of time: "q1(t)".
OF_TIME = re.compile(r"(?<=\S)\(t\)$")


def split_tokens(name: str) -> list[str]:
    """Split a column's name into words and numbers, in small letters without accents.

    >>> split_tokens("stampNanoSec[3]")
    ['stamp', 'nano', 'sec', '3']
    >>> split_tokens("axisQMsr")
    ['axis', 'q', 'msr']
    >>> split_tokens("q\u0307\u2081")
    ['dq', '1']
    >>> split_tokens("q1(t)")
    ['q', '1']
    """
    name = OF_TIME.sub("", name)
    name = re.sub(
        "([q\u03b8\u03c6])\u0307", r"d\1", name
    )  # a dot above is a derivative
    before_capital = r"(?<=[a-z])(?=[A-Z])"  # stamp|Nano
    before_last_capital = r"(?<=[A-Z])(?=[A-Z][a-z]{2})"  # Q|Msr
    with_blanks = re.sub(f"{before_capital}|{before_last_capital}", " ", name.strip())
    decomposed = unicodedata.normalize("NFKD", with_blanks.lower())
    without_accents = re.sub(r"[\u0300-\u036f]", "", decomposed)
    # Korean syllables and Japanese marks are no accents: they are put together again.
    text = unicodedata.normalize("NFC", without_accents)
    return re.findall(r"[^\W\d_]+|[0-9]+", text)


def n_common(rows: Sequence[Sequence[str]]) -> int:
    """Count the words with which all rows begin."""
    columns = enumerate(zip(*rows, strict=False))
    shortest = min(map(len, rows), default=0)
    return next((k for k, column in columns if len({*column}) > 1), shortest)


def group_of(our_name: str) -> str:
    """Return the channel group of a name of RUN.csv: "tau" for "tau3"."""
    return our_name.rstrip("0123456789")


def parts_of(their_name: str, names: Sequence[str]) -> tuple[str, ...]:
    """List the columns that a name of ``--rename`` stands for: one, or those of a stamp,
    "sec+nanosec" or "hour+minute+second"."""
    if their_name in names or "+" not in their_name:
        return (their_name,)
    return tuple(part.strip() for part in their_name.split("+"))


def starred(name: str) -> str:
    """Write a star for the last number in a name: "pos_*" for "pos_3"."""
    return re.sub(r"[0-9]+([^0-9]*)$", r"*\1", name)


def families(names: Sequence[str]) -> dict[str, list[str]]:
    """Collect columns that differ by their last number alone, by their pattern: "pos_*"
    for pos_0 and pos_1."""
    found = dict[str, list[str]]()
    for name in names:
        if re.search("[0-9]", name):
            found.setdefault(starred(name), []).append(name)
    return found


def brief_names(names: Sequence[str]) -> str:
    """Format names of columns in order, those that differ by their numbers as one.

    >>> brief_names(["t", "q_0", "q_1", "q_2"])
    'q_0..2, t'
    """
    shown = list[str]()
    numbers_of = dict[tuple[str, str], set[int]]()
    for name in names:
        match = re.fullmatch(r"(.*?)([0-9]+)([^0-9]*)", name)
        if match is None:
            shown.append(name)
        else:
            numbers_of.setdefault((match[1], match[3]), set()).add(int(match[2]))
    for (head, tail), found in numbers_of.items():
        numbers = sorted(found)
        is_range = numbers == list(range(numbers[0], numbers[-1] + 1))
        if len(numbers) > 2 and is_range:
            shown.append(f"{head}{numbers[0]}..{numbers[-1]}{tail}")
        else:
            shown += [f"{head}{number}{tail}" for number in numbers]
    return ", ".join(sorted({name[:40] for name in shown})) or "none"
