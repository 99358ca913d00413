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
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from sdp_vs_penalty import formatting
from sdp_vs_penalty.data.formats.inferred_units import (
    ANGLE,
    CLOCK,
    SERVO,
    unit_of_angles,
    unit_of_clock,
    unit_of_dates,
    unit_of_servo,
)
from sdp_vs_penalty.data.formats.renaming import (
    group_of,
    parts_of,
    rename_words,
    scale_words,
)
from sdp_vs_penalty.data.formats.stamps import (
    find_time_of_day,
    find_two_parts,
    fraction_column,
    has_fraction,
)
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
#: What tables call an index that has no name.
_NAMES_OF_INDICES = ("", "index", "unnamed: 0", "__index_level_0__", "row")
#: A unit, or what else stands in brackets at the end of a name.
_IN_BRACKETS = re.compile(r"[\[(]\s*([^\W\d][^\[\]()]{0,11})[\])]\s*$")
#: The part of a controller's state that it puts out, and those that it measures.
_OUTPUT = re.compile(r"\boutput\b")
_FEEDBACK = ("feedback", "actual")
#: Words of torques that are currents.
_CURRENTS = {"current", "currents", "curr", "cur", "amps", "i", "iq", "strom"}


class AmbiguousColumnsError(InputError):
    """Two sets of columns are equally good as positions, such as those of two arms.

    ``words`` holds the value of ``convert --rename`` that takes the first set.
    """

    def __init__(self, what: str, words: str) -> None:
        """Make the error that several sets of columns are equally good as positions.

        ``what`` names the sets, for the message. ``words`` is the value of ``convert
        --rename`` that takes the first set; the remedy shows it, and callers read it
        again.
        """
        super().__init__(what, f"choose with `convert --rename {words}`")
        self.words = words


@dataclass(frozen=True)
class CellTable:
    """Kinds and first cells of a file's columns, as the recogniser needs them."""

    #: "number", "text", "list", "stamp" or "empty", by the column's name.
    kinds: Mapping[str, str]
    #: Texts of the first cells that are not empty, by the column's name.
    cells: Mapping[str, Sequence[str]]
    #: Units that the file's metadata say, by the column's name.
    units: Mapping[str, str] = field(default_factory=dict)

    def values(self, name: str) -> Array:
        """Return the numbers in the first 50 cells of a column that are not empty.

        Returns
        -------
        Array
            (K,) numbers; where cells hold lists, the numbers of all lists in one row.
        """
        text = " ".join(self.cells.get(name, ())[:50])
        numbers = re.findall(r"[-+]?[0-9]*\.?[0-9]+(?:[eE][-+]?[0-9]+)?", text)
        return np.array(numbers, float)


@dataclass(frozen=True)
class Recognition:
    """Which column of a foreign file is which channel, in which unit and why."""

    #: The file's names by ours (t, q1 ..., or q for a block); that of t is "sec+nanosec"
    #: where a stamp is in two parts, "hour+minute+second" for a time of day.
    rename: dict[str, str]
    #: Factors to SI by our names, where they are not 1.
    scale: dict[str, float]
    #: The program that writes such files, or how the columns were recognised, in words.
    logger: str = "by their words"
    #: Sentences on the units that are not SI, with the reasons.
    units: tuple[str, ...] = ()
    #: ANGLE, SERVO or CLOCK by channel group, of units that the first cells suggest.
    inferred: Mapping[str, str] = field(default_factory=dict)
    #: Names of the joints, where the file says them.
    joints: tuple[str, ...] = ()
    #: Places of the robot's joints within a block, where the orders differ.
    order: tuple[int, ...] | None = None
    #: Name of the column that counts runs.
    episode: str | None = None
    #: Whether the robot's joints have other names than the file's.
    has_other_joints: bool = False
    #: "A" where the torques are motor currents, by their words.
    torque_unit: str = ""

    @property
    def is_identity(self) -> bool:
        """Whether all columns already have our names (t, q1, tau1 ...), so that nothing
        was guessed."""
        return all(
            our_name == their_name for our_name, their_name in self.rename.items()
        )

    def with_units(self, units: Mapping[str, tuple[str, str]]) -> Recognition:
        """Return the recognition with other units of some channel groups.

        Parameters
        ----------
        units : mapping of str to (str, str)
            Unit and reason by channel group.

        Returns
        -------
        Recognition
            With their factors and sentences.
        """
        scale = {k: x for k, x in self.scale.items() if group_of(k) not in units}
        begins = tuple(f"{group} in " for group in units)
        sentences = [text for text in self.units if not text.startswith(begins)]
        for group, (unit, reason) in units.items():
            names = [name for name in self.rename if group_of(name) == group]
            sentences.append(f"{group} in {unit}, {reason}")
            factor = UNITS.get(unit, 1.0)
            if factor != 1.0:
                scale |= dict.fromkeys(names, factor)
        return replace(self, scale=scale, units=tuple(sentences))

    def command(
        self,
        path: Path,
        names: Sequence[str],
        rate: float | None = None,
        scale: Mapping[str, str] | None = None,
        options: Sequence[str] = (),
    ) -> str:
        """Format the `convert` command that states this reading of the columns
        explicitly.

        Parameters
        ----------
        names : Sequence[str]
            Names of the file's columns.
        rate : float | None
            Sampling rate that replaces the file's clock [Hz].
        scale : Mapping[str, str] | None
            Units and factors that the user gave, by our names.
        options : Sequence[str]
            Further words of the command that is running.

        Returns
        -------
        str
            A command for the shell; "" if there is none, because the user scales a
            channel whose unit was recognised, too: one factor is written a channel.
        """
        words = ["--rename", rename_words(self.rename, names)]
        given = scale or {}
        if {group_of(name.rstrip("*")) for name in given} & set(
            map(group_of, self.scale)
        ):
            return ""
        factors = [scale_words(self.scale, self.rename)] if self.scale else []
        factors += [f"{name}={factor}" for name, factor in given.items()]
        if factors:
            words += ["--scale", ",".join(factors)]
        if self.order is not None:
            words += ["--joints", ",".join(self.joints)]
        if rate is not None:
            words += ["--rate", f"{rate:.12g}"]
        words += options
        return formatting.convert_command(path, *words)

    def sentence(
        self,
        path: Path,
        names: Sequence[str],
        rate: float | None = None,
        scale: Mapping[str, str] | None = None,
        options: Sequence[str] = (),
        has_file: bool = True,
    ) -> str:
        """Format the remark on the recognised columns: which column was taken for which
        channel, in which unit and why, and the command that states the same.

        Parameters
        ----------
        names : Sequence[str]
            Names of the file's columns.
        rate : float | None
            Sampling rate that replaces the file's clock [Hz].
        has_file : bool
            False for a data frame, which no command converts.
        """
        pairs = first_and_last(self.rename)
        columns = ", ".join(f"{ours} = {theirs}" for ours, theirs in pairs)
        units = "".join(f"; {unit}" for unit in self.units)
        joints = f"; joints {', '.join(self.joints)}" if self.joints else ""
        if self.joints and self.has_other_joints:
            joints += " in the file's order, for the robot's have other names"
        command = self.command(path, names, rate, scale, options)
        repeated = f"; the same by `{command}`" if command and has_file else ""
        return (
            f"{path}: columns recognised ({self.logger}): {columns}{units}{joints}"
            f"{repeated}"
        )


def first_and_last(rename: Mapping[str, str]) -> list[tuple[str, str]]:
    """Shorten a renaming for a message: of each channel group the first and the last
    column.

    Parameters
    ----------
    rename : Mapping[str, str]
        The file's names by our names (t, q1, tau1 ...).

    Returns
    -------
    list[tuple[str, str]]
        One pair a group, such as ("q1..q6", "pos_0 .. pos_5").
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
    """Return whether columns with our names count the joints from 0 (q0, tau0) instead
    of 1.

    Returns
    -------
    bool
        True where q0, dq0, tau0 or qcmd0 is among them.
    """
    return bool({"q0", "dq0", "tau0", "qcmd0"} & set(names))


def has_our_names(names: Sequence[str]) -> bool:
    """Return whether a file has the names of RUN.csv, so that nothing needs to be
    recognised.

    Returns
    -------
    bool
        True where t, positions (q or q1 ...) and torques or commands are there, for the
        same number of joints, counted from 1.
    """
    known = set(names)
    has_positions = bool({"q", "q1"} & known)
    has_torques = bool({"tau", "tau1", "qcmd", "qcmd1"} & known)
    is_ours = "t" in known and has_positions and has_torques
    return is_ours and _has_equal_counts(names) and not counted_from_zero(names)


def _has_equal_counts(names: Sequence[str]) -> bool:
    """Return whether q1, q2 ... are as many columns as tau1, tau2 ... (or qcmd1, ...).

    A group that is one block, or is missing, has no numbered column and is not
    compared.
    """
    n_columns = {
        group: sum(bool(re.fullmatch(rf"{group}[0-9]+", name)) for name in names)
        for group in ("q", "tau", "qcmd")
    }
    n_positions = n_columns["q"]
    n_torques = n_columns["tau"] or n_columns["qcmd"]
    if n_positions == 0 or n_torques == 0:
        return True
    return n_positions == n_torques


def recognise(
    names: Sequence[str],
    joints: Sequence[str] | None = None,
    table: CellTable | None = None,
) -> Recognition | None:
    """Recognise which column of a foreign log is which channel, and in which unit.

    The column names of known loggers are tried first, then the words in the names.
    Columns of text are never channels.

    Parameters
    ----------
    names : sequence of str
        Names of the columns, in the file's order.
    joints : sequence of str, optional
        Names of the robot's joints in order: columns can be called by them.
    table : CellTable, optional
        Kinds and first cells of the columns; they tell degrees from radians, say.

    Returns
    -------
    Recognition or None
        None where positions, or both torques and commands, are not among the columns.

    Raises
    ------
    AmbiguousColumnsError
        Two sets of columns are equally good as positions, such as those of two arms.
    """
    kinds = {} if table is None else table.kinds
    usable = [name for name in names if kinds.get(name) != "text"]
    recognition = _by_logger(usable, names, joints, table)
    if recognition is None:
        outputs = _outputs_beside_feedback(usable)
        measured = [name for name in usable if name not in outputs]
        recognition = _by_words(measured, names, joints, table)
        if recognition is not None and outputs:
            said = f"what the controller puts out as {_shortened(outputs)} is not used"
            recognition = replace(recognition, units=(*recognition.units, said))
    return None if recognition is None else _with_unit_of_clock(recognition, table)


def _shortened(names: Sequence[str]) -> str:
    """List columns for a message: of those that differ by their numbers alone, the first
    and the last."""
    families = dict[str, list[str]]()
    for name in names:
        families.setdefault(re.sub("[0-9]+", "*", name), []).append(name)
    shown = [
        family[0] if len(family) == 1 else f"{family[0]} .. {family[-1]}"
        for family in families.values()
    ]
    return ", ".join(shown)


def _outputs_beside_feedback(names: Sequence[str]) -> list[str]:
    """List the columns of a controller's output that have a column of its feedback
    beside them: "output/effort[0]" beside "feedback/effort[0]"."""
    known = set(names)
    return [
        name
        for name in names
        if _OUTPUT.search(name)
        and any(_OUTPUT.sub(word, name) in known for word in _FEEDBACK)
    ]


def recognised(
    names: Sequence[str], joints: Sequence[str] | None = None
) -> Recognised | None:
    """Recognise which column is which channel by the columns' names alone.

    Parameters
    ----------
    names : Sequence[str]
        Names of the columns, in the file's order.
    joints : Sequence[str] | None
        Names of the robot's joints in order.

    Returns
    -------
    Recognised | None
        The file's names, and factors to SI, both by our names (t, q1, tau1 ...). None
        where positions, torques or the clock are not recognised.
    """
    recognition = recognise(names, joints)
    if recognition is None or "t" not in recognition.rename:
        return None
    return recognition.rename, recognition.scale


def find_clock(names: Sequence[str], table: CellTable | None = None) -> str | None:
    """Find the column that holds a file's time stamps.

    Among several, the best word wins ("time" before "tick"), then the name with the
    fewest other words. Where no name says it, the only column of stamps is the clock, or
    else an index without a name that rises in fractions, or else the only column of
    unknown words that ends with a unit of time and rises ("run_minutes").

    Parameters
    ----------
    table : CellTable | None
        Kinds and first cells of the columns.

    Returns
    -------
    str | None
        The column's name; "sec+nanosec" for a stamp in two columns,
        "hour+minute+second" for a time of day in three; None without a clock.
    """
    from sdp_vs_penalty.data.formats.column_names import read_name

    time_of_day = find_time_of_day(names) or ()
    if not _are_whole(time_of_day[:2], table):
        time_of_day = ()
    if time_of_day:
        # Another clock goes first, for its stamps may be finer; a date is none.
        others = [name for name in names if name not in time_of_day]
        other = find_clock(others, table)
        is_clock = other is not None and not _stands_still(other, table)
        return other if is_clock else "+".join(time_of_day)
    pair = find_two_parts(names)
    if pair is not None:
        return "+".join(pair)
    clocks = list[tuple[int, int, str]]()  # the smallest is the best
    for name in names:
        reading = read_name(name)
        if reading is None or reading.quantity != "t" or reading.number is not None:
            continue
        clocks.append((reading.rank, len(reading.other_words), name))
    clock = min(clocks)[2] if clocks else None
    if table is None:
        return clock
    for find in (_clock_without_name, _clock_by_unit):
        clock = find(names, table) if clock is None else clock
    stamps = table.cells.get(clock, ()) if clock is not None else ()
    if table.kinds.get(clock or "") == "stamp" and not any(map(has_fraction, stamps)):
        fraction = fraction_column([name for name in names if name != clock])
        return f"{clock}+{fraction}" if fraction is not None else clock
    return clock


def _are_whole(names: Sequence[str], table: CellTable | None) -> bool:
    """Return whether the first cells of columns hold whole numbers, as those of hours and
    minutes do; a clock in minutes rises in fractions. True without cells."""
    if table is None or not names:
        return True
    values = np.concatenate([table.values(name) for name in names])
    return bool(np.all(values == np.round(values)))


def _stands_still(name: str, table: CellTable | None) -> bool:
    """Return whether the first cells of a column hold one number; False without
    cells."""
    if table is None or table.kinds.get(name) != "number":
        return False
    values = table.values(name)
    return len(values) > 0 and bool(np.all(values == values[0]))


def _clock_by_unit(names: Sequence[str], table: CellTable) -> str | None:
    """Return the only column that ends with a unit of time, "run_minutes", says nothing
    else that is known, and whose first values rise; None without one, or with several."""
    from sdp_vs_penalty.data.formats.column_names import read_name, read_time_by_unit

    clocks = list[str]()
    for name in names:
        says_time_alone = (
            read_name(name) is None and read_time_by_unit(name) is not None
        )
        values = table.values(name) if says_time_alone else np.zeros(0)
        if len(values) > 2 and np.all(np.diff(values) > 0.0):
            clocks.append(name)
    return clocks[0] if len(clocks) == 1 else None


def _clock_without_name(names: Sequence[str], table: CellTable) -> str | None:
    """Return the only column of stamps, or an index without a name that rises in
    fractions; None where the file has neither. Whole numbers count rows."""
    stamps = [name for name in names if table.kinds.get(name) == "stamp"]
    if len(stamps) == 1:
        return stamps[0]
    for name in names:
        if name.lower() in _NAMES_OF_INDICES and table.kinds.get(name) == "number":
            values = table.values(name)
            rises = len(values) > 2 and bool(np.all(np.diff(values) > 0.0))
            if rises and np.any(values != np.round(values)):
                return name
    return None


def _by_logger(
    usable: Sequence[str],
    names: Sequence[str],
    joints: Sequence[str] | None,
    table: CellTable | None,
) -> Recognition | None:
    """Recognise a file by the loggers that are known (loggers.toml); None where none
    wrote it.

    ``usable`` are the columns that can hold numbers, ``names`` all columns: those of
    text can hold the joints' names.
    """
    from sdp_vs_penalty.data.formats.loggers import LOGGERS, columns_of_logger

    found = [(logger, columns_of_logger(logger, usable)) for logger in LOGGERS]
    # A logger whose torques are there goes before one of which only positions and
    # their commands are: two loggers may differ in the name of the torques alone.
    found.sort(key=lambda entry: "tau" not in (entry[1] or {}))
    for logger, groups in found:
        clock = _first_present(logger["t"], usable)
        if clock is None or not groups:
            continue
        keys_in_file = list(groups["q"])
        joint_names, keys = _joints_of_logger(
            logger, keys_in_file, names, joints, table
        )
        # The file's names by ours: t, q1, q2 ..., tau1 ....
        rename = {"t": clock}
        for group, columns in groups.items():
            for k, key in enumerate(keys, start=1):
                rename[_our_name(group, key, k)] = columns[key]
        scale, units = _units_of_logger(logger, rename, table)
        inferred = {
            group: unit
            for group, unit in logger.get("units", {}).items()
            if unit in (ANGLE, CLOCK, SERVO)
            and any(group_of(x) == group for x in rename)
            and _stated_unit(group, rename, table) is None
        }
        return Recognition(
            rename,
            scale,
            logger=str(logger["name"]),
            units=units,
            inferred=inferred,
            joints=joint_names,
            episode=_first_present(logger.get("episode"), names),
            has_other_joints=_has_other_joints(joints, joint_names),
        )
    return None


def _our_name(group: str, key: Hashable, number: int) -> str:
    """Return our name of a joint's column, "q3".

    The key "" marks a column that holds all joints: its name is the group's, "q".
    """
    return group if key == "" else f"{group}{number}"


def _joints_of_logger(
    logger: Mapping[str, Any],
    keys: list[Hashable],
    names: Sequence[str],
    joints: Sequence[str] | None,
    table: CellTable | None,
) -> tuple[tuple[str, ...], list[Hashable]]:
    """Find the joints' names in a known logger's file, and put the joints in the
    robot's order.

    ``keys`` tell the joints of the position columns apart: names, numbers, or "" for
    one column with all joints. Names stand in the columns' names, or in text columns of
    their own (the logger's pattern "names").

    Returns
    -------
    joint_names : tuple of str
        Empty where the file does not name its joints.
    keys : list
        The given keys, in the order of ``joint_names`` where there are some.
    """
    from sdp_vs_penalty.data.formats.loggers import columns_of_pattern

    are_keys_names = keys != [""] and all(isinstance(key, str) for key in keys)
    if are_keys_names:
        in_order = _in_order_of(joints, [str(key) for key in keys])
        return tuple(in_order), list(in_order)
    name_columns = columns_of_pattern(logger.get("names"), names)
    has_names = bool(name_columns) and set(keys) <= set(name_columns)
    if table is None or not has_names:
        return (), keys
    names_in_file = [_first_cell(table, name_columns[key]) for key in keys]
    if len(set(names_in_file)) != len(names_in_file):
        return (), keys
    key_by_name = dict(zip(names_in_file, keys, strict=True))
    joint_names = _in_order_of(joints, names_in_file)
    return tuple(joint_names), [key_by_name[name] for name in joint_names]


def _units_of_logger(
    logger: Mapping[str, Any], rename: Mapping[str, str], table: CellTable | None
) -> tuple[dict[str, float], tuple[str, ...]]:
    """Find the units of a known logger's columns.

    An entry of loggers.toml gives a unit for each channel group; "angle" and "clock"
    mean that the unit shows in the first values.

    Returns
    -------
    scale : dict of str to float
        Factors to SI by our names, where they are not 1.
    sentences : tuple of str
        The unit of each group and the reason for it, for the remark to the user.
    """
    scale = dict[str, float]()
    sentences = list[str]()
    for group, unit in logger.get("units", {}).items():
        our_names = [name for name in rename if group_of(name) == group]
        columns = [rename[name] for name in our_names]
        if not columns:
            continue
        why = f"as {logger['name']} writes it"
        stated = _stated_unit(group, rename, table)
        if stated is not None:
            unit, why = stated, "as the file's metadata say"
        elif unit in (ANGLE, CLOCK, SERVO):
            unit, why = _inferred_unit(unit, columns, table)
        if unit in SHARES:
            sentences.append(_share_sentence(group, unit))
        if unit.lower() not in UNITS:
            continue
        sentences.append(f"{group} in {unit}, {why}")
        factor = UNITS[unit.lower()]
        if factor != 1.0:
            scale |= dict.fromkeys(our_names, factor)
    return scale, tuple(sentences)


def _stated_unit(
    group: str, rename: Mapping[str, str], table: CellTable | None
) -> str | None:
    """Return the unit that the file's metadata say of a channel group's columns; None
    where they say none."""
    if table is None:
        return None
    columns = [name for ours, name in rename.items() if group_of(ours) == group]
    units = {table.units.get(name, "").lower() for name in columns}
    unit = units.pop() if len(units) == 1 else ""
    return unit if unit in UNITS or unit in SHARES else None


def _inferred_unit(
    kind: str, names: Sequence[str], table: CellTable | None
) -> tuple[str, str]:
    """Guess the unit of columns (ANGLE, SERVO or CLOCK) by their first values, with the
    reason as a phrase; without values the unit stays open."""
    if table is None or not names:
        return kind, ""
    if kind == CLOCK:
        return unit_of_clock(table.values(names[0]))
    values = np.concatenate([table.values(name) for name in names])
    return unit_of_servo(values) if kind == SERVO else unit_of_angles(values)


def episode_of(names: Sequence[str]) -> str | None:
    """Return the first column that counts runs by the name that a known logger gives it;
    None where there is none."""
    from sdp_vs_penalty.data.formats.loggers import LOGGERS

    found = (_first_present(logger.get("episode"), names) for logger in LOGGERS)
    return next((name for name in found if name is not None), None)


def _first_present(patterns: Any, names: Sequence[str]) -> str | None:
    """Return the first of some column names that the file has, as an entry of
    loggers.toml lists them; "sec+nanosec" needs both columns. None where the file has
    no such column."""
    from sdp_vs_penalty.data.formats.loggers import as_list

    for pattern in as_list(patterns):
        if set(parts_of(pattern, names)) <= set(names):
            return str(pattern)
    return None


def _in_order_of(
    joints: Sequence[str] | None, names_in_file: Sequence[str]
) -> list[str]:
    """Return the file's names of the joints, in the order of the robot's joints where
    these are there.

    The order of the file is kept where there is no robot, or where neither all of the
    robot's joints are among the file's nor the other way round.
    """
    return _matched(joints, names_in_file) or list(names_in_file)


def _has_other_joints(
    joints: Sequence[str] | None, names_in_file: Sequence[str]
) -> bool:
    """Return whether robot and file both name joints, and the names do not match."""
    is_named = bool(joints) and bool(names_in_file)
    return is_named and not _matched(joints, names_in_file)


def _matched(joints: Sequence[str] | None, names_in_file: Sequence[str]) -> list[str]:
    """List the file's names of the joints in the robot's order; empty unless all joints
    of the robot, or all of the file, match."""
    from sdp_vs_penalty.data.formats.joint_names import match_joints

    name_in_file = match_joints(joints or (), names_in_file, by_numbers=True)
    is_complete = len(name_in_file) in (len(joints or ()), len(names_in_file))
    return list(name_in_file.values()) if is_complete else []


def _by_words(
    usable: Sequence[str],
    names: Sequence[str],
    joints: Sequence[str] | None,
    table: CellTable | None,
) -> Recognition | None:
    """Recognise a file by the words in its columns' names; None where they say no
    positions, or neither torques nor commands.

    ``usable`` are the columns that can hold numbers, ``names`` all columns.
    """
    from sdp_vs_penalty.data.formats.column_names import read_time_by_unit

    readings, choice = _read_and_choose(usable, joints)
    if choice is not None and not joints:
        choice = _one_joint_of_several(readings, choice, table)
    if choice is None:
        return None
    clock = find_clock(usable, table)
    if clock is not None and clock in usable and clock not in readings:
        by_unit = read_time_by_unit(clock)
        readings = readings if by_unit is None else {**readings, clock: by_unit}
    if choice.rivals:
        raise _ambiguous(choice, clock)
    positions = choice.sets["q"]
    joint_names, keys, order = _joints_of_words(positions, names, joints, table)
    rename = {} if clock is None else {"t": clock}
    for quantity, column_set in choice.sets.items():
        for k, key in enumerate(keys, start=1):
            rename[_our_name(quantity, key, k)] = column_set.columns[key]
    scale = {
        our_name: readings[their_name].factor
        for our_name, their_name in rename.items()
        if their_name in readings and readings[their_name].factor != 1.0
    }
    recognition = Recognition(
        rename,
        scale,
        units=(*_units_of_words(rename, readings), *_left_out(choice)),
        joints=joint_names,
        order=order,
        episode=episode_of(names),
        has_other_joints=_has_other_joints(joints, joint_names),
        torque_unit="A" if _torques_are_currents(rename, readings) else "",
    )
    if table is None or not positions.is_bare:
        return recognition
    # Nothing says the unit of "j1" either: ABB, KUKA and Staubli log degrees.
    unit_and_reason = _inferred_unit(ANGLE, list(positions.columns.values()), table)
    with_unit = recognition.with_units({"q": unit_and_reason})
    return replace(with_unit, inferred={"q": ANGLE})


def _read_and_choose(
    usable: Sequence[str], joints: Sequence[str] | None
) -> tuple[dict[str, Reading], SetChoice | None]:
    """Read the columns' names, and choose the sets of columns that hold q, tau and so
    on.

    The names are read twice: with the robot's joint names as words that they can hold,
    and without. The second reading is taken where only it gives as many columns as the
    robot has joints.

    Returns what each name says, and the choice (None where there is no set of
    positions).
    """
    from sdp_vs_penalty.data.formats.column_names import JointNames
    from sdp_vs_penalty.data.formats.column_sets import choose_sets

    n_joints = len(joints) if joints else None
    bare = _bare_joints(usable)
    if bare and choose_sets(_readings(usable, None), n_joints) is None:
        readings = _readings(usable, None) | bare
        return readings, choose_sets(readings, n_joints)
    with_joints = _readings(usable, JointNames(joints) if joints else None)
    choice = choose_sets(with_joints, n_joints)
    if choice is not None and len(choice.sets["q"].columns) == n_joints:
        return with_joints, choice
    without_joints = _readings(usable, None)
    other_choice = choose_sets(without_joints, n_joints)
    if joints and other_choice is not None:
        n_columns = len(other_choice.sets["q"].columns)
        if n_columns == n_joints:
            return without_joints, other_choice
    return with_joints, choice


def _one_joint_of_several(
    readings: Mapping[str, Reading], choice: SetChoice, table: CellTable | None
) -> SetChoice:
    """Correct a choice that took one joint's column for the column of all joints.

    Of the columns "A angle" to "F angle", the word "A" says nothing, so "A angle" looks
    like a block with all joints. Where it holds single numbers instead of lists, the
    set in which a word tells the joints apart is chosen instead.
    """
    from sdp_vs_penalty.data.formats.column_sets import choose_sets

    positions = choice.sets["q"]
    name = next(iter(positions.columns.values()))
    holds_single_numbers = table is not None and table.kinds.get(name) == "number"
    if positions.style != "block" or not holds_single_numbers:
        return choice
    without_blocks = choose_sets(readings, None, has_blocks=False)
    if without_blocks is None:
        return choice
    is_one_of_several = name in without_blocks.sets["q"].columns.values()
    return without_blocks if is_one_of_several else choice


def _readings(
    names: Sequence[str], joint_names: JointNames | None
) -> dict[str, Reading]:
    """Read what each column's name says; names that say nothing are left out."""
    from sdp_vs_penalty.data.formats.column_names import read_name

    readings = {name: read_name(name, joint_names) for name in names}
    return {name: r for name, r in readings.items() if r is not None}


def _bare_joints(names: Sequence[str]) -> dict[str, Reading]:
    """Read the columns whose names say nothing but a joint's number as positions."""
    from sdp_vs_penalty.data.formats.column_names import read_bare_joint

    readings = {name: read_bare_joint(name) for name in names}
    return {name: r for name, r in readings.items() if r is not None}


def _ambiguous(choice: SetChoice, clock: str | None) -> InputError:
    """Return the error of column sets that are equally good as positions."""
    candidates = [choice.sets["q"], *choice.rivals]
    shown = " or ".join(_first_to_last(columns) for columns in candidates)
    pairs = {} if clock is None else {"t": clock}
    for quantity, columns in choice.sets.items():
        for k, (key, name) in enumerate(columns.columns.items(), start=1):
            pairs[_our_name(quantity, key, k)] = name
    words = rename_words(pairs, list(pairs.values()))
    return AmbiguousColumnsError(f"q could be {shown}", words)


def _first_to_last(columns: ColumnSet) -> str:
    """Format a set of columns by its first and last name, for a message."""
    names = list(columns.columns.values())
    return f"{names[0]} to {names[-1]}"


def _joints_of_words(
    positions: ColumnSet,
    names: Sequence[str],
    joints: Sequence[str] | None,
    table: CellTable | None,
) -> tuple[tuple[str, ...], list[Hashable], tuple[int, ...] | None]:
    """Find the joints' names in a file that was recognised by words, and put the joints
    in the robot's order.

    Returns
    -------
    joint_names : tuple of str
        Empty where the file does not name its joints.
    keys : list
        What tells the joints' columns apart, in the order of ``joint_names``.
    order : tuple of int, or None
        Where one column holds all joints: the place, in its lists, of each joint.
    """
    keys = list(positions.columns)
    if positions.style == "joint" and joints is not None:
        return tuple(joints[int(str(key))] for key in keys), keys, None
    if positions.style == "name" and joints is not None:
        key_of_name = {_words_of_key(key): key for key in positions.columns}
        in_order = _in_order_of(joints, list(key_of_name))
        return tuple(in_order), [key_of_name[name] for name in in_order], None
    names_in_file = _texts_of_joints(names, table)
    if not names_in_file:
        return (), keys, None
    in_order = _in_order_of(joints, names_in_file)
    if positions.style == "block":
        order = tuple(names_in_file.index(name) for name in in_order)
        return tuple(in_order), keys, order
    if len(names_in_file) != len(keys):
        return (), keys, None
    key_by_name = dict(zip(names_in_file, keys, strict=True))
    return tuple(in_order), [key_by_name[name] for name in in_order], None


def _words_of_key(key: Hashable) -> str:
    """Return what tells a column apart that is called by words: "left wrist 2"."""
    parts = key if isinstance(key, tuple) else (key,)
    return " ".join(part for part in map(str, parts) if part != "None")


def _units_of_words(
    rename: Mapping[str, str], readings: Mapping[str, Reading]
) -> list[str]:
    """Format what the columns' names say about units, one sentence each: units other
    than SI, per cent of a rating, unknown units, positions of motors, and torques that
    are motor currents.
    """
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
            sentences.append(_share_sentence(group, reading.unit))
    sentences += [
        f"the unit {unit!r} of {group} is not known: --scale {group}=... makes SI units of"
        " it"
        for group, unit in _unknown_units(rename, readings).items()
    ]
    position_columns = [
        n for our_name, n in rename.items() if group_of(our_name) == "q"
    ]
    if any("motor" in name.lower() for name in position_columns):
        sentences.append(
            "q are the motors' positions: behind a gear, --motors makes the joints' of them"
        )
    torque_columns = [
        n for our_name, n in rename.items() if group_of(our_name) == "tau"
    ]
    are_motors = [any("motor" in x.lower() for x in position_columns)]
    are_motors += [any("motor" in x.lower() for x in torque_columns)]
    if are_motors == [False, True]:
        sentences.append(
            "tau are the motors' torques: behind a gear, --scale tau=... makes the joints'"
            " of them"
        )
    if _torques_are_currents(rename, readings):
        sentences.append("tau is a current in A: --scale tau=... makes torques of it")
    return sentences


def _torques_are_currents(
    rename: Mapping[str, str], readings: Mapping[str, Reading]
) -> bool:
    """Tell whether columns that are taken for torques are called currents."""
    names = [n for our_name, n in rename.items() if group_of(our_name) == "tau"]
    return any(_CURRENTS & set(readings[name].words) for name in names)


def _left_out(choice: SetChoice) -> list[str]:
    """Format which columns of the motors were left out for those of the links, one
    sentence a quantity, and which other torques of the same joints there are."""
    what = {"q": "positions", "dq": "velocities", "tau": "torques"}
    others = [_first_to_last(columns) for columns in choice.other_torques]
    not_used = f"not used, of the same joints: {formatting.words(others or ['none'])}"
    sentences = [f"{not_used}: name them in --rename to take them"] if others else []
    return sentences + [
        f"{quantity} are the links' {what[quantity]}, the motors'"
        f" ({_first_to_last(columns)}) are not used"
        for quantity, columns in choice.left_out.items()
        if quantity in what
    ]


def _unknown_units(
    rename: Mapping[str, str], readings: Mapping[str, Reading]
) -> dict[str, str]:
    """Find the text in brackets that ends all names of a channel group and is no unit
    known here.

    Returns the text by the channel group (q, tau, ...).
    """
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
    """Format the remark on values in per cent of a rating: only the user knows the
    factor to SI."""
    what = f"{group} is in {unit} of a rating that the file does not say"
    return f"{what}: --scale {group}=... makes SI units of it"


def _texts_of_joints(names: Sequence[str], table: CellTable | None) -> list[str]:
    """Find the joints' names in text columns, in the order of the columns' numbers.

    Such columns are called "name0", "name1" ..., one joint each, or "name", with a list
    of all names in each cell. Empty where there are no such columns, or names repeat.
    """
    if table is None:
        return []
    texts = [_first_cell(table, name) for name in columns_of_joint_names(names)]
    texts = joints_of_texts(texts)
    is_unique = len(set(texts)) == len(texts)
    return texts if is_unique and all(texts) else []


def columns_of_joint_names(names: Sequence[str]) -> list[str]:
    """Find the columns that hold joints' names.

    Parameters
    ----------
    names : Sequence[str]
        Names of the file's columns.

    Returns
    -------
    list of str
        "name0", "name1" ..., one joint each, by their numbers; or "name", with a list
        of all names.
    """
    without_number = -1
    columns = dict[int, str]()
    for name in names:
        match = _JOINT_NAMES.fullmatch(name.lower())
        if match is not None:
            number = int(match[1]) if match[1] else without_number
            columns[number] = name
    return [columns[number] for number in sorted(columns)]


def joints_of_texts(texts: Sequence[str]) -> list[str]:
    """Read the joints' names of one row, from its cells in the columns of
    :func:`columns_of_joint_names`.

    There is one name a cell, or the names of a list in the only cell; none without
    cells, and for a list of fewer than two names.
    """
    return _words_of_list(texts[0]) if len(texts) == 1 else list(texts)


def _first_cell(table: CellTable, name: str) -> str:
    """Return the first cell of a column that is not empty; "" where the column has
    none."""
    return next(iter(table.cells.get(name, ())), "")


def _words_of_list(text: str) -> list[str]:
    """Split the text of a list of names, "['j1', 'j2']"; empty for fewer than two
    names."""
    words = re.findall(r"[A-Za-z_][\w/.-]*", text)
    words = [word for word in words if word != "array"]
    return words if len(words) > 1 else []


def _with_unit_of_clock(
    recognition: Recognition, table: CellTable | None
) -> Recognition:
    """Add the unit of a clock whose stamps are dates in that unit, and say of a time of
    day in several columns that the date is not read."""
    clock = recognition.rename.get("t")
    known = () if table is None else table.kinds
    if clock is not None and clock not in known and clock.count("+") > 1:
        said = (
            "t is the time of day, of hours, minutes and seconds; the date is not read"
        )
        return replace(recognition, units=(*recognition.units, said))
    if table is None or clock is None or "t" in recognition.scale:
        return recognition
    if table.kinds.get(clock) != "number":
        return recognition
    dated = unit_of_dates(table.values(clock))
    if dated is None:
        return recognition
    unit, why = dated
    return replace(
        recognition,
        scale={"t": UNITS[unit], **recognition.scale},
        units=(*recognition.units, f"t in {unit}, for {why}"),
    )
