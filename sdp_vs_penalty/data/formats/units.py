"""Units that the names of columns end with, or that ``--units`` asks for."""

import math
import re
from dataclasses import dataclass
from functools import cache

_DEGREE = math.pi / 180.0

#: Units that can be asked for, by what a value has to be multiplied by.
UNITS: dict[str, float] = {
    "ns": 1e-9,
    "100ns": 1e-7,
    "us": 1e-6,
    "ms": 1e-3,
    "s": 1.0,
    "min": 60.0,
    "h": 3600.0,
    "day": 86_400.0,
    "deg": _DEGREE,
    "degrees": _DEGREE,
    "degree": _DEGREE,
    "rad": 1.0,
    "radian": 1.0,
    "radians": 1.0,
    "rpm": math.pi / 30.0,
    "nm": 1.0,
    "mnm": 1e-3,
    "ncm": 1e-2,
    "kgfm": 9.80665,
    "lbfft": 1.3558179,
    "lbfin": 0.1129848,
    "a": 1.0,
    "ma": 1e-3,
    "mm": 1e-3,
}

#: Words for radians and degrees.
_RADIANS = (
    *(
        "rad",
        "radian",
        "radians",
        "radianes",
        "radianti",
        "radianos",
        "radialen",
        "radianer",
    ),
    *("bogenmaß", "radiany", "рад", "弧度", "ラジアン", "라디안"),
)
_DEGREES = (
    *(
        "deg",
        "degs",
        "degree",
        "degrees",
        "°",
        "º",
        "grad",
        "degré",
        "degrés",
        "degre",
        "degres",
    ),
    *(
        "grado",
        "grados",
        "gradi",
        "grau",
        "graus",
        "graden",
        "grader",
        "stopnie",
        "derece",
    ),
    *("град", "度", "도"),
)
_LENGTHS = {
    **dict.fromkeys(_RADIANS, 1.0),
    "mrad": 1e-3,
    **dict.fromkeys(_DEGREES, _DEGREE),
    "rev": math.tau,
    "turns": math.tau,
    "m": 1.0,
    "mm": 1e-3,
    "cm": 1e-2,
}
_SECONDS = (
    *(
        "s",
        "sec",
        "secs",
        "seconds",
        "sek",
        "sekunden",
        "secondes",
        "segundos",
        "secondi",
    ),
    *("с", "сек", "秒", "초"),  # noqa: RUF001 (the first is Cyrillic)
)
_PER_SECOND = ("{}/s", "{}/sec", "{}_s", "{} s", "{}_per_s", "{}_per_sec", "{}*s^-1")

#: Units of torque by force and length, and what stands between the two.
_TORQUES = {
    ("n", "m"): 1.0,
    ("mn", "m"): 1e-3,
    ("kn", "m"): 1e3,
    ("n", "cm"): 1e-2,
    ("n", "mm"): 1e-3,
    ("kgf", "m"): 9.80665,
    ("kgf", "cm"): 0.0980665,
    ("kg", "cm"): 0.0980665,
    ("lbf", "ft"): 1.3558179,
    ("lbf", "in"): 0.1129848,
    ("ozf", "in"): 0.007061552,
    ("oz", "in"): 0.007061552,
}
_BETWEEN = ("", " ", "_", ".", "*", "·", "-")

#: Positions in per cent of a joint's range go a little beyond its ends.
LARGEST_PERCENT = 101.0
#: Units that are shares of a rating.
SHARES = ("%", "percent", "pct", "permil", "permille", "promille", "‰")

#: What names end with, by quantity.
UNITS_IN_NAMES: dict[str, dict[str, float]] = {
    "t": {
        "ns": 1e-9,
        "nsec": 1e-9,
        "nanosec": 1e-9,
        "nanoseconds": 1e-9,
        "us": 1e-6,
        "µs": 1e-6,
        "usec": 1e-6,
        "microseconds": 1e-6,
        "ms": 1e-3,
        "msec": 1e-3,
        "millisec": 1e-3,
        "milliseconds": 1e-3,
        **dict.fromkeys(_SECONDS, 1.0),
        **dict.fromkeys(("мс", "毫秒", "ミリ秒"), 1e-3),
        **dict.fromkeys(("min", "mins", "minutes", "minuten", "分", "мин"), 60.0),
        **dict.fromkeys(("h", "hr", "hours", "stunden"), 3600.0),
        "day": 86_400.0,
        "days": 86_400.0,
    },
    "q": _LENGTHS,
    "dq": {
        **_LENGTHS,
        **{
            pattern.format(unit): factor
            for unit, factor in _LENGTHS.items()
            for pattern in _PER_SECOND
        },
        "rads": 1.0,
        "degs": _DEGREE,
        "dps": _DEGREE,
        "rpm": math.pi / 30.0,
    },
    "tau": {
        **{
            f"{force}{sign}{length}": factor
            for (force, length), factor in _TORQUES.items()
            for sign in _BETWEEN
        },
        **{f"н{sign}м": 1.0 for sign in _BETWEEN},
        **dict.fromkeys(("牛米", "牛·米", "牛顿米"), 1.0),
        "n": 1.0,
        "a": 1.0,
        "amps": 1.0,
        "ma": 1e-3,
        **dict.fromkeys(SHARES, 1.0),
    },
    "temp": {"c": 1.0, "°c": 1.0, "degc": 1.0, "celsius": 1.0},
}
UNITS_IN_NAMES["qcmd"] = UNITS_IN_NAMES["q"]

#: Units of one quantity alone: by them a column that is called by its joint is known.
TELLING_UNITS: dict[str, frozenset[str]] = {
    "q": frozenset(_LENGTHS) - {"m", "mm", "cm"},
    "dq": frozenset(UNITS_IN_NAMES["dq"]) - frozenset(_LENGTHS),
    "tau": frozenset(UNITS_IN_NAMES["tau"]) - {"n", *SHARES},
}


def unit_of_factor(factor: float, quantity: str) -> str | None:
    """Find the unit whose conversion to SI is a given factor.

    Parameters
    ----------
    factor : float
        Factor to SI, such as 0.001.
    quantity : str
        "t", "q", "dq", "tau" ...: of several units with the factor, one of this
        quantity is preferred ("ms" or "mnm").

    Returns
    -------
    str or None
        A unit of UNITS; None where no unit has this factor.
    """
    units = [unit for unit, value in UNITS.items() if value == factor]
    units_of_quantity = UNITS_IN_NAMES.get(quantity, ())
    preferred = [unit for unit in units if unit in units_of_quantity]
    return next(iter([*preferred, *units]), None)


@dataclass(frozen=True)
class NamedUnit:
    """A unit at the end of a column's name."""

    #: Quantity that has this unit.
    quantity: str
    #: The unit as the table of units writes it.
    text: str
    #: Factor to SI.
    factor: float
    #: The column's name without the unit.
    remainder: str


def units_of_name(name: str) -> list[NamedUnit]:
    """List the units with which a column's name can end, the longest first.

    A joint's number may follow the unit: "pos_deg_3".

    Returns
    -------
    list[NamedUnit]
        Empty where it ends with no unit.
    """
    text = name.strip()
    folded = text.casefold()
    candidates = list[NamedUnit]()
    for quantity, units in UNITS_IN_NAMES.items():
        for unit, factor in units.items():
            if unit.casefold() not in folded:
                continue  # two hundred patterns take longer to compile than to read a run
            match = _pattern(unit).search(text)
            if match is not None:
                remainder = f"{text[: match.start()]} {match['number']}"
                candidates.append(NamedUnit(quantity, unit, factor, remainder))
    return sorted(candidates, key=lambda unit: len(unit.text), reverse=True)


@cache
def _pattern(unit: str) -> re.Pattern[str]:
    """Compile the pattern of a unit at the end of a name, where a number may follow.

    The unit stands behind a mark or blank ("pos_deg"), or begins with a capital letter
    ("posDeg"). It is no part of a longer word.
    """
    behind_a_mark = r"(?<![^\W\d_])(?<![°/·*])"  # and not behind a letter of any script
    at_a_capital = r"(?<=[a-z])(?=[A-Z][a-z]{2})"
    number_and_marks = r"[\W_]*(?P<number>[0-9]*)[\W_]*$"
    begin = f"(?:{behind_a_mark}|{at_a_capital})"
    return re.compile(f"{begin}(?i:{re.escape(unit)}){number_and_marks}")
