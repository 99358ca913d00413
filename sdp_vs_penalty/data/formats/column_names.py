"""What the name of a column says: a quantity, a joint or its number, a unit."""

import re
import tomllib
import unicodedata
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from sdp_vs_penalty.data.formats.units import (
    TELLING_UNITS,
    NamedUnit,
    units_of_name,
)

_TABLE = tomllib.loads(Path(__file__).with_name("words.toml").read_text("utf-8"))
#: The words of each quantity, the best first.
WORDS: dict[str, tuple[str, ...]] = {
    name: tuple(words) for name, words in _TABLE["quantities"].items()
}
#: Words that say nothing about a quantity.
FILLERS = frozenset(_TABLE["fillers"])
#: Words that say nothing but "joint".
_JOINTS = frozenset(_TABLE["joints"])
#: Words of clocks whose names say the unit, and of counters otherwise.
_COUNTERS = frozenset(_TABLE["counters"])
#: Words of columns that are something else than was measured.
_OTHERS = frozenset(_TABLE["others"])
#: Units by which a torque is a current.
_AMPERES = ("a", "amps", "ma")
#: Two words that mean one.
_COMPOUNDS = {tuple(text.split()): word for text, word in _TABLE["compounds"].items()}


@dataclass(frozen=True)
class Reading:
    """What a name says.

    Parameters
    ----------
    quantity : t, q, dq, tau, temp or qcmd
    rank : place of the word in its quantity's list, 0 for the best
    joint : place of the robot's joint that the name holds, from 0; None without
    number : the last number of the name; None without
    other_words : what else the name holds, such as "left"
    unit : as the name ends with, "" without
    factor : of the unit, to SI
    words : of the quantity
    """

    quantity: str
    rank: int
    joint: int | None
    number: int | None
    other_words: tuple[str, ...]
    unit: str = ""
    factor: float = 1.0
    words: tuple[str, ...] = ()


class JointNames:
    """The robot's joints, as tokens that names of columns can hold."""

    def __init__(self, names: Sequence[str]) -> None:
        tokens = [tuple(split_tokens(name)) for name in names]
        shared = _common_prefix(tokens)
        self._joint_by_tokens = {words: k for k, words in enumerate(tokens)}
        short_names = [words[shared:] for words in tokens]
        has_letters = all(any(w.isalpha() for w in words) for words in short_names)
        if has_letters and len(set(short_names)) == len(names):
            for k, words in enumerate(short_names):
                self._joint_by_tokens.setdefault(words, k)

    def find(self, tokens: Sequence[str]) -> tuple[int, list[str]] | None:
        """Find the joint that a name holds; the longest joint's name counts.

        Parameters
        ----------
        tokens : Sequence[str]
            Words and numbers of the name.

        Returns
        -------
        tuple[int, list[str]] | None
            The joint's place from 0, and the other tokens; None without a joint.
        """
        by_length = sorted(self._joint_by_tokens, key=len, reverse=True)
        for words in by_length:
            if not words:
                continue
            for start in range(len(tokens) - len(words) + 1):
                end = start + len(words)
                if tuple(tokens[start:end]) == words:
                    others = [*tokens[:start], *tokens[end:]]
                    return self._joint_by_tokens[words], others
        return None


def _common_prefix(names: Sequence[tuple[str, ...]]) -> int:
    """How many first tokens all names share, less than any has."""
    if len(names) < 2:
        return 0
    shortest = min(len(words) for words in names) - 1
    for k in range(shortest):
        if len({words[k] for words in names}) > 1:
            return k
    return max(shortest, 0)


def split_tokens(name: str) -> list[str]:
    """Split a column's name into words and numbers, in small letters without accents.

    >>> split_tokens("stampNanoSec[3]")
    ['stamp', 'nano', 'sec', '3']
    >>> split_tokens("axisQMsr")
    ['axis', 'q', 'msr']

    Parameters
    ----------
    name : str
        As the file writes it.

    Returns
    -------
    list[str]
        Words and numbers in their order.
    """
    with_blanks = re.sub(
        r"(?<=[a-z])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z]{2})",
        " ",
        name.strip(),
    )
    decomposed = unicodedata.normalize("NFKD", with_blanks.lower())
    without_accents = re.sub(r"[\u0300-\u036f]", "", decomposed)
    return re.findall(r"[^\W\d_]+|[0-9]+", without_accents)


def is_no_measurement(name: str) -> bool:
    """Tell whether a column is something else than was measured, such as a target.

    Parameters
    ----------
    name : str
        Of the column.

    Returns
    -------
    bool
        True where one of its words says so.
    """
    return bool(_OTHERS & set(split_tokens(name)))


def read_name(name: str, joints: JointNames | None = None) -> Reading | None:
    """Read what a column's name says: quantity, joint, unit.

    Parameters
    ----------
    name : str
        Of the column.
    joints : JointNames | None
        The robot's joints.

    Returns
    -------
    Reading | None
        None where it says nothing, or of something that was not measured.
    """
    for unit in units_of_name(name):
        reading = _read_tokens(split_tokens(unit.remainder), joints)
        if reading is not None and reading.quantity == unit.quantity:
            return Reading(
                reading.quantity,
                reading.rank,
                reading.joint,
                reading.number,
                reading.other_words,
                unit=unit.text,
                factor=unit.factor,
                words=reading.words,
            )
        by_unit = _read_by_unit(unit, joints)
        if by_unit is not None:
            return by_unit
    return _read_tokens(split_tokens(name), joints)


def _read_by_unit(unit: NamedUnit, joints: JointNames | None) -> Reading | None:
    """The reading of a name that says a joint and a unit of one quantity, "J1 [deg]", or
    a counter and a unit of time, "Tick (ms)"; None for another name."""
    tokens = split_tokens(unit.remainder)
    match = joints.find(tokens) if joints is not None else None
    joint, others = match or (None, tokens)
    letters = {token for token in others if token.isalpha()}
    numbers = [token for token in others if token.isdigit()]
    has_joint = joint is not None or bool(letters & _JOINTS and numbers)
    if has_joint:
        is_read = letters <= FILLERS and unit.text in TELLING_UNITS.get(
            unit.quantity, ()
        )
    else:
        is_read = unit.quantity == "t" and bool(letters & _COUNTERS) and not numbers
    if not is_read or letters & _OTHERS:
        return None
    return Reading(
        unit.quantity,
        len(WORDS[unit.quantity]),
        joint,
        int(numbers[-1]) if numbers else None,
        tuple(numbers[:-1]),
        unit=unit.text,
        factor=unit.factor,
        words=("current",) if unit.text in _AMPERES else (),
    )


def _read_tokens(tokens: list[str], joints: JointNames | None) -> Reading | None:
    """The reading without the robot's joint where there is one, else of all tokens."""
    match = joints.find(tokens) if joints is not None else None
    if match is not None:
        joint, others = match
        reading = _read_words(others, joint)
        if reading is not None:
            return reading
    return _read_words(tokens, None)


def _read_words(tokens: list[str], joint: int | None) -> Reading | None:
    tokens = _join_compounds(tokens)
    letters = [token for token in tokens if token.isalpha()]
    numbers = [token for token in tokens if token.isdigit()]
    if _OTHERS & set(letters):
        return None
    quantity = _quantity_of(letters)
    if quantity is None:
        return None
    known = WORDS[quantity]
    its_words = tuple(word for word in letters if word in known)
    other_words = [
        word
        for word in letters
        if word not in known and word not in FILLERS and word != "q"
    ]
    return Reading(
        quantity,
        min(known.index(word) for word in its_words),
        joint,
        int(numbers[-1]) if numbers else None,
        (*other_words, *numbers[:-1]),
        words=its_words,
    )


def _quantity_of(letters: Sequence[str]) -> str | None:
    """The one quantity that words are of: "q1_torque" is of joint q1, not a position, and
    "Torque_T" of joint T."""
    quantities = {
        quantity: [word for word in letters if word in known]
        for quantity, known in WORDS.items()
    }
    quantities = {quantity: words for quantity, words in quantities.items() if words}
    if len(quantities) > 1:
        # A single letter beside a word is a joint's, or another word's symbol.
        quantities = {
            quantity: words
            for quantity, words in quantities.items()
            if any(len(word) > 1 for word in words)
        }
    return next(iter(quantities)) if len(quantities) == 1 else None


def _join_compounds(tokens: Sequence[str]) -> list[str]:
    """Tokens with "theta dot" as one word."""
    joined = list[str]()
    for token in tokens:
        pair = (joined[-1], token) if joined else ()
        if pair in _COMPOUNDS:
            joined[-1] = _COMPOUNDS[pair]
        else:
            joined.append(token)
    return joined
