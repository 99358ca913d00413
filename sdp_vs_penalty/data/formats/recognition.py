"""Which columns of another program's log are t, q, dq, tau ...: one table of words
(words.toml).

A name is read as words and at most one number: ``actual_q_0``,
``joint_states.position[3]``, ``qd5``, ``/joint_states/elbow_joint/effort``. What says
nothing about a quantity (actual, joint, field) is left out; what remains has to be one
of a quantity's words. Where several kinds of column could be one quantity, the word
that comes first is taken: a torque before a current.
"""

import fnmatch
import re
import tomllib
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from sdp_vs_penalty import formatting
from sdp_vs_penalty.data.formats.stamps import find_two_parts
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.errors import InputError, Remark
from sdp_vs_penalty.robot.arrays import Array

_TABLE = tomllib.loads(Path(__file__).with_name("words.toml").read_text())
#: The words of each quantity, the best first.
WORDS: dict[str, tuple[str, ...]] = {
    name: tuple(words) for name, words in _TABLE["quantities"].items()
}
#: Words that say nothing about a quantity; those of columns that are something else
#: than was measured.
_FILLERS = set(_TABLE["fillers"])
_OTHERS = set(_TABLE["others"])
#: Loggers that are known by the names of their columns (loggers.toml), and the groups
#: that an entry can name.
LOGGERS: list[dict[str, Any]] = tomllib.loads(
    Path(__file__).with_name("loggers.toml").read_text()
)["logger"]
_GROUPS_OF_LOGGERS = ("q", "dq", "tau", "temp", "qcmd")
#: Units that a name ends with, or that are asked for, by what a value has to be
#: multiplied by.
UNITS: dict[str, float] = {
    "ns": 1e-9,
    "us": 1e-6,
    "ms": 1e-3,
    "s": 1.0,
    "deg": np.pi / 180.0,
    "degrees": np.pi / 180.0,
    "degree": np.pi / 180.0,
    "rad": 1.0,
    "rpm": np.pi / 30.0,
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


#: Our names (t, q1 ..., or q for a block) to the file's; factors by our names, where
#: they are not 1.
Recognised: TypeAlias = tuple[dict[str, str], dict[str, float]]
#: Columns of names, of a log that says in each row which joint is which.
_JOINT_NAMES = re.compile(r"(?:.*[^a-z])?names?[^a-z0-9]*([0-9]*)[^a-z0-9]*")


@dataclass(frozen=True)
class CellTable:
    """What a file's columns hold: their kinds ("number", "text", "list", "stamp",
    "empty") and the texts of their first cells, by name."""

    kinds: Mapping[str, str]
    cells: Mapping[str, Sequence[str]]

    def values(self, name: str) -> Array:
        """The first numbers of a column, of lists all of theirs."""
        numbers_in_text = re.findall(
            r"[-+]?[0-9]*\.?[0-9]+(?:[eE][-+]?[0-9]+)?",
            " ".join(self.cells.get(name, ())[:50]),
        )
        return np.array(numbers_in_text, float)


@dataclass(frozen=True)
class Recognition:
    """What a file of foreign names is read as.

    rename : our names (t, q1 ..., or q for a block) to the file's; t to "sec+nanosec"
    where a stamp is in two parts; scale : factors by our names, where they are not 1;
    logger : what writes such files, in words; units : what each group is in, where that
    is not SI, and why; joints : their names, where the file says them; order : of the
    joints of a block, where the robot's is another one; episode : what counts runs.
    """

    rename: dict[str, str]
    scale: dict[str, float]
    logger: str = "by their words"
    units: tuple[str, ...] = ()
    joints: tuple[str, ...] = ()
    order: tuple[int, ...] | None = None
    episode: str | None = None

    def command(self, path: Path, names: Sequence[str]) -> str:
        """The command that reads the file alike."""
        pairs = ",".join(f"{a}={b}" for a, b in _as_patterns(self.rename, names))
        words = ["--rename", pairs]
        if self.scale:
            words += ["--scale", ",".join(_as_units(self.scale, self.rename))]
        return formatting.convert_command(path, *words)


def recognise_and_warn(
    path: Path, names: Sequence[str], choice: Any, table: CellTable | None
) -> Recognition | None:
    """The columns that a file of foreign names is read by, said in one line with the
    command that reads it alike; None where our own names are there, or nothing is
    recognised."""
    if _has_our_names(names):
        return None
    recognition = recognise(names, choice.joints, table)
    if recognition is None:
        return None
    if all(
        our_name == their_name for our_name, their_name in recognition.rename.items()
    ):
        return recognition  # our own names, beside a clock that is missing
    columns_taken = ", ".join(f"{a} = {b}" for a, b in _in_short(recognition.rename))
    units = "".join(f"; {unit}" for unit in recognition.units)
    joints = f"; joints {', '.join(recognition.joints)}" if recognition.joints else ""
    if (
        recognition.joints
        and choice.joints
        and not _match_joints(choice.joints, recognition.joints)
    ):
        joints += " in the file's order, for the robot's have other names"
    warning = (
        f"{path}: columns recognised ({recognition.logger}): "
        f"{columns_taken}{units}{joints}; the same"
        f" by `{recognition.command(path, names)}`"
    )
    warnings.warn(warning, Remark, stacklevel=3)
    return recognition


def counted_from_zero(names: Sequence[str]) -> bool:
    """Whether columns that are called as ours are counted from 0."""
    return bool({"q0", "dq0", "tau0", "qcmd0"} & set(names))


def _has_our_names(names: Sequence[str]) -> bool:
    """Whether columns are called as in RUN.csv, counted from 1."""
    known = set(names)
    return bool(
        not counted_from_zero(names)
        and "t" in known
        and {"q", "q1"} & known
        and {"tau", "tau1", "qcmd", "qcmd1"} & known
    )


def _in_short(rename: Mapping[str, str]) -> list[tuple[str, str]]:
    """The first and the last column of each group."""
    groups: dict[str, list[tuple[str, str]]] = {}
    for our_name, their_name in rename.items():
        groups.setdefault(our_name.rstrip("0123456789"), []).append(
            (our_name, their_name)
        )
    out = []
    for pairs in groups.values():
        (our_name, their_name), (last, last_of_theirs) = pairs[0], pairs[-1]
        several = len(pairs) > 1
        out.append(
            (f"{our_name}..{last}", f"{their_name} .. {last_of_theirs}")
            if several
            else (our_name, their_name)
        )
    return out


def _as_patterns(
    rename: Mapping[str, str], names: Sequence[str]
) -> list[tuple[str, str]]:
    """Pairs of --rename, those of a group as one pattern where it means the same, and
    columns by their number where their names cannot be written."""
    groups: dict[str, dict[str, str]] = {}
    for our_name, their_name in rename.items():
        groups.setdefault(our_name.rstrip("0123456789"), {})[our_name] = their_name
    out = list[tuple[str, str]]()
    for group, pairs in groups.items():
        pattern = re.sub(r"[0-9]+([^0-9]*)$", r"*\1", next(iter(pairs.values())))
        patterns = {f"{group}*": pattern}
        simple = "*" in pattern and pattern.count("*") == 1
        simple = simple and len(pairs) > 1 and not set(",=#+") & set(pattern)
        if simple and expanded(patterns, names) == pairs:
            out += patterns.items()
            continue
        out += [
            (our_name, _writable(their_name, names))
            for our_name, their_name in pairs.items()
        ]
    return out


def _as_units(scale: Mapping[str, float], rename: Mapping[str, str]) -> list[str]:
    """Pairs of --scale, a unit's word for a group where it says the same."""
    words = {x: word for word, x in reversed(UNITS.items())}
    groups: dict[str, dict[str, float]] = {}
    for our_name, factor in scale.items():
        groups.setdefault(our_name.rstrip("0123456789"), {})[our_name] = factor
    out = list[str]()
    for group, factors in groups.items():
        columns = [
            our_name for our_name in rename if our_name.rstrip("0123456789") == group
        ]
        values = set(factors.values())
        if len(values) == 1 and len(columns) == len(factors):
            factor = values.pop()
            out.append(f"{group}={words.get(factor, f'{factor:.12g}')}")
        else:
            out += [
                f"{our_name}={words.get(x, f'{x:.12g}')}"
                for our_name, x in factors.items()
            ]
    return out


def _writable(name: str, names: Sequence[str]) -> str:
    """A column's name, or its number where commas or the like are in it."""
    if name in names and (set(",=*+") & set(name) or name != name.strip() or not name):
        return f"#{list(names).index(name) + 1}"
    return name


def recognise(
    names: Sequence[str],
    joints: Sequence[str] | None = None,
    table: CellTable | None = None,
) -> Recognition | None:
    """What the columns of these names are; None where positions or torques are not
    among them.

    joints : names of the robot's joints in order, for columns that are called by joints.
    Known loggers come first, then what the words of each name say.
    """
    numeric = [
        name for name in names if table is None or table.kinds.get(name) != "text"
    ]
    recognition = _by_logger(numeric, names, joints, table)
    recognition = recognition or _by_words(numeric, names, joints, table)
    return None if recognition is None else _with_units(recognition, table)


def recognised(
    names: Sequence[str], joints: Sequence[str] | None = None
) -> Recognised | None:
    """Names and factors of :func:`recognise`; None where there is no clock either."""
    recognition = recognise(names, joints)
    return (
        None
        if recognition is None or "t" not in recognition.rename
        else (recognition.rename, recognition.scale)
    )


def find_clock(names: Sequence[str]) -> str | None:
    """The column of a file's clock, "sec+nanosec" where it is in two; None without."""
    if (pair := find_two_parts(names)) is not None:
        return "+".join(pair)
    read = {name: r for name in names if (r := _read(name)) is not None}
    stamps = [
        (r.rank, len(r.other_words), n)
        for n, r in read.items()
        if (r.quantity, r.number) == ("t", None)
    ]
    return min(stamps)[2] if stamps else None


def parts_of(their_name: str, names: Sequence[str]) -> tuple[str, ...]:
    """The columns that a name stands for: two for "sec+nanosec"."""
    if their_name in names or "+" not in their_name:
        return (their_name,)
    return tuple(part.strip() for part in their_name.split("+"))


def _by_logger(
    numeric: Sequence[str],
    names: Sequence[str],
    joints: Sequence[str] | None,
    table: CellTable | None,
) -> Recognition | None:
    """What a logger of the table writes; None where the file is none of theirs."""
    for logger in LOGGERS:
        columns = {
            group: columns_found
            for group in _GROUPS_OF_LOGGERS
            if (columns_found := _columns_of_logger(logger.get(group), numeric))
        }
        keys = list(columns.get("q", ()))
        columns = {
            g: columns_found
            for g, columns_found in columns.items()
            if list(columns_found) == keys
        }
        clock = _first_there(logger["t"], numeric)
        if clock is None or not {"tau", "qcmd"} & set(columns):
            continue
        called, keys = _joints_of_logger(logger, keys, names, joints, table)
        rename = {"t": clock}
        for group, columns_found in columns.items():
            for k, key in enumerate(keys, start=1):
                rename[f"{group}{'' if key == '' else k}"] = columns_found[key]
        scale, units = _units_of_logger(logger, rename, table)
        episode = _first_there(logger.get("episode", ()), names)
        name = str(logger["name"])
        return Recognition(rename, scale, name, units, called, None, episode)
    return None


def _joints_of_logger(
    logger: Mapping[str, Any],
    keys: list[Any],
    names: Sequence[str],
    joints: Sequence[str] | None,
    table: CellTable | None,
) -> tuple[tuple[str, ...], list[Any]]:
    """The joints' names where the file says them, and the keys of their columns, both
    in the robot's order."""
    if keys and keys != [""] and all(isinstance(key, str) for key in keys):
        keys = _in_order_of(joints, keys)
        return tuple(keys), keys
    texts = _columns_of_logger(logger.get("names"), names)
    if table is None or not texts or not set(keys) <= set(texts):
        return (), keys
    first_cells = [next(iter(table.cells.get(texts[k], ())), "") for k in keys]
    if len(set(first_cells)) != len(first_cells):
        return (), keys
    by_name = dict(zip(first_cells, keys, strict=True))
    called = _in_order_of(joints, first_cells)
    return tuple(called), [by_name[name] for name in called]


def _units_of_logger(
    logger: Mapping[str, Any], rename: Mapping[str, str], table: CellTable | None
) -> tuple[dict[str, float], tuple[str, ...]]:
    """Factors by our names, and the units in words with the reason for each."""
    scale = dict[str, float]()
    units = list[str]()
    for group, unit in logger.get("units", {}).items():
        columns = {o: n for o, n in rename.items() if o.rstrip("0123456789") == group}
        why = f"as {logger['name']} writes it"
        if unit == "angle" and columns and table is not None:
            values = np.concatenate([table.values(name) for name in columns.values()])
            largest = float(np.abs(values).max(initial=0.0))
            unit = "deg" if largest > 4.0 * np.pi else "rad"  # of two turns
            why = f"its first values reach {largest:.3g}"
        if columns and unit in UNITS | {"A": 1.0}:
            units.append(f"{group} in {unit}, {why}")
            if UNITS[unit.lower()] != 1.0:
                scale |= dict.fromkeys(columns, UNITS[unit.lower()])
    return scale, tuple(units)


def _first_there(patterns: Any, names: Sequence[str]) -> str | None:
    """The first of some names, or sums of two, that the file has."""
    for pattern in [patterns] if isinstance(patterns, str) else patterns:
        if set(parts_of(pattern, names)) <= set(names):
            return str(pattern)
    return None


def _columns_of_logger(patterns: Any, names: Sequence[str]) -> dict[Any, str]:
    """A group's columns by joint, the number or the name in the pattern, in order;
    counted from 0 or from 1 without a gap."""
    for pattern in [patterns] if isinstance(patterns, str) else patterns or ():
        text = re.escape(pattern).replace(r"\{k\}", "([0-9]+)")
        regex = re.compile(text.replace(r"\{joint\}", "([^/]+)"))
        matches = [(m, name) for name in names if (m := regex.fullmatch(name))]
        if not matches:
            continue
        if "{k}" in pattern:
            columns_found: dict[Any, str] = {
                k: name for k, name in sorted((int(m[1]), name) for m, name in matches)
            }
            first = min(columns_found)
            if first <= 1 and list(columns_found) == list(
                range(first, first + len(columns_found))
            ):
                return columns_found
        elif "{joint}" in pattern:
            return {m[1]: name for m, name in matches}
        else:
            return {"": matches[0][1]}
    return {}


def _in_order_of(joints: Sequence[str] | None, called: Sequence[str]) -> list[str]:
    """Joints' names in the robot's order where it has all of them, or they have all of
    its; those of the file's order otherwise."""
    if joints is None:
        return list(called)
    places = _match_joints(joints, called)
    order = [places[joint] for joint in joints if joint in places]
    complete = len(order) == len(joints) or len(order) == len(called)
    return order if order and complete else list(called)


def _match_joints(joints: Sequence[str], called: Sequence[str]) -> dict[str, str]:
    """The file's name of each of the robot's joints: the same but for marks and capital
    letters, or the same behind one prefix that all have."""
    plain = {re.sub(r"[^a-z0-9]", "", name.lower()): name for name in called}
    plain_joints = {joint: re.sub(r"[^a-z0-9]", "", joint.lower()) for joint in joints}
    matched = {
        joint: plain[text] for joint, text in plain_joints.items() if text in plain
    }
    if matched:
        return matched
    for name in plain:
        for text in plain_joints.values():
            if name.endswith(text):
                prefix = name.removesuffix(text)
                return {
                    joint: plain[prefix + x]
                    for joint, x in plain_joints.items()
                    if prefix + x in plain
                }
    return {}


def _with_units(recognition: Recognition, table: CellTable | None) -> Recognition:
    """The same with the unit of its clock where it counts since 1970."""
    clock = recognition.rename.get("t")
    if table is None or clock is None or "t" in recognition.scale or "+" in clock:
        return recognition
    values = table.values(clock) if table.kinds.get(clock) == "number" else np.zeros(0)
    # Seconds since 1970 between 2001 and 2128 are 1e9 to 5e9.
    for word in ("ms", "us", "ns"):
        unit = UNITS[word]
        if len(values) and 1e9 < unit * values[0] < 5e9:
            why = f"t in {word}, for it counts since 1970"
            return replace(
                recognition,
                scale={"t": unit, **recognition.scale},
                units=(*recognition.units, why),
            )
    return recognition


@dataclass(frozen=True)
class _Read:
    """One name as read: its quantity, how good its word is, its number, other words,
    its unit."""

    quantity: str
    rank: int
    number: int | None
    other_words: tuple[str, ...]
    factor: float


def _read(name: str) -> _Read | None:
    text = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", name.strip()).lower().replace("%", "")
    words = re.findall(r"[a-z]+|[0-9]+", text)
    numbers = [int(w) for w in words if w.isdigit()]
    letters = [w for w in words if not w.isdigit()]
    if len(numbers) > 1 or _OTHERS & set(letters):
        return None
    factor = 1.0
    if len(letters) > 1 and letters[-1] in UNITS and letters[-1] != "a":
        factor = UNITS[letters.pop()]
    for quantity, known in WORDS.items():
        quantities = [w for w in letters if w in known]
        if len(quantities) == 1:
            other_words = tuple(
                w for w in letters if w != quantities[0] and w not in _FILLERS
            )
            number = numbers[0] if numbers else None
            return _Read(
                quantity, known.index(quantities[0]), number, other_words, factor
            )
    return None


def _by_words(
    numeric: Sequence[str],
    names: Sequence[str],
    joints: Sequence[str] | None,
    table: CellTable | None,
) -> Recognition | None:
    """What the words of each name say."""
    read = {name: r for name in numeric if (r := _read(name)) is not None}
    clock = find_clock(numeric)
    rename = {} if clock is None else {"t": clock}
    joint_words = _said_joints(names, table)
    count = len(_columns("q", read, joints))
    called = _called_by_columns(_columns("q", read, joints), read, joints)
    order: tuple[int, ...] | None = None
    for quantity in [q for q in WORDS if q != "t"]:
        columns = _columns(quantity, read, joints)
        if len(columns) != count or not count:
            continue
        block = count == 1 and read[columns[0]].number is None
        is_list = block and table is not None and table.kinds.get(columns[0]) == "list"
        if joint_words and not block and len(joint_words) == count:
            by_name = dict(zip(joint_words, columns, strict=True))
            called = tuple(_in_order_of(joints, joint_words))
            columns = [by_name[name] for name in called]
        elif joint_words and is_list:
            called = tuple(_in_order_of(joints, joint_words))
            order = tuple(joint_words.index(name) for name in called)
        rename |= {
            f"{quantity}{'' if block else k}": n for k, n in enumerate(columns, start=1)
        }
    scale = {
        our_name: read[n].factor
        for our_name, n in rename.items()
        if n in read and read[n].factor != 1.0
    }
    torque = any(re.fullmatch("(tau|qcmd)[0-9]*", our_name) for our_name in rename)
    if not (count and torque):
        return None
    units = []
    for group in sorted({our_name.rstrip("0123456789") for our_name in scale}):
        units.append(f"{group} in the unit that its name ends with")
    current = any(
        "current" in n.lower() or "amps" in n.lower()
        for our_name, n in rename.items()
        if our_name.startswith("tau")
    )
    if current:
        units.append("tau is a current in A: --scale tau=... makes torques of it")
    return Recognition(rename, scale, units=tuple(units), joints=called, order=order)


def _said_joints(names: Sequence[str], table: CellTable | None) -> list[str]:
    """The joints' names in the order of their columns, where columns hold them: one
    text a joint, or a list of texts."""
    if table is None:
        return []
    columns = {}
    for name in names:
        if match := _JOINT_NAMES.fullmatch(name.lower()):
            columns[int(match[1] or -1)] = name
    cells = {k: next(iter(table.cells.get(n, ())), "") for k, n in columns.items()}
    if list(cells) == [-1]:
        words = re.findall(r"[A-Za-z_][\w/.-]*", cells[-1])
        return [w for w in words if w != "array"] if len(words) > 1 else []
    texts = [cells[k] for k in sorted(cells)]
    return texts if len(set(texts)) == len(texts) and all(texts) else []


def _columns(
    quantity: str, read: Mapping[str, _Read], joints: Sequence[str] | None
) -> list[str]:
    """The columns of one quantity in the order of the joints; none where that is not
    clear."""
    readings = {name: r for name, r in read.items() if r.quantity == quantity}
    kinds: dict[tuple[object, ...], list[str]] = {}
    for name, r in readings.items():
        by_joint = r.number is None and r.other_words
        kinds.setdefault(
            (r.rank, () if by_joint else r.other_words, r.number is None), []
        ).append(name)
    if len({r.rank for r in readings.values()}) == 1 and any(
        r.number is None for r in readings.values()
    ):
        called = {(*r.other_words, str(r.number)): name for name, r in readings.items()}
        if (
            len(called) == len(readings) > 1
        ):  # joints have names, some of them with a number
            return _by_joint(list(readings), readings, joints)
    for key in sorted(kinds, key=lambda k: (k[0], k[2], len(k[1]), k[1])):  # type: ignore[arg-type]
        reading_of_joint = kinds[key]
        numbers = [readings[name].number for name in reading_of_joint]
        if None not in numbers:
            order = sorted(range(len(reading_of_joint)), key=lambda i: numbers[i] or 0)
            first = min(n for n in numbers if n is not None)
            if first <= 1 and sorted(numbers) == list(  # type: ignore[type-var]
                range(first, first + len(reading_of_joint))
            ):
                return [reading_of_joint[i] for i in order]
        elif len(reading_of_joint) == 1 or len(
            {readings[name].other_words for name in reading_of_joint}
        ) == len(reading_of_joint):
            return _by_joint(reading_of_joint, readings, joints)
    return []


def _by_joint(
    names_found: list[str], readings: Mapping[str, _Read], joints: Sequence[str] | None
) -> list[str]:
    """Columns called by joints in the robot's order, where all its joints are among
    them or all of them are its joints (others are held)."""
    if joints is None:
        return names_found
    tails = [_tail_of(joint) for joint in joints]
    by_tail = {
        (*readings[name].other_words, str(readings[name].number)): name
        for name in names_found
    }
    ordered = [by_tail[tail] for tail in tails if tail in by_tail]
    complete = len(ordered) == len(tails) or len(ordered) == len(names_found)
    return ordered if complete else names_found


def _tail_of(joint: str) -> tuple[str, ...]:
    """What a joint's name adds to a column's: its words and its number."""
    words = re.findall("[a-z]+", joint.lower())
    numbers = re.findall("[0-9]+", joint.lower())
    return (
        *(w for w in words if w not in _FILLERS),
        str(next(map(int, numbers), None)),
    )


def _called_by_columns(
    columns: Sequence[str], read: Mapping[str, _Read], joints: Sequence[str] | None
) -> tuple[str, ...]:
    """The robot's joints that columns are called by; none where they are not all."""
    tails = {_tail_of(joint): joint for joint in joints or ()}
    found = [tails.get((*read[n].other_words, str(read[n].number))) for n in columns]
    return () if None in found else tuple(str(name) for name in found)


def expanded(rename: Mapping[str, str], names: Sequence[str]) -> dict[str, str]:
    """``q*=actual_q_*`` as one pair for each joint; InputError where no column has such
    a name."""
    out: dict[str, str] = {}
    for our_name, their_name in rename.items():
        by_number = re.fullmatch("#([1-9][0-9]*)", their_name)
        if by_number and their_name not in names and int(by_number[1]) <= len(names):
            their_name = names[int(by_number[1]) - 1]
        if "*" not in their_name or their_name in names:
            out[our_name] = their_name
            continue
        pattern = re.compile(re.escape(their_name).replace(r"\*", "([0-9]+)"))
        numbered = sorted((int(m[1]), n) for n in names if (m := pattern.fullmatch(n)))
        if not numbered:
            near = (
                ", ".join(fnmatch.filter(names, their_name)[:4])
                or "none that is numbered"
            )
            remedy = "give --rename a pattern of the file's names"
            raise InputError(f"no column {their_name!r} ({near})", remedy)
        out |= {
            f"{our_name.rstrip('*')}{k}": n
            for k, (_, n) in enumerate(numbered, start=1)
        }
    return out


def scaled(run: Measurements, factors: Mapping[str, str]) -> Measurements:
    """The run in other units: ``--scale q=deg,tau=10:10.7:8.5``, by our names q, q1
    ..., t a unit, a number, or one number a joint.

    Raises InputError for words that are none of them, and columns that are not there.
    """
    groups = {"t": run.t[:, None], **run.groups}
    for our_name, word in factors.items():
        by = np.array(
            [UNITS.get(w.lower()) or _number(our_name, w) for w in word.split(":")]
        )
        name = our_name.rstrip("0123456789")
        count = groups[name].shape[1] if name in groups else 0
        joint = int(our_name[len(name) :] or 1)
        if not 1 <= joint <= count:
            what = f"--scale {our_name}: the run has no such column"
            raise InputError(what, "name t, q, dq or tau")
        if our_name != name:
            by = np.where(np.arange(count) == joint - 1, by[0], 1.0)
        elif len(by) not in (1, count):
            what = f"--scale {our_name}={word}: {len(by)} factors"
            raise InputError(what, f"give one, or {count}")
        groups[name] = groups[name] * by
    return Measurements.of(groups.pop("t")[:, 0], groups, run.names)


def _number(our_name: str, word: str) -> float:
    try:
        value = float(word)
    except ValueError:
        value = 0.0
    if not value or not np.isfinite(value):
        known = ", ".join(sorted(UNITS))
        raise InputError(
            f"--scale {our_name}={word}",
            f"give a number other than 0, or a unit: {known}",
        )
    return value
