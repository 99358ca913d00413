"""How what a user writes in a word becomes values: numbers, pairs, windows of time."""

from sdp_vs_penalty.errors import InputError


def numbers(option: str, text: str, count: int | None = None) -> list[float]:
    """Parse an option that holds numbers, "0,0,-9.81".

    Parameters
    ----------
    option : str
        Name of the option, for messages.
    text : str
        Its value: numbers separated by commas.

    Raises
    ------
    InputError
        Other texts, or another count.
    """
    try:
        values = [float(word) for word in text.split(",")]
    except ValueError:
        values = []
    if not values or len(values) != (count or len(values)):
        many = f"{count} numbers" if count else "numbers"
        raise InputError(
            f"{option} {text!r} is not {many}", f"write {many} separated by commas"
        )
    return values


def pairs(option: str, text: str | None) -> dict[str, str] | None:
    """Parse an option that holds pairs, "t=time,q=qm".

    Parameters
    ----------
    option : str
        Name of the option, for messages.
    text : str | None
        Its value; None where the option is not given.

    Returns
    -------
    dict[str, str] | None
        Right sides by left ones; None for None.

    Raises
    ------
    InputError
        A pair without an equals sign.
    """
    if text is None:
        return None
    words = [word.partition("=") for word in text.split(",")]
    if not all(key and equals and value for key, equals, value in words):
        raise InputError(
            f"{option} {text!r}",
            "write OURS=THEIRS separated by commas, like t=time,q=qm",
        )
    return {key.strip(): value.strip() for key, _, value in words}


def time_windows(
    text: str | None, option: str = "--window"
) -> list[tuple[float, float]]:
    """Parse an option that holds windows of time, "0:14,20:30".

    Parameters
    ----------
    text : str | None
        Its value, windows in order; None for one window over the whole run.
    option : str
        Name of the option, for messages.

    Returns
    -------
    list[tuple[float, float]]
        Start and stop of each window [s].

    Raises
    ------
    InputError
        A window that is empty or out of order.
    """
    if text is None:
        return [(0.0, float("inf"))]
    out: list[tuple[float, float]] = []
    for part in text.split(","):
        first, colon, last = part.partition(":")
        try:
            start = float(first or 0.0)
            stop = float(last or "inf")
        except ValueError:
            start = 0.0
            stop = -1.0
        if not (colon and 0.0 <= start < stop and (not out or start >= out[-1][1])):
            remedy = (
                "write START:STOP in seconds from a run's start, like 0:14 or 14.2:"
            )
            raise InputError(
                f"{option} {text!r}",
                f"{remedy} (several in order, separated by commas)",
            )
        out.append((start, stop))
    return out
