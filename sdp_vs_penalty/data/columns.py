"""Which column of a log is which channel: the ways in, from what the user chose to what
the values suggest. The first way that answers decides."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from string import ascii_lowercase

import numpy as np

from sdp_vs_penalty import formatting
from sdp_vs_penalty.data.hypotheses.channels import (
    Recognition,
    counted_from_zero,
    has_our_names,
)
from sdp_vs_penalty.data.log import Log
from sdp_vs_penalty.data.measurements import COMMANDED
from sdp_vs_penalty.data.recorder import Recorder
from sdp_vs_penalty.data.words.tokens import brief_names, group_of, parts_of
from sdp_vs_penalty.errors import InputError

# Files with our own names need no tables of words and loggers: these are imported where
# a foreign file is recognised.

#: The groups of columns, in the order in which they are written.
GROUPS = ("q", "dq", "tau", "temp", *COMMANDED)
#: Groups that are left out unless every joint has them: other logs use these names for
#: other things.
OPTIONAL_GROUPS = ("temp", "current", "voltage")
#: Mark of a clock under our name, which counts seconds unless its steps cannot be that.
OUR_CLOCK = "ours"


@dataclass(frozen=True)
class Choice:
    """What of a file to take."""

    #: Names of the robot's joints in order, for formats that name theirs.
    joints: Sequence[str] | None = None
    #: Topic of a bag that has several.
    topic: str | None = None
    #: The file's names of columns or variables by ours, for tables.
    rename: Mapping[str, str] | None = None
    #: Sampling rate [Hz] in place of the file's clock.
    rate: float | None = None
    #: Factors by our names of the `convert` command that is running: they are not applied
    #: here, but stand in the command that repeats it.
    scale: Mapping[str, str] | None = None
    #: Further words of that command.
    options: Sequence[str] = ()
    #: Whether names mean what they say, and ours mean SI, whatever values and arm tell.
    as_written: bool = False
    #: What the arm has told of other logs, by their columns.
    recorders: Sequence[Recorder] = ()

    @property
    def recorder(self) -> Recorder:
        """What is known of the log's recorder, once the log is known: see `for_columns`."""
        return next(iter(self.recorders), Recorder())

    def for_columns(self, names: Sequence[str]) -> Choice:
        """Return the choice with what is known of the recorder that writes such columns;
        nothing where the user states what columns are."""
        is_stated = self.as_written or self.rename or self.scale
        recorders = [x for x in self.recorders if x.columns == tuple(names)]
        return replace(self, recorders=() if is_stated else tuple(recorders))

    @property
    def n_logged(self) -> int:
        """Number of the robot's joints, with those that are held; 0 without a robot."""
        return len(self.joints or ()) + len(getattr(self.joints, "held", ()))

    @property
    def groups_scaled(self) -> list[str]:
        """Our names, of groups or of single joints, whose units the command states."""
        return [x for x in self.scale or {} if group_of(x) in ("t", *GROUPS)]

    @property
    def is_of_motors(self) -> bool:
        """Whether the command that is running says that the log is the motors'."""
        return not {"--motors", "--motor-side"}.isdisjoint(self.options)


def our_columns(names: Sequence[str]) -> dict[str, str]:
    """Return the columns that have our names, by these."""
    return {x: x for x in names if group_of(x) in ("t", *GROUPS)}


#: A log, perhaps with a column a joint, and which of its columns are which channels.
Answer = tuple[Log, Recognition]


def channels_of(log: Log, choice: Choice) -> Answer:
    """Return the log, perhaps with a column a joint, and which of its columns are which
    channels, as the first of :data:`WAYS` that answers has it."""
    answers = (way(log, choice) for way in WAYS)
    return next(answer for answer in answers if answer is not None)


def _by_messages(log: Log, choice: Choice) -> Answer | None:
    """Take what messages say of each column: its quantity, joint and clock."""
    if not log.is_of_messages:
        return None
    from sdp_vs_penalty.data.hypotheses.facts import by_facts

    return log, by_facts(log, choice.joints, choice.topic)


def _by_long_table(log: Log, choice: Choice) -> Answer | None:
    """Turn a table with a row a joint into one with a column a joint, and begin again."""
    if log.texts is None or len(our_columns(log.names)) == len(log.columns):
        return None
    from sdp_vs_penalty.data.hypotheses.long_form import widened

    wide = widened(log)
    return None if wide is log else channels_of(wide, choice)


def _by_our_names(log: Log, choice: Choice) -> Answer | None:
    """Take columns t, q1, tau1 for what they are called, with what lines above the table
    say of their units and order."""
    ours = our_columns(log.names)
    if not has_our_names(log.names) or _has_other_velocities(log, ours):
        return None
    episode = None
    if len(ours) < len(log.columns):
        from sdp_vs_penalty.data.hypotheses.recognition import episode_of

        episode = episode_of(log.columns, ours)
    known = Recognition(
        ours,
        logger="by our names",
        episode=episode,
        order=_order(log, choice.joints),
        inferred={"t": OUR_CLOCK},
    )
    if log.heading and not choice.as_written:
        from sdp_vs_penalty.data.hypotheses.recognition import (
            units_of_chosen,
            with_facts,
        )

        n = sum(re.fullmatch("q[0-9]+", x) is not None for x in ours)
        known = units_of_chosen(known, log.columns, log.heading)
        known = with_facts(known, log.columns, log.heading, n)
        known = _in_stated_order(known, log.heading, choice.joints, n)
    return log, known


def _by_values(log: Log, choice: Choice) -> Answer | None:
    """Guess by their values what columns without names are, or those called a, b, c ..."""
    letters = [*ascii_lowercase[: len(log.names)]]
    is_lettered = len(letters) > 3 and [x.lower() for x in log.names] == letters
    if not is_lettered and not next(iter(log.names), "").startswith("#1"):
        return None
    from sdp_vs_penalty.data.hypotheses.proposals import names_by_values

    n_joints = None if choice.joints is None else len(choice.joints)
    content = "letters alone" if is_lettered else "numbers instead of a header"
    problem = f"row 1 holds {content}"
    return log, names_by_values(log, log.names, n_joints, problem, rate=choice.rate)


def _by_words(log: Log, choice: Choice) -> Answer | None:
    """Recognise columns by the program that writes such files or by their words; a block
    with several columns of each joint is split first."""
    recognition = recognised_in(log, choice.joints)
    if split := _of_wide_block(log, recognition, choice.joints):
        return split
    return None if recognition is None else (log, recognition)


def _by_suggestion(log: Log, choice: Choice) -> Answer | None:
    """Propose columns for channels that no name says, which the arm has to confirm; raise
    InputError where joints are counted from 0, and not alike."""
    if counted_from_zero(log.names):
        from sdp_vs_penalty.data.hypotheses.proposals import lacking

        problem = "columns are counted from 0, and not alike"
        raise lacking(log, problem, ["q", "tau"], None)
    ours = our_columns(log.names)
    missing = _missing_channels(ours)
    if not missing:
        return None
    from sdp_vs_penalty.data.hypotheses.proposals import proposed

    return log, proposed(log, missing, choice.joints, ours)


def _by_names_without_clock(log: Log, choice: Choice) -> Answer:
    """Take columns with our names whose clock is missing."""
    return log, Recognition(our_columns(log.names))


def _in_stated_order(
    recognition: Recognition,
    heading: Sequence[str],
    joints: Sequence[str] | None,
    n: int,
) -> Recognition:
    """Return the columns q1..qn and so on in the order of the robot's joints, where a line
    above the table names them in another one."""
    from sdp_vs_penalty.data.words.joints import joints_of_heading

    in_file = joints_of_heading(heading, joints or (), n)
    if not in_file or in_file == [*(joints or ())]:
        return recognition
    place = {f"{k}": f"{in_file.index(x) + 1}" for k, x in enumerate(joints or (), 1)}

    def in_place(ours: str) -> str:
        group = group_of(ours)
        return group + place.get(ours.removeprefix(group), "")

    rename = {x: in_place(x) for x in recognition.rename}
    factors = {
        x: recognition.scale[y]
        for x in rename
        if (y := in_place(x)) in recognition.scale
    }
    sentence = (
        f"joints {', '.join(in_file)} in the file, as a line above the table says"
    )
    scale = {x: y for x, y in recognition.scale.items() if x not in rename} | factors
    return replace(
        recognition, rename=rename, scale=scale, said=(*recognition.said, sentence)
    )


def _has_other_velocities(log: Log, ours: Mapping[str, str]) -> bool:
    """Tell whether a file with our names has velocities by another name, "qd": another
    program wrote it."""
    if len(ours) == len(log.columns) or "dq" in map(group_of, ours):
        return False
    recognition = recognised_in(log, None)
    return recognition is not None and "dq" in map(group_of, recognition.rename)


def _of_wide_block(
    log: Log, recognition: Recognition | None, joints: Sequence[str] | None
) -> tuple[Log, Recognition] | None:
    """Split the block that holds several columns of each joint, and tell by their values
    what its columns are; None without such a block.

    The block is that of the positions or, where nothing is recognised, the only one whose
    name says nothing else.
    """
    widths = {x: y.width for x, y in log.columns.items() if y.kind == "list"}
    if not widths or log.remedy:
        return None
    from sdp_vs_penalty.data.hypotheses.proposals import names_by_values
    from sdp_vs_penalty.data.hypotheses.recognition import find_clock
    from sdp_vs_penalty.data.words.names import quantity_of

    if recognition is None:
        quantity_by_block = {x: quantity_of(x) for x in widths}
        taus = [x for x, quantity in quantity_by_block.items() if quantity == "tau"][:1]
        clock = find_clock(log.columns)
        pairs = {"t": clock} if clock else {}
        recognition = Recognition(pairs | ({"tau": taus[0]} if taus else {}))
        # Without a robot or torques nothing tells how many joints a block of positions has.
        open_to = (None, "q") if joints or taus else (None,)
        blocks = [x for x, quantity in quantity_by_block.items() if quantity in open_to]
    else:
        blocks = [x for x in widths if x == recognition.rename.get("q")]
    n = len(joints) if joints else widths.get(recognition.rename.get("tau", ""))
    wide = [x for x in blocks if n is None or (widths[x] > n and widths[x] % n == 0)]
    if len(wide) != 1 or (n is None and "q" in recognition.rename):
        return None
    (block,) = wide
    log = log.with_columns_of(block)
    names = {x: y for x, y in recognition.rename.items() if y != block}
    ours = [x for x in log.columns if x.startswith(f"{block}_")]
    problem = f"{block} holds {len(ours)} columns"
    problem += f", {len(ours) // n} of each of {n} joints" if n else ""
    recognition = replace(recognition, rename=names, joints=(), order=None)
    return log, names_by_values(log, ours, n, problem, recognition)


def recognised_in(log: Log, joints: Sequence[str] | None) -> Recognition | None:
    """Return what is recognised of a log; InputError with the command that chooses,
    where two sets of columns are equally good."""
    from sdp_vs_penalty.data.hypotheses.recognition import (
        AmbiguousColumnsError,
        recognise,
    )

    try:
        return recognise(log.columns, joints, log.heading)
    except AmbiguousColumnsError as error:
        command = formatting.convert_command(log.path, "--rename", error.words)
        how = log.remedy or "choose one"
        command = "" if log.remedy else f"such as by `{command}`"
        raise InputError(error.what, how, log.path, command) from None


def _by_choice(log: Log, choice: Choice) -> Answer | None:
    """Take the columns that the user chose, with those that have our names.

    A choice of torques alone leaves the rest to recognition. A table with a row for
    each joint has not the chosen names: it is then turned into one with a column for
    each joint.
    """
    if not choice.rename:
        return None
    from sdp_vs_penalty.data.hypotheses.recognition import (
        episode_of,
        find_clock,
        units_of_chosen,
        with_torque,
    )
    from sdp_vs_penalty.data.hypotheses.renaming import expanded

    rename = choice.rename
    if log.texts is not None and not {*rename.values()} <= {*log.names}:
        from sdp_vs_penalty.data.hypotheses.long_form import widened

        with suppress(InputError):
            wide = widened(log)
            expanded(rename, wide.names)
            log = wide
    for name, column in list(log.columns.items()):
        if column.kind == "list" and any(
            x.startswith(f"{name}_") and x not in log.columns for x in rename.values()
        ):
            log = log.with_columns_of(name)
    names = log.names
    chosen = expanded(rename, names)
    for our_name, their_name in chosen.items():
        if not {*parts_of(their_name, names)} <= {*names}:
            what = (
                f"no column {their_name!r} to take as {our_name} (columns:"
                f" {brief_names(names)})"
            )
            remedy = "give a name of the file"
            raise InputError(what, remedy, log.path, "--rename")
    if {*map(group_of, chosen)} == {"tau"} and not has_our_names(names):
        recognition = recognised_in(log, choice.joints)
        if recognition is not None:
            return log, with_torque(recognition, chosen)
    # A group that is chosen as a whole is not also a column a joint; and one of which its
    # own columns are chosen has no others.
    taken = {*chosen, *chosen.values()}
    taken |= {group_of(x) for x, y in chosen.items() if x == y}
    ours = {x: x for x in our_columns(names) if not {x, group_of(x)} & taken}
    rename = ours | chosen
    clock = rename.get("t") or find_clock(log.columns)
    rename = {**({"t": clock} if clock else {}), **rename}
    _require_channels(log, rename, choice)
    for their_name, n in Counter(rename.values()).items():
        if n > 1:
            channels = " and ".join(x for x, y in rename.items() if y == their_name)
            what = f"column {their_name} is taken as {channels}"
            remedy = "give one column a channel"
            raise InputError(what, remedy, log.path, "--rename")
    order = _order(log, choice.joints)
    episode = episode_of(log.columns, rename.values())
    recognition = Recognition(rename, logger="", order=order, episode=episode)
    return log, units_of_chosen(recognition, log.columns)


def _order(log: Log, joints: Sequence[str] | None) -> tuple[int, ...] | None:
    """Return the place in a block of each of the robot's joints, as a column of texts
    in the file names them; None for the file's order."""
    if not joints or not any(x.kind == "text" for x in log.columns.values()):
        return None
    from sdp_vs_penalty.data.hypotheses.recognition import joints_in_cells
    from sdp_vs_penalty.data.words.joints import in_order_of

    in_file = joints_in_cells(log.columns)
    if not in_file or all(x.kind != "list" for x in log.columns.values()):
        return None
    return tuple(in_file.index(x) for x in in_order_of(joints, in_file)[0].values())


def _missing_channels(rename: Mapping[str, str]) -> list[str]:
    """List the channels that are missing, of t, q and tau; none where positions, and
    torques or commanded positions are there: a rate can replace the clock."""
    groups = {group_of(x) for x in rename}
    needed = ["q"] if "qcmd" in groups else ["q", "tau"]
    if groups.issuperset(needed):
        return []
    return [x for x in ("t", *needed) if x not in groups]


def _require_channels(log: Log, rename: Mapping[str, str], choice: Choice) -> None:
    """Raise InputError where positions, or both torques and commanded positions, are
    missing."""
    if missing := _missing_channels(rename):
        from sdp_vs_penalty.data.hypotheses.proposals import lacking

        what = f"no column {' or '.join(missing)}"
        raise lacking(log, what, missing, choice.joints, rename)


def with_counter(log: Log, recognition: Recognition) -> Recognition:
    """Take the column that counts rows as the clock, where it shows that rows were lost or
    come twice, and the header or the velocities tell the rate."""
    from sdp_vs_penalty.data.hypotheses.orders import counts_rows
    from sdp_vs_penalty.data.hypotheses.proposals import rate_of

    used = {*recognition.rename.values(), recognition.episode}
    counters = [
        name
        for name, column in log.columns.items()
        if name not in used and column.kind == "number" and counts_rows(column.head)
    ]
    if len(counters) != 1 or log.is_of_messages:
        return recognition
    pairs = {x: y for x, y in recognition.rename.items() if group_of(x) in ("q", "dq")}
    values = log.read([*counters, *pairs.values()]).columns
    counter = values[counters[0]]
    if np.all(np.diff(counter) == 1.0) or not counts_rows(counter):
        return recognition
    in_si = {x: recognition.scale.get(x, 1.0) * values[y] for x, y in pairs.items()}
    rate = log.rate or rate_of(in_si, is_usual=True)
    if rate is None:
        return recognition
    sentence = f"t = {counters[0]}, which counts rows at {rate:g} Hz"
    return replace(
        recognition,
        rename={"t": counters[0], **recognition.rename},
        scale={**recognition.scale, "t": 1.0 / rate},
        said=(*recognition.said, sentence),
    )


def columns_of_groups(
    rename: Mapping[str, str], log: Log, choice: Choice
) -> dict[str, list[str]]:
    """List the file's columns of each channel group in the joints' order, the clock
    (one column or its parts) first; InputError for a gap in the joints' numbers."""
    groups = dict[str, list[str]]()
    if "t" in rename and choice.rate is None:
        groups["t"] = list(parts_of(rename["t"], log.names))
    for group in GROUPS:
        if group in rename:
            groups[group] = [rename[group]]
            continue
        pattern = rf"{group}([1-9][0-9]{{0,3}})"
        matches = (re.fullmatch(pattern, x) for x in rename)
        numbers = sorted(int(match[1]) for match in matches if match)
        gap = next((k for k, number in enumerate(numbers, 1) if k != number), None)
        if gap is None and numbers:
            groups[group] = [rename[f"{group}{k}"] for k in numbers]
        elif gap is not None and group not in OPTIONAL_GROUPS:
            what = f"no column {group}{gap}, but {group}{numbers[-1]}"
            raise InputError(what, "give each joint a column", log.path)
    return groups


def require_numbers(log: Log, names: Sequence[str]) -> None:
    """Raise InputError for a column that comes twice, or holds texts."""
    for name in names:
        column, command = log.columns[name], ""
        if name in log.twice:
            what, remedy = f"column {name} comes twice", "rename one of them"
        elif column.kind == "text" and column.cells:
            cell = f"{column.cells[0][:40]!r} is not a number"
            what = f"column {name} is never a number: {cell}"
            remedy, command = "name the column that holds it", "`convert --rename`"
        else:
            continue
        raise InputError(what, remedy, log.path, command)


def remark_on_unused(log: Log, names: Sequence[str]) -> None:
    """Remark on columns that are not read. People expect accelerations to be read, so
    these get the reason."""
    is_acceleration = re.compile(r"(?i)(ddq|qdd|acc)_?[0-9]*").fullmatch
    why = ". Accelerations are computed from q, with the same filter as the torque"
    shown = ", ".join(name[:40] or "a column without a name" for name in names[:6])
    more = f" and {len(names) - 6} more" if len(names) > 6 else ""
    why = why if any(map(is_acceleration, names)) else ""
    if names:
        log.remark(f"not used: {shown}{more}{why}.")


#: The ways in, the surest first.
WAYS: tuple[Callable[[Log, Choice], Answer | None], ...] = (
    _by_messages,
    _by_choice,
    _by_long_table,
    _by_our_names,
    _by_values,
    _by_words,
    _by_suggestion,
    _by_names_without_clock,
)
