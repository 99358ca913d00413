"""How the words of a command line become values; shared by all verbs."""

from __future__ import annotations

from collections.abc import Sequence

from sdp_vs_penalty.errors import InputError

#: Options that take all words up to the next option: --data run1.csv run2.csv.
_MANY = frozenset({"--data"})


def numbers(option: str, text: str, count: int) -> list[float]:
    """``count`` numbers separated by commas; InputError naming the option otherwise."""
    try:
        values = [float(word) for word in text.split(",")]
    except ValueError:
        values = []
    if len(values) != count:
        raise InputError(
            f"{option} {text!r} is not {count} numbers", f"write {count} numbers separated by commas"
        )
    return values


def pairs(option: str, text: str | None) -> dict[str, str] | None:
    """OURS=THEIRS separated by commas; InputError naming the option otherwise."""
    if text is None:
        return None
    words = [word.partition("=") for word in text.split(",")]
    if not all(key and equals and value for key, equals, value in words):
        raise InputError(f"{option} {text!r}", "write OURS=THEIRS separated by commas, like t=time,q=qm")
    return {key.strip(): value.strip() for key, _, value in words}


def time_windows(text: str | None, option: str = "--window") -> list[tuple[float, float]]:
    """START:STOP in seconds, several separated by commas; either may be left out of each.

    Raises InputError naming the option otherwise.
    """
    if text is None:
        return [(0.0, float("inf"))]
    out: list[tuple[float, float]] = []
    for part in text.split(","):
        first, colon, last = part.partition(":")
        try:
            start, stop = float(first or 0.0), float(last or "inf")
        except ValueError:
            start, stop = 0.0, -1.0
        if not (colon and 0.0 <= start < stop and (not out or start >= out[-1][1])):
            raise InputError(
                f"{option} {text!r}",
                "write START:STOP in seconds from a run's start, like 0:14 or 14.2: (several in order, "
                "separated by commas)",
            )
        out.append((start, stop))
    return out


def expand_many(arguments: Sequence[str]) -> list[str]:
    """Repeat an option of several values before each.

    >>> expand_many(["--data", "a", "b", "--out", "c"])
    ['--data', 'a', '--data', 'b', '--out', 'c']
    """
    out: list[str] = []
    many = ""
    for word in arguments:
        if word.startswith("-") and word != "-":
            many = word if word in _MANY else ""
        elif many and out[-1] != many:
            out.append(many)
        out.append(word)
    return out
