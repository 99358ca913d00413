"""The command that names columns which nothing recognises: by their words as far as they
go, else by their order."""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import permutations

import numpy as np

from sdp_vs_penalty import formatting
from sdp_vs_penalty.data.catalogue import fetch_remedy
from sdp_vs_penalty.data.hypotheses.channels import Recognition
from sdp_vs_penalty.data.hypotheses.recognition import find_clock
from sdp_vs_penalty.data.hypotheses.renaming import rename_words, scale_words
from sdp_vs_penalty.data.hypotheses.weighing import (
    TIME,
    rate_from_velocities,
    unit_of_dates,
)
from sdp_vs_penalty.data.log import Log
from sdp_vs_penalty.data.words.names import (
    INITIALS,
    is_no_measurement,
    quantity_of,
    read_name,
)
from sdp_vs_penalty.data.words.tokens import (
    brief_names,
    families,
    group_of,
    split_tokens,
)
from sdp_vs_penalty.data.words.units import UNITS, units_of_name
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.robot.arrays import Array

#: What research code writes of each joint, the commonest first.
_GROUPS = (("q", "dq", "tau"), ("q", "tau"))
_HEADER = (
    "t,q1..qn,dq1..dqn,tau1..taun (dq optional; temp1..tempn, degrees Celsius, too, and"
    " qmot1..qmotn, motors' positions where q are the links'; without tau:"
    " qcmd1..qcmdn, the commanded positions)"
)


def lacking(
    log: Log, problem: str, missing: Sequence[str], joints: Sequence[str] | None
) -> InputError:
    """Return the error of a log that has no column for some groups of channels.

    Its remedy is the first of these that there is: what the log's reader says, how a
    public data set's raw file is converted, the `convert` command that names the
    columns, or how arrays are written.

    problem : what is wrong, in words; missing : groups among t, q and tau; joints : names
    of the robot's joints, None where no robot is known.
    """
    how = log.remedy or fetch_remedy(log.path)
    if not how and log.names:
        pairs, scale = _propose(log, missing, None if joints is None else len(joints))
        how = _rename_remedy(log, missing, pairs, scale)
    how = how or "write numbers, a column or an array a channel (t, q, tau)"
    return InputError(f"{problem} (columns: {brief_names(log.names)})", how, log.path)


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
    pairs, scale = _propose(log, missing, None if joints is None else len(joints))
    if "NAME" in {y for x, y in pairs.items() if x != "t"}:
        raise error
    pairs = {**ours, **{x: y for x, y in pairs.items() if y != "NAME"}}
    return Recognition(
        pairs,
        scale,
        "by letters and order",
        unsaid=frozenset({"q", "tau"} - {*map(group_of, scale)}),
        inferred={} if "t" in scale else {"t": TIME},
        unless_confirmed=error,
    )


def _propose(
    log: Log, missing: Sequence[str], n_joints: int | None
) -> tuple[dict[str, str], dict[str, float]]:
    """Propose columns for channel groups by our names, "NAME" where none fits, and their
    factors to SI."""
    names = log.names
    pairs = _by_words(log, missing)
    says_nothing = {*map(quantity_of, names)} <= {None, "t"}
    if "NAME" in pairs.values() and {"q", "tau"} <= {*missing} and says_nothing:
        pairs = _in_order(names, n_joints) or pairs
    scale = dict[str, float]()
    for ours, name in pairs.items():
        if name not in log.columns:
            continue  # a stamp in parts, or none
        units = [x for x in units_of_name(name) if x.quantity == group_of(ours)]
        dated = unit_of_dates(log.columns[name].head) if ours == "t" else None
        factor = units[0].factor if units else UNITS[dated.answer] if dated else 1.0
        scale |= {ours: factor} if factor != 1.0 else {}
    return pairs, scale


def _rename_remedy(
    log: Log, missing: Sequence[str], pairs: dict[str, str], scale: Mapping[str, float]
) -> str:
    """Format the remedy for missing columns: a `convert` command that names them."""
    is_timeless = (
        [x for x, name in pairs.items() if name == "NAME"] == ["t"] != [*pairs]
    )
    if is_timeless:
        del pairs["t"]
    words = ["--rename", rename_words(pairs, log.names)]
    words += ["--scale", scale_words(scale, pairs)] if scale else []
    words += ["--rate", "HZ"] if is_timeless else []
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


def _in_order(names: Sequence[str], n_joints: int | None) -> dict[str, str]:
    """Propose columns by their order alone: t, q, dq and tau, or t, q and tau; empty
    where they are not as many as these groups have.

    For tables in which no name says more than a number, as MATLAB writes them: "Var1"
    and the blocks "Var2_1", "Var2_2" ..., or "Var1", "Var2" ... of all channels.
    """
    blocks = [x for x in families(names).values() if len(x) > 1]
    in_blocks = {name for columns in blocks for name in columns}
    single = [name for name in names if name not in in_blocks]
    sizes = {*map(len, blocks)} if len(blocks) > 1 else {n_joints}
    if len(single) > 1 or not blocks or len(sizes) > 1:
        return {}
    ordered = [*single, *(name for columns in blocks for name in columns)]
    layout = layout_of(len(names), sizes.pop(), has_clock=True)
    is_of_robot = n_joints in (None, sum(group_of(x) == "q" for x in layout))
    return dict(zip(layout, ordered, strict=True)) if layout and is_of_robot else {}


def layout_of(
    width: int, n_joints: int | None, *, has_clock: bool | None = None
) -> list[str]:
    """Return our names for columns that have none: q, dq and tau, or q and tau, of n
    joints, with or without a clock in front; empty where no layout fits.

    The layout with the robot's number of joints is taken, else the first with q, dq and
    tau, else, where it is known whether there is a clock, with q and tau.
    """
    layouts = [
        (n_clocks, n, groups)
        for n_clocks in (0, 1)
        if has_clock in (None, bool(n_clocks))
        for groups in _GROUPS
        for n, n_left in [divmod(width - n_clocks, len(groups))]
        if n > 0 and n_left == 0
    ]
    of_robot = [x for x in layouts if x[1] == n_joints]
    usual = [x for x in layouts if x[2] == _GROUPS[0] or has_clock is not None]
    for n_clocks, n, groups in of_robot or usual:
        return ["t"] * n_clocks + [f"{x}{k}" for x in groups for k in range(1, n + 1)]
    return []


def _by_words(log: Log, missing: Sequence[str]) -> dict[str, str]:
    """Propose columns by the words in their names, "NAME" where none fits.

    Families and blocks without such words are proposed by their first letter, and by
    their order where exactly as many are left as groups.
    """
    by_pattern = families(log.names).values()
    single = [x[0] for x in by_pattern if len(x) == 1]
    alike = [_with_first(x, single) for x in by_pattern if len(x) > 1]
    alike += [[name] for name, x in log.columns.items() if x.kind == "list"]
    of_group, unknown = dict[str, list[str]](), list[list[str]]()
    for columns in alike:
        quantity = quantity_of(columns[0])
        if quantity in (None, "t"):
            unknown.append(columns)
        else:
            of_group.setdefault(quantity or "", columns)
    tokens, left = [{*split_tokens(x[0])} for x in alike], list[list[str]]()
    for columns in unknown:
        words = {*split_tokens(columns[0])}
        letters = (x for x, known in INITIALS.items() if words & {*known.split()})
        letter = next(letters, "")
        if is_no_measurement(columns[0]) or any(x < words for x in tokens):
            continue
        if letter and letter not in of_group:
            of_group[letter] = columns
        else:
            left.append(columns)
    groups = [x for x in missing if x not in ("t", *of_group)]
    if len(left) == len(groups) and len(alike) > 1 and len({*map(len, alike)}) == 1:
        of_group |= dict(zip(groups, left, strict=True))
    n_joints = len(of_group.get("tau", ()))
    if "dq" not in of_group and len(of_group.get("q", ())) == 2 * n_joints > 0:
        state = of_group["q"]  # positions, then velocities
        of_group |= {"q": state[:n_joints], "dq": state[n_joints:]}
    pairs = dict[str, str]()
    with_velocities = {"q": ["q", "dq"] if "dq" in of_group else ["q"]}
    for group in (y for x in missing for y in with_velocities.get(x, [x])):
        columns = of_group.get(group, [])
        if group == "t":
            pairs["t"] = find_clock(log.columns) or "NAME"
        elif len(columns) > 1:
            pairs |= {f"{group}{k}": name for k, name in enumerate(columns, 1)}
        else:
            said = ((x, read_name(x)) for x in log.names)
            of_name = (
                x for x, m in said if m and m.quantity == group and m.number is None
            )
            named = columns or list(of_name)
            pairs[group] = named[0] if len(named) == 1 else "NAME"
    return pairs


def _with_first(columns: list[str], single: Sequence[str]) -> list[str]:
    """Return columns that are numbered from 2 with the one numbered 1, which a rail has in
    another unit, or by another word: a force beside torques."""

    def number(name: str) -> int:
        return int(re.findall("[0-9]+", name)[-1])

    if number(columns[0]) != 2:
        return columns
    firsts = [x for x in single if number(x) == 1]
    for quantity in (quantity_of(columns[0]), None):
        of_quantity = [x for x in firsts if quantity_of(x) == quantity]
        if len(of_quantity) == 1:
            return [*of_quantity, *columns]
    return columns


def layout_of_table(
    width: int, n_joints: int | None, *, has_clock: bool | None = None
) -> list[str]:
    """Return our names for the columns of a table without a header, by their order.

    As :func:`layout_of`; where each of the robot's joints has more columns than three,
    the first are q, dq and tau, and those behind them have no name.
    """
    n_clocks = width % (n_joints or width)
    if _has_more_than_three(width, n_joints) and has_clock in (None, bool(n_clocks)):
        width = n_clocks + len(_GROUPS[0]) * (n_joints or 0)
        has_clock = bool(n_clocks)
    return layout_of(width, n_joints, has_clock=has_clock)


def _has_more_than_three(width: int, n_joints: int | None) -> bool:
    """Whether so many columns are more than three a joint, perhaps with a clock."""
    n_groups, n_clocks = divmod(width, n_joints or width)
    return (n_joints or 0) > 1 and n_clocks <= 1 and n_groups > len(_GROUPS[0])


def names_without_header(
    log: Log, n_joints: int | None, rate: float | None
) -> Recognition:
    """Name the columns of a table without a header, by ours: q1..qn, dq1..dqn,
    tau1..taun, as research code writes them, with t in front where one column more is
    there.

    Raises InputError where no rate is given (a rate shows that the user knows what the
    columns are), where the number of columns is not a multiple of the channel groups, or
    each of the robot's joints has more columns than three.
    """
    width = len(log.names)
    layout = layout_of_table(width, n_joints)
    problem = "row 1 holds numbers instead of a header"
    if _has_more_than_three(width, n_joints):
        n_groups, n_clocks = divmod(width, n_joints or width)
        command = _naming_command(log, layout, rate)
        a_clock = "a clock and " if n_clocks else ""
        raise InputError(
            f"{problem}, and {width} columns may be {a_clock}{n_groups} columns of each of"
            f" {n_joints} joints",
            "say which of them are q, dq and tau, where they come first in this order by"
            f" `{command}`",
            log.path,
        )
    if rate is not None:
        if layout:
            return Recognition(dict(zip(layout, log.names, strict=True)), logger="")
        remedy = "keep q, dq and tau of each joint, or name columns by --rename q1=#2"
        raise InputError(f"{width} columns are not three a joint", remedy, log.path)
    remedy = f"put {_HEADER} above them, or "
    if layout:
        groups = list(dict.fromkeys(map(group_of, layout)))
        shown = f"{', '.join(groups[:-1])} and {groups[-1]}"
        remedy += (
            f"where its columns are {shown}, `{_naming_command(log, layout, None)}`"
        )
    else:
        remedy += "name columns by their numbers with `convert --rename t=#1,q1=#2`"
    error = InputError(problem, fetch_remedy(log.path) or remedy, log.path)
    if not layout:
        raise error
    return Recognition(
        dict(zip(layout, log.names, strict=True)),
        logger="by their order",
        unsaid=frozenset({"q", "tau"}),
        inferred={"t": TIME},
        unless_confirmed=error,
    )


def other_orders(found: Recognition) -> Iterator[Recognition]:
    """Yield the other orders of a table's channel groups, behind its clock: group by group,
    or joint by joint."""
    usual, theirs = list(found.rename), list(found.rename.values())
    groups = list(dict.fromkeys(x for x in map(group_of, usual) if x != "t"))
    n_clocks = usual.count("t")
    joints = range(1, (len(usual) - n_clocks) // len(groups) + 1)
    for order in permutations(groups):
        by_group = [f"{x}{k}" for x in order for k in joints]
        by_joint = [f"{x}{k}" for k in joints for x in order]
        for ours in (by_group, by_joint):
            if ours != usual[n_clocks:]:
                names = zip(usual[:n_clocks] + ours, theirs, strict=True)
                in_order = sorted(names, key=lambda pair: usual.index(pair[0]))
                yield replace(found, rename=dict(in_order))


def _naming_command(log: Log, layout: Sequence[str], rate: float | None) -> str:
    """Format the `convert` command that names columns as a layout does; without a clock
    also the rate [Hz], estimated from the velocities where it is not known."""
    pairs = ",".join(f"{name}=#{k}" for k, name in enumerate(layout, 1))
    words = ["--rename", pairs]
    if layout[0] != "t":
        named = dict(zip(layout, log.names, strict=False))
        columns = log.read(list(named.values())).columns
        found = rate or rate_of({ours: columns[x] for ours, x in named.items()})
        words += ["--rate", "HZ" if found is None else f"{found:g}"]
    return formatting.convert_command(log.path, *words)


#: Mantissas of usual rates, their powers of ten [Hz], and by how much an estimate differs.
_USUAL_RATES = (1.0, 1.2, 1.25, 1.5, 2.0, 2.4, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0)
_DECADES_OF_RATES = (10.0, 100.0, 1000.0)
_OF_A_RATE = 5e-3


def rate_of(columns: Mapping[str, Array], *, is_usual: bool = False) -> float | None:
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


def no_clock(
    log: Log, columns: Mapping[str, Array], joints: Sequence[str] = ()
) -> InputError:
    """Return the error of a log without a clock, with the `convert` command that states
    the rate at which dq is the derivative of q, where the velocities show one, and the
    order of the robot's joints, where the columns name them."""
    what = f"no column t (columns: {brief_names(log.names)})"
    if log.remedy:
        return InputError(what, log.remedy, log.path)
    rate = rate_of(columns, is_usual=True)
    why = "HZ being its samples a second"
    if rate is not None:
        why = "dq is the derivative of q at this rate"
    word = "HZ" if rate is None else f"{rate:g}"
    words = ["--rate", word, *(["--joints", ",".join(joints)] if joints else [])]
    command = formatting.convert_command(log.path, *words)
    remedy = f"give its rate with `{command}` ({why}), or name its clock with --rename t=NAME"
    return InputError(what, remedy, log.path)
