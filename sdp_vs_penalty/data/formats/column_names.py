"""What the name of a column says: a quantity, a joint or its number, a unit."""

import re
import tomllib
import unicodedata
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from sdp_vs_penalty.data.formats.units import TELLING_UNITS, NamedUnit, units_of_name

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
#: Symbols of units have at most so many letters; longer ones are words.
_LONGEST_SYMBOL = 3
#: Units by which a torque is a current.
_AMPERES = ("a", "amps", "ma")
#: Two words that mean one.
_COMPOUNDS = {tuple(text.split()): word for text, word in _TABLE["compounds"].items()}


@dataclass(frozen=True)
class Reading:
    """What the name of a column says."""

    #: Quantity: "t", "q", "dq", "tau", "temp" or "qcmd".
    quantity: str
    #: Place of the name's word in the list of the quantity's words, 0 for the best.
    rank: int
    #: Place of the robot's joint that the name holds, from 0; None without.
    joint: int | None
    #: The last number in the name; None without.
    number: int | None
    #: Further words in the name, such as "left".
    other_words: tuple[str, ...]
    #: The unit at the end of the name, "" without.
    unit: str = ""
    #: Factor to SI.
    factor: float = 1.0
    #: The words that say the quantity.
    words: tuple[str, ...] = ()


class JointNames:
    """Finder of the robot's joint names within the names of columns.

    Names are compared as tokens (words and numbers in small letters). What all joints
    begin or end with may be missing: "elbow" for "left_elbow_joint" beside
    "left_wrist_joint".
    """

    def __init__(self, names: Sequence[str]) -> None:
        """Prepare the joints' names, and their short forms where these are words that
        differ."""
        full_names = [tuple(split_tokens(name)) for name in names]
        without_begin = _without_common_begin(full_names)
        reversed_names = [tokens[::-1] for tokens in without_begin]
        cores = [tokens[::-1] for tokens in _without_common_begin(reversed_names)]
        self._joint_by_tokens = {tokens: k for k, tokens in enumerate(full_names)}
        for short_names in (without_begin, cores):
            # Numbers alone are no names: any column can hold them.
            have_letters = all(any(x.isalpha() for x in name) for name in short_names)
            is_unique = len(set(short_names)) == len(names)
            if have_letters and is_unique:
                for k, tokens in enumerate(short_names):
                    self._joint_by_tokens.setdefault(tokens, k)

    def find(self, tokens: Sequence[str]) -> tuple[int, list[str]] | None:
        """Find the joint whose name a column's name contains; the longest joint name
        wins.

        Parameters
        ----------
        tokens : Sequence[str]
            Words and numbers of the column's name.

        Returns
        -------
        tuple[int, list[str]] | None
            The joint's place from 0, and the tokens without its name; None without a
            joint.
        """
        longest_first = sorted(self._joint_by_tokens, key=len, reverse=True)
        for joint_name in longest_first:
            if not joint_name:
                continue
            for start in range(len(tokens) - len(joint_name) + 1):
                end = start + len(joint_name)
                if tuple(tokens[start:end]) == joint_name:
                    others = [*tokens[:start], *tokens[end:]]
                    return self._joint_by_tokens[joint_name], others
        return None


def _without_common_begin(names: Sequence[tuple[str, ...]]) -> list[tuple[str, ...]]:
    """Leave out the first tokens that all names share; at least one token of each name
    stays, and a single name stays as it is."""
    if len(names) < 2:
        return list(names)
    n_shared = 0
    shortest = min(len(tokens) for tokens in names)
    while n_shared < shortest - 1 and len({name[n_shared] for name in names}) == 1:
        n_shared += 1
    return [tokens[n_shared:] for tokens in names]


def split_tokens(name: str) -> list[str]:
    """Split a column's name into words and numbers, in small letters without accents.

    >>> split_tokens("stampNanoSec[3]")
    ['stamp', 'nano', 'sec', '3']
    >>> split_tokens("axisQMsr")
    ['axis', 'q', 'msr']

    Parameters
    ----------
    name : str
        Name as the file writes it.

    Returns
    -------
    list[str]
        Words and numbers in their order.
    """
    before_capital = r"(?<=[a-z])(?=[A-Z])"  # stamp|Nano
    before_last_capital = r"(?<=[A-Z])(?=[A-Z][a-z]{2})"  # Q|Msr
    with_blanks = re.sub(f"{before_capital}|{before_last_capital}", " ", name.strip())
    decomposed = unicodedata.normalize("NFKD", with_blanks.lower())
    without_accents = re.sub(r"[\u0300-\u036f]", "", decomposed)
    # Korean syllables and Japanese marks are no accents: they are put together again.
    text = unicodedata.normalize("NFC", without_accents)
    return re.findall(r"[^\W\d_]+|[0-9]+", text)


def is_no_measurement(name: str) -> bool:
    """Return whether a column holds something that was not measured, such as a target,
    a limit or an error.

    Returns
    -------
    bool
        True where one of its words says so (list "others" of words.toml).
    """
    return bool(_OTHERS & set(split_tokens(name)))


def is_word_for_joint(words: Sequence[str]) -> bool:
    """Return whether words mean a joint: "joint", "arm axis".

    Returns
    -------
    bool
        True where one is a word for a joint, and the others say nothing.
    """
    return bool(_JOINTS & set(words)) and set(words) <= FILLERS


def read_name(name: str, joints: JointNames | None = None) -> Reading | None:
    """Read quantity, joint and unit off a column's name.

    A unit at the name's end is split off first; it counts where it is a unit of the
    quantity that the remaining words say.

    Parameters
    ----------
    joints : JointNames | None
        The robot's joint names, which the name can contain.

    Returns
    -------
    Reading | None
        None where the name says no quantity, or one that was not measured (a target).
    """
    for unit in units_of_name(name):
        reading = _read_tokens(split_tokens(unit.remainder), joints)
        if reading is not None and reading.quantity == unit.quantity:
            return replace(reading, unit=unit.text, factor=unit.factor)
        by_unit = _read_by_unit(unit, joints)
        if by_unit is not None:
            return by_unit
    return _read_tokens(split_tokens(name), joints)


def _read_by_unit(unit: NamedUnit, joints: JointNames | None) -> Reading | None:
    """Read a name in which only the unit says the quantity; None for other names.

    Such names are a joint and a unit of one quantity, "J1 [deg]", or a counter and a
    unit of time, "Tick (ms)". They rank behind all names with a word of the quantity.
    """
    tokens = split_tokens(unit.remainder)
    match = joints.find(tokens) if joints is not None else None
    joint, others = match or (None, tokens)
    words = {token for token in others if token.isalpha()}
    numbers = [token for token in others if token.isdigit()]
    has_joint = joint is not None or bool(words & _JOINTS and numbers)
    if has_joint:
        is_read = words <= FILLERS and _is_telling(unit)
    else:
        is_read = unit.quantity == "t" and bool(words & _COUNTERS) and not numbers
    is_other = bool(words & _OTHERS)  # a target, an error
    if not is_read or is_other:
        return None
    return Reading(
        unit.quantity,
        rank=len(WORDS[unit.quantity]),
        joint=joint,
        number=int(numbers[-1]) if numbers else None,
        other_words=tuple(numbers[:-1]),
        unit=unit.text,
        factor=unit.factor,
        words=("current",) if unit.text in _AMPERES else (),
    )


def read_time_by_unit(name: str) -> Reading | None:
    """Read a name of unknown words that ends with a unit of time, "run_minutes", as a
    clock.

    Durations end so too ("delay_ms"): a clock's values rise, which whoever asks has to
    see.

    Returns
    -------
    Reading | None
        Ranks behind all names with a word of time. None for names without a unit of
        time, with numbers, or with a word for what was not measured.
    """
    for unit in units_of_name(name):
        tokens = split_tokens(unit.remainder)
        is_clock = unit.quantity == "t" and not any(map(str.isdigit, tokens))
        # "q_min" is a limit of positions, "error_min" an error.
        says_no_quantity = _quantity_of(tokens) in (None, "t")
        # Alone "s" may be a length, and "min" a minimum; "minutes" are a time.
        is_clock = is_clock and (bool(tokens) or len(unit.text) > _LONGEST_SYMBOL)
        if is_clock and says_no_quantity and not _OTHERS & set(tokens):
            rank = len(WORDS["t"]) + 1
            return Reading("t", rank, None, None, tuple(tokens), unit.text, unit.factor)
    return None


def read_bare_joint(name: str) -> Reading | None:
    """Read a name that says nothing but a joint's number, "j1" or "AxisAct_A1", as a
    position.

    Returns
    -------
    Reading | None
        Ranks behind all names with a word of positions. None for other names.
    """
    tokens = split_tokens(name)
    numbers = [token for token in tokens if token.isdigit()]
    words = [token for token in tokens if token.isalpha()]
    if len(numbers) != 1 or not is_word_for_joint(words):
        return None
    rank = len(WORDS["q"]) + 1
    return Reading("q", rank, joint=None, number=int(numbers[0]), other_words=())


def _is_telling(unit: NamedUnit) -> bool:
    """Tell whether a unit belongs to one quantity alone, as "deg/s" to velocities; a
    length in "m" can be anything."""
    return unit.text in TELLING_UNITS.get(unit.quantity, ())


def _read_tokens(tokens: list[str], joints: JointNames | None) -> Reading | None:
    """Read the quantity that the tokens of a column's name say, such as "q" for
    "elbow", "position".

    The robot's joint name is taken out first, if the tokens contain one. If the other
    tokens say no quantity, all tokens are read: the joint's name may have the word that
    says it ("torque_motor"). None where no tokens say a quantity.
    """
    match = joints.find(tokens) if joints is not None else None
    if match is not None:
        joint, others = match
        reading = _read_words(others, joint)
        if reading is not None:
            return reading
    return _read_words(tokens, None)


def _read_words(tokens: list[str], joint: int | None) -> Reading | None:
    """Read the quantity that tokens say, with their last number and their further
    words.

    ``joint`` is the place, from 0, of the robot's joint that was found in the name.
    None where they say no quantity, or one that was not measured.
    """
    tokens = _without_port(_join_compounds(tokens))
    words = [token for token in tokens if token.isalpha()]
    numbers = [token for token in tokens if token.isdigit()]
    if _OTHERS & set(words):
        return None
    quantity = _quantity_of(words)
    if quantity is None:
        return None
    words_of_quantity = WORDS[quantity]
    its_words = tuple(word for word in words if word in words_of_quantity)
    says_nothing = {*words_of_quantity, *FILLERS, "q"}
    other_words = [word for word in words if word not in says_nothing]
    return Reading(
        quantity,
        rank=min(words_of_quantity.index(word) for word in its_words),
        joint=joint,
        number=int(numbers[-1]) if numbers else None,
        other_words=(*other_words, *numbers[:-1]),
        words=its_words,
    )


def _without_port(tokens: list[str]) -> list[str]:
    """Leave out the port of a block at a name's end, "q2/Out1", by which Simulink and
    dSPACE call signals, where the name has another number."""
    is_port = len(tokens) > 2 and tokens[-2] in ("out", "in") and tokens[-1].isdigit()
    has_number = any(token.isdigit() for token in tokens[:-2])
    return tokens[:-2] if is_port and has_number else tokens


def _quantity_of(words: Sequence[str]) -> str | None:
    """Return the one quantity that words say; None where they say none, or several.

    A single letter beside a word names a joint or is a symbol: "q1_torque" is the
    torque of joint q1, and "Torque_T" a torque, although q alone means positions and T
    a temperature.
    """
    quantities = list[str]()
    by_words_alone = list[str]()  # without single letters
    for quantity, words_of_quantity in WORDS.items():
        its_words = [word for word in words if word in words_of_quantity]
        if its_words:
            quantities.append(quantity)
        if any(len(word) > 1 for word in its_words):
            by_words_alone.append(quantity)
    candidates = quantities if len(quantities) == 1 else by_words_alone
    return candidates[0] if len(candidates) == 1 else None


def _join_compounds(tokens: Sequence[str]) -> list[str]:
    """Join pairs of tokens that mean one word: "theta", "dot" are a velocity."""
    joined = list[str]()
    for token in tokens:
        pair = (joined[-1], token) if joined else ()
        if pair in _COMPOUNDS:
            joined[-1] = _COMPOUNDS[pair]
        else:
            joined.append(token)
    return joined
