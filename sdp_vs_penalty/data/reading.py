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
from dataclasses import dataclass, replace
from itertools import chain
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty import formatting
from sdp_vs_penalty.data.hypotheses.channels import (
    Recognition,
    counted_from_zero,
    has_our_names,
)
from sdp_vs_penalty.data.log import Log, Values
from sdp_vs_penalty.data.measurements import COMMANDED, Measurements, columns_of
from sdp_vs_penalty.data.store import PART, concatenate_chunks, iter_chunks
from sdp_vs_penalty.data.words.tokens import brief_names, group_of, parts_of
from sdp_vs_penalty.errors import ColumnsRemark, InputError, Remark
from sdp_vs_penalty.robot.arrays import Array

if TYPE_CHECKING:
    from sdp_vs_penalty.data.hypotheses.arm import Fit

# Files with our own names need no tables of words and loggers: these are imported where
# a foreign file is recognised.

#: The groups of columns, in the order in which they are written.
GROUPS = ("q", "dq", "tau", "temp", *COMMANDED)
#: Groups that are taken where they are whole: other logs call other things so.
_WHOLE = ("temp", "current", "voltage")
#: Share of empty cells in a channel that competes with others.
_MOST_GAPS = 0.1
#: Odds that a servo's register has a sign bit where it is read so: few have one.
_ODDS_OF_A_REGISTER = 1e3
#: Rows that are shown of columns that were guessed.
_ROWS_SHOWN = 5


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
    #: Factors by our names of the `convert` command that is running, for the command
    #: that repeats it.
    scale: Mapping[str, str] | None = None
    #: Further words of that command.
    options: Sequence[str] = ()


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
    if choice.rate is None and log.rate is not None:
        said = f"{log.path}: {log.rate:g} rows a second, as the file's header says"
        warnings.warn(said, Remark, stacklevel=2)
        choice = replace(choice, rate=log.rate)
    log, found = _channels(log, choice)
    groups = _groups(found.rename, log, choice)
    names = [name for group in groups.values() for name in group]
    if found.episode:
        names.append(found.episode)
    for name in names:
        if name in log.twice:
            raise InputError(
                f"column {name} comes twice", "rename one of them", log.path
            )
        column = log.columns[name]
        if column.kind == "text" and column.cells:
            cell = column.cells[0][:40]
            what = f"column {name} is never a number: {cell!r} is not a number"
            remedy = "name the column that holds it with `convert --rename`"
            raise InputError(what, remedy, log.path)
    unused = [name for name in log.columns if name not in names]
    if (
        unused
        and not choice.rename
        and all(x == y for x, y in found.rename.items())
        and found.rename
    ):
        _say_unused(log, unused)
    torques = {} if choice.rename else found.torques
    rivals = {x: list(y.values()) for x, y in torques.items()}
    values = log.read(list(dict.fromkeys(chain(names, *rivals.values()))))
    # Sets of torques compete where they have a value nearly whenever the first one does.
    clock = log.columns[groups.get("tau", names)[0]].clock
    groups |= {
        label: columns
        for label, columns in rivals.items()
        if all(
            log.columns[x].clock == clock
            and np.mean(values.gaps.get(x, False)) < _MOST_GAPS
            for x in columns
        )
    }
    values = _in_one_order(log, values, found, choice)
    t, columns, rows = _aligned(log, groups, values, found, choice.rate)
    run, found = _in_si(log, found, groups, t, columns, rows, choice)
    if found.scale:
        from sdp_vs_penalty.data.hypotheses.wrapping import POSITIONS, unwrapped
        from sdp_vs_penalty.data.words.units import UNITS

        in_degrees = {group_of(x) for x, y in found.scale.items() if y == UNITS["deg"]}
        run = unwrapped(run, log.path, [x for x in POSITIONS if x in in_degrees])
    if found.is_identity:
        return run
    sentence = reading_sentence(log, found)
    command = repeating_command(log, found, choice)
    repeated = f"; the same by `{command}`" if command and not log.remedy else ""
    shown = _rows_shown(run, found.rename)
    others = {
        name: columns
        for name, columns in found.torques.items()
        if not columns.items() <= found.rename.items()
    }
    remark = ColumnsRemark(
        f"{log.path}: {sentence}{repeated}", shown, found.rename, others
    )
    warnings.warn(remark, stacklevel=2)
    return replace(run, reading=f"{log.path.name}: {sentence}")


# -- 1. what each column is -----------------------------------------------------------


def _channels(log: Log, choice: Choice) -> tuple[Log, Recognition]:
    """Return the log, perhaps with a column a joint, and which of its columns are which
    channels (a Recognition)."""
    names = log.names
    joints = choice.joints
    if log.is_of_messages:
        from sdp_vs_penalty.data.hypotheses.facts import by_facts

        return log, by_facts(log, joints, choice.topic)
    if choice.rename:
        return log, _other_torques(log, choice) or _as_chosen(log, choice)
    if has_our_names(names):
        ours = {x: x for x in names if group_of(x) in ("t", *GROUPS)}
        episode = None
        if len(ours) < len(names):
            from sdp_vs_penalty.data.words.loggers import episode_of

            episode = episode_of([x for x in names if x not in ours])
        return log, Recognition(ours, episode=episode, order=_order(log, joints))
    if names[:1] == ["#1"]:
        from sdp_vs_penalty.data.hypotheses.proposals import names_without_header

        n_joints = None if joints is None else len(joints)
        rename = names_without_header(log, n_joints, choice.rate)
        return log, Recognition(rename, logger="")
    if log.texts is not None:
        from sdp_vs_penalty.data.hypotheses.long_form import widened

        log = widened(log)
    found = recognised_in(log, joints)
    if found is not None:
        return log, found
    if counted_from_zero(log.names):
        from sdp_vs_penalty.data.hypotheses.proposals import lacking

        problem = "columns are counted from 0, and not alike"
        raise lacking(log, problem, ["q", "tau"], None)
    ours = {x: x for x in log.names if group_of(x) in ("t", *GROUPS)}
    _require_channels(log, ours, choice)
    return log, Recognition(ours)


def recognised_in(log: Log, joints: Sequence[str] | None) -> Recognition | None:
    """Return what is recognised of a log; InputError with the command that chooses,
    where two sets of columns are equally good."""
    from sdp_vs_penalty.data.hypotheses.recognition import (
        AmbiguousColumnsError,
        recognise,
    )

    try:
        return recognise(log.columns, joints)
    except AmbiguousColumnsError as error:
        command = formatting.convert_command(log.path, "--rename", error.words)
        how = log.remedy or f"choose, such as with `{command}`"
        raise InputError(error.what, how, log.path) from None


def _other_torques(log: Log, choice: Choice) -> Recognition | None:
    """Return what is recognised of a log, with the torques that the user chose; None
    where the user chose other channels as well, or nothing is recognised."""
    from sdp_vs_penalty.data.hypotheses.recognition import with_torque
    from sdp_vs_penalty.data.hypotheses.renaming import expanded

    chosen = expanded(choice.rename or {}, log.names)
    is_torque = all(group_of(x) == "tau" for x in chosen)
    if has_our_names(log.names) or not is_torque:
        return None
    if not {*chosen.values()} <= {*log.columns}:
        return None
    found = recognised_in(log, choice.joints)
    return found and with_torque(found, chosen)


def _as_chosen(log: Log, choice: Choice) -> Recognition:
    """Return the columns that the user chose, and those that have our names."""
    from sdp_vs_penalty.data.hypotheses.recognition import find_clock
    from sdp_vs_penalty.data.hypotheses.renaming import expanded
    from sdp_vs_penalty.data.words.loggers import episode_of

    names = log.names
    chosen = expanded(choice.rename or {}, names)
    for our_name, their_name in chosen.items():
        for name in parts_of(their_name, names):
            if name not in log.columns:
                what = (
                    f"no column {name!r} to take as {our_name} (columns:"
                    f" {brief_names(names)})"
                )
                raise InputError(what, "give --rename a name of the file", log.path)
    ours = {x: x for x in names if group_of(x) in ("t", *GROUPS)}
    # A group that is chosen as a whole is not also a column a joint.
    taken = {*chosen, *chosen.values()}
    rename = {x: x for x in ours if not {x, group_of(x)} & taken} | chosen
    clock = rename.get("t") or find_clock(log.columns)
    rename = {**({"t": clock} if clock else {}), **rename}
    _require_channels(log, rename, choice)
    for their_name, n in Counter(rename.values()).items():
        if n > 1:
            channels = " and ".join(x for x, y in rename.items() if y == their_name)
            what = f"column {their_name} is taken as {channels}"
            raise InputError(what, "give --rename one column a channel", log.path)
    order = _order(log, choice.joints)
    episode = episode_of([x for x in names if x not in rename.values()])
    return Recognition(rename, logger="", order=order, episode=episode)


def _order(log: Log, joints: Sequence[str] | None) -> tuple[int, ...] | None:
    """Return the place in a block of each of the robot's joints, where the file has
    columns of names, whatever the others are called; None for the file's order."""
    if not joints or not any(x.kind == "text" for x in log.columns.values()):
        return None
    from sdp_vs_penalty.data.hypotheses import recognition

    if not recognition.columns_of_joint_names(log.names):
        return None
    try:
        found = recognition.recognise(log.columns, joints)
    except recognition.AmbiguousColumnsError:
        return None
    return None if found is None else found.order


def _require_channels(log: Log, rename: Mapping[str, str], choice: Choice) -> None:
    """Raise InputError where positions, or both torques and commanded positions, are
    missing. The clock is asked for beside others; alone a rate can replace it."""
    groups = {group_of(x) for x in rename}
    needed = ["q"] if "qcmd" in groups else ["q", "tau"]
    if not groups.issuperset(needed):
        from sdp_vs_penalty.data.hypotheses.proposals import lacking

        missing = [x for x in ("t", *needed) if x not in groups]
        problem = f"no column {' or '.join(missing)}"
        raise lacking(log, problem, missing, choice.joints)


def _groups(
    rename: Mapping[str, str], log: Log, choice: Choice
) -> dict[str, list[str]]:
    """List the file's columns of each channel group in the joints' order, the clock
    (one column or its parts) first; InputError for a gap in the joints' numbers."""
    groups = dict[str, list[str]]()
    clock = rename.get("t", "") if choice.rate is None else ""
    if clock in log.columns and "t" in rename:
        groups["t"] = [clock]
    elif clock:
        groups["t"] = list(parts_of(clock, log.names))
    for group in GROUPS:
        if group in rename:
            groups[group] = [rename[group]]
            continue
        numbers = sorted(
            int(x[len(group) :])
            for x in rename
            if re.fullmatch(rf"{group}[1-9][0-9]{{0,3}}", x)
        )
        gap = next((k for k, number in enumerate(numbers, 1) if k != number), None)
        if gap is None and numbers:
            groups[group] = [rename[f"{group}{k}"] for k in numbers]
        elif gap is not None and group not in _WHOLE:
            lacking = f"no column {group}{gap}, but {group}{numbers[-1]}"
            raise InputError(lacking, "give each joint a column", log.path)
    return groups


def _say_unused(log: Log, names: Sequence[str]) -> None:
    """Remark on columns that are not read; of accelerations, the one kind that people
    expect to be read, say why."""
    has_acceleration = any(
        re.fullmatch(r"(ddq|qdd|acc)_?[0-9]*", x.lower()) for x in names
    )
    why = ". Accelerations are computed from q, with the same filter as the torque"
    shown = ", ".join(name[:40] or "a column without a name" for name in names[:6])
    more = f" and {len(names) - 6} more" if len(names) > 6 else ""
    said = f"{log.path}: not used: {shown}{more}{why if has_acceleration else ''}."
    warnings.warn(said, Remark, stacklevel=3)


# -- 2. values ------------------------------------------------------------------------


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
    if len({*rows}) < 2:
        return values
    places = {
        row: [row.index(x) for x in rows[0]]
        for row in {*rows}
        if sorted(row) == sorted(rows[0]) and len({*row}) == len(row)
    }
    wrong = next((k for k, row in enumerate(rows) if row not in places), None)
    if wrong is not None:
        number = wrong + 2 if values.rows is None else values.rows[wrong]
        what = f"{log.word} {number} names other joints than the first"
        raise InputError(
            what, "write the same joints in all of them, each once", log.path
        )
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
    log: Log,
    groups: Mapping[str, Sequence[str]],
    values: Values,
    found: Recognition,
    rate: float | None,
) -> tuple[Array | None, dict[str, Array], NDArray[np.intp] | None]:
    """Bring channels with stamps of their own to those of the torque.

    Returns the stamps (K,) in the clock's unit (None without a clock), the columns at
    them, and the rows of the file (None: row k is number k + 2).
    """
    columns = values.columns
    clock = groups.get("t", ())
    t = None
    if clock:
        t = _stamps(log, clock, columns)
    own = {
        x: log.columns[x].clock
        for group, xs in groups.items()
        if group != "t"
        for x in xs
    }
    own |= {found.episode: ""} if found.episode else {}
    # A column that is never a number says nothing of rows: whoever reads it says so.
    gaps = {x: gap for x, gap in values.gaps.items() if x in own and not gap.all()}
    if any(gap.all() for x, gap in values.gaps.items() if x in groups["q"]):
        gaps = {}
    if (
        not any(own.values())
        and not gaps
        and not (clock and any(x in values.gaps for x in clock))
    ):
        return t, {x: columns[x] for x in own}, values.rows
    from sdp_vs_penalty.data.stretches.merging import ChannelSamples, align

    n_rows = len(next(iter(columns.values())))
    of_log = np.arange(n_rows, dtype=float) if t is None else t
    seconds = _seconds_unit(found)
    stamps = dict[Any, tuple[Array, Any]]()  # by clock and empty cells
    channels = dict[str, ChannelSamples]()
    places = dict[str, Any]()
    for name, its_clock in own.items():
        gap = gaps.get(name)
        key = its_clock, None if gap is None else gap.tobytes()
        if key not in stamps:
            at = log.clocks[its_clock] if its_clock else of_log
            rows = np.flatnonzero(
                np.isfinite(at) if gap is None else ~gap & np.isfinite(at)
            )
            rows = rows[np.argsort(at[rows], kind="stable")]
            stamps[key] = seconds * at[rows], rows
        at, rows = stamps[key]
        places[name] = rows
        is_whole = len(rows) == len(columns[name]) and bool(np.all(np.diff(rows) == 1))
        channels[name] = ChannelSamples(
            at, columns[name] if is_whole else columns[name][rows], its_clock, rows
        )
    leading = (groups.get("tau") or groups["q"])[0]
    found_rows = align(channels, leading, [found.episode])
    taken = places[leading][found_rows.rows]
    numbers = np.arange(2, n_rows + 2) if values.rows is None else values.rows
    has_rows = not any(own.values())
    _say_lost(
        log,
        gaps,
        numbers if has_rows else None,
        n_rows - len(taken) if has_rows else found_rows.n_lost,
        found_rows.remark,
    )
    its = log.columns[leading].clock
    stamps_taken = (
        log.clocks[its][taken] if its else of_log[taken] if t is not None else None
    )
    return stamps_taken, found_rows.columns, numbers[taken] if has_rows else None


def _seconds_unit(found: Recognition) -> float:
    """Return the factor to seconds of the clock, as far as names say it."""
    return float(found.scale.get("t", 1.0))


def _say_lost(
    log: Log,
    gaps: Mapping[str, NDArray[np.bool_]],
    numbers: NDArray[np.intp] | None,
    n_lost: int,
    interpolated: str,
) -> None:
    """Remark on rows that are left out since a channel is missing there, and on channels
    that were interpolated."""
    reasons = list[str]()
    if n_lost:
        rows = formatting.count(n_lost, "row")
        where = ""
        if numbers is not None and gaps:
            first = numbers[int(np.argmax(np.any([*gaps.values()], axis=0)))]
            where = f" ({log.word} {first} is the first)"
        reasons.append(
            f"{rows} without all channels{where} left out or joined to others"
        )
    reasons += [interpolated] if interpolated else []
    if reasons:
        warnings.warn(f"{log.path}: {'; '.join(reasons)}", Remark, stacklevel=3)


def _stamps(log: Log, clock: Sequence[str], columns: Mapping[str, Array]) -> Array:
    """Return the stamps (N,) of a clock in one column or in parts (seconds and
    nanoseconds; hours, minutes and seconds), in its own unit."""
    if len(clock) == 1:
        stamps = np.ravel(columns[clock[0]])
    else:
        from sdp_vs_penalty.data.words.stamps import units_of_parts

        if len(clock) > 2:
            for name in clock[:2]:
                values = columns[name][np.isfinite(columns[name])]
                if np.any(values != np.round(values)):
                    what = (
                        f"column {name} holds no whole numbers, as a time of day does"
                    )
                    remedy = "name the clock with `convert --rename t=NAME`"
                    raise InputError(what, remedy, log.path)
        parts = zip(units_of_parts(clock), clock, strict=True)
        stamps = np.sum([unit * np.ravel(columns[x]) for unit, x in parts], axis=0)
    is_time_of_day = len(clock) > 2 or any(
        log.columns[x].kind == "stamp" for x in clock
    )
    if is_time_of_day:
        from sdp_vs_penalty.data.words.stamps import past_midnight

        stamps = past_midnight(stamps)
    return stamps


# -- 4. SI units ----------------------------------------------------------------------


def _in_si(
    log: Log,
    found: Recognition,
    groups: Mapping[str, Sequence[str]],
    t: Array | None,
    columns: Mapping[str, Array],
    rows: NDArray[np.intp] | None,
    choice: Choice,
) -> tuple[Measurements, Recognition]:
    """Make the run in SI units, and decide by its values the units that are open.

    Episodes (runs that begin their clock anew) are put one after the other, a second
    apart.
    """
    first = columns[groups["q"][0]]
    # A block can be (N, n) or (n, N): its longer side is that of the samples.
    count = max(first.shape) if first.ndim == 2 else len(first)
    if choice.rate is not None:
        t = np.arange(count) / choice.rate
    if t is None:
        if count and first.size:
            from sdp_vs_penalty.data.hypotheses.proposals import no_clock

            in_si = {
                ours: found.scale.get(ours, 1.0) * columns[x]
                for ours, x in found.rename.items()
                if x in columns
            }
            raise no_clock(log, in_si)
        t = np.zeros(count)
    blocks = {
        group: _block(log, group, [columns[x] for x in names], len(t))
        for group, names in groups.items()
        if group != "t"
    }
    blocks = {
        group: x
        for group, x in blocks.items()
        if group not in _WHOLE or x.shape == blocks["q"].shape
    }
    if len({x.shape[1] for x in blocks.values()}) > 1:
        shown = ", ".join(f"{group} {x.shape[1]}" for group, x in blocks.items())
        what = f"the groups have different numbers of joints: {shown}"
        raise InputError(what, "give q, dq and tau a column a joint", log.path)
    if found.order is not None and len(t):
        blocks = {group: x[:, found.order] for group, x in blocks.items()}
    if not found.is_identity:
        found, blocks = _with_open_units(found, t, blocks, choice.rate)
        if len(t) > 1 and "tau" in blocks:
            found, blocks = _as_the_arm_says(found, t, blocks, choice)
    blocks = {group: x for group, x in blocks.items() if group not in found.torques}
    scale = found.scale
    for group, x in blocks.items():
        factors = found.factors(group, x.shape[1])
        if any(factor != 1.0 for factor in factors):
            parts = (part * factors for _, part in iter_chunks(x))
            blocks[group] = concatenate_chunks([x[:0], *parts])
    if choice.rate is None:
        t = t * scale["t"] if scale.get("t", 1.0) != 1.0 else t
    if found.episode and len(t) > 1:
        t = _episodes_in_a_row(log, t)
    run = Measurements.of(
        t, blocks, (log.run_name or log.path.name,), None, found.torque_unit
    )
    return replace(run, joint_names=found.joints, file_rows=rows), found


def _with_open_units(
    found: Recognition, t: Array, blocks: dict[str, Array], rate: float | None
) -> tuple[Recognition, dict[str, Array]]:
    """Decide units by the values: of angles, of a servo's angles, of the clock."""
    from sdp_vs_penalty.data.hypotheses import weighing as w

    part = slice(w.ROWS_JUDGED)
    for group, kind in found.inferred.items():
        if kind == w.CLOCK:
            continue
        unit = w.unit_of_angles(blocks["q"][part], kind)
        if unit.answer == w.DEGREES_OR_PERCENT and group != "q" and "tau" in blocks:
            # Commands may be in per cent of other ranges.
            blocks = {x: block for x, block in blocks.items() if x != group}
            unit = replace(unit, why="of ranges of its own: it is left out")
        found = found.with_unit(group, unit)
    is_open = rate is None and "t" not in {**found.scale, **found.units}
    if is_open and (found.inferred.get("t") or "dq" in blocks) and len(t) > 1:
        n = blocks["q"].shape[1]
        moved = [
            blocks[x][part] * found.factors(x, n) for x in ("q", "dq") if x in blocks
        ]
        of_velocities = w.rate_from_velocities(*moved) if len(moved) == 2 else None
        if found.inferred.get("t"):
            found = found.with_unit("t", w.unit_of_clock(t[part], of_velocities))
        elif of_velocities:
            below = w.unit_by_velocities(t[part], of_velocities)
            found = found if below is None else found.with_unit("t", below)
    return found, blocks


def _as_the_arm_says(
    found: Recognition, t: Array, blocks: dict[str, Array], choice: Choice
) -> tuple[Recognition, dict[str, Array]]:
    """Decide by an arm's dynamics, where the robot is known, what names leave open: which
    of several sets of channels is the torque, and whether a register has a sign bit."""
    from sdp_vs_penalty.data.hypotheses.arm import N_PARTS, fit_arm, signed_register

    robot = getattr(choice.joints, "robot", None)
    q = blocks["q"] * found.factors("q", blocks["q"].shape[1])
    stamps = t * (found.scale.get("t", 1.0) if choice.rate is None else 1.0)

    def fit(tau: Array) -> Fit | None:
        if robot is None or robot.n != q.shape[1]:
            return None
        return fit_arm(robot, stamps, q, tau)

    channels = {x: blocks[x] for x in found.torques if x in blocks}
    if len(channels) > 1:
        from sdp_vs_penalty.data.hypotheses.recognition import is_current, with_torque
        from sdp_vs_penalty.data.hypotheses.weighing import weigh, which_torque

        whole = np.isfinite(np.hstack(list(channels.values()))).all(axis=1)
        priors = {label: 0.5**k for k, label in enumerate(channels, 1)}
        first = {x: next(iter(found.torques[x].values())) for x in channels}
        fits = {x: y for x, tau in channels.items() if (y := fit(tau)) is not None}
        hypotheses = which_torque(
            {x: tau[whole] for x, tau in channels.items()},
            priors,
            [x for x in channels if not is_current(first[x])],
            fits,
        )
        best = weigh(hypotheses)
        others = [
            f"{x.answer}{f' ({x.why})' if x.why else ''}"
            for x in hypotheses
            if x is not best
        ]
        said = f"not used, of the same joints: {formatting.words(others)}"
        said += ": name them in --rename to take them"
        blocks = {**blocks, "tau": channels[best.answer]}
        found = with_torque(found, found.torques[best.answer])
        why = f"tau: {best.why}" if best.why else ""
        found = replace(found, said=(*found.said, *filter(None, [why]), said))
    register, bit = signed_register(blocks["tau"]) if robot is not None else (q, 0)
    pair = (fit(blocks["tau"]), fit(register)) if bit else (None, None)
    if pair[0] is not None and pair[1] is not None:
        odds = (pair[0].share / pair[1].share) ** N_PARTS
        if odds > _ODDS_OF_A_REGISTER:
            sign = 1.0 if pair[1].friction > 0.0 else -1.0
            said = (
                f"tau is a register whose bit {bit} is its sign: the arm leaves"
                f" {100.0 * pair[1].share:.2g} % of it, {100.0 * pair[0].share:.2g} % as it"
                " is written"
            )
            blocks = {**blocks, "tau": sign * register}
            found = replace(found, said=(*found.said, said), is_of_arm=True)
    return found, blocks


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
        parts = [block]
    if len(parts) == 1 and block.ndim == 2:
        is_upright = len(block) == count or block.shape[1] != count
        block = block if is_upright else block.T
        if block.shape[1] == 0:
            what = f"{group} has no columns, so there are no joints"
            raise InputError(what, "give q, dq and tau a column a joint", log.path)
        parts = [block]
    for part in parts:
        if len(part) != count:
            what = f"{group} has {len(part)} rows, t has {count}"
            raise InputError(what, "give each as many rows as t", log.path)
    if len(parts) == 1 and parts[0].ndim == 2:
        return np.ascontiguousarray(parts[0])
    starts = (start for start, _ in iter_chunks(parts[0]))
    chunks = (
        np.column_stack([np.ravel(x[start : start + PART]) for x in parts])
        for start in starts
    )
    return (
        concatenate_chunks([np.zeros((0, len(parts))), *chunks])
        if count
        else np.zeros((0, len(parts)))
    )


def _episodes_in_a_row(log: Log, t: Array) -> Array:
    """Make the clock (N,) [s] of several episodes ascend: each begins one second after
    the end of the one before."""
    steps = np.diff(t)
    is_start = steps <= 0.0
    if not is_start.any():
        return t
    gaps = np.where(is_start, 1.0 - steps, 0.0)
    episodes = formatting.count(int(is_start.sum()) + 1, "episode")
    said = f"{log.path}: {episodes} one after the other, a second apart"
    warnings.warn(said, Remark, stacklevel=4)
    return t + np.concatenate([[0.0], np.cumsum(gaps)])


# -- 5. the sentence ------------------------------------------------------------------


def reading_sentence(log: Log, found: Recognition) -> str:
    """Format what was taken for what, in which unit and why."""
    from sdp_vs_penalty.data.hypotheses.renaming import by_group

    shown = list[str]()
    for pairs in by_group(found.rename).values():
        (ours, theirs), (our_last, their_last) = (
            next(iter(pairs.items())),
            list(pairs.items())[-1],
        )
        is_one = len(pairs) == 1
        shown.append(
            f"{ours} = {theirs}"
            if is_one
            else f"{ours}..{our_last} = {theirs} .. {their_last}"
        )
    said = [
        f"columns recognised ({found.logger}): {', '.join(shown)}",
        *found.sentences(),
    ]
    if found.joints:
        other = " in the file's order, for the robot's have other names"
        joints = f"joints {', '.join(found.joints)}"
        said.append(joints + other if found.has_other_joints else joints)
    return "; ".join(said)


def repeating_command(log: Log, found: Recognition, choice: Choice = Choice()) -> str:
    """Format the `convert` command that states a reading of the columns explicitly; ""
    where the user scales a channel whose unit was recognised, too: one factor is written
    a channel."""
    from sdp_vs_penalty.data.hypotheses.renaming import rename_words, scale_words

    given = choice.scale or {}
    if found.is_of_arm:  # it decides again where the robot is named, and no column is
        has_arm = "--problem" in choice.options
        return formatting.convert_command(log.path, *choice.options) if has_arm else ""
    if {group_of(x.rstrip("*")) for x in given} & {*map(group_of, found.scale)}:
        return ""
    words = ["--rename", rename_words(found.rename, log.names)]
    factors = [scale_words(found.scale, found.rename)] if found.scale else []
    factors += [f"{name}={factor}" for name, factor in given.items()]
    words += ["--scale", ",".join(factors)] if factors else []
    words += ["--joints", ",".join(found.joints)] if found.order is not None else []
    words += ["--rate", f"{choice.rate:.12g}"] if choice.rate is not None else []
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
