"""Numbers, units, joints and enumerations as text; axes of matplotlib if asked."""

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from sdp_vs_penalty.errors import command_line, missing_extra, printable


def axes(panels: Any, rows: int = 1, columns: int = 1, **settings: Any) -> Any:
    """Return axes to draw into: the given ones, or those of a new matplotlib figure.

    Parameters
    ----------
    rows, columns : int
        Grid of the new figure.

    Raises
    ------
    InputError
        If matplotlib (extra ``plot``) is not installed.
    """
    if panels is not None:
        return panels
    try:
        import matplotlib.pyplot as plt
    except ImportError as error:
        raise missing_extra("Plots need", "plot") from error
    return plt.subplots(rows, columns, **settings)[1]


def plain_unit(unit: str) -> str:
    """Write a unit for people: N*m as N m, kg*m^2 as kg m²; "" for a pure number ("-").

    Parameters
    ----------
    unit : str
        Unit as files hold it.
    """
    if unit == "-":
        return ""
    return unit.replace("*", " ").replace("^2", "²").replace("^3", "³")


#: What Markdown would take for markup: escapes, code, tables, tags, entities, links,
#: strikethrough, and emphasis by _, which is none within a word.
_MARKUP = re.compile(
    r"\\(?=[!-/:-@\[-`{-~])|[`|]|<(?=[A-Za-z/!?])|&(?=#?\w+;)|\](?=[(\[:])|~(?=~)"
    r"|(?<![A-Za-z0-9])_(?=\S)|(?<=\S)_(?![A-Za-z0-9])"
)


def escape_markdown(text: str) -> str:
    r"""Escape a text for Markdown, on one line.

    Returns
    -------
    str
        Markdown that shows this text.

    Examples
    --------
    >>> escape_markdown("*a* <b> q_1"), escape_markdown("[x](y)")
    ('\\*a\\* \\<b> q_1', '[x\\](y)')
    """
    line = " ".join(printable(text).split())
    escaped = _MARKUP.sub(lambda found: f"\\{found[0]}", line)
    if line.count("*") > 1:  # one alone is no emphasis: N*m
        escaped = escaped.replace("*", r"\*")
    return escaped


def finite(x: float) -> float | None:
    """Return a number for JSON, which has no NaN and no infinity: None instead of
    these."""
    return float(x) if math.isfinite(x) else None


def words(items: Sequence[object]) -> str:
    """Enumerate items in words: "1, 2 and 3".

    Examples
    --------
    >>> words([1]), words([1, 2]), words([1, 2, 3])
    ('1', '1 and 2', '1, 2 and 3')
    """
    texts = [str(item) for item in items]
    return texts[0] if len(texts) == 1 else f"{', '.join(texts[:-1])} and {texts[-1]}"


def sentence(text: str) -> str:
    """Begin a text with a capital letter.

    Returns
    -------
    str
        The sentence; all other letters stay.

    Examples
    --------
    >>> sentence("joint 2 errs by 3 N m")
    'Joint 2 errs by 3 N m'
    """
    return text[:1].upper() + text[1:]


def joint_number(j: int) -> int:
    """Return the number by which users know joint j (from 0): they count from 1."""
    return j + 1


def joints(numbers: Sequence[int]) -> str:
    """Name joints by number.

    Parameters
    ----------
    numbers : sequence of int
        Numbers of the joints, from 1.

    Examples
    --------
    >>> joints([4]), joints([2, 5]), joints([1, 2, 3, 4]), joints([1, 2, 4])
    ('joint 4', 'joints 2 and 5', 'joints 1 to 4', 'joints 1, 2 and 4')
    """
    if len(numbers) > 2 and list(numbers) == list(range(numbers[0], numbers[-1] + 1)):
        return f"joints {numbers[0]} to {numbers[-1]}"
    return f"joint{'s' if len(numbers) > 1 else ''} {words(numbers)}"


def place(joint_numbers: Sequence[int]) -> str:
    """Say where an effect acts: on joints by number, or on the whole robot.

    Parameters
    ----------
    joint_numbers : sequence of int
        Numbers of the joints, from 1; none for the whole robot.

    Examples
    --------
    >>> place([2, 5]), place([])
    ('joints 2 and 5', 'whole robot')
    """
    return joints(joint_numbers) if joint_numbers else "whole robot"


def number(x: float | None, digits: int = 3) -> str:
    """Write a number with a number of significant digits.

    Integers below a million get no exponent; an unknown number is a dash.

    Parameters
    ----------
    x : float or None
        The number; None if it is unknown.

    Examples
    --------
    >>> number(0.012345), number(1608.2, 2), number(99.7, 2), number(None)
    ('0.0123', '1608', '100', '-')
    """
    if x is None or not math.isfinite(x):
        return "-"
    text = f"{x:.{digits}g}"
    return f"{x:.0f}" if "e+" in text and abs(x) < 1e6 else text


#: Units that a prefix may stand before, as the first of a product.
_WITH_PREFIX = ("N", "A", "s", "m", "rad")


def _prefixed(largest: float, unit: str) -> tuple[float, str]:
    """Return the factor and the unit in which amounts up to a size are written:
    thousandths of a unit where all are smaller."""
    is_one = unit.split(" ")[0] in _WITH_PREFIX and " or " not in unit
    is_small = is_one and 0.0 < largest < 1e-3
    return (1e3, f"m{unit}") if is_small else (1.0, unit)


def amount(size: float, half: float, unit: str, digits: int = 3) -> str:
    """Write a size with half its 95 % interval and its unit, in thousandths of it where
    both are small.

    Examples
    --------
    >>> amount(1234.5, 1040.0, "N m"), amount(0.5, 0.02, "")
    ('1234 ± 1040 N m', '0.5 ± 0.02')
    >>> amount(0.000444, 8.1e-05, "N m"), amount(0.000444, 8.1e-05, "kg")
    ('0.444 ± 0.081 mN m', '0.000444 ± 8.1e-05 kg')
    """
    scale, unit = _prefixed(max(abs(size), half), unit)
    text = f"{number(scale * size, digits)} ± {number(scale * half, 2)} {unit}"
    return text.rstrip()


def quantity(value: float, unit: str, digits: int = 3) -> str:
    """Write an amount with its unit, in thousandths of it where it is small.

    Examples
    --------
    >>> quantity(5.77e-05, "N m"), quantity(0.0652, "N m"), quantity(0.0123, "N m", 2)
    ('0.0577 mN m', '0.0652 N m', '0.012 N m')
    """
    scale, unit = _prefixed(abs(value), unit)
    return f"{number(scale * value, digits)} {unit}"


def digits_beside(size: float, half: float) -> int:
    """Return the significant digits of a size that stands beside half its interval, of
    which two are shown: the last digits of both stand at one place; four at most.

    Examples
    --------
    >>> digits_beside(3.1234, 0.49), digits_beside(1.745, 2.4)
    (3, 2)
    """
    if not (size and half > 0.0 and math.isfinite(half)):
        return 4
    places = math.floor(math.log10(abs(size))) - math.floor(math.log10(half))
    return min(max(places + 2, 1), 4)


def amount_or_open(size: float, half: float, unit: str) -> str:
    """Write a size with half its 95 % interval; where the interval holds zero, or is not
    a number, the size is open.

    Examples
    --------
    >>> amount_or_open(3.1234, 0.49, "N m"), amount_or_open(0.324, 0.709, "kg")
    ('3.12 ± 0.49 N m', 'size open')
    """
    if not abs(size) > half:
        return "size open"
    return amount(size, half, unit, digits_beside(size, half))


def times_noise(ratio: float, error: float, unit: str) -> str:
    """Write an error [unit] as a multiple of its noise, and in its unit.

    Examples
    --------
    >>> times_noise(15.61, 0.0652, "N m")
    '0.0652 N m, 15.6 times its noise'
    """
    return f"{quantity(error, unit)}, {number(ratio)} times its noise"


def within_noise(ratio: float, joint: int, error: float, unit: str, kind: str) -> str:
    """Say by what multiple of its noise the worst joint (from 1) errs, and by how much
    [unit]; another joint may err by more in its unit. kind : of the error, or "".

    Examples
    --------
    >>> within_noise(1.18, 6, 0.00651, "N m", "")
    'no joint errs by more than 1.18 times its noise (joint 6: 0.00651 N m)'
    >>> within_noise(1.0, 2, 0.02, "N m", "")
    'no joint errs by more than its noise (joint 2: 0.02 N m)'
    >>> within_noise(0.95, 3, 0.00922, "N m", "")
    'the error cannot be told from the noise (joint 3: 0.00922 N m)'
    """
    of_kind = f", {kind}" if kind else ""
    size = f"(joint {joint}: {quantity(error, unit)}{of_kind})"
    if ratio < 1.0:
        return f"the error cannot be told from the noise {size}"
    times = "" if number(ratio) == "1" else f"{number(ratio)} times "
    return f"no joint errs by more than {times}its noise {size}"


def amounts(values: Sequence[float], unit: str, between: str = " → ") -> str:
    """Write amounts of one quantity, in thousandths of its unit where all are small.

    Examples
    --------
    >>> amounts([0.000109, 9.4e-05], "N m"), amounts([1.2, 0.8], "N m")
    ('0.109 → 0.094 mN m', '1.2 → 0.8 N m')
    """
    scale, unit = _prefixed(max(values), unit)
    return f"{between.join(number(scale * value) for value in values)} {unit}"


def errors_with_noise(
    errors: Sequence[float], ratios: Sequence[float] | None, unit: str, between: str
) -> str:
    """Write one joint's errors, and the same in multiples of its noise.

    Parameters
    ----------
    errors : sequence of float
        Errors in the order of the models [unit].
    ratios : sequence of float or None
        The same over the joint's noise floor; None where that is not known.
    between : str
        What stands between two errors.

    Examples
    --------
    >>> errors_with_noise([0.0654, 0.00418], [15.61, 0.998], "N m", " to ")
    '0.0654 to 0.00418 N m, 15.6 to 0.998 times the noise'
    """
    amount = amounts(errors, unit, between)
    if ratios is None:
        return amount
    return f"{amount}, {between.join(map(number, ratios))} times the noise"


def milli(value: float, unit: str, digits: int = 3) -> str:
    """Write a quantity in thousandths of its unit.

    Examples
    --------
    >>> milli(0.0123, "rad"), milli(0.004, "s", 2)
    ('12.3 mrad', '4 ms')
    """
    return f"{number(1e3 * value, digits)} m{unit}"


def percent(share: float, digits: int = 3) -> str:
    """Write a share (1 is all) in per cent.

    Examples
    --------
    >>> percent(0.1234)
    '12.3 %'
    """
    return f"{number(100.0 * share, digits)} %"


#: Files of --plugin, which every command needs that this process writes.
_PLUGIN_FILES: list[str] = []


@contextmanager
def naming_plugins(files: Sequence[str | Path]) -> Iterator[None]:
    """Name files of plug-ins in every command that this process writes meanwhile."""
    before = list(_PLUGIN_FILES)
    _PLUGIN_FILES[:] = map(str, files)
    try:
        yield
    finally:
        _PLUGIN_FILES[:] = before


def command(*words: object) -> str:
    """Return a command of this program as one line that can be pasted into a shell, with
    the plug-ins of this process (:func:`naming_plugins`).

    >>> command("convert", "my run.csv", "--rate", 200)
    "sdp-vs-penalty convert 'my run.csv' --rate 200"
    """
    plugins = ["--plugin", *_PLUGIN_FILES] if _PLUGIN_FILES else []
    return command_line(["sdp-vs-penalty", *words, *plugins])


def given_options(options: Mapping[str, object]) -> list[str]:
    """Return the options of a command that were given, neither None nor "", with their
    values as words.

    >>> given_options({"--hold": None, "--gravity": "-9.8,0,0", "--topic": "/joints"})
    ['--gravity=-9.8,0,0', '--topic', '/joints']
    """
    out = []
    for name, value in options.items():
        if value is not None and (text := str(value)):
            # A value that begins with a minus would be read as an option.
            out += [f"{name}={text}"] if text.startswith("-") else [name, text]
    return out


def convert_command(path: object, *words: object) -> str:
    """Return the ``convert`` command for a file, quoted for a shell.

    Returns
    -------
    str
        A command that writes a new file in the current folder.
    """
    out = "run.csv" if Path(str(path)).name != "run.csv" else "run_converted.csv"
    return command("convert", path, *words, "--out", out)


def scope_of_errors(band: float, still: float) -> str:
    """Say which errors are meant: those below a frequency, in motion.

    Parameters
    ----------
    band : float
        The low-pass that measured and modelled torque passed [Hz].
    still : float
        How long the arm stood still [s]; these rows are left out.

    Returns
    -------
    str
        Such as "below 8 Hz, 3.2 s of standstill left out".

    Examples
    --------
    >>> scope_of_errors(8.0, 0.0)
    'below 8 Hz'
    """
    return ", ".join(filter(None, (f"below {number(band)} Hz", left_out_still(still))))


def left_out_still(still: float) -> str:
    """Say that errors leave out how long the arm stood still [s]; "" for none."""
    return f"{number(still, 2)} s of standstill left out" if still else ""


def count(n: int, noun: str) -> str:
    """Write a number with its noun: "1 problem", "2 problems"."""
    return f"{n} {noun}{'' if n == 1 else 's'}"


def times(n: int) -> str:
    """Say how often something happens: "once", "2 times"."""
    return "once" if n == 1 else f"{n} times"


def change_of(before: float, after: float) -> str:
    """Write the relative change of an error in per cent, with its sign.

    Parameters
    ----------
    before, after : float
        The two errors, in the same unit.

    Returns
    -------
    str
        "0 %" below half a per cent; "-" if there was no error before.
    """
    if before <= 0.0:
        return "-"
    change = 100.0 * (after / before - 1.0)
    return f"{change:+.0f} %" if abs(change) >= 0.5 else "0 %"
