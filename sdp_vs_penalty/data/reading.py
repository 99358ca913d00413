"""Named columns become measurements: adapter, words, hypotheses, stretches, in this order.

1. What each column is: what the user chose, our own names, what the file says, or what
   is recognised (hypotheses).
2. The values of these columns, the joints of each row in one order.
3. Channels with stamps of their own, or with empty cells, come to the torque's stamps.
4. SI units, blocks (N, n) in the robot's order of joints.
5. One sentence says all of it.
"""

from __future__ import annotations

import re
import warnings
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import chain
from string import ascii_lowercase
from typing import Any

import numpy as np

from sdp_vs_penalty import formatting
from sdp_vs_penalty.data.hypotheses.channels import (
    Recognition,
    counted_from_zero,
    has_our_names,
)
from sdp_vs_penalty.data.log import Log, Values
from sdp_vs_penalty.data.measurements import COMMANDED, Measurements, columns_of
from sdp_vs_penalty.data.plausibility import far_outside
from sdp_vs_penalty.data.store import (
    PART,
    column_range,
    concatenate_chunks,
    iter_chunks,
)
from sdp_vs_penalty.data.stretches.gaps import (
    goes_on,
    is_set_back,
    order_of_time,
    spaced_evenly,
    stray_rows,
    usual_step,
)
from sdp_vs_penalty.data.words.tokens import brief_names, group_of, parts_of
from sdp_vs_penalty.errors import ColumnsRemark, InputError, Remark
from sdp_vs_penalty.robot.arrays import Array, Arrays, Indices, Mask

# Files with our own names need no tables of words and loggers: these are imported where
# a foreign file is recognised.

#: The groups of columns, in the order in which they are written.
GROUPS = ("q", "dq", "tau", "temp", *COMMANDED)
#: Groups that are left out unless every joint has them: other logs use these names for
#: other things.
_WHOLE = ("temp", "current", "voltage")
#: Largest share of empty cells in a channel that competes with others.
_MOST_GAPS = 0.1
#: Whole numbers that stand for a missing measurement are at least so large.
_LEAST_SENTINEL = 99.0
#: Name of the group that holds a set of columns which competes as the torques.
_RIVAL = "torques: {}"
#: A joint that moves by less does not move [rad, m].
_AT_REST = 1e-3
#: Mark of a clock under our name, which counts seconds unless its steps cannot be that.
_OF_OURS = "ours"
#: Usual steps of such a clock [s].
_USUAL_STEPS = (2e-5, 0.1)
#: Desired positions are at most so far from the measured ones, over their motion.
_FOLLOWS = 0.1
#: Rates that velocities and the clock tell are the same up to this share.
_SAME_RATE = 0.1
#: Rows by which a derivative is judged.
_LEAST_ROWS = 50
#: Rows that are shown of columns that were guessed, and orders of columns that are tried.
_ROWS_SHOWN, _MOST_ORDERS = 5, 12


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
    #: Unit of positions that the arm has told of another run of the same recorder.
    unit_of_others: str = ""

    @property
    def n_logged(self) -> int:
        """Number of the robot's joints, with those that are held; 0 without a robot."""
        return len(self.joints or ()) + len(getattr(self.joints, "held", ()))

    @property
    def is_of_motors(self) -> bool:
        """Whether the command that is running says that the log is the motors'."""
        return not {"--motors", "--motor-side"}.isdisjoint(self.options)


def run_of(log: Log, choice: Choice = Choice()) -> Measurements:
    """Make measurements of a log's columns.

    Parameters
    ----------
    choice : Choice
        The robot's joints, the columns chosen by ``--rename``, the rate, the topic.

    Returns
    -------
    Measurements
        One run in SI units, the joints in the robot's order.

    Raises
    ------
    InputError
        A channel that is missing, or columns that do not fit together.
    """
    log, run, found = run_and_reading(log, choice)
    n = choice.n_logged
    of_first_joints = ""
    if run.n == n + 1 > 1 and not (run.joint_names or choice.is_of_motors):
        of_first_joints = _command_of_first_joints(log, found, choice, n)
        what = f"{run.n} joints, the robot has {n}, and no name tells which"
        how = f"where the last is a gripper's, convert it by `{of_first_joints}`"
        _remark(log, f"{what}: {how}")
    if found.is_identity:
        return replace(run, unit_command=of_first_joints)
    sentence, said = sentence_and_command(log, found, choice)
    others = {
        name: columns
        for name, columns in found.torques.items()
        if not columns.items() <= found.rename.items()
    }
    remark = ColumnsRemark(said, _rows_shown(run, found.rename), found.rename, others)
    warnings.warn(remark, stacklevel=2)
    run = replace(
        run, reading=f"{log.path.name}: {sentence}", unit_by_arm=found.unit_by_arm
    )
    is_asked = ("q" in found.unsaid and not found.is_of_arm) or found.is_possible
    asked = _asking_command(log, found, choice) if is_asked else ""
    return replace(run, unit_command=of_first_joints or asked)


def _command_of_first_joints(
    log: Log, found: Recognition, choice: Choice, n: int
) -> str:
    """Format the command that takes the first n joints of a log, columns of blocks too."""
    rename = {x: y for x, y in found.rename.items() if group_of(x) == "t"}
    for k in range(1, n + 1):
        for ours, theirs in found.rename.items():
            group = group_of(ours)
            if ours == f"{group}{k}":
                rename[ours] = theirs
            elif ours == group != "t":
                rename[f"{group}{k}"] = f"{theirs}_{k}"
    scale = {x: y for x, y in found.scale.items() if x in (*rename, group_of(x))}
    return repeating_command(log, replace(found, rename=rename, scale=scale), choice)


def _asking_command(log: Log, found: Recognition, choice: Choice) -> str:
    """Format the command that states the unit of positions, which nothing says."""
    stated = {} if found.is_possible else {"q": "UNIT"}
    stated |= found.possible_scale
    for group in stated:
        found = found.without_unit(group)
    options = (*found.possible_options, *choice.options)
    scale = {**(choice.scale or {}), **stated}
    asking = replace(choice, scale=scale, options=options)
    return repeating_command(log, found, asking)


def run_and_reading(log: Log, choice: Choice) -> tuple[Log, Measurements, Recognition]:
    """Return the run of a log, what its columns were taken for, and the log, perhaps with
    a column a joint."""
    log, found = channels_of(log, choice)
    if choice.rate is None and "t" not in found.rename:
        found = _with_counter(log, found)
    if choice.rate is None and "t" not in found.rename and log.rate is not None:
        _remark(log, f"{log.rate:g} rows a second, as the file's header says")
        choice = replace(choice, rate=log.rate)
    for name, word in (choice.scale or {}).items():
        said = found.units.get(group_of(name))
        if said is not None and not re.search("(?i)(?<![0-9.])[a-z]", word):
            what = f"--scale {name}={word} makes SI of the numbers as written"
            _remark(log, f"{what}, not of {said.answer}, {said.why}")
    found = _without_given_units(found, choice)
    if choice.as_written and found.unless_confirmed is not None:
        raise found.unless_confirmed
    if found.others:
        found = _confirmed_order(log, found, choice)
    refusal = found.unless_confirmed
    try:
        run, found = _run_of_columns(log, found, choice)
    except InputError as error:
        raise refusal or error from None
    if found.unless_confirmed is not None:
        raise found.unless_confirmed
    if not (found.has_our_names or choice.rename) and _follows_positions(run):
        _remark(log, "what is called velocity follows the positions: left out")
        run = replace(run, dq=None)
    if not (choice.rename or choice.as_written) and _are_exchanged(run):
        other = {"q": "dq", "dq": "q"}
        rename = dict[str, str]()
        for ours in found.rename:
            group = group_of(ours)
            exchanged = other.get(group, group) + ours.removeprefix(group)
            rename[ours] = found.rename[exchanged]
        what = "q and dq are exchanged: what is called q is the derivative of dq"
        found = replace(found, rename=rename, said=(*found.said, what))
        run, found = _run_of_columns(log, found, choice)
    return log, run, found


def _with_counter(log: Log, found: Recognition) -> Recognition:
    """Take the column that counts rows as the clock, where it shows that rows were lost or
    come twice, and the header or the velocities tell the rate."""
    from sdp_vs_penalty.data.hypotheses.orders import counts_rows
    from sdp_vs_penalty.data.hypotheses.proposals import rate_of

    used = {*found.rename.values(), found.episode}
    counters = [
        name
        for name, column in log.columns.items()
        if name not in used and column.kind == "number" and counts_rows(column.head)
    ]
    if len(counters) != 1 or log.is_of_messages:
        return found
    pairs = {x: y for x, y in found.rename.items() if group_of(x) in ("q", "dq")}
    values = log.read([*counters, *pairs.values()]).columns
    counter = values[counters[0]]
    if np.all(np.diff(counter) == 1.0) or not counts_rows(counter):
        return found
    in_si = {x: found.scale.get(x, 1.0) * values[y] for x, y in pairs.items()}
    rate = log.rate or rate_of(in_si, is_usual=True)
    if rate is None:
        return found
    said = f"t = {counters[0]}, which counts rows at {rate:g} Hz"
    return replace(
        found,
        rename={"t": counters[0], **found.rename},
        scale={**found.scale, "t": 1.0 / rate},
        said=(*found.said, said),
    )


def _are_exchanged(run: Measurements) -> bool:
    """Return whether what is called positions is the derivative of what is called
    velocities, by the clock, and not the other way round."""
    if run.dq is None or len(run.t) < _LEAST_ROWS:
        return False
    from sdp_vs_penalty.data.hypotheses.weighing import rate_from_velocities

    turned = rate_from_velocities(run.dq, run.q)
    if turned is None or rate_from_velocities(run.q, run.dq) is not None:
        return False
    return abs(turned * float(np.median(np.diff(run.t))) - 1.0) < _SAME_RATE


def _follows_positions(run: Measurements) -> bool:
    """Tell whether what a name calls velocities are positions: "qd" may be desired ones."""
    if run.dq is None or len(run.t) < 2:
        return False
    apart = np.sqrt(np.mean((run.dq - run.q) ** 2, axis=0))
    return bool(np.all(apart < _FOLLOWS * np.std(run.q, axis=0)))


def _without_given_units(found: Recognition, choice: Choice) -> Recognition:
    """Leave out the units of groups that ``--scale`` names: the option states them."""
    for name in choice.scale or {}:
        if group_of(name) in ("t", *GROUPS):
            found = found.without_unit(name)
    return found


def _confirmed_order(log: Log, found: Recognition, choice: Choice) -> Recognition:
    """Return the order of columns that values and arm confirm far more than others; without
    a robot the likeliest one. Raises its error where they confirm none, or several."""
    from sdp_vs_penalty.data.hypotheses.arm import N_PARTS
    from sdp_vs_penalty.data.hypotheses.weighing import CERTAIN

    if getattr(choice.joints, "robot", None) is None:
        return found
    explained = list[tuple[Recognition, float]]()
    for order in (found, *found.others)[:_MOST_ORDERS]:
        if explained and order.weight * CERTAIN < found.weight:
            break
        with warnings.catch_warnings(action="ignore"), suppress(InputError):
            explained.append((order, _run_of_columns(log, order, choice)[1].share))
    shares = dict[tuple[str, ...], float]()
    for order, share in explained:
        motion = _motion_columns(order)
        shares[motion] = min(share, shares.get(motion, share))
    # Orders with the same motion share one number: the arm leaves least of a model's torque,
    # so that it does not tell which of several torques was measured.

    def odds(order: Recognition) -> float:
        return order.weight * shares[_motion_columns(order)] ** -N_PARTS

    ranked = sorted((order for order, _ in explained), key=odds, reverse=True)
    is_confirmed = len(ranked) == 1 or (
        len(ranked) > 1 and odds(ranked[0]) > CERTAIN * odds(ranked[1])
    )
    if found.unless_confirmed is not None and not is_confirmed:
        raise found.unless_confirmed
    return ranked[0] if ranked else found


def _motion_columns(found: Recognition) -> tuple[str, ...]:
    """Return the columns that a reading takes for what is no torque."""
    return tuple(y for x, y in found.rename.items() if group_of(x) != "tau")


def _run_of_columns(
    log: Log, found: Recognition, choice: Choice
) -> tuple[Measurements, Recognition]:
    """Return the run that some columns hold, and what else was decided about them."""
    groups = _groups(found.rename, log, choice)
    names = [*chain(*groups.values()), *filter(None, [found.episode])]
    _require_numbers(log, names)
    if found.has_our_names and not choice.rename:
        _say_unused(log, [name for name in log.columns if name not in names])
    torques = {} if choice.rename else found.torques
    rivals = {x: list(y.values()) for x, y in torques.items()}
    values = log.read(list(dict.fromkeys(chain(names, *rivals.values()))))
    # Sets of torques compete where they have a value nearly whenever the first one does.
    of_torques = log.columns[groups.get("tau", names)[0]].clock
    groups |= {
        _RIVAL.format(label): columns
        for label, columns in rivals.items()
        if all(
            log.columns[x].clock == of_torques
            and np.mean(values.gaps.get(x, False)) < _MOST_GAPS
            for x in columns
        )
    }
    values = _without_sentinels(log, values, groups.get("t", ()))
    values = _in_one_order(log, values, found, choice)
    t, columns, rows = _aligned(log, groups, values, found)
    order = None
    if t is not None and np.any(np.diff(t) < 0.0):
        order = order_of_time(t, np.column_stack([columns[x] for x in groups["q"]]))
    if t is not None and order is not None:
        _remark(log, "rows stand in no order of time: put in that of their stamps")
        n_rows = len(t)
        rows = (np.arange(2, n_rows + 2) if rows is None else rows)[order]
        columns = {x: y[order] if len(y) == n_rows else y for x, y in columns.items()}
        t = t[order]
    run, found = _in_si(log, found, groups, t, columns, choice)
    is_copy = _repeats_row_before(run)
    if 0 < is_copy.sum() < _MOST_GAPS * len(is_copy) and not choice.as_written:
        many = formatting.count(int(is_copy.sum()), "row")
        _remark(log, f"{many} like the one before, the stamp too: left out")
        run = run.rows(~is_copy)
        rows = (np.arange(2, len(is_copy) + 2) if rows is None else rows)[~is_copy]
    if not (found.has_our_names or choice.as_written) and (step := _rounded_to(run)):
        run = replace(run, t=spaced_evenly(run.t, step))
        each = float(np.median(np.diff(run.t)))
        steps = f"stamps were written in steps of {step:.3g} s"
        _remark(log, f"{steps}: rows are spaced evenly, {each:.3g} s apart")
    if found.scale:
        from sdp_vs_penalty.data.hypotheses.wrapping import POSITIONS, unwrapped
        from sdp_vs_penalty.data.words.units import UNITS

        in_degrees = {group_of(x) for x, y in found.scale.items() if y == UNITS["deg"]}
        in_degrees -= {*map(group_of, choice.scale or {})}
        run = unwrapped(run, log.path, [x for x in POSITIONS if x in in_degrees])
    return replace(run, file_rows=rows), found


def _repeats_row_before(run: Measurements) -> Mask:
    """Return which rows (N,) are copies of the one before, with the same stamp."""
    is_copy = np.append(False, np.diff(run.t) == 0.0)[: len(run.t)]
    rows = np.flatnonzero(is_copy)
    for x in run.groups.values() if len(rows) else ():
        is_copy[rows] &= (x[rows] == x[rows - 1]).all(axis=1)
    return is_copy


def _rounded_to(run: Measurements) -> float:
    """Return the step [s] in which a clock was written that has the same stamp in several
    rows, one row more or less; 0 for another clock, and where such rows are copies."""
    stamps, counts = np.unique(run.t, return_counts=True)
    inner = counts[1:-1]
    steps = np.diff(run.t)
    is_rounded = len(inner) > 1 and inner.min() > 1 and np.ptp(inner) < 2
    if not is_rounded or steps.min() < 0.0:
        return 0.0
    is_copy = (np.diff(np.hstack([run.q, run.tau]), axis=0) == 0.0).all(axis=1)
    return 0.0 if is_copy[steps == 0.0].all() else float(np.median(np.diff(stamps)))


def _remark(log: Log, said: str) -> None:
    """Remark on a file."""
    warnings.warn(f"{log.path}: {said}", Remark, stacklevel=3)


# -- 1. what each column is -----------------------------------------------------------


def our_columns(names: Sequence[str]) -> dict[str, str]:
    """Return the columns that have our names, by these."""
    return {x: x for x in names if group_of(x) in ("t", *GROUPS)}


def channels_of(log: Log, choice: Choice) -> tuple[Log, Recognition]:
    """Return the log, perhaps with a column a joint, and which of its columns are which
    channels (a Recognition)."""
    joints = choice.joints
    if log.is_of_messages:
        from sdp_vs_penalty.data.hypotheses.facts import by_facts

        return log, by_facts(log, joints, choice.topic)
    if choice.rename:
        return _as_chosen(log, choice)
    ours = our_columns(log.names)
    if log.texts is not None and len(ours) < len(log.columns):
        from sdp_vs_penalty.data.hypotheses.long_form import widened

        log = widened(log)
        ours = our_columns(log.names)
    if has_our_names(log.names) and not _has_other_velocities(log, ours):
        episode = None
        if len(ours) < len(log.columns):
            from sdp_vs_penalty.data.hypotheses.recognition import episode_of

            episode = episode_of(log.columns, ours)
        order = _order(log, joints)
        known = Recognition(
            ours,
            logger="by our names",
            episode=episode,
            order=order,
            inferred={"t": _OF_OURS},
        )
        if log.heading and not choice.as_written:
            from sdp_vs_penalty.data.hypotheses import recognition

            n = sum(re.fullmatch("q[0-9]+", x) is not None for x in ours)
            known = recognition.units_of_chosen(known, log.columns, log.heading)
            known = recognition.with_facts(known, log.columns, log.heading, n)
            known = _in_stated_order(known, log.heading, joints, n)
        return log, known
    letters = [*ascii_lowercase[: len(log.names)]]
    is_lettered = len(letters) > 3 and [x.lower() for x in log.names] == letters
    if is_lettered or next(iter(log.names), "").startswith("#1"):
        from sdp_vs_penalty.data.hypotheses.proposals import names_by_values

        n_joints = None if joints is None else len(joints)
        problem = "row 1 holds numbers instead of a header"
        problem = "row 1 holds letters alone" if is_lettered else problem
        return log, names_by_values(log, log.names, n_joints, problem, rate=choice.rate)
    found = recognised_in(log, joints)
    if wide := _of_wide_block(log, found, joints):
        return wide
    if found is not None:
        return log, found
    if counted_from_zero(log.names):
        from sdp_vs_penalty.data.hypotheses.proposals import lacking

        problem = "columns are counted from 0, and not alike"
        raise lacking(log, problem, ["q", "tau"], None)
    ours = our_columns(log.names)
    if missing := _missing_channels(ours):
        from sdp_vs_penalty.data.hypotheses.proposals import proposed

        return log, proposed(log, missing, joints, ours)
    return log, Recognition(ours)


def _in_stated_order(
    found: Recognition, heading: Sequence[str], joints: Sequence[str] | None, n: int
) -> Recognition:
    """Return the columns q1..qn and so on in the order of the robot's joints, where a line
    above the table names them in another one."""
    from sdp_vs_penalty.data.words.joints import joints_of_heading

    in_file = joints_of_heading(heading, joints or (), n)
    if not in_file or in_file == [*(joints or ())]:
        return found
    place = {f"{k}": f"{in_file.index(x) + 1}" for k, x in enumerate(joints or (), 1)}

    def in_place(ours: str) -> str:
        group = group_of(ours)
        return group + place.get(ours.removeprefix(group), "")

    rename = {x: in_place(x) for x in found.rename}
    factors = {x: found.scale[y] for x in rename if (y := in_place(x)) in found.scale}
    said = f"joints {', '.join(in_file)} in the file, as a line above the table says"
    scale = {x: y for x, y in found.scale.items() if x not in rename} | factors
    return replace(found, rename=rename, scale=scale, said=(*found.said, said))


def _has_other_velocities(log: Log, ours: Mapping[str, str]) -> bool:
    """Tell whether a file with our names has velocities by another name, "qd": another
    program wrote it."""
    if len(ours) == len(log.columns) or "dq" in map(group_of, ours):
        return False
    found = recognised_in(log, None)
    return found is not None and "dq" in map(group_of, found.rename)


def _of_wide_block(
    log: Log, found: Recognition | None, joints: Sequence[str] | None
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

    if found is None:
        said = {x: quantity_of(x) for x in widths}
        taus = [x for x, quantity in said.items() if quantity == "tau"][:1]
        clock = find_clock(log.columns)
        pairs = {"t": clock} if clock else {}
        found = Recognition(pairs | ({"tau": taus[0]} if taus else {}))
        # Without a robot or torques nothing tells how many joints a block of positions has.
        open_to = (None, "q") if joints or taus else (None,)
        blocks = [x for x, quantity in said.items() if quantity in open_to]
    else:
        blocks = [x for x in widths if x == found.rename.get("q")]
    n = len(joints) if joints else widths.get(found.rename.get("tau", ""))
    wide = [x for x in blocks if n is None or (widths[x] > n and widths[x] % n == 0)]
    if len(wide) != 1 or (n is None and "q" in found.rename):
        return None
    (block,) = wide
    log = log.with_columns_of(block)
    names = {x: y for x, y in found.rename.items() if y != block}
    ours = [x for x in log.columns if x.startswith(f"{block}_")]
    problem = f"{block} holds {len(ours)} columns"
    problem += f", {len(ours) // n} of each of {n} joints" if n else ""
    found = replace(found, rename=names, joints=(), order=None)
    return log, names_by_values(log, ours, n, problem, found)


def recognised_in(log: Log, joints: Sequence[str] | None) -> Recognition | None:
    """Return what is recognised of a log; InputError with the command that chooses,
    where two sets of columns are equally good."""
    from sdp_vs_penalty.data.hypotheses import recognition

    try:
        return recognition.recognise(log.columns, joints, log.heading)
    except recognition.AmbiguousColumnsError as error:
        command = formatting.convert_command(log.path, "--rename", error.words)
        how = log.remedy or "choose one"
        command = "" if log.remedy else f"such as by `{command}`"
        raise InputError(error.what, how, log.path, command) from None


def _as_chosen(log: Log, choice: Choice) -> tuple[Log, Recognition]:
    """Return the log and its columns as the user chose them, with the columns that have
    our names.

    A choice of torques alone leaves the rest to recognition. A table with a row for
    each joint has not the chosen names: it is then turned into one with a column for
    each joint.
    """
    from sdp_vs_penalty.data.hypotheses.recognition import (
        episode_of,
        find_clock,
        units_of_chosen,
        with_torque,
    )
    from sdp_vs_penalty.data.hypotheses.renaming import expanded

    rename = choice.rename or {}
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
            raise InputError(what, "give --rename a name of the file", log.path)
    if {*map(group_of, chosen)} == {"tau"} and not has_our_names(names):
        found = recognised_in(log, choice.joints)
        if found is not None:
            return log, with_torque(found, chosen)
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
            raise InputError(what, "give --rename one column a channel", log.path)
    order = _order(log, choice.joints)
    episode = episode_of(log.columns, rename.values())
    found = Recognition(rename, logger="", order=order, episode=episode)
    return log, units_of_chosen(found, log.columns)


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


def _groups(
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
        elif gap is not None and group not in _WHOLE:
            what = f"no column {group}{gap}, but {group}{numbers[-1]}"
            raise InputError(what, "give each joint a column", log.path)
    return groups


def _require_numbers(log: Log, names: Sequence[str]) -> None:
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


def _say_unused(log: Log, names: Sequence[str]) -> None:
    """Remark on columns that are not read. People expect accelerations to be read, so
    these get the reason."""
    is_acceleration = re.compile(r"(?i)(ddq|qdd|acc)_?[0-9]*").fullmatch
    why = ". Accelerations are computed from q, with the same filter as the torque"
    shown = ", ".join(name[:40] or "a column without a name" for name in names[:6])
    more = f" and {len(names) - 6} more" if len(names) > 6 else ""
    why = why if any(map(is_acceleration, names)) else ""
    if names:
        _remark(log, f"not used: {shown}{more}{why}.")


# -- 2. values ------------------------------------------------------------------------


def _without_sentinels(log: Log, values: Values, clock: Sequence[str]) -> Values:
    """Take cells as empty that hold a number in place of a measurement: zeros at the end of
    a clock (of an array that was longer than the run), and a whole number that repeats in
    few rows, far from all others of its channel, "-999"."""
    columns, gaps, numbers = {**values.columns}, {**values.gaps}, Counter[float]()
    empty = dict[str, Mask]()
    for name, x in values.columns.items():
        if x.ndim > 1 or not x.any():
            continue
        is_empty = np.zeros(len(x), bool)
        size = np.where(np.isfinite(x), np.abs(x), 0.0)
        largest = size.max()
        if clock == [name]:
            is_empty[len(np.trim_zeros(size, "b")) :] = True
        elif largest >= _LEAST_SENTINEL and largest == np.round(largest):
            is_empty = size == largest
            rest = size[~is_empty].max(initial=0.0)
            is_empty &= (is_empty.mean() < _MOST_GAPS) & (2.0 * rest < largest)
        if is_empty.any():
            empty[name] = is_empty
            numbers.update(x[is_empty].tolist())
    numbers = Counter({number: n for number, n in numbers.items() if n > 1})
    for name, is_empty in empty.items():
        x = columns[name]
        is_empty &= np.isin(x, [*numbers])
        if is_empty.any():
            columns[name] = np.where(is_empty, np.nan, x)
            gaps[name] = gaps.get(name, False) | is_empty
    for number, n in numbers.items():
        _remark(log, f"{n} cells of {number:g} are no measurements: taken as empty")
    return replace(values, columns=columns, gaps=gaps)


def _in_one_order(
    log: Log, values: Values, found: Recognition, choice: Choice
) -> Values:
    """Put the numbers of each row in the first row's order of joints, where every row
    names them: blocks of n joints, and n columns that differ by their number alone."""
    if log.texts is None or not (choice.rename or found.joints):
        return values
    from sdp_vs_penalty.data.hypotheses import recognition
    from sdp_vs_penalty.data.words.tokens import families

    names = recognition.columns_of_joint_names(log.names)
    names = [x for x in names if log.columns[x].kind in ("text", "list")]
    first = recognition.joints_of_texts(
        [next(iter(log.columns[x].cells), "") for x in names]
    )
    if len(first) < 2 or not {*found.joints} <= {*first}:
        return values
    rows = [tuple(recognition.joints_of_texts(row)) for row in log.texts(names)]
    places = {
        row: [row.index(x) for x in rows[0]]
        for row in {*rows}
        if sorted(row) == sorted(rows[0]) and len({*row}) == len(row)
    }
    if len({*rows}) < 2:
        return values
    wrong = next((k for k, row in enumerate(rows) if row not in places), None)
    if wrong is not None:
        number = wrong + 2 if values.rows is None else values.rows[wrong]
        what = f"{log.word} {number} names other joints than the first"
        remedy = "write the same joints in all of them, each once"
        raise InputError(what, remedy, log.path)
    order = np.array([places[row] for row in rows])  # (N, n)
    columns = dict(values.columns)
    for name, block in columns.items():
        if block.shape == order.shape:
            columns[name] = np.take_along_axis(block, order, axis=1)
    for family in families(list(columns)).values():
        by_number = sorted(family, key=lambda x: int(re.findall("[0-9]+", x)[-1]))
        if len(family) == order.shape[1] and all(columns[x].ndim == 1 for x in family):
            block = np.column_stack([columns[x] for x in by_number])
            block = np.take_along_axis(block, order, axis=1)
            columns |= dict(zip(by_number, block.T, strict=True))
    return replace(values, columns=columns)


# -- 3. stamps ------------------------------------------------------------------------


def _aligned(
    log: Log, groups: Mapping[str, Sequence[str]], values: Values, found: Recognition
) -> tuple[Array | None, dict[str, Array], Indices | None]:
    """Bring channels with stamps of their own to those of the torque.

    Returns the stamps (K,) in the clock's unit (None without a clock), the columns at
    them, and the rows of the file (None: row k is number k + 2).
    """
    columns, clock = values.columns, groups.get("t", ())
    t = _stamps(log, clock, columns) if clock else None
    names = [x for group, xs in groups.items() if group != "t" for x in xs]
    clocks = {x: log.columns[x].clock for x in names}
    clocks |= {found.episode: ""} if found.episode else {}
    # A column that is never a number says nothing of rows: whoever reads it says so.
    gaps = {x: gap for x, gap in values.gaps.items() if x in clocks and not gap.all()}
    if any(values.gaps[x].all() for x in groups["q"] if x in values.gaps):
        gaps = {}
    is_one_table = not any(clocks.values())
    if is_one_table and not gaps and not {*clock} & {*values.gaps}:
        return t, {x: columns[x] for x in clocks}, values.rows
    from sdp_vs_penalty.data.stretches.merging import ChannelStamps, align

    n_rows = len(next(iter(columns.values())))
    stamps = {**log.clocks, "": np.arange(float(n_rows)) if t is None else t}
    seconds = found.scale.get("t", 1.0)  # of a unit that names say
    samples, channels = dict[Any, ChannelStamps](), dict[str, tuple[Any, Array]]()
    for name, own in clocks.items():
        has_value = ~gaps[name] if name in gaps else np.ones(len(columns[name]), bool)
        key = own, has_value.tobytes()
        if key not in samples:
            stamps_of_clock = stamps[own]
            rows = np.flatnonzero(has_value & np.isfinite(stamps_of_clock))
            if not len(rows):
                what = "no sample has a stamp that is a number"
                raise InputError(
                    what, "log the clock as well, or give --rate", log.path
                )
            rows = rows[np.argsort(stamps_of_clock[rows], kind="stable")]
            samples[key] = ChannelStamps(seconds * stamps_of_clock[rows], rows, own)
        rows = samples[key].rows
        is_whole = len(rows) == len(columns[name]) and bool(np.all(np.diff(rows) == 1))
        channels[name] = key, columns[name] if is_whole else columns[name][rows]
    leading = (groups.get("tau") or groups["q"])[0]
    kept, columns, n_lost, remark = align(samples, channels, leading, [found.episode])
    taken = samples[channels[leading][0]].rows[kept]
    # Row 1 of a table without numbers of its own is the header.
    numbers = np.arange(2, n_rows + 2) if values.rows is None else values.rows
    where = ""
    if is_one_table:
        n_lost = n_rows - len(taken)
        if gaps:
            first = numbers[int(np.argmax(np.any([*gaps.values()], axis=0)))]
            where = f" ({log.word} {first} is the first)"
    reasons = [remark] if remark else []
    if n_lost:
        many = formatting.count(n_lost, "row")
        reasons[:0] = [
            f"{many} without all channels{where} left out or joined to others"
        ]
    if reasons:
        _remark(log, "; ".join(reasons))
    leading_clock = clocks[leading]
    has_clock = t is not None or leading_clock
    stamps_taken = stamps[leading_clock][taken] if has_clock else None
    return stamps_taken, columns, numbers[taken] if is_one_table else None


def _stamps(log: Log, clock: Sequence[str], columns: Arrays) -> Array:
    """Return the stamps (N,) of a clock in one column or in parts (seconds and
    nanoseconds; hours, minutes and seconds), in its own unit."""
    is_time_of_day = any(log.columns[x].kind == "stamp" for x in clock)
    if len(clock) == 1 and not is_time_of_day:
        return np.ravel(columns[clock[0]])
    from sdp_vs_penalty.data.words.stamps import past_midnight, units_of_parts

    for name in clock[:2] if len(clock) > 2 else ():
        values = columns[name][np.isfinite(columns[name])]
        if np.any(values != np.round(values)):
            what = f"column {name} holds no whole numbers, as a time of day does"
            command = "`convert --rename t=NAME`"
            raise InputError(what, "name the clock", log.path, command)
    parts = zip(units_of_parts(clock), clock, strict=True)
    stamps = np.sum([unit * np.ravel(columns[x]) for unit, x in parts], axis=0)
    return past_midnight(stamps) if is_time_of_day or len(clock) > 2 else stamps


# -- 4. SI units ----------------------------------------------------------------------


def _in_si(
    log: Log,
    found: Recognition,
    groups: Mapping[str, Sequence[str]],
    t: Array | None,
    columns: Arrays,
    choice: Choice,
) -> tuple[Measurements, Recognition]:
    """Make the run in SI units, and decide by its values the units that are open."""
    first = columns[groups["q"][0]]
    # A block can be (N, n) or (n, N): its longer side is that of the samples.
    count = max(first.shape) if first.ndim == 2 else len(first)
    has_clock = choice.rate is None and t is not None
    if choice.rate is not None:
        t = np.arange(count) / choice.rate
    if t is None and first.size:
        from sdp_vs_penalty.data.hypotheses.proposals import no_clock, rate_of

        pairs = {x: columns[y] for x, y in found.rename.items() if y in columns}
        pairs = {x: found.scale.get(x, 1.0) * y for x, y in pairs.items()}
        rate = None if choice.as_written else rate_of(pairs, is_usual=True)
        if rate is None:
            named = found.joints if choice.joints else ()
            raise no_clock(log, pairs, named)
        said = f"t = rows at {rate:g} Hz, at which dq is the derivative of q"
        found = replace(found, rate=rate, said=(*found.said, said))
        t = np.arange(count) / rate
    if t is None:
        t = np.zeros(count)
    blocks = {
        group: _block(log, group, [columns[x] for x in names], len(t))
        for group, names in groups.items()
        if group != "t"
    }
    found, blocks = _of_the_same_joints(log, found, groups, blocks, choice)
    if found.order is not None and len(t):
        blocks = {group: x[:, found.order] for group, x in blocks.items()}
    found, blocks = _with_open_units(found, blocks)
    follows = False
    if "qcmd" in blocks:
        from sdp_vs_penalty.data.hypotheses.weighing import is_in_one_unit

        follows = is_in_one_unit(blocks["q"], blocks["qcmd"])
    if found.zeros:
        in_counts = ["q", "qcmd"] if follows else ["q"]
        blocks |= {x: blocks[x] - found.zeros for x in in_counts}
    if not choice.as_written:
        found = _with_unit_of_clock(found, t, blocks, choice.rate)
    if len(t) > 1 and "tau" in blocks:
        found, blocks = _as_the_arm_says(found, t, blocks, choice)
    blocks = {group: x for group, x in blocks.items() if group in GROUPS}
    found = _without_given_units(found, choice)
    own = found.factors("q", blocks["q"].shape[1])
    given = {*map(group_of, choice.scale or {})}
    if follows and "qcmd" not in {*map(group_of, found.scale), *given}:
        found = found.with_factors("qcmd", own)
    for group, x in blocks.items():
        factors = found.factors(group, x.shape[1])
        if np.isnan(factors).any():
            what = f"{group} is in {found.units[group].answer}, each of some joints"
            remedy = (
                f"give --problem, or a unit a joint, such as --scale {group}=mm:deg"
            )
            raise InputError(what, remedy, log.path)
        if any(factor != 1.0 for factor in factors):
            parts = (part * factors for _, part in iter_chunks(x))
            blocks[group] = concatenate_chunks([x[:0], *parts])
    if choice.rate is None and "t" in found.scale:
        t = t * found.scale["t"]
    if not (choice.as_written or given & {"q", "dq", "t"}):
        from sdp_vs_penalty.data.hypotheses.weighing import in_one_unit

        blocks, told = in_one_unit(t, blocks, own)
        found = replace(found, said=(*found.said, *told))
    episode = None
    is_read = has_clock and not choice.as_written
    if len(t) > 1 and (found.episode or (is_read and is_set_back(t))):
        # Steps over which the clock was only set back, while the motion goes on.
        set_back = np.zeros(len(t) - 1, bool)
        if not found.episode:
            begins = np.diff(t) < 0.0
            rows = np.flatnonzero(begins)
            set_back[rows] = goes_on(blocks["q"], rows)
        elif has_clock:
            begins = np.diff(t) <= 0.0
        else:
            begins = np.diff(columns[found.episode]) != 0.0
        t, episode = _one_after_the_other(log, t, begins, set_back)
    name = log.run_name or log.path.name
    run = Measurements.from_channels(t, blocks, (name,), None, found.torque_unit)
    run = replace(run, joint_names=found.joints, episode=episode)
    return _without_others(log, run, choice), found


def _one_after_the_other(
    log: Log, t: Array, begins: Mask, set_back: Mask
) -> tuple[Array, Indices | None]:
    """Continue the clock t (N,) [s] at the steps (N - 1,) over which it ``begins`` anew, and
    return it with the number of each row's episode; None where the clock needs no change.

    Episodes come a second apart. None begins where the clock was only ``set_back``.
    """
    steps = np.diff(t)
    new_steps = np.ones(len(steps))
    if set_back.any():
        new_steps[set_back] = usual_step(t)
    added = np.where(begins, new_steps - steps, 0.0)
    if not added.any():
        return t, None
    begins = begins & ~set_back
    n_episodes = formatting.count(int(np.sum(begins)) + 1, "episode")
    said = f"{n_episodes} one after the other, a second apart"
    if not begins.any():
        said = "the clock was set back while the motion goes on: continued"
    _remark(log, said)
    return t + np.cumsum(np.append(0.0, added)), np.cumsum(np.append(0, begins))


def _of_the_same_joints(
    log: Log,
    found: Recognition,
    groups: Mapping[str, Sequence[str]],
    blocks: Arrays,
    choice: Choice,
) -> tuple[Recognition, dict[str, Array]]:
    """Leave out of blocks (N, n) the joints that some groups lack, such as a gripper without
    torque.

    The joints' names tell which these are. Without names it is the last one, if the robot
    has one joint less. Raises InputError otherwise.
    """
    widths = {x: y.shape[1] for x, y in blocks.items() if x not in _WHOLE}
    n = min(widths.values())
    if max(widths.values()) > n:
        named = {x: log.columns[groups[x][0]].joints for x in widths}
        shown = ", ".join(f"{group} {width}" for group, width in widths.items())
        what = f"the groups have different numbers of joints: {shown}"
        common = set.intersection(*({*x} for x in named.values()))
        is_last = n == len(choice.joints or ()) == max(widths.values()) - 1
        if len(common) != n and not is_last:
            raise InputError(what, "give q, dq and tau a column a joint", log.path)
        kept = {
            x: [k for k, joint in enumerate(named[x]) if joint in common] or [*range(n)]
            for x in widths
        }
        used = "those that all have" if common else f"the first {n}"
        _remark(log, f"{what}: {used} are used")
        blocks = {x: y[:, kept[x]] if x in kept else y for x, y in blocks.items()}
        order = found.order and tuple(
            kept["q"].index(k) for k in found.order if k in kept["q"]
        )
        joints = tuple(x for x in found.joints if x in common or not common)
        found = replace(found, order=order, joints=joints)
    shape = blocks["q"].shape
    return found, {
        x: y for x, y in blocks.items() if x not in _WHOLE or y.shape == shape
    }


def _without_others(log: Log, run: Measurements, choice: Choice) -> Measurements:
    """Leave out the joints beyond the robot's whose torque is exactly zero in every row, a
    gripper's, or that do not move at all while the others do, another arm's."""
    n = choice.n_logged
    if not choice.joints or run.n <= n or not run.torque_logged or not len(run.t):
        return run
    low, high = column_range(run.q)
    kinds = {
        "has no torque in any row": ~np.any(column_range(run.tau), axis=0),
        "does not move": high - low < _AT_REST,
    }
    what, is_idle = next(
        ((x, y) for x, y in kinds.items() if np.count_nonzero(y) == run.n - n),
        ("", None),
    )
    if is_idle is None:
        return run
    idle = np.flatnonzero(is_idle).tolist()
    shown = formatting.words([f"joint {k + 1}" for k in idle])
    _remark(log, f"{shown} of the log {what}: left out")
    joints = tuple(x for k, x in enumerate(run.joint_names) if k not in idle)
    return replace(run.without_joints(idle), joint_names=joints)


def _with_open_units(
    found: Recognition, blocks: dict[str, Array]
) -> tuple[Recognition, dict[str, Array]]:
    """Decide units of angles, and of a servo's, by the values."""
    angles = {group: kind for group, kind in found.inferred.items() if group != "t"}
    if not angles:
        return found, blocks
    from sdp_vs_penalty.data.hypotheses import weighing as w

    for group, kind in angles.items():
        unit = w.unit_of_angles(blocks["q"][: w.ROWS_JUDGED], kind)
        if unit.answer == w.DEGREES_OR_PERCENT and group != "q" and "tau" in blocks:
            # Commands may be in per cent of other ranges.
            blocks = {x: block for x, block in blocks.items() if x != group}
            unit = replace(unit, why="of ranges of its own: it is left out")
        found = found.with_unit(group, unit)
    return found, blocks


def _with_unit_of_clock(
    found: Recognition, t: Array, blocks: Arrays, rate: float | None
) -> Recognition:
    """Decide the unit of a clock that nothing says, by its steps, the velocities and how
    fast joints move."""
    if rate is not None or "t" not in found.inferred or len(t) < 2:
        return found
    kind = found.inferred["t"]
    if kind == _OF_OURS:
        step = np.median(np.diff(t))
        if not step > 0.0 or _USUAL_STEPS[0] <= step <= _USUAL_STEPS[1]:
            return found
    from sdp_vs_penalty.data.hypotheses import weighing as w

    if kind == _OF_OURS and (dated := w.unit_of_dates(t)):
        return found.with_unit("t", dated)

    part = slice(w.ROWS_JUDGED)
    moved = [
        blocks[x][part] * found.factors(x, blocks[x].shape[1])
        for x in ("q", "dq")
        if x in blocks
    ]
    of_velocities = w.rate_from_velocities(*moved) if len(moved) == 2 else None
    with np.errstate(all="ignore"):  # steps of numbers that are none
        ways = np.nan_to_num(np.abs(np.diff(moved[0], axis=0)))
    # The logger of CLOCK writes seconds or milliseconds; an arm at rest has no speed.
    is_at_rest = np.ptp(moved[0], axis=0).max(initial=0.0) < _AT_REST
    way = 0.0 if kind == w.CLOCK or is_at_rest else float(np.max(ways.mean(axis=0)))
    unit = w.unit_of_clock(t[part], of_velocities, way, kind=kind)
    is_said = kind == w.CLOCK or unit.answer != "s" or "t" in found.units
    return found.with_unit("t", unit) if is_said else found


def _as_the_arm_says(
    found: Recognition, t: Array, blocks: dict[str, Array], choice: Choice
) -> tuple[Recognition, dict[str, Array]]:
    """Decide by an arm's dynamics, where the robot is known, what names leave open."""
    rivals = {x: _RIVAL.format(x) for x in found.torques}
    channels = {x: blocks[y] for x, y in rivals.items() if y in blocks}
    robot = None if choice.as_written else getattr(choice.joints, "robot", None)
    if robot is not None and robot.n != blocks["q"].shape[1]:
        robot = None
    if robot is None and len(channels) < 2:
        return found, blocks
    is_open = not found.is_identity or bool(choice.unit_of_others)
    is_open |= not np.any(blocks["tau"][: len(t) // 10 + 1] < 0.0)  # a register's sign
    if robot and not is_open and not far_outside(robot, blocks["q"]):
        return found, blocks
    from sdp_vs_penalty.data.hypotheses import by_arm

    def seconds(found: Recognition) -> Array:
        return t * (found.scale.get("t", 1.0) if choice.rate is None else 1.0)

    def clock_of_positions(q: Array) -> Array:
        return seconds(_with_unit_of_clock(found, t, {"q": q}, choice.rate))

    if robot is not None:
        found = by_arm.with_lengths(found, robot)
    if robot is not None and "q" not in map(group_of, choice.scale or {}):
        links = getattr(choice.joints, "links", None)
        each = bool(found.torque_unit)
        of_links, apart = (
            by_arm.fit_of(robot, clock_of_positions, links, each_in_its_unit=x)
            for x in (each, True)
        )
        before = found
        found, blocks = by_arm.with_unit_of_positions(
            found, blocks, robot, of_links, apart, choice.unit_of_others
        )
        if found is not before:  # the speed of joints in the new unit tells the clock's
            found = _with_unit_of_clock(found, t, blocks, choice.rate)
        if found.possible_scale:
            found = _with_possible_clock(found, t, blocks["q"], choice.rate)
    fit = by_arm.fit_of(robot, lambda _: seconds(found))
    if robot is not None and not (found.unit_by_arm or choice.is_of_motors):
        found, blocks = by_arm.with_joint_side(found, blocks, robot, fit)
    found, blocks = by_arm.with_channel_of_torque(found, blocks, channels, fit)
    if robot is not None:
        found, blocks = by_arm.with_signed_register(found, blocks, fit)
    steady = ~stray_rows(t)
    fit = by_arm.fit_of(robot, lambda _: seconds(found)[steady])
    of_steady = {group: x[steady] for group, x in blocks.items()}
    return by_arm.confirmed(found, of_steady, fit), blocks


def _with_possible_clock(
    found: Recognition, t: Array, q: Array, rate: float | None
) -> Recognition:
    """Add the unit of the clock by which joints move at a usual speed in a unit of positions
    (N, n) that is only possible."""
    from sdp_vs_penalty.data.hypotheses.renaming import factors_and_zeros

    possible = found.possible_scale
    factors, zeros = factors_and_zeros("q", possible["q"], q.shape[1])
    in_si = {"q": factors * (q - zeros)}
    clock = _with_unit_of_clock(found.without_unit("q"), t, in_si, rate).units.get("t")
    if clock is None or clock == found.units.get("t"):
        return found
    return replace(found, possible_scale={**possible, "t": clock.answer})


def _block(log: Log, group: str, parts: Sequence[Array], count: int) -> Array:
    """Return the channels (N, n) of one group, from n columns (N,) or from one block.

    A block (n, N) is turned, and axes of length 1 are left out, as Simulink logs
    (n, 1, N). ``count`` is N, the number of time stamps.
    """
    block = parts[0]
    if block.ndim > 2:
        block = block.reshape(count, 1) if block.size == count else np.squeeze(block)
        if block.ndim > 2:
            what = f"{group} has {block.ndim} dimensions"
            raise InputError(what, "give it 2: samples and joints", log.path)
    if len(parts) == 1 and block.ndim == 2:
        is_upright = len(block) == count or block.shape[1] != count
        parts = [block if is_upright else block.T]
        if parts[0].shape[1] == 0:
            what = f"{group} has no columns, so there are no joints"
            raise InputError(what, "give q, dq and tau a column a joint", log.path)
    for part in parts:
        if len(part) != count:
            what = f"{group} has {len(part)} rows, t has {count}"
            raise InputError(what, "give each as many rows as t", log.path)
    if len(parts) == 1 and parts[0].ndim == 2:
        return np.ascontiguousarray(parts[0])
    chunks = (
        np.column_stack([np.ravel(x[start : start + PART]) for x in parts])
        for start, _ in iter_chunks(parts[0])
    )
    return concatenate_chunks([np.zeros((0, len(parts))), *chunks])


# -- 5. the sentence ------------------------------------------------------------------


def sentence_and_command(
    log: Log, found: Recognition, choice: Choice
) -> tuple[str, str]:
    """Format what was taken for what, in which unit and why; and the same with the file's
    path and the `convert` command that states it. Both are "" where nothing was guessed.
    """
    if found.is_identity:
        return "", ""
    from sdp_vs_penalty.data.hypotheses.renaming import by_group

    shown = list[str]()
    for pairs in by_group(found.rename).values():
        ours, theirs = ("..", " .. ") if len(pairs) > 1 else ("", "")
        ends = [[*x][:: max(len(x) - 1, 1)] for x in (pairs, pairs.values())]
        shown.append(f"{ours.join(ends[0])} = {theirs.join(ends[1])}")
    units = (f"{group} in {x.answer}, {x.why}" for group, x in found.units.items())
    said = [f"columns recognised ({found.logger or 'as chosen'}): {', '.join(shown)}"]
    said += [*units, *found.said]
    if found.logger and "tau" not in map(group_of, found.rename):
        said.append(
            "no torque is in the file: log it as well, or identify the servos from their"
            " commands with --known, such as a mass"
        )
    named_above = {x.split(" ")[0] for x in (*found.units, *found.said)}
    if unsaid := sorted(found.unsaid - named_above):
        said.append(f"no name says the unit of {formatting.words(unsaid)}: taken as SI")
    if found.joints:
        other = " in the file's order, for the robot's have other names"
        said.append(
            f"joints {', '.join(found.joints)}{other if found.has_other_joints else ''}"
        )
    sentence = "; ".join(said)
    is_possible = found.is_possible
    format_command = _asking_command if is_possible else repeating_command
    command = "" if log.remedy else format_command(log, found, choice)
    how = "if so, convert it by" if is_possible else "the same by"
    repeated = f"; {how} `{command}`" if command else ""
    return sentence, f"{log.path}: {sentence}{repeated}"


def repeating_command(log: Log, found: Recognition, choice: Choice) -> str:
    """Format the `convert` command that states a reading of the columns explicitly; ""
    where no command does."""
    from sdp_vs_penalty.data.hypotheses.renaming import choosing_words

    words = list[str]()
    if (
        found.is_of_arm
    ):  # the arm decides again if the command names the robot, no columns
        if "--problem" not in choice.options:
            return ""
    else:
        rate = choice.rate or found.rate
        text = f"{rate:.12g}" if rate else ""
        words = choosing_words(found, log.names, text, choice.scale or {})
    return formatting.convert_command(log.path, *words, *choice.options)


def _rows_shown(run: Measurements, rename: Mapping[str, str]) -> tuple[str, ...]:
    """Format the first five rows of a run as text, a line a channel with its name in the
    file."""
    lines = list[str]()
    for name, values in columns_of(run.rows(slice(0, _ROWS_SHOWN))).items():
        theirs = rename.get(name, rename.get(group_of(name), ""))
        numbers = " ".join(f"{x:>11.5g}" for x in values)
        lines.append(f"  {name:<6} {numbers}  {theirs}")
    return tuple(lines)
