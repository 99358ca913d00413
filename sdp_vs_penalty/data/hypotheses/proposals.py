"""The command that names columns which nothing recognises: by their words as far as they
go, else by their order."""

from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from types import MappingProxyType

import numpy as np

from sdp_vs_penalty import formatting
from sdp_vs_penalty.data.catalogue import raw_file_of
from sdp_vs_penalty.data.hypotheses.channels import Recognition
from sdp_vs_penalty.data.hypotheses.orders import Layout, layouts
from sdp_vs_penalty.data.hypotheses.recognition import (
    find_clock,
    known_columns,
    units_of_chosen,
    with_unit_of_clock,
)
from sdp_vs_penalty.data.hypotheses.renaming import convert_options
from sdp_vs_penalty.data.hypotheses.weighing import rate_from_velocities
from sdp_vs_penalty.data.log import Log
from sdp_vs_penalty.data.words.joints import families_of_joints
from sdp_vs_penalty.data.words.names import (
    INITIALS,
    WORDS,
    is_no_measurement,
    is_part_of_torque,
    quantity_of,
    read_name,
)
from sdp_vs_penalty.data.words.tokens import (
    brief_names,
    families,
    group_of,
    split_tokens,
)
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.robot.arrays import Array, Arrays

#: Columns a joint that most tables have: q, dq and tau.
_MOST_BLOCKS = 3
_HEADER = (
    "t,q1..qn,dq1..dqn,tau1..taun (dq optional; temp1..tempn, degrees Celsius, too, and"
    " qmot1..qmotn, motors' positions where q are the links'; without tau:"
    " qcmd1..qcmdn, the commanded positions)"
)


def lacking(
    log: Log,
    problem: str,
    missing: Sequence[str],
    joints: Sequence[str] | None,
    chosen: Mapping[str, str] = MappingProxyType({}),
) -> InputError:
    """Return the error of a log that has no column for some groups of channels.

    Its remedy is the first of these that there is: what the log's reader says, how a
    public data set's raw file is converted, the `convert` command that names the
    columns, or how arrays are written.

    problem : what is wrong, in words; missing : groups among t, q and tau; joints : names
    of the robot's joints, None where no robot is known; chosen : columns that the command
    names already, by our names.
    """
    what = f"{problem} (columns: {brief_names(log.names)})"
    how = log.remedy
    if not how and (name := raw_file_of(log.path)):
        return _raw_file(name, what, log)
    if not how and log.names:
        found = _propose(log, missing, joints, chosen)
        how = _rename_remedy(log, missing, found)
        counts = Counter(map(group_of, found.rename))
        few = [counts[x] for x in ("q", "tau") if 1 < counts[x] < len(joints or ())]
        if few:
            how += f"; it names {min(few)} of the robot's {len(joints or ())} joints"
    how = how or "write numbers, a column or an array a channel (t, q, tau)"
    return InputError(what, how, log.path)


def _raw_file(name: str, what: str, log: Log) -> InputError:
    """Return the error of a raw file of the public data set of this name."""
    remedy = f"it is a raw file of the built-in {name}: choose that, and load its measurements"
    return InputError(what, remedy, log.path, f"`sdp-vs-penalty fetch {name}`")


def proposed(
    log: Log,
    missing: Sequence[str],
    joints: Sequence[str] | None,
    ours: Mapping[str, str],
) -> Recognition:
    """Return the columns that words, letters or their order suggest for channel groups that
    no name says, beside those with our names (``ours``); the arm has to confirm them.
    Raises InputError where none are suggested."""
    error = lacking(log, f"no column {' or '.join(missing)}", missing, joints)
    if log.remedy or not log.names:
        raise error
    found = _propose(log, missing, joints, ours)
    if "NAME" in {y for x, y in found.rename.items() if x != "t"}:
        if {"q", "tau"} <= {*missing} and {*map(quantity_of, log.names)} <= {None, "t"}:
            clock = found.rename.get("t", "NAME")
            pairs = {} if clock == "NAME" else {"t": clock}
            known = Recognition(pairs, logger="by their order")
            columns = log.columns.items()
            free = [x for x, y in columns if y.kind == "number" and x != clock]
            n_joints = None if joints is None else len(joints)
            with suppress(InputError):
                return names_by_values(log, free, n_joints, error.what, known)
        raise error
    pairs = {x: y for x, y in found.rename.items() if y != "NAME"}
    if any(is_part_of_torque(y) for x, y in pairs.items() if group_of(x) == "tau"):
        raise error  # an arm confirms what is external, too: friction is part of it
    return replace(
        found,
        rename=pairs,
        logger="by letters and order",
        unsaid=frozenset({"q", "tau"} - {*found.units, *map(group_of, found.scale)}),
        unless_confirmed=error,
    )


def _propose(
    log: Log,
    missing: Sequence[str],
    joints: Sequence[str] | None,
    known: Mapping[str, str],
) -> Recognition:
    """Propose columns for channel groups by our names, "NAME" where none fits, beside those
    that are ``known``, and the units of all."""
    pairs = {**known, **_by_words(log, missing, joints)}
    found = units_of_chosen(Recognition(pairs), log.columns, log.heading)
    return with_unit_of_clock(found, log.columns)


def _rename_remedy(log: Log, missing: Sequence[str], found: Recognition) -> str:
    """Format the remedy for missing columns: a `convert` command that names them."""
    pairs = {**found.rename}
    is_timeless = (
        [x for x, name in pairs.items() if name == "NAME"] == ["t"] != [*pairs]
    )
    if is_timeless:
        del pairs["t"]
    found = replace(found, rename=pairs)
    words = convert_options(found, log.names, "HZ" if is_timeless else "")
    how = f"name them with `{formatting.convert_command(log.path, *words)}`"
    if is_timeless:
        how += (
            " (HZ being its samples a second), or name its clock with --rename t=NAME"
        )
    elif "NAME" in pairs.values():
        how += f" (columns of joints as '{missing[-1]}*=NAME_*')"
    elif {*pairs} - {"t"}:
        how += ", if they are that"
    if "tau" in missing and "q" not in missing:
        joined = formatting.convert_command(f"{log.path}+TORQUES.csv")
        how += f"; or join the file that holds torques with `{joined}`"
    return how


def _is_asked_for(name: str) -> bool:
    """Return whether a person may say that a column is a measurement: a part of the
    torque is one for whoever knows the rest."""
    return is_part_of_torque(name) or not is_no_measurement(name)


def _by_words(
    log: Log, missing: Sequence[str], joints: Sequence[str] | None
) -> dict[str, str]:
    """Propose columns for ``missing`` channel groups, by our names, "NAME" where none fits.

    Names whose words say quantity and joint come first. Families, columns of several
    joints that are called alike, then serve the groups that no such name serves: by a
    word, by a letter, and by their order where as many are left as groups.
    """
    of_group, joints_in_file = known_columns(log.columns, joints)
    families_left = _families_left(log, of_group, joints_in_file or joints or ())
    of_group = _with_families_by_quantity(of_group, families_left)
    of_group = _with_families_by_order(of_group, families_left, missing)
    of_group = _with_halves_of_states(of_group)
    pairs = dict[str, str]()
    for group in missing:
        pairs |= _pairs_of_group(log, group, of_group.get(group, []))
        if group == "q" and "dq" in of_group:
            pairs |= _pairs_of_group(log, "dq", of_group["dq"])
    return pairs


def _families_left(
    log: Log, of_group: Mapping[str, Sequence[str]], joints: Sequence[str]
) -> list[list[str]]:
    """List the families among columns that serve no group yet: numbered names, names of the
    joints with the same words beside, and blocks, each a family by itself."""
    alike = [x for x in families(log.names).values() if len(x) > 1]
    alike += [x for x in families_of_joints(log.names, joints) if x not in alike]
    alike += [[name] for name, x in log.columns.items() if x.kind == "list"]
    taken = {name for columns in of_group.values() for name in columns}
    return [x for x in alike if taken.isdisjoint(x) and _is_asked_for(x[0])]


def _with_families_by_quantity(
    of_group: Mapping[str, list[str]], families_left: Sequence[list[str]]
) -> dict[str, list[str]]:
    """Add the families whose names say a group. A word counts more than a letter; of two
    families that say the same group the first is taken."""
    by_word = [(quantity_of(x[0]), x) for x in families_left]
    by_letter = [
        (_group_of_letters(columns[0]), columns)
        for group, columns in by_word
        if group in (None, "t")
    ]
    out = {**of_group}
    for group, columns in (*by_word, *by_letter):
        if group not in (None, "t"):
            out.setdefault(group, columns)
    return out


def _group_of_letters(name: str) -> str | None:
    """Return the only group that a word or a letter in a name may stand for, "v" for dq;
    None where there is none, or more than one."""
    words = {*split_tokens(name)}
    groups = [
        group
        for group, letters in INITIALS.items()
        if words & {*letters.split(), *WORDS[group]}
    ]
    return groups[0] if len(groups) == 1 else None


def _with_families_by_order(
    of_group: Mapping[str, list[str]],
    families_left: Sequence[list[str]],
    missing: Sequence[str],
) -> dict[str, list[str]]:
    """Add the families that serve no group, in their order, to the missing groups without
    columns, if there are as many of them and all have as many columns."""
    unused = [x for x in families_left if x not in of_group.values()]
    groups = [x for x in missing if x not in ("t", *of_group)]
    widths = {len(x) for x in (*families_left, *of_group.values())}
    if len(unused) != len(groups) or len(widths) != 1:
        return {**of_group}
    return {**of_group, **dict(zip(groups, unused, strict=True))}


def _with_halves_of_states(of_group: Mapping[str, list[str]]) -> dict[str, list[str]]:
    """Take twice as many positions as torques as positions and, behind them, velocities."""
    n_joints, state = len(of_group.get("tau", ())), of_group.get("q", [])
    if "dq" in of_group or not len(state) == 2 * n_joints > 0:
        return {**of_group}
    return {**of_group, "q": state[:n_joints], "dq": state[n_joints:]}


def _pairs_of_group(log: Log, group: str, columns: Sequence[str]) -> dict[str, str]:
    """Return the proposal for one group: a name a joint of its columns, the only column, or
    "NAME" where none fits or several do."""
    if group == "t":
        return {"t": find_clock(log.columns) or "NAME"}
    if len(columns) > 1:
        return {f"{group}{k}": name for k, name in enumerate(columns, 1)}
    if not columns:
        meanings = {name: read_name(name) for name in log.names}
        columns = [
            name
            for name, meaning in meanings.items()
            if meaning and meaning.quantity == group and meaning.number is None
        ]
    return {group: columns[0] if len(columns) == 1 else "NAME"}


def names_by_values(
    log: Log,
    names: Sequence[str],
    n_joints: int | None,
    problem: str,
    known: Recognition | None = None,
    rate: float | None = None,
) -> Recognition:
    """Return the likeliest of what columns that no name tells can be by their values, with
    the others; the arm has to confirm one.

    A rate shows that the user knows what they are. Raises InputError where the values
    suggest nothing.
    """
    beside = known or Recognition({})
    clock = beside.rename.get("t", "")
    values = log.read([*names, *filter(log.columns.__contains__, [clock])]).columns
    columns, t = {x: values[x] for x in names}, values.get(clock)
    found = layouts(columns, n_joints, {*map(group_of, beside.rename)}, t)
    n = sum(x.startswith("q") for x in found[0].names) if found else 0
    n_blocks = len(names) // max(n, 1)
    if n > 1 and n_blocks > _MOST_BLOCKS:
        a_clock = "a clock and " if "t" in found[0].names else ""
        each = f"{n_blocks} columns of each of {n} joints"
        problem += f", and {len(names)} columns may be {a_clock}{each}"
    how = "" if known else f"put {_HEADER} above them, or "

    def refusal(layout: Layout | None) -> InputError:
        if name := raw_file_of(log.path):
            return _raw_file(name, problem, log)
        remedy = "name columns by their numbers"
        command = "convert --rename t=#1,q1=#2"
        if layout is not None and layout.is_supported:
            order = Recognition({**beside.rename, **layout.names})
            text = ""
            if "t" not in order.rename:
                read = log.read([*order.rename.values()]).columns
                told = rate or rate_of({x: read[y] for x, y in order.rename.items()})
                text = "HZ" if told is None else f"{told:g}"
            words = convert_options(order, log.names, text)
            command = formatting.convert_command(log.path, *words)
            in_file = sorted(layout.names, key=lambda x: names.index(layout.names[x]))
            groups = [*dict.fromkeys(map(group_of, in_file))]
            remedy = f"where its columns are {formatting.words(groups)}, say so"
        return InputError(problem, how + remedy, log.path, f"`{command}`")

    if not found:
        raise refusal(None)
    orders = [
        with_unit_of_clock(
            replace(
                beside,
                rename={**beside.rename, **layout.names},
                logger=beside.logger if known else "by their order",
                unsaid=frozenset({"q", "tau"}) - {*map(group_of, beside.rename)},
                unless_confirmed=refusal(layout),
                weight=layout.weight,
            ),
            log.columns,
        )
        for layout in found
    ]
    if rate is not None:
        return replace(orders[0], unless_confirmed=None)
    return replace(orders[0], others=tuple(orders[1:]))


#: Mantissas of usual rates, their powers of ten [Hz], and by how much an estimate differs.
_USUAL_RATES = (1.0, 1.2, 1.25, 1.5, 2.0, 2.4, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0)
_DECADES_OF_RATES = (10.0, 100.0, 1000.0)
_OF_A_RATE = 5e-3


def rate_of(columns: Arrays, *, is_usual: bool = False) -> float | None:
    """Estimate the sampling rate [Hz] at which dq is the derivative of q, of columns (N,)
    or blocks (N, n) by our names; None where there are no velocities, or none fits. With
    ``is_usual`` the rate is one at which logs are written, or None: units of positions and
    velocities that differ make another one."""
    blocks = dict[str, Array]()
    for group in ("q", "dq"):
        parts = [x for name, x in columns.items() if group_of(name) == group]
        if not parts or len({*map(len, parts)}) > 1:
            return None
        blocks[group] = np.column_stack([np.reshape(x, (len(x), -1)) for x in parts])
    if blocks["q"].shape != blocks["dq"].shape:
        return None
    rate = rate_from_velocities(blocks["q"], blocks["dq"])
    if rate is None or not is_usual:
        return rate
    usual = (x * decade for x in _USUAL_RATES for decade in _DECADES_OF_RATES)
    return next((x for x in usual if abs(rate / x - 1.0) < _OF_A_RATE), None)


def no_clock(log: Log, columns: Arrays, joints: Sequence[str] = ()) -> InputError:
    """Return the error of a log without a clock, with the `convert` command that states
    the rate at which dq is the derivative of q, where the velocities show one, and the
    order of the robot's joints, where the columns name them."""
    what = f"no column t (columns: {brief_names(log.names)})"
    if log.remedy:
        return InputError(what, log.remedy, log.path)
    rate = rate_of(columns, is_usual=True)
    why = "" if rate is None else " at which dq is the derivative of q"
    word = "HZ" if rate is None else f"{rate:g}"
    words = ["--rate", word, *(["--joints", ",".join(joints)] if joints else [])]
    command = formatting.convert_command(log.path, *words)
    remedy = f"give its rate{why}, or name its clock"
    return InputError(what, remedy, log.path, f"`{command}` or --rename t=NAME")
