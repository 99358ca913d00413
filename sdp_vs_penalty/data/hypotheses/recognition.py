"""Which columns of another program's log are t, q, dq, tau and so on.

What metadata say ends the question. Then come the loggers of loggers.toml, then the words
and numbers in the names (words.toml): ``actual_q_0``, ``joint_states.position[3]``,
``/joint_states/elbow_joint/effort``. Words that say nothing about a quantity (actual,
joint, field) do not count. Columns that are named alike make a set, one column a joint.
Of several sets of torques the hypotheses are weighed when their values are read. Where
two sets of positions are as good, nobody guesses.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Hashable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty import formatting
from sdp_vs_penalty.data.hypotheses.channels import (
    BY_WORDS,
    UNSAID_CURRENT,
    Recognition,
)
from sdp_vs_penalty.data.hypotheses.orders import counts_rows, rises
from sdp_vs_penalty.data.hypotheses.renaming import by_group, rename_words
from sdp_vs_penalty.data.hypotheses.sets import SetChoice, choose_sets, column_sets
from sdp_vs_penalty.data.hypotheses.weighing import (
    ANGLE,
    CLOCK,
    SERVO,
    TIME,
    ColumnHypothesis,
    unit_of_dates,
)
from sdp_vs_penalty.data.log import Column
from sdp_vs_penalty.data.words import table
from sdp_vs_penalty.data.words.joints import (
    hide_joints,
    in_order_of,
    joints_of_heading,
    match_joints,
)
from sdp_vs_penalty.data.words.loggers import clock_of, find_logger
from sdp_vs_penalty.data.words.names import (
    AMPERES,
    Meaning,
    counts_runs,
    facts_of_heading,
    is_no_measurement,
    read_bare_joint,
    read_commanded,
    read_letter,
    read_name,
    read_time_by_unit,
    unit_of,
    units_of_heading,
)
from sdp_vs_penalty.data.words.stamps import (
    find_time_of_day,
    find_two_parts,
    fraction_column,
    has_fraction,
)
from sdp_vs_penalty.data.words.tokens import OF_TIME, brief_names, group_of
from sdp_vs_penalty.data.words.units import SHARES, UNITS, units_of_name
from sdp_vs_penalty.errors import InputError

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
_CURRENTS = frozenset(table()["currents"])
#: What the channel groups are called in a sentence.
_WORDS_OF_GROUPS = {"q": "positions", "dq": "velocities", "tau": "torques"}

Columns = Mapping[str, Column]


class AmbiguousColumnsError(InputError):
    """Two sets of columns are equally good as positions, such as those of two arms.

    ``words`` holds the value of ``convert --rename`` that takes the first set.
    """

    def __init__(self, what: str, words: str) -> None:
        """Make the error; ``what`` names the sets."""
        super().__init__(what, "choose one", None, f"`convert --rename {words}`")
        self.words = words


def columns_called(names: Sequence[str]) -> dict[str, Column]:
    """Describe columns by their names alone."""
    return {name: Column("") for name in names}


def recognise(
    columns: Columns | Sequence[str],
    joints: Sequence[str] | None = None,
    heading: Sequence[str] = (),
) -> Recognition | None:
    """Recognise which column of a log is which channel, and in which unit.

    Columns of text are never channels.

    Parameters
    ----------
    columns : mapping of str to Column, or sequence of str
        The file's columns in order, or their names alone.
    joints : sequence of str, optional
        Names of the robot's joints in order: columns can be called by them.
    heading : sequence of str
        Lines above a table, which may say units.

    Returns
    -------
    Recognition or None
        None where positions, or both torques and commands, are not among the columns.

    Raises
    ------
    AmbiguousColumnsError
        Two sets of columns are equally good as positions, such as those of two arms.
    """
    if not isinstance(columns, Mapping):
        columns = columns_called(columns)
    usable = [name for name, x in columns.items() if x.kind != "text"]
    logger, said = find_logger(usable)
    outputs = list[str]()
    if logger:
        choice = choose_sets(said, None)
        clock = clock_of(logger, usable) or find_clock(columns)
        if choice and "tau" not in choice.sets:
            # Torques beside its commands are those of another version of the logger.
            by_words = _read_and_choose({x: columns[x] for x in usable}, joints)
            has_torque = by_words[1] is not None and "tau" in by_words[1].sets
            said, choice = by_words if has_torque else (said, choice)
    else:
        # What a controller puts out counts where it has no feedback beside it.
        outputs = [
            x
            for x in usable
            if _OUTPUT.search(x)
            and any(_OUTPUT.sub(word, x) in usable for word in _FEEDBACK)
        ]
        usable = [x for x in usable if x not in outputs]
        chosen = {name: columns[name] for name in usable}
        said, choice = _read_and_choose(chosen, joints)
        if choice and all(map(is_current, _torques_of(choice))):
            # Letters may be the joints' torques, which the arm weighs against currents.
            letters = {x: y for x in usable if (y := read_letter(x))}
            letters = {x: y for x, y in letters.items() if _says_nothing(said.get(x))}
            choice = choose_sets(said | letters, len(joints) if joints else None)
        clock = find_clock(chosen)
        if choice is None:
            read = partial(_read_or_commanded, quantity="tau")
            said, choice = _read_and_choose(chosen, joints, read)
        if choice is None:
            read = partial(_read_or_commanded, quantity="q")
            filled = {x: y for x, y in chosen.items() if y.kind != "empty"}
            said, choice = _read_and_choose(filled, joints, read)
            # A column that nothing names may be the torque.
            known = {*said, clock}
            if any(not (x in known or is_no_measurement(x)) for x in filled):
                choice = None
    if choice is None:
        return None
    pairs = {} if clock is None else {"t": clock}
    joint_names, keys, order, is_known = _joints_of_words(
        choice, columns, joints, heading
    )

    def by_our_names(quantity: str, names: Mapping[Hashable, str]) -> dict[str, str]:
        # The key "" marks a column that holds all joints.
        numbered = enumerate(keys, 1)
        return {
            f"{quantity}{k if key != '' else ''}": names[key] for k, key in numbered
        }

    for quantity, column_set in choice.sets.items():
        pairs |= by_our_names(quantity, column_set.columns)
    if choice.rivals:
        sets = (choice.sets["q"], *choice.rivals)
        shown = " or ".join(x.first_to_last for x in sets)
        words = rename_words(pairs, list(pairs.values()))
        raise AmbiguousColumnsError(f"q could be {shown}", words)
    torques = (
        [choice.sets["tau"], *choice.other_torques] if choice.other_torques else []
    )
    said_of = [
        f"{x} are the links' {_WORDS_OF_GROUPS[x]}, the motors' ({sets.first_to_last}) are not used"
        for x, sets in choice.left_out.items()
        if x in _WORDS_OF_GROUPS
    ]
    if any(read_commanded(x, "tau") for x in _torques_of(choice)):
        said_of.append("tau is what was commanded, for no other torque is there")
    if outputs:
        said_of.append(
            f"what the controller puts out as {brief_names(outputs)} is not used"
        )
    found = Recognition(
        pairs,
        logger=str(logger["name"]) if logger else BY_WORDS,
        torques={x.first_to_last: by_our_names("tau", x.columns) for x in torques},
        joints=joint_names,
        order=order,
        episode=episode_of(columns),
        has_other_joints=not is_known,
        inferred={"q": ANGLE} if choice.sets["q"].is_bare else {},
        said=tuple(said_of),
    )
    if not logger and clock in usable and clock not in said:
        of_unit = read_time_by_unit(clock)
        said |= {} if of_unit is None else {clock: of_unit}
    found = with_units(found, said, columns, logger, heading)
    n = len(keys) if "" not in keys else columns[choice.sets["q"].columns[""]].width
    found = with_facts(found, columns, heading, n)
    found = replace(found, unsaid=_without_unit(found, said))
    return with_unit_of_clock(found, columns)


def episode_of(columns: Columns, taken: Collection[str] = ()) -> str | None:
    """Return the first column of numbers that counts runs, of those that are not taken;
    None where there is none."""
    names = (x for x, y in columns.items() if y.kind == "number" and x not in taken)
    return next(filter(counts_runs, names), None)


def _without_unit(found: Recognition, said: Mapping[str, Meaning]) -> frozenset[str]:
    """Return those of q and tau whose unit neither names, metadata nor the program that
    wrote a file say."""
    if found.logger != BY_WORDS:
        return frozenset({"q"} if found.inferred.get("q") == SERVO else ())
    has_unit = {*found.units, *map(group_of, found.scale)}
    for ours, name in found.rename.items():
        if name in said and said[name].unit not in ("", *SHARES):
            has_unit.add(group_of(ours))
    return frozenset({"q", "tau"} - has_unit)


def find_clock(columns: Columns | Sequence[str]) -> str | None:
    """Find the column that holds a file's time stamps: "sec+nanosec" for a stamp in two
    columns, "hour+minute+second" for a time of day; None without a clock.

    Among several, those whose values do not fall win, then the best word ("time" before
    "tick"), then the name with the fewest other words. Where no name says it, the only
    column of stamps is the clock, or else an index without a name that rises in
    fractions, or else the only column of unknown words that rises evenly ("shijian").
    """
    if not isinstance(columns, Mapping):
        columns = columns_called(columns)
    names = list(columns)
    time_of_day = find_time_of_day(names)
    # The first cells of hours and minutes are whole; a clock in minutes rises in fractions.
    heads = [columns[x].head for x in time_of_day[:2]]
    if time_of_day and all(np.all(x == np.round(x)) for x in heads):
        # Another clock goes first, for its stamps may be finer; a date is none.
        others = {x: c for x, c in columns.items() if x not in time_of_day}
        other = find_clock(others) or ""
        is_number = other in others and others[other].kind == "number"
        head = others[other].head if is_number else np.zeros(0)
        stands_still = len(head) > 0 and bool(np.all(head == head[0]))
        return other if other and not stands_still else "+".join(time_of_day)
    if pair := find_two_parts(names):
        return "+".join(pair)
    kinds = {name: column.kind for name, column in columns.items()}
    said = {x: read_name(x) for x in names if kinds[x] not in ("list", "empty")}
    # Durations have such words too, and fall: "cycle_time_us" beside "timestamp".
    clocks = [
        (
            bool(np.any(np.diff(columns[name].head) < 0.0)),
            x.rank,
            len(x.other_words),
            name,
        )
        for name, x in said.items()
        if x is not None and x.quantity == "t" and x.number is None
    ]
    clock = min(clocks)[-1] if clocks else _clock_by_values(columns, said)
    if clock is None or columns[clock].kind != "stamp":
        return clock
    is_whole = not any(map(has_fraction, columns[clock].cells))
    fraction = (
        fraction_column([name for name in names if name != clock]) if is_whole else None
    )
    return f"{clock}+{fraction}" if fraction is not None else clock


def _clock_by_values(
    columns: Columns, said: Mapping[str, Meaning | None]
) -> str | None:
    """Find the clock that no name says, by its values; see :func:`find_clock`. A counter of
    rows is none, unless its name says that it counts time."""
    numbers = {x: y.head for x, y in columns.items() if y.kind == "number"}
    rising = {x: head for x, head in numbers.items() if rises(head)}
    indices = [x for x in columns if x.lower() in _NAMES_OF_INDICES]
    unknown = [
        x for x in rising if not (said[x] or is_no_measurement(x) or x in indices)
    ]
    surest_first = (
        [x for x, y in columns.items() if y.kind == "stamp"],
        [x for x in indices if x in rising and np.any(rising[x] % 1.0)][:1],
        [x for x in unknown if read_time_by_unit(x)],
        [x for x in unknown if not counts_rows(rising[x])],
    )
    return next((found[0] for found in surest_first if len(found) == 1), None)


def _read_or_commanded(name: str, quantity: str) -> Meaning | None:
    """Read what a name says was measured, else the quantity that was commanded."""
    return read_name(name) or read_commanded(name, quantity)


def _read_and_choose(
    usable: Mapping[str, Column],
    joints: Sequence[str] | None,
    read_name: Callable[[str], Meaning | None] = read_name,
) -> tuple[dict[str, Meaning], SetChoice | None]:
    """Read the columns' names, and choose the sets of columns that hold q, tau and so on.

    The names of the robot's joints say no quantity. Where they do not make all joints with
    their torques, and numbers do, these tell the joints: joint0 may be joint_1. Columns
    that are called by a joint alone are positions if no other columns are.
    """
    n_joints = len(joints) if joints else None
    single = [name for name, x in usable.items() if x.kind == "number"]
    hidden, _ = hide_joints(list(usable), joints or ())

    def read_and_choose(
        hidden: Mapping[str, str],
    ) -> tuple[dict[str, Meaning], SetChoice | None]:
        said = {name: x for name in usable if (x := read_name(hidden.get(name, name)))}
        return said, choose_sets(said, n_joints, single)

    def n_whole(choice: SetChoice | None) -> int:
        has_torque = choice is not None and "tau" in choice.sets
        return len(choice.sets["q"].columns) if choice and has_torque else 0

    said, choice = read_and_choose(hidden)
    if hidden and n_joints and n_whole(choice) < n_joints:
        by_number = read_and_choose({})
        if n_whole(by_number[1]) == n_joints:
            said, choice = by_number
    if choice is None:
        bare = said | {name: x for name in usable if (x := read_bare_joint(name))}
        choice = choose_sets(bare, n_joints, single)
        said = said if choice is None else bare
    return said, choice


def known_columns(
    columns: Columns, joints: Sequence[str] | None
) -> tuple[dict[str, list[str]], tuple[str, ...]]:
    """Return the columns of a log that lacks some channels, by the quantities that their
    names say, one a joint in the robot's order; and the joints that they name."""
    said, _ = _read_and_choose(
        {x: y for x, y in columns.items() if y.kind != "text"}, joints
    )
    found, names = dict[str, list[str]](), tuple[str, ...]()
    for quantity in ("q", "dq", "tau"):
        sets = column_sets(quantity, said, len(joints) if joints else None)
        best = next((x for x in sets if len(x.columns) > 1), None)
        if best is not None:
            choice = SetChoice({"q": best})
            in_file, keys, _, _ = _joints_of_words(choice, columns, joints)
            found[quantity] = [best.columns[key] for key in keys]
            names = names or in_file
    return found, names


def _says_nothing(said: Meaning | None) -> bool:
    """Return whether a name says nothing, or a clock with a number: "T1" is no clock."""
    return said is None or (said.quantity == "t" and said.number is not None)


def _torques_of(choice: SetChoice) -> list[str]:
    """List the columns of the chosen torques."""
    return list(choice.sets["tau"].columns.values()) if "tau" in choice.sets else [""]


def _joints_of_words(
    choice: SetChoice,
    columns: Columns,
    joints: Sequence[str] | None,
    heading: Sequence[str] = (),
) -> tuple[tuple[str, ...], list[Hashable], tuple[int, ...] | None, bool]:
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
    is_known : bool
        False where robot and file both name joints, and the names do not match.
    """
    positions = choice.sets["q"]
    keys = list(positions.columns)
    if positions.style == "name":
        _, joint_of = hide_joints((), joints or ())
        words = (x for x in keys if isinstance(x, tuple))
        in_file = [
            " ".join(joint_of.get(str(x), str(x)) for x in part) for part in words
        ]
    else:
        named = [x for name in positions.columns.values() for x in columns[name].joints]
        in_file = named or joints_in_cells(columns)
    if positions.style == "number" and not in_file:
        in_file = joints_of_heading(heading, joints or (), len(keys))
    if positions.style == "number" and not in_file:
        in_file = _with_numbers(joints or (), positions.columns.values())
    in_order, is_known = in_order_of(joints, in_file)
    if in_file and positions.style == "block":
        order = tuple(in_file.index(x) for x in in_order.values())
        return tuple(in_order.values()), keys, order, is_known
    if len(in_file) != len(keys):
        return (), keys, None, True
    key_by_name = dict(zip(in_file, keys, strict=True))
    return tuple(in_order), [key_by_name[x] for x in in_order.values()], None, is_known


def _with_numbers(joints: Sequence[str], names: Collection[str]) -> list[str]:
    """List the robot's joints that have the numbers of the columns, if the robot has
    further joints, such as a gripper that was not logged; none otherwise."""
    numbers = ["".join(re.findall("[0-9]+", x)[-1:]) for x in names]
    found = match_joints(joints, numbers, by_numbers=True)
    by_number = {y: x for x, y in found.items()}
    is_clear = len(by_number) == len(numbers) < len(joints)
    return [by_number[x] for x in numbers] if is_clear else []


def with_units(
    found: Recognition,
    said: Mapping[str, Meaning],
    columns: Columns,
    logger: Mapping[str, Any] = MappingProxyType({}),
    heading: Sequence[str] = (),
) -> Recognition:
    """Add the unit of each channel group, and what the user has to know of it.

    What metadata say goes before what a known logger writes, this before the ends of the
    columns' names, and these before the lines above the table. "angle", "servo" and
    "clock" show in the values; the size of a share of a rating only the user knows.
    """
    scale, units, inferred = {**found.scale}, {**found.units}, {**found.inferred}
    remarks, torque_unit = list[str](), ""
    groups, of_logger = by_group(found.rename), logger.get("units", {})
    in_heading = units_of_heading(heading)
    for group, pairs in groups.items():
        named = {
            x: (said[y].unit, said[y].factor)
            for x, y in pairs.items()
            if y in said and said[y].unit
        }
        for x in [x for x in pairs if named and x not in named]:
            # "rail_pos_in" beside "arm_pos_deg": a word where no neighbour has a unit
            if told := unit_of(re.split(r"[\W_]+", pairs[x])[-1], group):
                named[x] = told
        stated = {
            x: told
            for x, y in pairs.items()
            if y in columns and (told := unit_of(columns[y].unit, group))
        }
        unit, why, factors = "", "", dict[str, float]()
        if group in in_heading and not any(
            SHARES.get(x, 1.0) for x, _ in named.values()
        ):
            named = {}  # steps of an encoder, whose size the lines above say
        if stated:
            unit, factors = _joined(stated)
            why = "as the file's metadata say"
        elif group in of_logger:
            unit, why = of_logger[group], f"as {logger['name']} writes it"
        elif named:
            unit, factors = _joined(named)
            why = "the unit that its name ends with"
        elif group in in_heading:
            unit, factor = in_heading[group]
            why, factors = "the lines above the table", dict.fromkeys(pairs, factor)
        elif bracket := _unknown_unit(pairs.values(), said):
            remarks.append(
                f"{group} is in {bracket!r}, a unit that is not known: --scale"
                f" {group}=... makes SI units of it"
            )
        is_open = unit in SHARES and {*factors.values()} <= {1.0}
        if group == "tau" and (is_open or (not named and unit.lower() in AMPERES)):
            torque_unit = unit if is_open else "A"
        if is_open:
            remarks.append(
                f"{group} is in {unit}, whose size the file does not say: --scale"
                f" {group}=... makes SI units of it"
            )
        elif unit in (ANGLE, CLOCK, SERVO):
            inferred[group] = unit
        elif unit and not (named and {*factors.values()} == {1.0}):
            factor = UNITS.get(unit.lower(), 1.0)
            factors = factors or dict.fromkeys(pairs, factor)
            scale |= {x: y for x, y in factors.items() if y != 1.0}
            units[group] = ColumnHypothesis(unit, 1.0, why)
            inferred.pop(group, None)
    if not logger:
        remarks += _of_motors(groups)
    torques = groups.get("tau", {}).values()
    # One alone may have its joint's letter: trq_a, trq_b, ...
    if torques and all(map(is_current, torques)) and "tau" not in of_logger:
        torque_unit = "A"
        has_unit = "tau" in units or any(x in said and said[x].unit for x in torques)
        of_unit = "in A" if has_unit else UNSAID_CURRENT
        remarks.append(
            f"tau is a current {of_unit}: --scale tau=... makes torques of it"
        )
    return replace(
        found,
        scale=scale,
        units=units,
        inferred=inferred,
        said=(*remarks, *found.said),
        torque_unit=torque_unit,
    )


#: Words of a line whose numbers are of joints, behind the gear.
_AT_JOINTS = re.compile(r"(?i)\b(incl\w*|with|output|joint|gelenk|abtrieb)")


#: What says that all was logged at the motors.
_AT_MOTORS = re.compile(r"(?i)\b(motor side|motorseit\w*|at the motors?)\b")


def with_facts(
    found: Recognition, columns: Columns, heading: Sequence[str], n: int
) -> Recognition:
    """Bring channels to SI units of the n joints by the numbers that the lines above the
    table say (:func:`facts_of_heading`).

    Channels are shares of rated torques, currents, motions and torques of motors behind
    gears, and counts of encoders. The numbers stand in the order of the columns.
    """
    facts = facts_of_heading(heading, n)
    if found.joints and {"q1", f"q{n}"} <= {*found.rename}:
        in_file = [[*columns].index(found.rename[f"q{k}"]) for k in range(1, n + 1)]
        places = np.argsort(np.argsort(in_file))
        facts = {x: ([y[k] for k in places], line) for x, (y, line) in facts.items()}
    unit = found.units.get("q")
    if "zero" in facts and unit is not None and SHARES.get(unit.answer) == 0.0:
        numbers, line = facts["zero"]
        found = replace(
            found, zeros=tuple(numbers), said=(_said_above("q", [line]), *found.said)
        )
    names = {x: " ".join(y.values()) for x, y in by_group(found.rename).items()}
    are_all = any(map(_AT_MOTORS.search, heading))
    are_of_motors = {
        x for x, text in names.items() if are_all or "motor" in text.lower()
    }
    lines, factors = list[str](), dict[str, NDArray[Any]]()
    kind = "constant" if found.torque_unit == "A" else "rated"
    if found.torque_unit and kind in facts and SHARES.get(found.torque_unit, 1.0):
        numbers, line = facts[kind]
        factors["tau"] = SHARES.get(found.torque_unit, 1.0) * np.array(numbers)
        lines.append(line)
        is_of_motor = kind == "constant" or "motor" in line.lower()
        are_of_motors |= {"tau"} if is_of_motor else set()
        are_of_motors -= {"tau"} if _AT_JOINTS.search(line) else set()
    is_torque = not found.torque_unit or "tau" in factors
    if "ratio" in facts and is_torque:
        ratios, line = np.array(facts["ratio"][0]), facts["ratio"][1]
        for group in [x for x in names if x in are_of_motors]:
            # A gear multiplies torques by its ratio, and divides motions.
            power = 1.0 if group == "tau" else -1.0
            factors[group] = factors.get(group, 1.0) * ratios**power
            lines = [*dict.fromkeys([*lines, line])]
    for group, factor in factors.items():
        own = np.array(found.factors(group, n))
        found = found.with_factors(group, (own * factor).tolist())
    if not factors:
        return found
    # These sentences ask for the factors that the lines have said.
    begins = tuple(f"{x} {y}" for x in factors for y in ("is ", "are the motors'"))
    said = _said_above(formatting.words([*factors]), lines)
    kept = [x for x in found.said if not x.startswith(begins)]
    return replace(found, said=(said, *kept), torque_unit="")


def _said_above(groups: str, lines: Sequence[str]) -> str:
    """Say which groups are in SI by which lines above the table."""
    text = formatting.words([repr(x.strip("#/% ")[:80]) for x in lines])
    return f"{groups} of the joints in SI, as the lines above say: {text}"


def _joined(units: Mapping[str, tuple[str, float]]) -> tuple[str, dict[str, float]]:
    """Return the units of columns as one text, and their factors to SI by our names."""
    texts = dict.fromkeys(text for text, _ in units.values())
    return " and ".join(texts), {x: factor for x, (_, factor) in units.items()}


def _unknown_unit(names: Iterable[str], said: Mapping[str, Meaning]) -> str:
    """Return what stands in brackets at the end of all of some names; "" where it
    differs, or they say a unit that is known."""
    matches = [_IN_BRACKETS.search(OF_TIME.sub("", x)) for x in names if x in said]
    texts = {match[1].strip() if match else "" for match in matches}
    return texts.pop() if len(texts) == 1 else ""


def _of_motors(groups: Mapping[str, Mapping[str, str]]) -> list[str]:
    """Say what the names of motors' positions or torques mean behind a gear."""
    q, tau = (
        any("motor" in x.lower() for x in groups.get(group, {}).values())
        for group in ("q", "tau")
    )
    if q:
        behind = "" if tau else " (--joint-torque: tau is the joints' already)"
        ratios = ",".join(f"RATIO {x}" for x in groups["q"])
        return [
            f"q are the motors' positions: behind a gear, --motors '{ratios}' makes the"
            f" joints' of them{behind}"
        ]
    said = (
        "tau are the motors' torques: behind a gear, --scale tau=... makes the joints'"
    )
    return [f"{said} of them"] if tau else []


def units_of_chosen(
    found: Recognition, columns: Columns, heading: Sequence[str] = ()
) -> Recognition:
    """Add the units that names of chosen columns end with, that metadata say, and the
    lines above the table."""
    said = dict[str, Meaning]()
    for ours, name in found.rename.items():
        group = group_of(ours)
        unit = next((x for x in units_of_name(name) if x.quantity == group), None)
        if unit is not None and unit.factor != 1.0 and name in columns:
            said[name] = Meaning(group, 0, unit=unit.text, factor=unit.factor)
    return with_units(found, said, columns, heading=heading)


def is_current(name: str) -> bool:
    """Return whether a torque's column is a motor current by its name: by a word, or by
    its unit."""
    said = read_name(name)
    return said is not None and (
        not _CURRENTS.isdisjoint(said.words) or said.unit in AMPERES
    )


def with_torque(found: Recognition, columns: Mapping[str, str]) -> Recognition:
    """Return the recognition with other columns of torques, by our names, and what their
    names say about their unit."""
    if columns.items() <= found.rename.items():
        return found
    kept = found.without_unit("tau")
    others = tuple(x for x in found.said if not x.startswith("tau "))
    said = {x: y for x in columns.values() if (y := read_name(x)) is not None}
    torques = with_units(Recognition(dict(columns)), said, {})
    return replace(
        kept,
        rename={**kept.rename, **columns},
        scale={**kept.scale, **torques.scale},
        units={**kept.units, **torques.units},
        said=(*torques.said, *others),
        torque_unit=torques.torque_unit,
    )


def joints_in_cells(columns: Columns) -> list[str]:
    """Find the joints' names in columns of text, in the order of the columns' numbers;
    empty where there are none, or names repeat."""
    cells = [
        next(iter(columns[x].cells), "") for x in columns_of_joint_names(list(columns))
    ]
    texts = joints_of_texts(cells)
    return texts if len({*texts}) == len(texts) and all(texts) else []


def columns_of_joint_names(names: Sequence[str]) -> list[str]:
    """Find the columns that hold joints' names: "name0", "name1" ..., one joint each, by
    their numbers; or "name", with a list of all names in each cell."""
    matches = [(_JOINT_NAMES.fullmatch(name.lower()), name) for name in names]
    numbered = {int(m[1] or -1): name for m, name in matches if m}
    return [numbered[number] for number in sorted(numbered)]


def joints_of_texts(texts: Sequence[str]) -> list[str]:
    """Read the joints' names of one row, from its cells in the columns of
    :func:`columns_of_joint_names`: one name a cell, or the names of a list in the only
    cell; none for a list of fewer than two names."""
    if len(texts) != 1:
        return list(texts)
    words = [x for x in re.findall(r"[A-Za-z_][\w/.-]*", texts[0]) if x != "array"]
    return words if len(words) > 1 else []


def with_unit_of_clock(found: Recognition, columns: Columns) -> Recognition:
    """Add the unit of a clock whose stamps are dates in that unit, say of a time of day
    in several columns that the date is not read, and mark a unit that nothing says."""
    clock = found.rename.get("t", "")
    if clock not in columns and clock.count("+") > 1:
        said = (
            "t is the time of day, of hours, minutes and seconds; the date is not read"
        )
        return replace(found, said=(*found.said, said))
    meaning = read_name(clock)
    is_stated = meaning is not None and bool(meaning.unit)
    is_stated |= "t" in {**found.scale, **found.units}
    if clock not in columns or columns[clock].kind != "number" or is_stated:
        return found
    dated = unit_of_dates(columns[clock].head)
    if dated is None:
        return replace(found, inferred={"t": TIME, **found.inferred})
    return found.with_unit("t", replace(dated, why=f"for {dated.why}"))
