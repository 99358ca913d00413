"""Which columns of another program's log are t, q, dq, tau and so on.

Loggers of loggers.toml come first. Then a name is read as words and numbers
(words.toml): ``actual_q_0``, ``joint_states.position[3]``, ``qd5``,
``/joint_states/elbow_joint/effort``. Words that say nothing about a quantity (actual,
joint, field) do not count. Columns that are named alike make a set, one column a joint.
Where several sets of torques belong to the positions, the best word is taken: a torque
before a current. Where two sets of positions are as good, nobody guesses.
"""

from __future__ import annotations

import re
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from sdp_vs_penalty import formatting
from sdp_vs_penalty.data.formats.renaming import (
    group_of,
    parts_of,
    rename_words,
    scale_words,
)
from sdp_vs_penalty.data.formats.stamps import find_two_parts
from sdp_vs_penalty.data.formats.units import SHARES, UNITS
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.robot.arrays import Array

# Files with our own names need no tables of words and loggers: their functions are
# imported where a foreign file is recognised.
if TYPE_CHECKING:
    from sdp_vs_penalty.data.formats.column_names import JointNames, Reading
    from sdp_vs_penalty.data.formats.column_sets import ColumnSet, SetChoice

#: Our names (t, q1 ..., or q for a block) to the file's; factors by our names, where
#: they are not 1.
Recognised: TypeAlias = tuple[dict[str, str], dict[str, float]]
#: Columns of names, of a log that says in each row which joint is which.
_JOINT_NAMES = re.compile(r"(?:.*[^a-z])?names?[^a-z0-9]*([0-9]*)[^a-z0-9]*")
#: Angles beyond two turns are degrees [rad].
_TWO_TURNS = 4.0 * np.pi
#: A unit, or what else stands in brackets at the end of a name.
_IN_BRACKETS = re.compile(r"[\[(]\s*([^\W\d][^\[\]()]{0,11})[\])]\s*$")
#: Words of torques that are currents.
_CURRENTS = {"current", "currents", "curr", "cur", "amps", "i", "iq", "strom"}
#: Steps of a clock that are longer count milliseconds [s].
_SLOWEST_STEP = 0.1


class AmbiguousColumnsError(InputError):
    """Two sets of columns are positions as well; words : of ``--rename`` for the first."""

    def __init__(self, what: str, words: str) -> None:
        super().__init__(what, f"choose with `convert --rename {words}`")
        self.words = words


@dataclass(frozen=True)
class CellTable:
    """What a file's columns hold.

    Parameters
    ----------
    kinds : "number", "text", "list", "stamp" or "empty", by the column's name
    cells : the texts of the first cells that are not empty, by the column's name
    """

    kinds: Mapping[str, str]
    cells: Mapping[str, Sequence[str]]

    def values(self, name: str) -> Array:
        """Parse the first cells of a column.

        Parameters
        ----------
        name : str
            Of the column.

        Returns
        -------
        Array
            (K,) numbers; of lists all of theirs.
        """
        text = " ".join(self.cells.get(name, ())[:50])
        numbers = re.findall(r"[-+]?[0-9]*\.?[0-9]+(?:[eE][-+]?[0-9]+)?", text)
        return np.array(numbers, float)


@dataclass(frozen=True)
class Recognition:
    """What a file of foreign names is read as.

    Parameters
    ----------
    rename : our names (t, q1 ..., or q for a block) to the file's; t to "sec+nanosec"
        where a stamp is in two parts
    scale : factors by our names, where they are not 1
    logger : what writes such files, in words
    units : what each group is in, where that is not SI, and why
    joints : their names, where the file says them
    order : of the joints of a block, where the robot's is another one
    episode : the column that counts runs
    has_other_joints : the robot's joints have other names than the file's
    """

    rename: dict[str, str]
    scale: dict[str, float]
    logger: str = "by their words"
    units: tuple[str, ...] = ()
    joints: tuple[str, ...] = ()
    order: tuple[int, ...] | None = None
    episode: str | None = None
    has_other_joints: bool = False

    @property
    def is_identity(self) -> bool:
        """Whether the file has our own names."""
        return all(
            our_name == their_name for our_name, their_name in self.rename.items()
        )

    def command(
        self,
        path: Path,
        names: Sequence[str],
        rate: float | None = None,
    ) -> str:
        """Format the command that reads the file alike.

        Parameters
        ----------
        path : Path
            Path of the file.
        names : Sequence[str]
            Of the file's columns.
        rate : float | None
            Samples a second in place of its clock [Hz].

        Returns
        -------
        str
            A command that can be pasted.
        """
        words = ["--rename", rename_words(self.rename, names)]
        if self.scale:
            words += ["--scale", scale_words(self.scale, self.rename)]
        if self.order is not None:
            words += ["--joints", ",".join(self.joints)]
        if rate is not None:
            words += ["--rate", f"{rate:.12g}"]
        return formatting.convert_command(path, *words)

    def sentence(
        self,
        path: Path,
        names: Sequence[str],
        rate: float | None = None,
    ) -> str:
        """Say what was taken for what, in which unit and why, with the command that
        repeats it.

        Parameters
        ----------
        path : Path
            Path of the file.
        names : Sequence[str]
            Of the file's columns.
        rate : float | None
            Samples a second in place of its clock [Hz].

        Returns
        -------
        str
            One sentence.
        """
        columns = ", ".join(f"{a} = {b}" for a, b in first_and_last(self.rename))
        units = "".join(f"; {unit}" for unit in self.units)
        joints = f"; joints {', '.join(self.joints)}" if self.joints else ""
        if self.joints and self.has_other_joints:
            joints += " in the file's order, for the robot's have other names"
        return (
            f"{path}: columns recognised ({self.logger}): {columns}{units}{joints};"
            f" the same by `{self.command(path, names, rate)}`"
        )


def first_and_last(rename: Mapping[str, str]) -> list[tuple[str, str]]:
    """Shorten pairs of names to the first and last of each group.

    Parameters
    ----------
    rename : Mapping[str, str]
        Our names to the file's.

    Returns
    -------
    list[tuple[str, str]]
        Pairs of texts such as q1..q6 and pos_0 .. pos_5.
    """
    groups = dict[str, list[tuple[str, str]]]()
    for our_name, their_name in rename.items():
        groups.setdefault(group_of(our_name), []).append((our_name, their_name))
    shown = list[tuple[str, str]]()
    for pairs in groups.values():
        our_first, their_first = pairs[0]
        our_last, their_last = pairs[-1]
        if len(pairs) == 1:
            shown.append((our_first, their_first))
        else:
            shown.append((f"{our_first}..{our_last}", f"{their_first} .. {their_last}"))
    return shown


def counted_from_zero(names: Sequence[str]) -> bool:
    """Tell whether columns that are called as ours are counted from 0.

    Parameters
    ----------
    names : Sequence[str]
        Of the columns.

    Returns
    -------
    bool
        True where q0, dq0 or tau0 is among them.
    """
    return bool({"q0", "dq0", "tau0", "qcmd0"} & set(names))


def has_our_names(names: Sequence[str]) -> bool:
    """Tell whether columns are called as in RUN.csv, counted from 1.

    Parameters
    ----------
    names : Sequence[str]
        Of the columns.

    Returns
    -------
    bool
        True where t, q and tau or qcmd are, one a joint.
    """
    known = set(names)
    has_positions = bool({"q", "q1"} & known)
    has_torques = bool({"tau", "tau1", "qcmd", "qcmd1"} & known)
    is_ours = "t" in known and has_positions and has_torques
    return is_ours and _are_as_many(names) and not counted_from_zero(names)


def _are_as_many(names: Sequence[str]) -> bool:
    """Whether as many columns are called q1, q2 ... as tau1, tau2 ... or commands."""
    n_columns = {
        group: sum(bool(re.fullmatch(rf"{group}[0-9]+", name)) for name in names)
        for group in ("q", "tau", "qcmd")
    }
    n_torques = n_columns["tau"] or n_columns["qcmd"]
    return 0 in (n_columns["q"], n_torques) or n_columns["q"] == n_torques


def recognise(
    names: Sequence[str],
    joints: Sequence[str] | None = None,
    table: CellTable | None = None,
) -> Recognition | None:
    """What the columns of these names are.

    Parameters
    ----------
    names : of the columns, in the file's order
    joints : names of the robot's joints in order, for columns that are called by joints
    table : what the columns hold

    Returns
    -------
    Recognition or None
        None where positions, or torques and commands, are not among them.

    Raises
    ------
    AmbiguousColumnsError
        Two sets of columns are positions as well, such as those of two arms.
    """
    usable = [n for n in names if table is None or table.kinds.get(n) != "text"]
    recognition = _by_logger(usable, names, joints, table)
    if recognition is None:
        recognition = _by_words(usable, names, joints, table)
    return None if recognition is None else _with_unit_of_clock(recognition, table)


def recognised(
    names: Sequence[str], joints: Sequence[str] | None = None
) -> Recognised | None:
    """Recognise columns by their names alone.

    Parameters
    ----------
    names : Sequence[str]
        Of the columns, in order.
    joints : Sequence[str] | None
        The robot's joint names.

    Returns
    -------
    Recognised | None
        Names and factors of :func:`recognise`; None where there is no clock either.
    """
    recognition = recognise(names, joints)
    if recognition is None or "t" not in recognition.rename:
        return None
    return recognition.rename, recognition.scale


def find_clock(names: Sequence[str]) -> str | None:
    """Find the column of a file's clock.

    Parameters
    ----------
    names : Sequence[str]
        Of the columns.

    Returns
    -------
    str | None
        Its name, "sec+nanosec" where it is in two parts; None without.
    """
    from sdp_vs_penalty.data.formats.column_names import read_name

    pair = find_two_parts(names)
    if pair is not None:
        return "+".join(pair)
    readings = [(read_name(name), name) for name in names]
    clocks = [
        (reading.rank, len(reading.other_words), name)
        for reading, name in readings
        if reading is not None and reading.quantity == "t" and reading.number is None
    ]
    return min(clocks)[2] if clocks else None


def _by_logger(
    usable: Sequence[str],
    names: Sequence[str],
    joints: Sequence[str] | None,
    table: CellTable | None,
) -> Recognition | None:
    """What a logger of the table writes; None where the file is none of theirs."""
    from sdp_vs_penalty.data.formats.loggers import LOGGERS, columns_of_logger

    for logger in LOGGERS:
        groups = columns_of_logger(logger, usable)
        clock = _first_present(logger["t"], usable)
        if clock is None or not groups:
            continue
        called, keys = _joints_of_logger(
            logger,
            list(groups["q"]),
            names,
            joints,
            table,
        )
        rename = {"t": clock}
        for group, columns in groups.items():
            for k, key in enumerate(keys, start=1):
                rename[_our_name(group, key, k)] = columns[key]
        scale, units = _units_of_logger(logger, rename, table)
        return Recognition(
            rename,
            scale,
            str(logger["name"]),
            units,
            called,
            episode=_first_present(logger.get("episode"), names),
            has_other_joints=_has_other_joints(joints, called),
        )
    return None


def _our_name(group: str, key: Hashable, number: int) -> str:
    """Our name of a column: of a block the group's alone."""
    return group if key == "" else f"{group}{number}"


def _joints_of_logger(
    logger: Mapping[str, Any],
    keys: list[Hashable],
    names: Sequence[str],
    joints: Sequence[str] | None,
    table: CellTable | None,
) -> tuple[tuple[str, ...], list[Hashable]]:
    """The joints' names where the file says them, and the keys of their columns, both
    in the robot's order."""
    from sdp_vs_penalty.data.formats.loggers import columns_of_pattern

    if keys != [""] and all(isinstance(key, str) for key in keys):
        in_order = _in_order_of(joints, [str(key) for key in keys])
        return tuple(in_order), list(in_order)
    columns = columns_of_pattern(logger.get("names"), names)
    if table is None or not columns or not set(keys) <= set(columns):
        return (), keys
    texts = [_first_cell(table, columns[key]) for key in keys]
    if len(set(texts)) != len(texts):
        return (), keys
    key_by_name = dict(zip(texts, keys, strict=True))
    called = _in_order_of(joints, texts)
    return tuple(called), [key_by_name[name] for name in called]


def _units_of_logger(
    logger: Mapping[str, Any],
    rename: Mapping[str, str],
    table: CellTable | None,
) -> tuple[dict[str, float], tuple[str, ...]]:
    """Factors by our names, and the units in words with the reason for each."""
    scale = dict[str, float]()
    units = list[str]()
    for group, unit in logger.get("units", {}).items():
        columns = {
            our_name: n for our_name, n in rename.items() if group_of(our_name) == group
        }
        why = f"as {logger['name']} writes it"
        if unit == "angle":
            unit, why = _unit_of_angles(list(columns.values()), table)
        elif unit == "clock":
            unit, why = _unit_of_clock(list(columns.values()), table)
        if columns and unit in SHARES:
            units.append(_share_sentence(group, unit))
        if not columns or unit.lower() not in UNITS:
            continue
        units.append(f"{group} in {unit}, {why}")
        factor = UNITS[unit.lower()]
        if factor != 1.0:
            scale |= dict.fromkeys(columns, factor)
    return scale, tuple(units)


def _unit_of_angles(names: Sequence[str], table: CellTable | None) -> tuple[str, str]:
    """ "deg" where the first values are beyond two turns, "rad" otherwise, and why."""
    if table is None or not names:
        return "angle", ""
    values = np.concatenate([table.values(name) for name in names])
    largest = float(np.abs(values).max(initial=0.0))
    unit = "deg" if largest > _TWO_TURNS else "rad"
    return unit, f"its first values reach {largest:.3g}"


def _unit_of_clock(names: Sequence[str], table: CellTable | None) -> tuple[str, str]:
    """ "ms" where the first steps are a tenth or more, "s" otherwise, and why: no arm is
    logged ten times a second."""
    if table is None or not names:
        return "clock", ""
    steps = np.diff(table.values(names[0]))
    usual = float(np.median(steps)) if len(steps) else 1.0
    unit = "ms" if usual >= _SLOWEST_STEP else "s"
    return unit, f"its first steps are {usual:.3g}"


def _first_present(patterns: Any, names: Sequence[str]) -> str | None:
    """The first of some names, or sums of two, that the file has."""
    from sdp_vs_penalty.data.formats.loggers import as_list

    for pattern in as_list(patterns):
        if set(parts_of(pattern, names)) <= set(names):
            return str(pattern)
    return None


def _in_order_of(joints: Sequence[str] | None, called: Sequence[str]) -> list[str]:
    """Joints' names in the robot's order where it has all of them, or they have all of
    its; in the file's order otherwise."""
    if joints is None:
        return list(called)
    places = _match_joints(joints, called)
    order = [places[joint] for joint in joints if joint in places]
    is_complete = len(order) in (len(joints), len(called))
    return order if order and is_complete else list(called)


def _has_other_joints(joints: Sequence[str] | None, called: Sequence[str]) -> bool:
    """Whether the robot's joints and the file's have no name in common."""
    return bool(joints) and not _match_joints(joints or (), called)


def _match_joints(joints: Sequence[str], called: Sequence[str]) -> dict[str, str]:
    """The file's name of each of the robot's joints: the same but for marks and capital
    letters, or the same behind one prefix that all have."""
    plain = {re.sub(r"[^a-z0-9]", "", name.lower()): name for name in called}
    plain_joints = {joint: re.sub(r"[^a-z0-9]", "", joint.lower()) for joint in joints}
    prefixes = [""]
    for name in plain:
        for text in plain_joints.values():
            if name.endswith(text):
                prefixes.append(name.removesuffix(text))
    matches = [
        {j: plain[p + text] for j, text in plain_joints.items() if p + text in plain}
        for p in dict.fromkeys(prefixes)
    ]
    return matches[0] or max(matches, key=len)


def _by_words(
    usable: Sequence[str],
    names: Sequence[str],
    joints: Sequence[str] | None,
    table: CellTable | None,
) -> Recognition | None:
    """What the words of each name say."""
    known, choice = _read_and_choose(usable, joints)
    if choice is not None and not joints:
        choice = _one_joint_of_several(known, choice, table)
    if choice is None:
        return None
    clock = find_clock(usable)
    if choice.rivals:
        raise _ambiguous(choice, clock)
    called, keys, order = _joints_of_words(
        choice.sets["q"],
        names,
        joints,
        table,
    )
    rename = {} if clock is None else {"t": clock}
    for quantity, columns in choice.sets.items():
        for k, key in enumerate(keys, start=1):
            rename[_our_name(quantity, key, k)] = columns.columns[key]
    scale = {
        our_name: known[their_name].factor
        for our_name, their_name in rename.items()
        if their_name in known and known[their_name].factor != 1.0
    }
    return Recognition(
        rename,
        scale,
        units=tuple(_units_of_words(rename, known)),
        joints=called,
        order=order,
        episode="episode_index" if "episode_index" in names else None,
        has_other_joints=_has_other_joints(joints, called),
    )


def _read_and_choose(
    usable: Sequence[str], joints: Sequence[str] | None
) -> tuple[dict[str, Reading], SetChoice | None]:
    """What the names say, and the sets of columns; without the robot's joints where only
    some of them are in the names and other words tell as many columns apart."""
    from sdp_vs_penalty.data.formats.column_names import JointNames
    from sdp_vs_penalty.data.formats.column_sets import choose_sets

    n_joints = len(joints) if joints else None
    with_joints = _readings(usable, JointNames(joints) if joints else None)
    choice = choose_sets(with_joints, n_joints)
    if choice is not None and len(choice.sets["q"].columns) == n_joints:
        return with_joints, choice
    without_joints = _readings(usable, None)
    other = choose_sets(without_joints, n_joints)
    if joints and other is not None and len(other.sets["q"].columns) == n_joints:
        return without_joints, other
    return with_joints, choice


def _one_joint_of_several(
    readings: Mapping[str, Reading],
    choice: SetChoice,
    table: CellTable | None,
) -> SetChoice:
    """The sets of "A angle" to "F angle" where "A angle" was chosen alone, because "A"
    says nothing; a column of lists holds all joints by itself."""
    from sdp_vs_penalty.data.formats.column_sets import choose_sets

    positions = choice.sets["q"]
    name = next(iter(positions.columns.values()))
    is_list = table is None or table.kinds.get(name) != "number"
    if positions.style != "block" or is_list:
        return choice
    other = choose_sets(readings, None, has_blocks=False)
    has_it = other is not None and name in other.sets["q"].columns.values()
    return other if other is not None and has_it else choice


def _readings(
    names: Sequence[str], joint_names: JointNames | None
) -> dict[str, Reading]:
    """What each name says, of those that say something."""
    from sdp_vs_penalty.data.formats.column_names import read_name

    readings = {name: read_name(name, joint_names) for name in names}
    return {name: r for name, r in readings.items() if r is not None}


def _ambiguous(choice: SetChoice, clock: str | None) -> InputError:
    """The error of columns that could be positions as well."""
    candidates = [choice.sets["q"], *choice.rivals]
    shown = " or ".join(_first_to_last(columns) for columns in candidates)
    pairs = {} if clock is None else {"t": clock}
    for quantity, columns in choice.sets.items():
        for k, (key, name) in enumerate(columns.columns.items(), start=1):
            pairs[_our_name(quantity, key, k)] = name
    words = rename_words(pairs, list(pairs.values()))
    return AmbiguousColumnsError(f"q could be {shown}", words)


def _first_to_last(columns: ColumnSet) -> str:
    names = list(columns.columns.values())
    return f"{names[0]} to {names[-1]}"


def _joints_of_words(
    positions: ColumnSet,
    names: Sequence[str],
    joints: Sequence[str] | None,
    table: CellTable | None,
) -> tuple[tuple[str, ...], list[Hashable], tuple[int, ...] | None]:
    """The joints' names, the keys of their columns in the robot's order, and the order
    of the joints within a block."""
    keys = list(positions.columns)
    if positions.style == "joint" and joints is not None:
        return tuple(joints[int(str(key))] for key in keys), keys, None
    texts = _texts_of_joints(names, table)
    if not texts:
        return (), keys, None
    called = _in_order_of(joints, texts)
    if positions.style == "block":
        order = tuple(texts.index(name) for name in called)
        return tuple(called), keys, order
    if len(texts) != len(keys):
        return (), keys, None
    key_by_name = dict(zip(texts, keys, strict=True))
    return tuple(called), [key_by_name[name] for name in called], None


def _units_of_words(
    rename: Mapping[str, str], readings: Mapping[str, Reading]
) -> list[str]:
    """The units that names end with, where they are not SI; torques that are currents."""
    units = dict[str, str]()
    for our_name, their_name in rename.items():
        reading = readings.get(their_name)
        if reading is not None and reading.factor != 1.0:
            units[group_of(our_name)] = reading.unit
    sentences = [
        f"{group} in {unit}, the unit that its name ends with"
        for group, unit in sorted(units.items())
    ]
    for our_name, their_name in rename.items():
        group = group_of(our_name)
        reading = readings.get(their_name)
        if reading is not None and reading.unit in SHARES and group not in units:
            units[group] = reading.unit
            what = (
                f"{group} is in {reading.unit} of a rating that the file does not say"
            )
            sentences.append(f"{what}: --scale {group}=... makes SI units of it")
    sentences += [
        f"the unit {unit!r} of {group} is not known: --scale {group}=... makes SI units of"
        " it"
        for group, unit in _unknown_units(rename, readings).items()
    ]
    torques = [
        readings[n] for our_name, n in rename.items() if group_of(our_name) == "tau"
    ]
    if any(_CURRENTS & set(r.words) for r in torques):
        sentences.append("tau is a current in A: --scale tau=... makes torques of it")
    return sentences


def _unknown_units(
    rename: Mapping[str, str], readings: Mapping[str, Reading]
) -> dict[str, str]:
    """What all names of a group have in brackets at their end and nobody knows, by the
    group."""
    texts = dict[str, set[str]]()
    for our_name, their_name in rename.items():
        reading = readings.get(their_name)
        match = _IN_BRACKETS.search(their_name)
        is_unknown = match is not None and reading is not None and not reading.unit
        text = match[1].strip() if match is not None and is_unknown else ""
        texts.setdefault(group_of(our_name), set()).add(text)
    return {
        group: next(iter(found))
        for group, found in texts.items()
        if len(found) == 1 and "" not in found
    }


def _share_sentence(group: str, unit: str) -> str:
    """What is to be done about values in per cent of something."""
    what = f"{group} is in {unit} of a rating that the file does not say"
    return f"{what}: --scale {group}=... makes SI units of it"


def _texts_of_joints(names: Sequence[str], table: CellTable | None) -> list[str]:
    """The joints' names in the order of their columns, where columns hold them: one
    text a joint, or a list of texts."""
    if table is None:
        return []
    columns = dict[int, str]()
    for name in names:
        match = _JOINT_NAMES.fullmatch(name.lower())
        if match is not None:
            columns[int(match[1] or -1)] = name
    texts = [_first_cell(table, columns[k]) for k in sorted(columns)]
    if list(columns) == [-1]:
        return _words_of_list(texts[0])
    is_unique = len(set(texts)) == len(texts)
    return texts if is_unique and all(texts) else []


def _first_cell(table: CellTable, name: str) -> str:
    """The first text of a column, "" without."""
    return next(iter(table.cells.get(name, ())), "")


def _words_of_list(text: str) -> list[str]:
    """The names in a list that is written as text; none of one name alone."""
    words = re.findall(r"[A-Za-z_][\w/.-]*", text)
    words = [word for word in words if word != "array"]
    return words if len(words) > 1 else []


def _with_unit_of_clock(
    recognition: Recognition, table: CellTable | None
) -> Recognition:
    """The same with the unit of its clock where it counts since 1970."""
    clock = recognition.rename.get("t")
    if table is None or clock is None or "t" in recognition.scale:
        return recognition
    if table.kinds.get(clock) != "number":
        return recognition
    values = table.values(clock)
    # Seconds since 1970 between 2001 and 2128 are 1e9 to 5e9.
    for word in ("ms", "us", "ns"):
        if len(values) and 1e9 < UNITS[word] * values[0] < 5e9:
            why = f"t in {word}, for it counts since 1970"
            return replace(
                recognition,
                scale={"t": UNITS[word], **recognition.scale},
                units=(*recognition.units, why),
            )
    return recognition
