"""Numbers, units, joints and enumerations as text; axes of matplotlib if asked."""

import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from sdp_vs_penalty.errors import command_line, missing_extra, printable


def axes(panels: Any, rows: int = 1, columns: int = 1, **settings: Any) -> Any:
    """``panels`` axes, or those of a new figure. Raises InputError without matplotlib
    (extra [plot])."""
    if panels is not None:
        return panels
    try:
        import matplotlib.pyplot as plt
    except ImportError as error:
        raise missing_extra("Plots need", "plot") from error
    return plt.subplots(rows, columns, **settings)[1]


def plain_unit(unit: str) -> str:
    """N*m as N m, kg*m^2 as kg m²; nothing for a pure number."""
    return (
        ""
        if unit == "-"
        else unit.replace("*", " ").replace("^2", "²").replace("^3", "³")
    )


#: What Markdown would take for markup: escapes, code, tables, tags, entities, links,
#: strikethrough, and emphasis by _, which is none within a word.
_MARKUP = re.compile(
    r"\\(?=[!-/:-@\[-`{-~])|[`|]|<(?=[A-Za-z/!?])|&(?=#?\w+;)|\](?=[(\[:])|~(?=~)"
    r"|(?<![A-Za-z0-9])_(?=\S)|(?<=\S)_(?![A-Za-z0-9])"
)


def escape_markdown(text: str) -> str:
    r"""A text as Markdown shows it, on one line.

    >>> escape_markdown("*a* <b> q_1"), escape_markdown("[x](y)")
    ('\\*a\\* \\<b> q_1', '[x\\](y)')
    """
    line = " ".join(printable(text).split())
    escaped = _MARKUP.sub(lambda found: f"\\{found[0]}", line)
    if line.count("*") > 1:  # one alone is no emphasis: N*m
        escaped = escaped.replace("*", r"\*")
    return escaped


def finite(x: float) -> float | None:
    """JSON knows no NaN: what is undefined (no torque at all) is null."""
    return float(x) if math.isfinite(x) else None


def words(items: Sequence[object]) -> str:
    """An enumeration.

    >>> words([1]), words([1, 2]), words([1, 2, 3])
    ('1', '1 and 2', '1, 2 and 3')
    """
    texts = [str(item) for item in items]
    return texts[0] if len(texts) == 1 else f"{', '.join(texts[:-1])} and {texts[-1]}"


def sentence(text: str) -> str:
    """A text that begins with a capital letter, otherwise as it is.

    >>> sentence("joint 2 errs by 3 N m")
    'Joint 2 errs by 3 N m'
    """
    return text[:1].upper() + text[1:]


def joints(numbers: Sequence[int]) -> str:
    """Joints by numbers that count from 1.

    >>> joints([4]), joints([2, 5]), joints([1, 2, 3, 4]), joints([1, 2, 4])
    ('joint 4', 'joints 2 and 5', 'joints 1 to 4', 'joints 1, 2 and 4')
    """
    if len(numbers) > 2 and list(numbers) == list(range(numbers[0], numbers[-1] + 1)):
        return f"joints {numbers[0]} to {numbers[-1]}"
    return f"joint{'s' if len(numbers) > 1 else ''} {words(numbers)}"


def number(x: float | None, digits: int = 3) -> str:
    """Significant digits; whole numbers below a million without an exponent; a dash for
    what is unknown.

    >>> number(0.012345), number(1608.2, 2), number(99.7, 2), number(None)
    ('0.0123', '1608', '100', '-')
    """
    if x is None or not math.isfinite(x):
        return "-"
    text = f"{x:.{digits}g}"
    return f"{x:.0f}" if "e+" in text and abs(x) < 1e6 else text


def milli(value: float, unit: str, digits: int = 3) -> str:
    """A value in thousandths of its unit.

    >>> milli(0.0123, "rad"), milli(0.004, "s", 2)
    ('12.3 mrad', '4 ms')
    """
    return f"{number(1e3 * value, digits)} m{unit}"


def percent(share: float, digits: int = 3) -> str:
    """A share in per cent.

    >>> percent(0.1234)
    '12.3 %'
    """
    return f"{number(100.0 * share, digits)} %"


def command(*words: object) -> str:
    """A command of this program as one line that can be pasted into a shell.

    >>> command("convert", "my run.csv", "--rate", 200)
    "sdp-vs-penalty convert 'my run.csv' --rate 200"
    """
    return command_line(["sdp-vs-penalty", *words])


def convert_command(path: object, *words: object) -> str:
    """The command that converts a file with these options, into one of another name."""
    out = "run.csv" if Path(str(path)).name != "run.csv" else "run_converted.csv"
    return command("convert", path, *words, "--out", out)


def count(number: int, noun: str) -> str:
    """ "1 problem", "2 problems"."""
    return f"{number} {noun}{'' if number == 1 else 's'}"


def change_of(before: float, after: float) -> str:
    """How much smaller or larger an error is, in per cent."""
    if before <= 0.0:
        return "-"
    percent = 100.0 * (after / before - 1.0)
    return f"{percent:+.0f} %" if abs(percent) >= 0.5 else "0 %"
