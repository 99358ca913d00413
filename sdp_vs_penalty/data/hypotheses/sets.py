"""Columns of one quantity that belong together: one a joint, named alike."""

from collections.abc import Collection, Hashable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from sdp_vs_penalty.data.words import table
from sdp_vs_penalty.data.words.names import WORDS, Meaning
from sdp_vs_penalty.data.words.tokens import n_common, split_tokens, starred

#: How columns can be told apart, the surest first.
_STYLES = ("number", "block", "name")
#: Words of what is measured at the motor, before the gear, and of what is at the link.
_MOTOR_WORDS = frozenset({"motor", "motors", "mot", "actuator", "drive", "rotor"})
_LINK_WORDS = frozenset({"link", "joint", "arm", "load", "l", "j"})
#: Symbols that mean the motor only beside columns with a link's symbol, or without one:
#: q_m beside q_l. Alone, q_m is what was measured.
_MOTOR_SYMBOLS = {"qm": "q", "m": ""}
_LINK_SYMBOLS = {"ql": "q", **dict.fromkeys(_LINK_WORDS, "")}
#: Words of what a rail needs, beside the torques of other joints.
_FORCES = frozenset(table()["forces"])


@dataclass(frozen=True)
class ColumnSet:
    """Columns of one quantity that belong together, one for each joint."""

    #: Quantity: "q", "dq", "tau", "temp" or "qcmd".
    quantity: str
    #: Place of the set's word in the list of the quantity's words, 0 for the best.
    rank: int
    #: What tells the joints apart: "number", "block" (one column holds all joints), "name"
    #: (other words).
    style: str
    #: Further words that all its names share.
    other_words: tuple[str, ...]
    #: The file's names by joint, number or words, in the order of the joints.
    columns: dict[Hashable, str]
    #: Words of its names that say the quantity.
    n_words: int = 1
    #: Whether its names are those of another set of these joints and more, as
    #: "q_d/Position1" beside "Position1": they say what else it is.
    is_qualified: bool = False

    @property
    def is_bare(self) -> bool:
        """Whether the names say nothing but the joints' numbers, "j1"."""
        return self.rank > len(WORDS[self.quantity])

    @property
    def preference(self) -> tuple[bool, int, int, int, int]:
        """Sort key among the sets of one quantity, of which the smallest wins: whether it
        is a qualified one, the rank of its word, how many further words there are, style,
        and minus the size."""
        n_further = len(self.other_words) + max(self.n_words, 1) - 1
        style = _STYLES.index(self.style)
        return self.is_qualified, self.rank, n_further, style, -len(self.columns)

    def qualifies(self, other: "ColumnSet") -> bool:
        """Return whether its names are those of another set of the same joints and more."""
        if self.columns.keys() != other.columns.keys():
            return False
        names = self.columns.values(), other.columns.values()
        return all(y in x and x != y for x, y in zip(*names, strict=True))

    @property
    def first_to_last(self) -> str:
        """Its first and last name, for messages."""
        names = list(self.columns.values())
        return names[0] if len(names) == 1 else f"{names[0]} to {names[-1]}"


def column_sets(
    quantity: str, said: Mapping[str, Meaning], n_joints: int | None = None
) -> list[ColumnSet]:
    """Collect the columns of one quantity into sets with one column for each joint, the
    best first. Numbers may have gaps where there are as many as the robot's joints.

    A column can stand in several sets, of different styles. Motors and links have two
    columns for each joint (motor_pos_1 and link_pos_1): they are split by these words,
    and position columns with other ways of numbering by their names.
    """
    groups = dict[tuple[str, int, tuple[str, ...], int], list[str]]()
    of_quantity = {x: y for x, y in said.items() if y.quantity == quantity}
    for name, meaning in of_quantity.items():
        # "left_q_1" is told from others by its words, or by its number among left ones.
        by_number = "block" if meaning.number is None else "number"
        for style, others in (("name", ()), (by_number, meaning.other_words)):
            key = style, meaning.rank, others, len(meaning.words)
            groups.setdefault(key, []).append(name)
    sets, is_of_arms = list[ColumnSet](), False
    for (style, rank, others, n_words), names in groups.items():
        if all(said[x].words and _FORCES.issuperset(said[x].words) for x in names):
            continue  # a tool's, but for those that complete others
        if style == "number":
            names = _with_rails(names, of_quantity, others, n_joints)
        parts = [names]
        if not _columns_by_joint(style, names, said, n_joints):
            parts = _split(names, lambda x: frozenset(_SIDES & {*split_tokens(x)}))
            if (
                quantity == "q"
                and style == "number"
                and not any(
                    _columns_by_joint(style, part, said, n_joints) for part in parts
                )
            ):
                parts = _split(names, starred)
        arms = _of_arms(names, said, n_joints) if style == "name" else {}
        for further, part in arms.items() or ((others, x) for x in parts):
            if columns := _columns_by_joint(style, part, said, n_joints):
                kind = "number" if all(isinstance(x, int) for x in columns) else style
                found = ColumnSet(quantity, rank, kind, further, columns, n_words)
                sets.append(found)
                is_of_arms |= bool(arms)
    if is_of_arms:
        # Beside them "robot1/elbow" and "robot2/elbow" are no set: of one joint each.
        sets = [x for x in sets if x.style != "number" or len(x.columns) == n_joints]
    sets = [replace(x, is_qualified=any(map(x.qualifies, sets))) for x in sets]
    return sorted(sets, key=lambda column_set: column_set.preference)


def _with_rails(
    names: list[str],
    said: Mapping[str, Meaning],
    others: tuple[str, ...],
    n_joints: int | None,
) -> list[str]:
    """Return numbered columns with those of the numbers that they lack, which a unit or a
    word for forces tells, or another word in place of ``others``: those of a rail among
    turning joints."""
    numbers, words = {said[x].number for x in names}, {*said[names[0]].words}
    rails = [
        x
        for x, y in said.items()
        if y.number not in {None, *numbers} and {*y.words} <= words | _FORCES
    ]
    alike = [x for x in rails if said[x].other_words == others]
    is_open = (
        len(names) < n_joints
        if n_joints
        else not _columns_by_joint("number", names, said)
    )
    for together in ([*names, *alike], [*names, *rails]) if is_open else ():
        is_whole = n_joints in (None, len(together)) and len(together) > len(names)
        if is_whole and _columns_by_joint("number", together, said):
            return together
    return names


#: Words and symbols that say on which side of the gear a column was measured.
_SIDES = {*_MOTOR_WORDS, *_LINK_WORDS, *_MOTOR_SYMBOLS}


def _split(names: Sequence[str], key: Any) -> list[list[str]]:
    """Split names into lists with equal keys; no lists where all have the same."""
    groups = dict[Hashable, list[str]]()
    for name in names:
        groups.setdefault(key(name), []).append(name)
    return list(groups.values()) if len(groups) > 1 else []


def _of_arms(
    names: Sequence[str], said: Mapping[str, Meaning], n_joints: int | None
) -> dict[tuple[str, ...], list[str]]:
    """Split the columns of several arms, each with the robot's number of joints, by the
    word or number that tells the arms apart ("left" and "right", "robot1" and "robot2");
    empty where none does."""
    words = {x: _words_of(said[x]) for x in names}
    for place in range(min(map(len, words.values()))):
        arms = dict[tuple[str, ...], list[str]]()
        for name in names:
            arms.setdefault(words[name][place : place + 1], []).append(name)
        is_of_arms = len(arms) > 1 and (n_joints or 0) > 1
        if is_of_arms and {*map(len, arms.values())} == {n_joints}:
            return arms
    return {}


def _words_of(meaning: Meaning) -> tuple[str, ...]:
    """Return the further words of a name, its last number behind them."""
    number = () if meaning.number is None else (str(meaning.number),)
    return (*meaning.other_words, *number)


def _columns_by_joint(
    style: str,
    names: Sequence[str],
    said: Mapping[str, Meaning],
    n_joints: int | None = None,
) -> dict[Hashable, str]:
    """Order the columns of one set by what tells their joints apart.

    By style that is a number from 0 ("number"), the further words of the name ("name"), or
    "" for one column that holds all joints ("block").
    Empty if the columns are no set: two columns of one joint, numbers with a gap,
    several blocks, or a single "name".
    """
    if style == "block":
        return {"": names[0]} if len(names) == 1 else {}
    numbers = {x: said[x].number or 0 for x in names}
    if style == "name":
        if len({*numbers.values()}) > 1 and all(
            said[x].number is not None for x in names
        ):
            return {}
        words = [_words_of(said[x]) for x in names]
        before = n_common(words)
        behind = n_common([x[before:][::-1] for x in words])
        keys = [x[before : len(x) - behind] for x in words]
        if len({*keys}) < len(names) or len(names) < 2:
            return {}
        if not all(len(x) == 1 and x[0].isdigit() for x in keys):
            return dict(zip(keys, names, strict=True))
        # The last number is that of a signal, "A1.r2521".
        numbers = {name: int(x[0]) for name, x in zip(names, keys, strict=True)}
    places = {number: name for name, number in numbers.items()}
    in_order = {key: places[key] for key in sorted(places)}
    if len(in_order) != len(names):
        return {}
    first = next(iter(in_order))
    is_whole = first < 2 and list(in_order) == list(range(first, first + len(names)))
    is_whole |= len(names) == n_joints
    # One column alone is of the joint that it numbers: q1 is not driven by target_q_0.
    joints = in_order if len(in_order) == 1 else range(len(in_order))
    return dict(zip(joints, in_order.values(), strict=True)) if is_whole else {}


def _is_of_motors(columns: ColumnSet, others: Sequence[ColumnSet]) -> bool:
    """Return whether a set was measured at the motors, where another set of the same
    joints was measured at the links: by a word in the names, or by the symbol m beside
    l, j or no symbol."""

    def words_of(columns: ColumnSet) -> list[str]:
        return [
            x for x in split_tokens(next(iter(columns.columns.values()))) if x.isalpha()
        ]

    def bare(words: Sequence[str], symbols: Mapping[str, str]) -> list[str]:
        return [x for word in words if (x := symbols.get(word, word))]

    words = words_of(columns)
    beside = [
        words_of(x)
        for x in others
        if x.columns.keys() == columns.columns.keys() and x.columns != columns.columns
    ]
    if not _MOTOR_WORDS.isdisjoint(words):
        return any(_MOTOR_WORDS.isdisjoint(x) for x in beside)
    stem = bare(words, _MOTOR_SYMBOLS)
    return not _MOTOR_SYMBOLS.keys().isdisjoint(words) and any(
        bare(x, _LINK_SYMBOLS) == stem and x != words for x in beside
    )


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
    said: Mapping[str, Meaning], n_joints: int | None, single: Collection[str] = ()
) -> SetChoice | None:
    """Choose the set of position columns, and the sets of torques, velocities and so on
    that have the same joints; None where there is none.

    Positions without torques or commands for the same joints are no candidates. Among
    the candidates the preference of the positions decides. Sets of the motors are taken
    only where the links have none.

    Parameters
    ----------
    said : mapping of str to Meaning
        What each column's name says.
    n_joints : int or None
        Number of the robot's joints.
    single : collection of str
        Columns that hold a number a row: one that is called by more than its quantity,
        "q_elbow", is not all of several joints.
    """
    by_quantity = {x: column_sets(x, said, n_joints) for x in WORDS if x != "t"}
    motors = {
        x: [s for s in sets if _is_of_motors(s, sets)]
        for x, sets in by_quantity.items()
    }
    links = {
        x: [s for s in sets if s not in motors[x]] for x, sets in by_quantity.items()
    }
    candidates = list[dict[str, ColumnSet]]()
    for positions in links["q"]:
        positions = _driven(positions, links["tau"])
        if (
            positions.style == "block"
            and positions.other_words
            and n_joints not in (None, 1)
            and positions.columns[""] in single
        ):
            continue
        partners = {x: _partner_of(positions, links[x]) for x in links if x != "q"}
        candidate = {"q": positions, **{x: s for x, s in partners.items() if s}}
        if candidate.keys() & {"tau", "qcmd"}:
            candidates.append(candidate)
    # One column with all joints gives way to a column for each joint of the robot.
    if candidates and candidates[0]["q"].style == "block" and n_joints != 1:
        is_robot = [
            x["q"].style == "name" and len(x["q"].columns) == n_joints
            for x in candidates
        ]
        candidates = [
            x for x, fits in zip(candidates, is_robot, strict=True) if fits
        ] or candidates
    if not candidates:
        return None
    best, *others = candidates
    seen = {*best["tau"].columns.values()} if "tau" in best else set()
    torques = list[ColumnSet]()
    for columns in links["tau"] if seen else ():
        has_joints = columns.columns.keys() >= best["tau"].columns.keys()
        if has_joints and seen.isdisjoint(columns.columns.values()):
            torques.append(columns)
            seen |= {*columns.columns.values()}
    return SetChoice(
        best,
        tuple(x["q"] for x in others if x["q"].preference == best["q"].preference),
        {
            x: columns
            for x, sets in motors.items()
            for columns in sets
            if x in best and columns.columns.keys() >= best[x].columns.keys()
        },
        tuple(torques),
    )


def _driven(positions: ColumnSet, torques: Sequence[ColumnSet]) -> ColumnSet:
    """Leave joints without a torque column, such as a gripper's, out of positions that
    are called by names, where more than half of them have a torque."""
    if positions.style != "name":
        return positions
    joints = positions.columns.keys()
    driven = [x.columns.keys() for x in torques if x.style == "name"]
    most = [x for x in driven if x < joints and 2 * len(x) > len(joints)]
    if joints in driven or not most:
        return positions
    columns = {key: x for key, x in positions.columns.items() if key in most[0]}
    return replace(positions, columns=columns)


def _partner_of(positions: ColumnSet, others: Sequence[ColumnSet]) -> ColumnSet | None:
    """Return the best set of another quantity that has the same joints as the positions,
    in their order; one that shares their further words ("left arm") is preferred."""
    joints = positions.columns.keys()
    partners = [
        x
        for x in others
        if x.columns.keys() == joints
        or (x.style == positions.style == "name" and x.columns.keys() > joints)
    ]
    if not partners:
        return None
    best = min(
        partners, key=lambda x: (x.other_words != positions.other_words, x.preference)
    )
    return replace(best, columns={key: best.columns[key] for key in positions.columns})
