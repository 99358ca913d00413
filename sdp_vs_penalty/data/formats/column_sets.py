"""Columns of one quantity that belong together: one a joint, named alike."""

import re
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, replace

from sdp_vs_penalty.data.formats.column_names import WORDS, Reading

#: How columns can be told apart, the surest first.
_STYLES = ("joint", "number", "block", "name")


@dataclass(frozen=True)
class ColumnSet:
    """Columns of one quantity.

    Parameters
    ----------
    quantity : q, dq, tau, temp or qcmd
    rank : of its word
    style : "joint" (columns hold the robot's joints' names), "number", "block" (one
        column), "name" (other words tell them apart)
    other_words : what all names hold besides
    columns : the file's names by joint, number or words, in the order of the joints
    """

    quantity: str
    rank: int
    style: str
    other_words: tuple[str, ...]
    columns: dict[Hashable, str]

    @property
    def keys(self) -> frozenset[Hashable]:
        """What its joints are told apart by."""
        return frozenset(self.columns)

    @property
    def preference(self) -> tuple[int, int, int, int]:
        """Smaller is better: the word, the words besides, the style, the size."""
        style = _STYLES.index(self.style)
        return self.rank, len(self.other_words), style, -len(self.columns)


def column_sets(quantity: str, readings: Mapping[str, Reading]) -> list[ColumnSet]:
    """Collect the sets of columns of one quantity, one column a joint.

    Parameters
    ----------
    quantity : str
        q, dq, tau, temp or qcmd.
    readings : Mapping[str, Reading]
        What each column's name says.

    Returns
    -------
    list[ColumnSet]
        Sets without gaps in their numbers, the best first.
    """
    of_quantity = {
        name: reading
        for name, reading in readings.items()
        if reading.quantity == quantity
    }
    groups = dict[tuple[str, int, tuple[str, ...]], list[str]]()
    for name, reading in of_quantity.items():
        for style, other_words in _styles_of(reading):
            groups.setdefault((style, reading.rank, other_words), []).append(name)
    sets = list[ColumnSet]()
    for (style, rank, other_words), names in groups.items():
        columns = _columns_by_joint(style, names, of_quantity)
        if columns:
            sets.append(ColumnSet(quantity, rank, style, other_words, columns))
        elif quantity == "q" and style == "number":
            for alike in _named_alike(names):
                columns = _columns_by_joint(style, alike, of_quantity)
                if columns and len(alike) < len(names):
                    sets.append(ColumnSet(quantity, rank, style, other_words, columns))
    return sorted(sets, key=lambda columns: columns.preference)


def _named_alike(names: Sequence[str]) -> list[list[str]]:
    """Columns that differ by their last number alone: motor_pos_1 and link_pos_1 do by
    more."""
    groups = dict[str, list[str]]()
    for name in names:
        stem = re.sub(r"[0-9]+([^0-9]*)$", r"*\1", name)
        groups.setdefault(stem, []).append(name)
    return list(groups.values())


def _styles_of(reading: Reading) -> list[tuple[str, tuple[str, ...]]]:
    """The styles that a name can be of, with the words that its set shares."""
    if reading.joint is not None:
        return [("joint", reading.other_words)]
    styles = list[tuple[str, tuple[str, ...]]]([("name", ())])
    if reading.number is None:
        styles.append(("block", reading.other_words))
    else:
        styles.append(("number", reading.other_words))
    return styles


def _columns_by_joint(
    style: str,
    names: Sequence[str],
    readings: Mapping[str, Reading],
) -> dict[Hashable, str]:
    """Columns of one set by their joint, in the joints' order; empty where two columns
    name one joint, where numbers have gaps, or where the style needs another count."""
    if style == "block":
        return {"": names[0]} if len(names) == 1 else {}
    columns = {_key_of(style, readings[name]): name for name in names}
    if len(columns) != len(names):
        return {}
    if style == "name":
        is_numbered = all(readings[name].number is not None for name in names)
        return {} if is_numbered or len(columns) < 2 else columns
    in_order = {k: columns[k] for k in sorted(columns)}  # type: ignore[type-var]
    return _from_zero(in_order) if style == "number" else in_order


def _key_of(style: str, reading: Reading) -> Hashable:
    """What tells a column's joint from others: the joint, its number, or other words."""
    if style == "joint":
        return reading.joint
    if style == "number":
        return reading.number
    return (*reading.other_words, str(reading.number))


def _from_zero(columns: Mapping[Hashable, str]) -> dict[Hashable, str]:
    """Columns that are counted from 0 or 1 without a gap, from 0; none otherwise."""
    numbers = list(columns)
    first = numbers[0]
    is_whole = first in (0, 1) and numbers == list(range(first, first + len(columns)))  # type: ignore[call-overload,operator]
    return dict(enumerate(columns.values())) if is_whole else {}


@dataclass(frozen=True)
class SetChoice:
    """The sets that were chosen by quantity, and others as good, which leave it open."""

    sets: dict[str, ColumnSet]
    rivals: tuple[ColumnSet, ...] = ()


def choose_sets(
    readings: Mapping[str, Reading],
    n_joints: int | None,
    *,
    has_blocks: bool = True,
) -> SetChoice | None:
    """Choose the best set of positions that has torques, or commanded positions, of the
    same joints.

    Parameters
    ----------
    readings : Mapping[str, Reading]
        What each column's name says.
    n_joints : int | None
        Of the robot; columns that are called by fewer of its joints than half are not
        taken.
    has_blocks : bool
        Take one column as all joints too.

    Returns
    -------
    SetChoice | None
        The sets by quantity, and rivals that are as good; None where there is none.
    """
    by_quantity = {
        quantity: column_sets(quantity, readings)
        for quantity in WORDS
        if quantity != "t"
    }
    choices = list[SetChoice]()
    torques = by_quantity["tau"]
    for positions in _with_torque_alone(by_quantity["q"], torques):
        if positions.style == "joint" and 2 * len(positions.columns) <= (n_joints or 0):
            continue
        if positions.style == "block" and not has_blocks:
            continue
        sets = {"q": positions}
        for quantity, candidates in by_quantity.items():
            if quantity == "q":
                continue
            partner = _partner_of(positions, candidates)
            if partner is not None:
                sets[quantity] = partner
        if {"tau", "qcmd"} & set(sets):
            choices.append(SetChoice(sets))
    if not choices:
        return None
    first = choices[0].sets["q"]
    for_robot = [
        choice
        for choice in choices
        if choice.sets["q"].style == "name"
        and len(choice.sets["q"].columns) == n_joints
    ]
    if first.style == "block" and n_joints != 1 and for_robot:
        choices = for_robot
    best = choices[0].sets["q"]
    rivals = [
        choice.sets["q"]
        for choice in choices[1:]
        if choice.sets["q"].preference == best.preference
    ]
    return SetChoice(choices[0].sets, tuple(rivals))


def _with_torque_alone(
    positions: Sequence[ColumnSet], torques: Sequence[ColumnSet]
) -> list[ColumnSet]:
    """The sets of positions; those of the robot's joints, of which some have no torque (a
    gripper's), without these."""
    out = list[ColumnSet]()
    for columns in positions:
        keys = [s.keys for s in torques if s.style == columns.style == "joint"]
        fewer = [
            some
            for some in keys
            if some < columns.keys and 2 * len(some) > len(columns.keys)
        ]
        if columns.keys in keys or not fewer:
            out.append(columns)
            continue
        driven = {key: name for key, name in columns.columns.items() if key in fewer[0]}
        out.append(replace(columns, columns=driven))
    return out


def _partner_of(
    positions: ColumnSet, candidates: Sequence[ColumnSet]
) -> ColumnSet | None:
    """The set of another quantity of the same joints, of the same words if there is one;
    its columns in the order of the positions."""
    partners = [
        s
        for s in candidates
        if s.keys == positions.keys
        or (s.style == positions.style == "joint" and s.keys > positions.keys)
    ]
    if not partners:
        return None
    best = min(
        partners,
        key=lambda s: (s.other_words != positions.other_words, s.preference),
    )
    columns = {key: best.columns[key] for key in positions.columns}
    return ColumnSet(
        best.quantity,
        best.rank,
        best.style,
        best.other_words,
        columns,
    )
