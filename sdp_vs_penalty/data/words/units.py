"""Units that the names of columns end with, or that ``--units`` asks for."""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache, lru_cache
from itertools import product

from sdp_vs_penalty.data.words import table

#: Positions in per cent of a joint's range go a little beyond its ends.
LARGEST_PERCENT = 101.0
#: Encoders count two to the power of so many a turn.
ENCODER_BITS = range(10, 21)
#: Units of positions of prismatic joints.
LENGTHS = {"m", "mm", "cm", "in", "inch", "inches"}
#: Units whose size a file does not say: shares of a rating with their size, and steps of an
#: encoder (0).
SHARES: dict[str, float] = {
    x: size for text, size in table()["shares"].items() for x in text.split()
}
_PER_SECOND = ("{}/s", "{}/sec", "{}_s", "{} s", "{}_per_s", "{}_per_sec", "{}*s^-1")
_BETWEEN = ("", " ", "_", ".", "*", "·", "-")


def _torques() -> Iterator[tuple[list[tuple[str, str]], float]]:
    """Yield the spellings of each unit of torque, two words each, with the factor to SI."""
    for system, parts in table()["torques"].items():
        for force, length in product(parts["forces"], parts["lengths"]):
            pairs = [*product(force.split(), length.split())]
            if system == "imperial":
                pairs += [(b, a) for a, b in pairs]
            yield pairs, parts["forces"][force] * parts["lengths"][length]


#: Units that can be asked for, by what a value has to be multiplied by.
UNITS: dict[str, float] = {
    **{"".join(pairs[0]): factor for pairs, factor in _torques()},
    **table()["asked"],
}


@cache
def units_in_names() -> dict[str, dict[str, float]]:
    """Return the factors to SI of the units that names end with, by quantity."""
    units = {
        quantity: {x: factor for text, factor in row.items() for x in text.split()}
        for quantity, row in table()["units"].items()
    }
    units["dq"] |= units["q"]
    for unit, factor in units["q"].items():
        units["dq"] |= dict.fromkeys((x.format(unit) for x in _PER_SECOND), factor)
    for pairs, factor in _torques():
        texts = (x.join(pair) for pair in pairs for x in _BETWEEN)
        units["tau"] |= dict.fromkeys(texts, factor)
    return {**units, "qcmd": units["q"]}


@cache
def telling_units(quantity: str) -> frozenset[str]:
    """Return the units of one quantity alone: by them a column that is called by its
    joint is known, "J1 [deg]". A length in "m" can be anything."""
    units = units_in_names()
    others = {"q": LENGTHS, "dq": {*units["q"]}, "tau": {"n", *SHARES}}
    return frozenset(units[quantity]) - others.get(quantity, {*units[quantity]})


def unit_of_factor(factor: float, quantity: str, said: str = "") -> str | None:
    """Return the unit of a quantity ("t", "q", "tau" ...) in UNITS with this factor to SI,
    one of those that are ``said`` of it, "deg/s and mm/s", before others; None where none
    has it."""
    known = units_in_names().get(quantity, ())
    units = [x for x, value in UNITS.items() if value == factor and x in known]
    words = re.split("[^a-z]+", said.lower())
    return min(units, key=lambda unit: unit not in words, default=None)


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


#: What stands in brackets at the end of a name.
_AT_THE_END = re.compile(r"[\[(][^\[\]()]*[\])]$")


@lru_cache(maxsize=1 << 14)
def units_of_name(name: str) -> list[NamedUnit]:
    """List the units with which a column's name can end, the longest first; a joint's
    number may follow the unit, "pos_deg_3"."""
    # Blanks within brackets at the end are none of a unit: "[per mil]", "[deg / s]".
    without_blanks = _AT_THE_END.sub(lambda x: x[0].replace(" ", ""), name.strip())
    text = _with_unit_in_brackets(without_blanks)
    folded = text.casefold()
    candidates = list[NamedUnit]()
    for small, unit, quantity, factor in _units_in_small_letters():
        if len(small) == 1 and quantity == "tau" and text.replace("_", "").isalpha():
            continue  # trq_a is the torque of joint a
        if small not in folded:
            continue  # two thousand patterns take longer to compile than to read a run
        match = _pattern(unit).search(text)
        if match is not None:
            remainder = f"{text[: match.start()]} {match['number']}"
            candidates.append(NamedUnit(quantity, unit, factor, remainder))
    return sorted(candidates, key=lambda unit: len(unit.text), reverse=True)


#: Units of one letter, as SI writes them.
_LETTERS = frozenset("smhNA")


def _with_unit_in_brackets(name: str) -> str:
    """Return "M_3 [N]" for "M_3/N", a quantity over its unit; other names, "deg/s" among
    them, as they are."""
    before, _, after = (x.strip() for x in name.partition("/"))
    unit = after.strip("() ")
    units = {small for small, *_ in _units_in_small_letters()} - {"in"}
    is_unit = unit.casefold() in units and (len(unit) > 1 or unit in _LETTERS)
    words = re.findall(r"[^\W_]+", before)
    is_named = bool(words) and words[-1].casefold() not in units
    return f"{before} [{unit}]" if is_unit and is_named else name


@cache
def _units_in_small_letters() -> list[tuple[str, str, str, float]]:
    """List the units that names end with: each in small letters, as the table writes
    it, its quantity, and its factor to SI."""
    return [
        (unit.casefold(), unit, quantity, factor)
        for quantity, units in units_in_names().items()
        for unit, factor in units.items()
    ]


@cache
def _pattern(unit: str) -> re.Pattern[str]:
    """Compile the pattern of a unit at the end of a name, where a number may follow.

    The unit stands behind a mark or blank ("pos_deg"), or begins with a capital letter
    ("posDeg"). It is no part of a longer word, and a single letter before a number, "A1",
    names a joint.
    """
    behind_a_mark = r"(?<![^\W\d_])(?<![°/·*])"  # and not behind a letter of any script
    at_a_capital = r"(?<=[a-z])(?=[A-Z][a-z]{2})"
    of_joint = r"(?:[\W_]+(?i:j|joint|axis|achse)(?=[\W_]*[0-9]))?"  # "PCT_J1"
    number_and_marks = rf"{of_joint}[\W_]*(?P<number>[0-9]*)[\W_]*$"
    number_and_marks = "(?![0-9])" * (len(unit) == 1) + number_and_marks
    begin = f"(?:{behind_a_mark}|{at_a_capital})"
    if unit in ("in", "in s"):  # a word where no bracket says a unit
        begin = r"(?<=[\[(])"
    return re.compile(f"{begin}(?i:{re.escape(unit)}){number_and_marks}")
