"""Columns of one quantity that belong together: one a joint, named alike."""

import re
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, field, replace

from sdp_vs_penalty.data.formats.column_names import WORDS, Reading, split_tokens

#: How columns can be told apart, the surest first.
_STYLES = ("joint", "number", "block", "name")
#: Words of what is measured at the motor, before the gear, and of what is at the link.
_MOTOR_WORDS = frozenset({"motor", "motors", "mot", "actuator", "drive", "rotor"})
_LINK_WORDS = frozenset({"link", "joint", "arm", "load", "l", "j"})
#: Symbols that mean the motor only beside columns with a link's symbol, or without one:
#: q_m beside q_l. Alone, q_m is what was measured.
_MOTOR_SYMBOLS = {"qm": "q", "m": ""}
_LINK_SYMBOLS = {"ql": "q", **dict.fromkeys(_LINK_WORDS, "")}


@dataclass(frozen=True)
class ColumnSet:
    """Columns of one quantity that belong together, one for each joint."""

    #: Quantity: "q", "dq", "tau", "temp" or "qcmd".
    quantity: str
    #: Place of the set's word in the list of the quantity's words, 0 for the best.
    rank: int
    #: What tells the joints apart: "joint" (the robot's joint names), "number", "block"
    #: (one column holds all joints), "name" (other words).
    style: str
    #: Further words that all its names share.
    other_words: tuple[str, ...]
    #: The file's names by joint, number or words, in the order of the joints.
    columns: dict[Hashable, str]
    #: Words of its names that say the quantity.
    n_words: int = 1

    @property
    def keys(self) -> frozenset[Hashable]:
        """What tells the columns apart: the robot's joints (from 0), the numbers, or
        the words in their names."""
        return frozenset(self.columns)

    @property
    def is_bare(self) -> bool:
        """Whether the names say nothing but the joints' numbers, "j1"."""
        return self.rank > len(WORDS[self.quantity])

    @property
    def preference(self) -> tuple[int, int, int, int]:
        """Sort key among the sets of one quantity; the smallest wins.

        In this order: rank of the word that says the quantity (0 for the most certain
        word), number of further words in the names, those of the quantity among them,
        style (how the names tell the joints apart), and minus the size, so that the
        larger set wins.
        """
        style = _STYLES.index(self.style)
        n_further = len(self.other_words) + max(self.n_words, 1) - 1
        return self.rank, n_further, style, -len(self.columns)


def column_sets(quantity: str, readings: Mapping[str, Reading]) -> list[ColumnSet]:
    """Collect the columns of one quantity into sets with one column for each joint.

    A column can stand in several sets, of different styles.

    Parameters
    ----------
    quantity : str
        q, dq, tau, temp or qcmd.
    readings : Mapping[str, Reading]
        What each column's name says, by the name.

    Returns
    -------
    list[ColumnSet]
        The sets whose numbers have no gap, the best first.
    """
    of_quantity = {
        name: reading
        for name, reading in readings.items()
        if reading.quantity == quantity
    }
    # Names by style, rank of the best word, further words, and further words of the
    # quantity: "TorqueCur" is a torque that is a current, "Torque" says that alone.
    groups = dict[tuple[str, int, tuple[str, ...], int], list[str]]()
    for name, reading in of_quantity.items():
        for style, other_words in _styles_of(reading):
            key = style, reading.rank, other_words, len(reading.words)
            groups.setdefault(key, []).append(name)
    sets = list[ColumnSet]()
    for (style, rank, other_words, n_words), names in groups.items():
        for columns in _sets_of_names(quantity, style, names, of_quantity):
            sets.append(ColumnSet(quantity, rank, style, other_words, columns, n_words))
    return sorted(sets, key=lambda column_set: column_set.preference)


def _sets_of_names(
    quantity: str, style: str, names: Sequence[str], readings: Mapping[str, Reading]
) -> list[dict[Hashable, str]]:
    """Make sets of columns, each with one column for each joint, of some names.

    The names share a style (how they tell the joints apart: "joint", "number", "name"
    or "block") and their further words. Usually they are one set. Motors and links have
    two columns for each joint (motor_pos_1 and link_pos_1), so they are split by these
    words. Position columns with other ways of numbering are split by their names.

    Returns the columns by joint, number or words; an empty list if they are no set.
    """
    columns = _columns_by_joint(style, names, readings)
    if columns:
        return [columns]
    split_sets = _sets_of_parts(style, _by_side(names), readings)
    if not split_sets and quantity == "q" and style == "number":
        parts = [part for part in _named_alike(names) if len(part) < len(names)]
        split_sets = _sets_of_parts(style, parts, readings)
    return split_sets


def _sets_of_parts(
    style: str, parts: Sequence[Sequence[str]], readings: Mapping[str, Reading]
) -> list[dict[Hashable, str]]:
    """Make a set of columns of each part of the names; without the parts that are no
    set."""
    sets = [_columns_by_joint(style, part, readings) for part in parts]
    return [columns for columns in sets if columns]


def _by_side(names: Sequence[str]) -> list[list[str]]:
    """Split columns by the words and symbols for motors and links in their names."""
    sides = dict[frozenset[str], list[str]]()
    known = {*_MOTOR_WORDS, *_LINK_WORDS, *_MOTOR_SYMBOLS}
    for name in names:
        sides.setdefault(frozenset(known & set(split_tokens(name))), []).append(name)
    return list(sides.values()) if len(sides) > 1 else []


def is_of_motors(columns: ColumnSet, others: Sequence[ColumnSet]) -> bool:
    """Return whether a set of columns was measured at the motors, where another set was
    measured at the links.

    Parameters
    ----------
    others : Sequence[ColumnSet]
        All sets of that quantity, of which those with the same joints count.

    Returns
    -------
    bool
        By a word in the names, or by the symbol m beside l, j or no symbol.
    """
    tokens = _words_of(columns)
    beside = [
        _words_of(other)
        for other in others
        if other.keys == columns.keys and other.columns != columns.columns
    ]
    if _MOTOR_WORDS & set(tokens):
        return any(not _MOTOR_WORDS & set(other) for other in beside)
    if not set(_MOTOR_SYMBOLS) & set(tokens):
        return False
    stem = _without_symbols(tokens, _MOTOR_SYMBOLS)
    return any(
        _without_symbols(other, _LINK_SYMBOLS) == stem and other != tokens
        for other in beside
    )


def _words_of(columns: ColumnSet) -> list[str]:
    """List the words in the name of a set's first column."""
    name = next(iter(columns.columns.values()))
    return [token for token in split_tokens(name) if token.isalpha()]


def _without_symbols(tokens: Sequence[str], symbols: Mapping[str, str]) -> list[str]:
    """Return tokens without the symbols for motors or links: "q" of "ql", "q m"."""
    return [x for token in tokens if (x := symbols.get(token, token))]


def _named_alike(names: Sequence[str]) -> list[list[str]]:
    """Split columns into lists that differ by their last number alone: motor_pos_1
    stands with motor_pos_2, not with link_pos_1."""
    groups = dict[str, list[str]]()
    for name in names:
        stem = re.sub(r"[0-9]+([^0-9]*)$", r"*\1", name)
        groups.setdefault(stem, []).append(name)
    return list(groups.values())


def _styles_of(reading: Reading) -> list[tuple[str, tuple[str, ...]]]:
    """List the styles of the sets to which a column can belong, each with the further
    words that all columns of the set share.

    The style says what tells the joints apart: "joint" (the robot's joint names),
    "number", "name" (further words, so that the columns share none) or "block" (one
    column with all joints). Example: [("name", ()), ("number", ("left",))] for
    "left_q_1".
    """
    if reading.joint is not None:
        return [("joint", reading.other_words)]
    styles = list[tuple[str, tuple[str, ...]]]([("name", ())])
    if reading.number is None:
        styles.append(("block", reading.other_words))
    else:
        styles.append(("number", reading.other_words))
    return styles


def _columns_by_joint(
    style: str, names: Sequence[str], readings: Mapping[str, Reading]
) -> dict[Hashable, str]:
    """Order the columns of one set by what tells their joints apart: {0: "q_1", 1:
    "q_2"}.

    By style that is the robot's joint ("joint"), a number ("number", from 0 in the
    result), the further words of the name ("name"), or "" for one column that holds all
    joints ("block"). Empty if the columns are no set: two columns of one joint, numbers
    with a gap, several blocks, or a single "name".
    """
    if style == "block":
        return {"": names[0]} if len(names) == 1 else {}
    columns = {_key_of(style, readings[name]): name for name in names}
    if len(columns) != len(names):
        return {}
    if style == "name":
        is_numbered = all(readings[name].number is not None for name in names)
        return {} if is_numbered or len(columns) < 2 else columns
    in_order = {key: columns[key] for key in sorted(columns)}  # type: ignore[type-var]
    return _from_zero(in_order) if style == "number" else in_order


def _key_of(style: str, reading: Reading) -> Hashable:
    """Return what tells a column's joint apart in a set of this style: the robot's
    joint from 0 ("joint"), a number ("number"), or the further words and the number of
    its name ("name")."""
    if style == "joint":
        return reading.joint
    if style == "number":
        return reading.number
    return (*reading.other_words, str(reading.number))


def _from_zero(columns: Mapping[Hashable, str]) -> dict[Hashable, str]:
    """Renumber columns from 0 where their numbers begin at 0 or 1 and have no gap;
    empty otherwise."""
    numbers = list(columns)
    n_columns = len(columns)
    from_zero = list(range(n_columns))
    from_one = list(range(1, n_columns + 1))
    if numbers not in (from_zero, from_one):
        return {}
    return dict(enumerate(columns.values()))


@dataclass(frozen=True)
class SetChoice:
    """The chosen set of each quantity."""

    #: The chosen sets by quantity.
    sets: dict[str, ColumnSet]
    #: Other sets of positions that are equally good; the user has to choose among them.
    rivals: tuple[ColumnSet, ...] = ()
    #: Sets of the motors, by quantity, in whose place those of the links are taken.
    left_out: Mapping[str, ColumnSet] = field(default_factory=dict)
    #: Further sets of torques of the same joints.
    other_torques: tuple[ColumnSet, ...] = ()


def choose_sets(
    readings: Mapping[str, Reading], n_joints: int | None, *, has_blocks: bool = True
) -> SetChoice | None:
    """Choose the set of position columns, and the sets of torques, velocities and so on
    that have the same joints.

    Positions without torques or commands for the same joints are no candidates. Among
    the candidates the preference of the positions decides. Sets of the motors are taken
    only where the links have none.

    Parameters
    ----------
    readings : Mapping[str, Reading]
        What each column's name says, by the name.
    n_joints : int | None
        Number of the robot's joints. Columns that are called by its joints have to name
        two of them.
    has_blocks : bool
        Whether one column may hold all joints, a list in each cell.

    Returns
    -------
    SetChoice | None
        The sets by quantity, and rivals that are equally good; None without a
        candidate.
    """
    sets_of_quantity = {
        quantity: column_sets(quantity, readings)
        for quantity in WORDS
        if quantity != "t"
    }
    of_motors = {
        quantity: [x for x in sets if is_of_motors(x, sets)]
        for quantity, sets in sets_of_quantity.items()
    }
    sets_of_quantity = {
        quantity: [x for x in sets if x not in of_motors[quantity]]
        for quantity, sets in sets_of_quantity.items()
    }
    torques = sets_of_quantity["tau"]
    candidates = list[dict[str, ColumnSet]]()
    for positions in _without_undriven_joints(sets_of_quantity["q"], torques):
        if not _is_candidate(positions, n_joints, has_blocks):
            continue
        candidate = _with_partners(positions, sets_of_quantity)
        if {"tau", "qcmd"} & set(candidate):
            candidates.append(candidate)
    if not candidates:
        return None
    # One column with all joints gives way to a column for each joint of the robot.
    fits_robot = [
        candidate
        for candidate in candidates
        if candidate["q"].style == "name" and len(candidate["q"].columns) == n_joints
    ]
    is_block = candidates[0]["q"].style == "block"
    if is_block and n_joints != 1 and fits_robot:
        candidates = fits_robot
    best, *others = candidates
    rivals = [
        other["q"] for other in others if other["q"].preference == best["q"].preference
    ]
    left_out = {
        quantity: columns
        for quantity, sets in of_motors.items()
        for columns in sets
        if quantity in best and columns.keys >= best[quantity].keys
    }
    return SetChoice(best, tuple(rivals), left_out, _other_torques(best, torques))


def _other_torques(
    chosen: Mapping[str, ColumnSet], torques: Sequence[ColumnSet]
) -> tuple[ColumnSet, ...]:
    """Return the sets of torques of the same joints that were not chosen, each once."""
    if "tau" not in chosen:
        return ()
    seen = set(chosen["tau"].columns.values())
    out = list[ColumnSet]()
    for columns in torques:
        names = set(columns.columns.values())
        if columns.keys >= chosen["tau"].keys and not names & seen:
            out.append(columns)
            seen |= names
    return tuple(out)


def _is_candidate(positions: ColumnSet, n_joints: int | None, has_blocks: bool) -> bool:
    """Return whether a set of positions may be chosen: it names two of the robot's
    joints or more where it is called by them (those of one arm of two), and is a block
    only where blocks are allowed."""
    if positions.style == "joint":
        return len(positions.columns) >= min(2, n_joints or 0)
    return positions.style != "block" or has_blocks


def _with_partners(
    positions: ColumnSet, sets_of_quantity: Mapping[str, Sequence[ColumnSet]]
) -> dict[str, ColumnSet]:
    """Return the chosen set of each quantity by its name: the given set of positions,
    and for the other quantities the set with equal joints."""
    chosen = {"q": positions}
    for quantity, column_sets_of_it in sets_of_quantity.items():
        if quantity == "q":
            continue
        partner = _partner_of(positions, column_sets_of_it)
        if partner is not None:
            chosen[quantity] = partner
    return chosen


def _without_undriven_joints(
    position_sets: Sequence[ColumnSet], torque_sets: Sequence[ColumnSet]
) -> list[ColumnSet]:
    """Leave joints without a torque column, such as a gripper's, out of the position
    sets.

    This concerns sets that are called by the robot's joints, and only where more than
    half of the joints have a torque. Other sets are returned as they are.
    """
    driven_joints = [
        torques.keys for torques in torque_sets if torques.style == "joint"
    ]
    out = list[ColumnSet]()
    for positions in position_sets:
        joints = positions.keys
        most_of_them = [
            driven
            for driven in driven_joints
            if driven < joints and 2 * len(driven) > len(joints)
        ]
        is_as_it_is = joints in driven_joints or not most_of_them
        if positions.style != "joint" or is_as_it_is:
            out.append(positions)
            continue
        driven = most_of_them[0]
        columns = {key: x for key, x in positions.columns.items() if key in driven}
        out.append(replace(positions, columns=columns))
    return out


def _partner_of(
    positions: ColumnSet, candidates: Sequence[ColumnSet]
) -> ColumnSet | None:
    """Find the set of another quantity that has the same joints as the positions.

    A set that shares the positions' further words ("left arm") is preferred. Its
    columns are put in the order of the positions. None where no set has the joints.
    """
    partners = list[ColumnSet]()
    for candidate in candidates:
        has_same_joints = candidate.keys == positions.keys
        has_more_joints = candidate.keys > positions.keys
        is_by_joint = candidate.style == positions.style == "joint"
        if has_same_joints or (is_by_joint and has_more_joints):
            partners.append(candidate)
    if not partners:
        return None

    def preference(partner: ColumnSet) -> tuple[bool, tuple[int, int, int, int]]:
        """Sort key; the smallest wins: equal further words come first."""
        return partner.other_words != positions.other_words, partner.preference

    best = min(partners, key=preference)
    columns_in_order = {key: best.columns[key] for key in positions.columns}
    return replace(best, columns=columns_in_order)
