"""What the name of a column says: a quantity, a joint or its number, a unit."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import zip_longest

import numpy as np

from sdp_vs_penalty.data.words import table
from sdp_vs_penalty.data.words.tokens import split_tokens
from sdp_vs_penalty.data.words.units import (
    SHARES,
    NamedUnit,
    telling_units,
    units_in_names,
    units_of_name,
)

#: The words of each quantity, the best first.
WORDS: dict[str, list[str]] = table()["quantities"]
#: Words that say nothing about a quantity.
_FILLERS = frozenset(table()["fillers"])
#: Those of them that say "joint".
_JOINTS = frozenset(table()["joints"])
#: Words of a clock if a unit of time follows, else of a counter.
_COUNTERS = frozenset(table()["counters"])
#: Words of columns that were not measured.
_OTHERS = frozenset(table()["others"])
#: Those of them that say what was commanded.
_COMMANDS = frozenset(table()["commands"])
#: Words of what is only a part of a torque.
_PARTS = frozenset(table()["parts"])
#: Words for a run, and for its number.
_RUNS, _INDICES = frozenset(table()["runs"]), frozenset(table()["indices"])
#: Units of time that alone may mean anything else, such as a length or a minimum.
_OTHER_SYMBOLS = ("s", "min", "mins", "h", "day")
#: Units by which a torque is a current.
AMPERES: list[str] = table()["amperes"]
#: Letters of each quantity.
INITIALS: dict[str, str] = table()["initials"]
#: Two words that mean one.
_COMPOUNDS = {tuple(text.split()): word for text, word in table()["compounds"].items()}


@dataclass(frozen=True)
class Meaning:
    """What the name of a column says."""

    #: Quantity: "t", "q", "dq", "tau", "temp" or "qcmd".
    quantity: str
    #: Place of the name's word in the list of the quantity's words, 0 for the best.
    rank: int
    #: The last number in the name; None without.
    number: int | None = None
    #: Further words in the name, such as "left".
    other_words: tuple[str, ...] = ()
    #: The unit at the end of the name, "" without.
    unit: str = ""
    #: Factor to SI.
    factor: float = 1.0
    #: The words that say the quantity.
    words: tuple[str, ...] = ()


def is_no_measurement(name: str) -> bool:
    """Return whether a column holds something that was not measured, such as a target,
    a limit or an error."""
    return not _OTHERS.isdisjoint(split_tokens(name))


def is_part_of_torque(name: str) -> bool:
    """Return whether a column is by its name a part of a joint's torque, such as what is
    external."""
    return not _PARTS.isdisjoint(split_tokens(name))


def is_word_for_joint(words: Sequence[str]) -> bool:
    """Return whether words mean a joint: "joint", "arm axis"."""
    return not _JOINTS.isdisjoint(words) and _FILLERS.issuperset(words)


def counts_runs(name: str) -> bool:
    """Return whether a name means a run among several: "demo_3", "trial index"."""
    words = {x for x in split_tokens(name) if x.isalpha()}
    return bool(words & _RUNS) and words <= _RUNS | _INDICES


def read_name(name: str) -> Meaning | None:
    """Read quantity, joint and unit off a column's name; None where it says no quantity,
    or one that was not measured.

    A unit at the name's end is split off first; it counts where it is a unit of the
    quantity that the remaining words say.
    """
    if match := _SHARE_OF.search(name):  # "torque_2 [% of 60 Nm]"
        said = _read_words(split_tokens(name[: match.start()]))
        rated = unit_of(match[3], "tau")
        if said is not None and said.quantity == "tau" and rated is not None:
            factor = SHARES[match[1].lower()] * float(match[2]) * rated[1]
            return replace(said, unit=match[0], factor=factor)
    for unit in units_of_name(name):
        said = _read_words(split_tokens(unit.remainder))
        if said is not None and said.quantity == unit.quantity:
            return replace(said, unit=unit.text, factor=unit.factor)
        by_unit = _read_by_unit(unit)
        if by_unit is not None:
            return by_unit
    return _read_words(split_tokens(name))


#: A share of a torque that the unit says, "% of 60 Nm".
_SHARE_OF = re.compile(
    r"(?i)(%|percent|pct|permil|permille|promille|‰)[ _](?:of|von)[ _]"
    r"([0-9]*\.?[0-9]+) ?([^\W\d][\w·*]*)"
)


def quantity_of(name: str) -> str | None:
    """Return the quantity that a name says; None where it says none."""
    said = read_name(name)
    return None if said is None else said.quantity


def rate_of_heading(lines: Sequence[str]) -> float | None:
    """Read the sampling rate [Hz] off the lines above a table, "# sample rate: 250 Hz",
    "dt = 4 ms", "sample time,0.004" or "logged at 50 Hz"; None where they say none, or several.

    A number without a unit is in Hz behind a word for a rate, else in s.
    """
    rates = set[float]()
    for match in filter(None, map(_sampling().search, lines)):
        if match["at"] and not match["unit"]:
            continue  # "logged at 12" is no rate
        size, unit = float(match["size"]), match["unit"] or match["unit_before"] or ""
        is_rate = (match["rate"] or match["rate_alone"]) is not None
        if unit.lower().endswith("hz") or (is_rate and not unit):
            rates.add(size * (1e3 if unit[:1] in ("k", "K") else 1.0))
        elif size > 0.0 and (factor := units_in_names()["t"].get(unit or "s")):
            rates.add(float(f"{1.0 / (factor * size):.12g}"))
    rates = {x for x in rates if x >= 1.0}  # else it is how long was recorded
    return rates.pop() if len(rates) == 1 else None


@cache
def _sampling() -> re.Pattern[str]:
    """Compile the pattern of a word for sampling, its number, and its unit on either side."""
    texts = {x: "|".join(words) for x, words in table()["sampling"].items()}
    before, rate, step, rate_alone, at, step_alone = texts.values()
    unit = "k?hz|s|sec|ms|us"
    return re.compile(
        rf"(?i)(?:(?<![^\W_])(?:{before})[ _-]*(?:(?P<rate>{rate})|{step}|(?P<at>{at}))"
        rf"|^\W*(?:(?P<rate_alone>{rate_alone})|{step_alone}))"
        rf"(?:[\s_]*[\[(_](?P<unit_before>{unit})\b[\])]?)?\s*(?:[:=,;\t]|is|of)?\s*"
        rf"(?P<size>[0-9]*\.?[0-9]+(?:e-?[0-9]+)?)\s*(?P<unit>{unit})?(?![\w.:/-])"
    )


def units_of_heading(lines: Sequence[str]) -> dict[str, tuple[str, float]]:
    """Read units off the lines above a table, by quantity, each with its factor to SI:
    "time in s, positions in mdeg", "torque [mNm]", "units: time s, position deg", or
    "units: s deg deg/s Nm" in the order of the quantities. The factor of several units,
    "position mm, deg", is NaN: the joints' kinds tell which is whose."""
    found = dict[str, tuple[str, float]]()
    for line in lines:
        if match := _COUNTS_A_TURN.search(line):
            found["q"] = match[2], 2.0 * np.pi / int(match[1])
        if match := _PER_COUNT.search(line):
            quantity = _quantity(split_tokens(line[: match.start()])) or ""
            if unit := unit_of(match[2], quantity):
                found[quantity] = unit[0], float(match[1]) * unit[1]
        for match in _IN_UNIT.finditer(line):
            word, text = match.groups()
            quantity = _quantity(split_tokens(word)) or ""
            if unit := unit_of(text.replace(" ", ""), quantity):
                found.setdefault(quantity, unit)
        listed = _LIST_OF_UNITS.search(line)
        texts = re.split(r"[\s,;:=]+", listed[1].strip()) if listed else []
        quantity, listed_units = "", dict[str, list[tuple[str, float]]]()
        for text in texts:  # "time s, position mm, deg"
            if unit := unit_of(text, quantity):
                listed_units.setdefault(quantity, []).append(unit)
            else:
                quantity = _quantity(split_tokens(text)) or ""
        for quantity, units in listed_units.items():
            factors = {factor for _, factor in units}
            text = " and ".join(text for text, _ in units)
            factor = factors.pop() if len(factors) == 1 else np.nan
            found[quantity] = text, factor
        for quantity in ("t", "q", "dq", "tau"):
            while texts and quantity not in found:
                if unit := unit_of(texts[0], quantity):
                    found[quantity] = unit
                    texts = texts[1:]
                elif quantity == "dq":
                    break  # a list may leave out velocities
                else:
                    texts = []
    return found


def facts_of_heading(
    lines: Sequence[str], n: int
) -> dict[str, tuple[list[float], str]]:
    """Read numbers of n joints off the lines above a table, by what they are, each with
    its line.

    They are "rated" torques [N m], a torque "constant" [N m/A], a gear's "ratio", or an
    encoder's counts at "zero", as in "torque constants [Nm/A]: 0.12, 0.11", "gear ratios =
    [101:1, 120:1]" or "encoder: 4096 counts per revolution, zero at 2048". A line gives n
    numbers, or one for all joints.
    """
    found = dict[str, tuple[list[float], str]]()
    for line in lines:
        without_counts_a_turn = _COUNTS_A_TURN.sub(" ", line)
        line_of_facts = _AT_ZERO.sub(r" zero \1 ", without_counts_a_turn)
        kinds = [*_facts().finditer(line_of_facts)]
        for kind, next_kind in zip_longest(kinds, kinds[1:]):
            end = next_kind.start() if next_kind else None
            numbers = _numbers_alone(line_of_facts[kind.end() : end])
            if len(numbers) in (1, n):
                found[kind.lastgroup or ""] = numbers * (n // len(numbers)), line
    return found


def _numbers_alone(text: str) -> list[float]:
    """Read the numbers in a text, torques in N m; none where other words than a unit and
    such as "of the joints" stand beside them."""
    if ";" in text:  # the commas are decimal
        text = re.sub(r"(?<=\d),(?=\d)", ".", text)
    units = (unit_of(x, "tau") for x in re.findall(r"[^\W\d_]+", text))
    factor = next((unit[1] for unit in units if unit), 1.0)
    for pattern in (_REMARK, _NAME_OF_JOINT, _ONE_OF_RATIO, *_words_beside_facts()):
        text = pattern.sub(" ", text)
    words = re.sub(r"[][()=:,;|{}]|(?<!\d)\.(?!\d)", " ", text).split()
    are_numbers = all(map(_POSITIVE.fullmatch, words))
    return [factor * float(x) for x in words] if are_numbers else []


#: A remark in brackets: "[Nm/A]", "(of the motors)".
_REMARK = re.compile(r"[\[(][^\[\]()]*[^\W\d][^\[\]()]*[\])]")
#: The name of a joint before its number: "shoulder =", "A1".
_NAME_OF_JOINT = re.compile(r"[^\W\d]\w*\s*=|(?<![\w.])[^\W\d]+[0-9]+")
#: The 1 of a ratio: "101:1", "1:101".
_ONE_OF_RATIO = re.compile(r"(?<=\d):1(?![\d.])|(?<![\d.])1:(?=\d)")


@cache
def _words_beside_facts() -> list[re.Pattern[str]]:
    """Compile the patterns of words that may stand beside numbers a joint."""
    words = table()["facts"]["beside"]
    return [re.compile(rf"(?i)(?<![^\W\d]){x}(?![^\W\d])") for x in words]


#: A number above zero.
_POSITIVE = re.compile(r"(?=.*[1-9])[0-9]*\.?[0-9]+(?:e-?[0-9]+)?")


@cache
def _facts() -> re.Pattern[str]:
    """Compile the pattern of the words for numbers a joint."""
    words = table()["facts"]
    kinds = (f"(?P<{x}>{'|'.join(words[x])})" for x in words if x != "beside")
    return re.compile(rf"(?i)(?<![^\W_])(?:{'|'.join(kinds)})(?![^\W_])")


#: A word and its unit: "positions in deg", "torque [Nm]", "load: 0.1 % of stall torque".
#: A unit of numbers that follow is left out: "rated torque [Nm]: 60, 110".
_IN_UNIT = re.compile(
    r"(\w+)(?:\s+in\s+|\s*[\[(:=]\s*)(0\.1 ?%|[^\s,;\])]++)(?!\s*[\])]?\s*[:=]?\s*[-\d])"
)
#: The counts of an encoder in a turn: "4096 counts per revolution".
_COUNTS_A_TURN = re.compile(
    r"(?i)\b([0-9]{3,9})\s*(inc|increments|counts|ticks|pulses?|qc)"
    r"\s*(?:/|per|a)\s*(?:joint\s+)?(?:turn|rev)\w*"
)
#: The size of a count, "2.69 mA per unit".
_PER_COUNT = re.compile(
    r"(?i)(?<![\w.])([0-9]*\.?[0-9]+(?:e-?[0-9]+)?)\s*([^\W\d][\w·*/]*?)\s*(?:/|\bper)"
    r"\s*(?:unit|count|tick|lsb|bit|digit|step|inc)\w*"
)
#: A reading at zero, "8192 = 0 deg".
_AT_ZERO = re.compile(
    r"(?i)\b([0-9]+)\s*(?:inc|counts|ticks|pulses?)?\s*(?:=|is|at)\s*0(?:\.0*)?\s*(?:deg|rad|°)"
)
#: Units in a list: "units: s deg deg/s Nm".
_LIST_OF_UNITS = re.compile(r"(?i)\b(?:units?|einheiten|unités|unidades)\s*[:=]\s*(.+)")


def unit_of(text: str, quantity: str) -> tuple[str, float] | None:
    """Return a unit of a quantity as the table of units writes it, with its factor."""
    units = units_in_names().get(quantity, {})
    known = {unit.casefold(): (unit, factor) for unit, factor in units.items()}
    return known.get(text.casefold())


def read_letter(name: str) -> Meaning | None:
    """Read a name that is a letter of torques and a number, "u_1", as a torque that ranks
    behind all names with a word; None for other names."""
    letters, tokens = INITIALS["tau"].split(), split_tokens(name)
    numbers = [x for x in tokens if x.isdigit()]
    words = [x for x in tokens if x in letters or x not in (*numbers, *_FILLERS)]
    if len(words) != 1 or words[0] not in letters or len(numbers) != 1:
        return None
    return Meaning("tau", len(WORDS["tau"]) + 1, number=int(numbers[0]))


def read_commanded(name: str, quantity: str) -> Meaning | None:
    """Read a name that says a quantity ("q", "tau") and that it was commanded: a position,
    "goal_position_2", as a command, a torque, "TorqueReference_2", as a torque; None for
    other names."""
    tokens = split_tokens(name)
    said = read_name("_".join(x for x in tokens if x not in _COMMANDS))
    if said is None or said.quantity != quantity or _COMMANDS.isdisjoint(tokens):
        return None
    return replace(said, quantity="qcmd" if quantity == "q" else quantity)


def _read_by_unit(unit: NamedUnit) -> Meaning | None:
    """Read a name in which only the unit says the quantity; None for other names.

    Such names are a joint, or the letter of a quantity, and a unit that says enough,
    "J1 [deg]", "elbow [Nm]" and "M1 [Nm]", or a counter and a unit of time, "Tick (ms)".
    They rank behind all names with a word of the quantity.
    """
    tokens = split_tokens(unit.remainder)
    words = {token for token in tokens if token.isalpha()}
    numbers = [token for token in tokens if token.isdigit()]
    if unit.quantity == "t":
        is_read = bool(words & _COUNTERS) and not numbers
    else:
        is_read = bool(words) and unit.text in telling_units(unit.quantity)
        # A letter of the quantity and a number: "x1 [m]" beside "x2 [deg]".
        is_symbol = bool(numbers) and words <= {
            *INITIALS.get(unit.quantity, "").split()
        }
        is_read |= bool(words) and is_symbol and unit.text not in SHARES
        # A letter alone names a joint, or is a symbol; no clock is in this unit.
        is_letter = all(len(x) == 1 for x in words)
        is_read &= is_letter or _quantity([*(words - {"t"})]) is None
    if not is_read or words & _OTHERS:
        return None
    letters = {*INITIALS.get(unit.quantity, "").split()} if numbers else set()
    others = [x for x in _words_beside_fillers(tokens) if x not in letters]
    return Meaning(
        unit.quantity,
        rank=len(WORDS[unit.quantity]),
        number=int(numbers[-1]) if numbers else None,
        other_words=(*others, *numbers[:-1]),
        unit=unit.text,
        factor=unit.factor,
        words=("current",) if unit.text in AMPERES else (),
    )


def read_time_by_unit(name: str) -> Meaning | None:
    """Read a name of unknown words that ends with a unit of time, "run_minutes", as a
    clock; None for names with numbers, or with a word for what was not measured.

    Durations end with such units too ("delay_ms"): the caller has to check that the values
    rise, as those of a clock do.
    """
    for unit in units_of_name(name):
        tokens = split_tokens(unit.remainder)
        is_clock = bool(tokens) or unit.text not in _OTHER_SYMBOLS
        is_clock = (
            is_clock and unit.quantity == "t" and not any(map(str.isdigit, tokens))
        )
        # "q_min" is a limit of positions, "error_min" an error.
        if is_clock and _quantity(tokens) in (None, "t") and _OTHERS.isdisjoint(tokens):
            rank = len(WORDS["t"]) + 1
            return Meaning("t", rank, None, tuple(tokens), unit.text, unit.factor)
    return None


def read_bare_joint(name: str) -> Meaning | None:
    """Read a name that says nothing but a joint's number, "j1" or "AxisAct_A1", as a
    position that ranks behind all names with a word; None for other names."""
    tokens = _join_compounds(split_tokens(name))
    numbers = [token for token in tokens if token.isdigit()]
    if len(numbers) != 1 or not is_word_for_joint([x for x in tokens if x.isalpha()]):
        return None
    return Meaning("q", len(WORDS["q"]) + 1, number=int(numbers[0]))


def _read_words(tokens: list[str]) -> Meaning | None:
    """Read the quantity that the tokens of a name say, with their last number and their
    further words, "elbow" for "elbow_position"."""
    tokens = _without_port(_join_compounds(tokens))
    words = [token for token in tokens if token.isalpha()]
    numbers = [token for token in tokens if token.isdigit()]
    quantity = _quantity(words) if _OTHERS.isdisjoint(words) else None
    if quantity is None:
        return None
    known = WORDS[quantity]
    its_words = tuple(word for word in words if word in known)
    others = [
        word for word in _words_beside_fillers(tokens) if word not in (*known, "q")
    ]
    return Meaning(
        quantity,
        rank=min(known.index(word) for word in its_words),
        number=int(numbers[-1]) if numbers else None,
        other_words=(*others, *numbers[:-1]),
        words=its_words,
    )


def _words_beside_fillers(tokens: Sequence[str]) -> list[str]:
    """Return the words that are no fillers. A single letter is none where no number names
    the joint: the letter may name it."""
    words = [token for token in tokens if token.isalpha()]
    has_number = any(map(str.isdigit, tokens))
    if has_number:
        return [x for x in words if x not in _FILLERS]
    return [x for x in words if x not in _FILLERS or len(x) == 1]


def _without_port(tokens: list[str]) -> list[str]:
    """Leave out the port of a block at a name's end, "q2/Out1", by which Simulink and
    dSPACE call signals, where the name has another number."""
    is_port = len(tokens) > 2 and tokens[-2] in ("out", "in") and tokens[-1].isdigit()
    has_number = any(token.isdigit() for token in tokens[:-2])
    return tokens[:-2] if is_port and has_number else tokens


def _quantity(words: Sequence[str]) -> str | None:
    """Return the one quantity that words say; None where they say none, or several.

    A single letter beside a word names a joint or is a symbol: "q1_torque" is the
    torque of joint q1, and "Torque_T" a torque, although q alone means positions and T
    a temperature.
    """
    by_quantity = {x: [w for w in words if w in known] for x, known in WORDS.items()}
    said = [x for x, its_words in by_quantity.items() if its_words]
    if len(said) != 1:  # "encoder velocity": what says where it is measured counts less
        said = [
            x
            for x, its_words in by_quantity.items()
            if any(len(word) > 1 and word not in _FILLERS for word in its_words)
        ]
    return said[0] if len(said) == 1 else None


def _join_compounds(tokens: Sequence[str]) -> list[str]:
    """Join pairs of tokens that mean one word: "theta", "dot" are a velocity."""
    joined = list[str]()
    for token in tokens:
        pair = (*joined[-1:], token)
        if pair in _COMPOUNDS:
            joined[-1] = _COMPOUNDS[pair]
        else:
            joined.append(token)
    return joined
