"""Values of columns on one clock, in SI units, joints in the robot's order: a list of
steps, each of one task."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import chain
from typing import Any

import numpy as np

from sdp_vs_penalty import formatting
from sdp_vs_penalty.data.columns import (
    GROUPS,
    OPTIONAL_GROUPS,
    Choice,
    columns_of_groups,
    remark_on_unused,
    require_numbers,
)
from sdp_vs_penalty.data.draft import RIVAL, Draft
from sdp_vs_penalty.data.hypotheses.channels import Recognition
from sdp_vs_penalty.data.log import ROWS_JUDGED, Log, Values
from sdp_vs_penalty.data.measurements import Measurements
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
    rows_before_steps_back,
    spaced_evenly,
    usual_step,
)
from sdp_vs_penalty.data.words.tokens import group_of
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.robot.arrays import Array, Arrays, Indices, Mask

# What only foreign files need is imported where they are read.

#: Largest share of empty cells in a channel that competes with others.
_MOST_GAPS = 0.1
#: Whole numbers that stand for a missing measurement are at least so large.
_LEAST_SENTINEL = 99.0
#: A joint that moves by less does not move [rad, m].
_AT_REST = 1e-3


def run_of_columns(
    log: Log, recognition: Recognition, choice: Choice
) -> tuple[Measurements, Recognition]:
    """Return the run that some columns hold, and what else was decided about them."""
    draft = _read_draft(log, recognition, choice)
    for step in STEPS:
        draft = step(draft)
    run = Measurements.from_channels(
        draft.t,
        draft.blocks,
        (log.run_name or log.path.name,),
        None,
        draft.recognition.torque_unit,
    )
    run = replace(
        run,
        joint_names=draft.recognition.joints,
        episode=draft.episode,
        file_rows=draft.rows,
    )
    for step_of_run in STEPS_OF_RUN:
        run = step_of_run(run, draft)
    return run, draft.recognition


def _read_draft(log: Log, recognition: Recognition, choice: Choice) -> Draft:
    """Read the columns of each channel group, and of rival torques, at the torque's stamps."""
    groups = columns_of_groups(recognition.rename, log, choice)
    names = [*chain(*groups.values()), *filter(None, [recognition.episode])]
    require_numbers(log, names)
    if recognition.has_our_names and not choice.rename:
        remark_on_unused(log, [name for name in log.columns if name not in names])
    torques = {} if choice.rename else recognition.torques
    rivals = {x: list(y.values()) for x, y in torques.items()}
    values = log.read(list(dict.fromkeys(chain(names, *rivals.values()))))
    # Sets of torques compete where they have a value nearly whenever the first one does.
    of_torques = log.columns[groups.get("tau", names)[0]].clock
    groups |= {
        RIVAL.format(label): columns
        for label, columns in rivals.items()
        if all(
            log.columns[x].clock == of_torques
            and np.mean(values.gaps.get(x, False)) < _MOST_GAPS
            for x in columns
        )
    }
    values = _without_sentinels(log, values, groups.get("t", ()))
    values = _in_one_order(log, values, recognition, choice)
    t, columns, rows = _aligned(log, groups, values, recognition)
    return Draft(log, choice, recognition, groups, columns, t, rows)


def _without_sentinels(log: Log, values: Values, clock: Sequence[str]) -> Values:
    """Take cells as empty that hold a number in place of a measurement: zeros at the end of
    a clock (of an array that was longer than the run), and a whole number that repeats in
    few rows, far from all others of its channel, "-999"."""
    columns, gaps, numbers = {**values.columns}, {**values.gaps}, Counter[float]()
    empty = dict[str, Mask]()
    for name, x in values.columns.items():
        if x.ndim > 1 or not x.any():
            continue
        is_empty = _zeros_behind_clock(x) if clock == [name] else _far_larger_number(x)
        if is_empty is not None:
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
        log.remark(f"{n} cells of {number:g} are no measurements: taken as empty")
    return replace(values, columns=columns, gaps=gaps)


def _zeros_behind_clock(t: Array) -> Mask | None:
    """Return which of N stamps lie behind the last one that is finite and not zero; None
    where none does."""
    n_stamps = 0
    for first, part in iter_chunks(t):
        rows = np.flatnonzero(_finite_sizes(part))
        n_stamps = first + int(rows[-1]) + 1 if len(rows) else n_stamps
    return np.asarray(np.arange(len(t)) >= n_stamps) if n_stamps < len(t) else None


def _far_larger_number(x: Array) -> Mask | None:
    """Return which cells (N,) of a column hold its largest number, if that is whole, in few
    cells and more than twice as large as all others; None where it is not."""
    largest = max(float(_finite_sizes(part).max()) for _, part in iter_chunks(x))
    if largest < _LEAST_SENTINEL or largest != np.round(largest):
        return None
    sizes = _finite_sizes(x)
    is_largest = sizes == largest
    largest_other = sizes[~is_largest].max(initial=0.0)
    is_far = 2.0 * largest_other < largest and is_largest.mean() < _MOST_GAPS
    return is_largest if is_far else None


def _finite_sizes(x: Array) -> Array:
    """Return the absolute values (N,) of numbers, 0 of what is not finite."""
    return np.where(np.isfinite(x), np.abs(x), 0.0)


def _in_one_order(
    log: Log, values: Values, recognition: Recognition, choice: Choice
) -> Values:
    """Put the numbers of each row in the first row's order of joints, where every row
    names them: blocks of n joints, and n columns that differ by their number alone."""
    if log.texts is None or not (choice.rename or recognition.joints):
        return values
    from sdp_vs_penalty.data.hypotheses.recognition import (
        columns_of_joint_names,
        joints_of_texts,
    )
    from sdp_vs_penalty.data.words.tokens import families

    names = columns_of_joint_names(log.names)
    names = [x for x in names if log.columns[x].kind in ("text", "list")]
    first = joints_of_texts([next(iter(log.columns[x].cells), "") for x in names])
    if len(first) < 2 or not {*recognition.joints} <= {*first}:
        return values
    rows = [tuple(joints_of_texts(row)) for row in log.texts(names)]
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


def _aligned(
    log: Log,
    groups: Mapping[str, Sequence[str]],
    values: Values,
    recognition: Recognition,
) -> tuple[Array | None, dict[str, Array], Indices | None]:
    """Bring channels with stamps of their own to those of the torque.

    Returns the stamps (K,) in the clock's unit (None without a clock), the columns at
    them, and the rows of the file (None: row k is number k + 2).
    """
    columns, clock = values.columns, groups.get("t", ())
    t = _stamps(log, clock, columns) if clock else None
    names = [x for group, xs in groups.items() if group != "t" for x in xs]
    clocks = {x: log.columns[x].clock for x in names}
    clocks |= {recognition.episode: ""} if recognition.episode else {}
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
    seconds = recognition.scale.get("t", 1.0)  # of a unit that names say
    samples, channels = dict[Any, ChannelStamps](), dict[str, tuple[Any, Array]]()
    for name, clock_of_column in clocks.items():
        has_value = ~gaps[name] if name in gaps else np.ones(len(columns[name]), bool)
        key = clock_of_column, has_value.tobytes()
        if key not in samples:
            stamps_of_clock = stamps[clock_of_column]
            rows = np.flatnonzero(has_value & np.isfinite(stamps_of_clock))
            if not len(rows):
                what = "no sample has a stamp that is a number"
                remedy = "log the clock as well, or give the rate"
                raise InputError(what, remedy, log.path, "--rate HZ")
            rows = rows[np.argsort(stamps_of_clock[rows], kind="stable")]
            samples[key] = ChannelStamps(
                seconds * stamps_of_clock[rows], rows, clock_of_column
            )
        rows = samples[key].rows
        is_whole = len(rows) == len(columns[name]) and bool(np.all(np.diff(rows) == 1))
        channels[name] = key, columns[name] if is_whole else columns[name][rows]
    leading = (groups.get("tau") or groups["q"])[0]
    kept, columns, n_lost, remark = align(
        samples, channels, leading, [recognition.episode]
    )
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
        log.remark("; ".join(reasons))
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


def _in_order_of_time(draft: Draft) -> Draft:
    """Put rows that stand in no order of time in that of their stamps."""
    t, columns, rows = draft.stamps, draft.columns, draft.rows
    if t is None or not len(rows_before_steps_back(t)):
        return draft
    order = order_of_time(t, np.column_stack([columns[x] for x in draft.groups["q"]]))
    if order is None:
        return draft
    draft.log.remark("rows stand in no order of time: put in that of their stamps")
    n_rows = len(t)
    rows = (np.arange(2, n_rows + 2) if rows is None else rows)[order]
    columns = {x: y[order] if len(y) == n_rows else y for x, y in columns.items()}
    return replace(draft, stamps=t[order], columns=columns, rows=rows)


def _with_stamps(draft: Draft) -> Draft:
    """Take the rate that is chosen for the clock, or the one that velocities tell of a file
    without a clock; raise InputError where nothing tells it."""
    choice, recognition, columns = draft.choice, draft.recognition, draft.columns
    first = columns[draft.groups["q"][0]]
    # A block can be (N, n) or (n, N): its longer side is that of the samples.
    count = max(first.shape) if first.ndim == 2 else len(first)
    if choice.rate is not None:
        return replace(draft, stamps=None, t=np.arange(count) / choice.rate)
    if draft.stamps is not None:
        return replace(draft, t=draft.stamps)
    if not first.size:
        return replace(draft, t=np.zeros(count))
    from sdp_vs_penalty.data.hypotheses.proposals import no_clock, rate_of

    pairs = {x: columns[y] for x, y in recognition.rename.items() if y in columns}
    pairs = {x: recognition.scale.get(x, 1.0) * y for x, y in pairs.items()}
    rate = None if choice.as_written else rate_of(pairs, is_usual=True)
    if rate is None:
        named = recognition.joints if choice.joints else ()
        raise no_clock(draft.log, pairs, named)
    sentence = f"t = rows at {rate:g} Hz, at which dq is the derivative of q"
    recognition = replace(recognition.with_sentences(sentence), rate=rate)
    return replace(draft, recognition=recognition, t=np.arange(count) / rate)


def _with_blocks(draft: Draft) -> Draft:
    """Put the columns of each group together to a block (N, n)."""
    blocks = {
        group: _block(draft.log, group, [draft.columns[x] for x in names], len(draft.t))
        for group, names in draft.groups.items()
        if group != "t"
    }
    return replace(draft, blocks=blocks)


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
    return concatenate_chunks(chain([np.zeros((0, len(parts)))], chunks))


def _with_the_same_joints(draft: Draft) -> Draft:
    """Leave out of blocks (N, n) the joints that some groups lack, such as a gripper without
    torque.

    The joints' names tell which these are. Without names it is the last one, if the robot
    has one joint less. Raises InputError otherwise.
    """
    log, recognition, blocks = draft.log, draft.recognition, draft.blocks
    widths = {x: y.shape[1] for x, y in blocks.items() if x not in OPTIONAL_GROUPS}
    n = min(widths.values())
    if max(widths.values()) > n:
        named = {x: log.columns[draft.groups[x][0]].joints for x in widths}
        shown = ", ".join(f"{group} {width}" for group, width in widths.items())
        what = f"the groups have different numbers of joints: {shown}"
        common = set.intersection(*({*x} for x in named.values()))
        is_last = n == len(draft.choice.joints or ()) == max(widths.values()) - 1
        if len(common) != n and not is_last:
            raise InputError(what, "give q, dq and tau a column a joint", log.path)
        places = {
            x: [k for k, joint in enumerate(named[x]) if joint in common] or [*range(n)]
            for x in widths
        }
        used = "those that all have" if common else f"the first {n}"
        log.remark(f"{what}: {used} are used")
        blocks = {x: y[:, places[x]] if x in places else y for x, y in blocks.items()}
        order = recognition.order and tuple(
            places["q"].index(k) for k in recognition.order if k in places["q"]
        )
        joints = tuple(x for x in recognition.joints if x in common or not common)
        recognition = replace(recognition, order=order, joints=joints)
    shape = blocks["q"].shape
    blocks = {
        x: y for x, y in blocks.items() if x not in OPTIONAL_GROUPS or y.shape == shape
    }
    return replace(draft, recognition=recognition, blocks=blocks)


def _in_order_of_robot(draft: Draft) -> Draft:
    """Put the joints of each block in the robot's order."""
    order = draft.recognition.order
    if order is None or not len(draft.t):
        return draft
    blocks = {group: x[:, order] for group, x in draft.blocks.items()}
    return replace(draft, blocks=blocks)


def _with_units_of_angles(draft: Draft) -> Draft:
    """Decide units of angles, and of a servo's, by the values."""
    recognition, blocks = draft.recognition, draft.blocks
    angles = {
        group: kind for group, kind in recognition.inferred.items() if group != "t"
    }
    if not angles:
        return draft
    from sdp_vs_penalty.data.hypotheses import weighing as w

    for group, kind in angles.items():
        unit = w.unit_of_angles(blocks["q"][:ROWS_JUDGED], kind)
        if unit.answer == w.DEGREES_OR_PERCENT and group != "q" and "tau" in blocks:
            # Commands may be in per cent of other ranges.
            blocks = {x: block for x, block in blocks.items() if x != group}
            unit = replace(unit, why="of ranges of its own: it is left out")
        recognition = recognition.with_unit(group, unit)
    return replace(draft, recognition=recognition, blocks=blocks)


def _from_zero_of_encoders(draft: Draft) -> Draft:
    """Count positions, and commands in their unit, from the encoders' readings at zero."""
    zeros, blocks = draft.recognition.zeros, draft.blocks
    is_in_unit_of_q = False
    if "qcmd" in blocks:
        from sdp_vs_penalty.data.hypotheses.weighing import is_in_one_unit

        is_in_unit_of_q = is_in_one_unit(blocks["q"], blocks["qcmd"])
    if zeros:
        in_counts = ["q", "qcmd"] if is_in_unit_of_q else ["q"]
        blocks = {**blocks, **{x: blocks[x] - zeros for x in in_counts}}
    return replace(draft, blocks=blocks, is_command_in_unit_of_q=is_in_unit_of_q)


def _with_unit_of_clock(draft: Draft) -> Draft:
    """Decide the unit of a clock that nothing says, by its steps, the velocities and how
    fast joints move."""
    return draft if draft.choice.as_written else draft.with_unit_of_clock()


def _as_the_arm_says(draft: Draft) -> Draft:
    """Decide by an arm's dynamics, where the robot is known, what names leave open."""
    recognition, q = draft.recognition, draft.blocks["q"]
    if len(draft.t) < 2 or "tau" not in draft.blocks:
        return draft
    robot = draft.robot
    if robot is None and len(draft.rival_torques) < 2:
        return draft
    is_open = not recognition.is_identity or draft.choice.recorder.is_told
    first_torques = draft.blocks["tau"][: len(draft.t) // 10 + 1]
    is_open |= not np.any(first_torques < 0.0)  # a register's sign
    if robot and not is_open and not far_outside(robot, q):
        return draft
    from sdp_vs_penalty.data.hypotheses.by_arm import STEPS_BY_ARM

    for step in STEPS_BY_ARM:
        draft = step(draft)
    return draft


def _in_si(draft: Draft) -> Draft:
    """Multiply blocks and stamps by their factors to SI; raise InputError where a unit is
    only known to be one of several."""
    choice = draft.choice
    blocks = {group: x for group, x in draft.blocks.items() if group in GROUPS}
    recognition = draft.recognition.without_units_of(choice.groups_scaled)
    factors_of_q = recognition.factors("q", blocks["q"].shape[1])
    has_factor = "qcmd" in {*map(group_of, (*recognition.scale, *(choice.scale or {})))}
    if draft.is_command_in_unit_of_q and not has_factor:
        recognition = recognition.with_factors("qcmd", factors_of_q)
    for group, x in blocks.items():
        factors = recognition.factors(group, x.shape[1])
        if np.isnan(factors).any():
            units = recognition.units[group].answer
            what = f"{group} is in {units}, each of some joints"
            remedy = "name the robot, or give a unit a joint"
            command = f"--problem, or --scale {group}=mm:deg"
            raise InputError(what, remedy, draft.log.path, command)
        if any(factor != 1.0 for factor in factors):
            blocks[group] = _multiplied(x, factors)
    t = draft.t
    if choice.rate is None and "t" in recognition.scale:
        t = _multiplied(t, recognition.scale["t"])
    return replace(draft, recognition=recognition, t=t, blocks=blocks)


def _multiplied(x: Array, factors: float | Sequence[float]) -> Array:
    """Return channels (N, ...) times a factor, or n of them, chunk by chunk."""
    parts = (part * factors for _, part in iter_chunks(x))
    return concatenate_chunks(chain([x[:0]], parts))


def _with_velocities_in_unit_of_positions(draft: Draft) -> Draft:
    """Bring velocities and commands to the unit of positions where values show another."""
    choice, recognition = draft.choice, draft.recognition
    if choice.as_written or {*map(group_of, choice.scale or {})} & {"q", "dq", "t"}:
        return draft
    from sdp_vs_penalty.data.hypotheses.weighing import in_one_unit

    factors_of_q = recognition.factors("q", draft.blocks["q"].shape[1])
    blocks, sentences = in_one_unit(draft.t, draft.blocks, factors_of_q)
    recognition = recognition.with_sentences(*sentences)
    return replace(draft, recognition=recognition, blocks=blocks)


def _with_one_clock(draft: Draft) -> Draft:
    """Continue a clock that begins anew, or is set back, and number the episodes."""
    t, column = draft.t, draft.recognition.episode
    has_clock = draft.stamps is not None
    is_read = has_clock and not draft.choice.as_written
    if len(t) < 2 or not (column or (is_read and is_set_back(t))):
        return draft
    # Steps over which the clock was only set back, while the motion goes on.
    set_back = np.zeros(len(t) - 1, bool)
    if not column:
        begins = np.diff(t) < 0.0
        rows = np.flatnonzero(begins)
        set_back[rows] = goes_on(draft.blocks["q"], rows)
    elif has_clock:
        begins = np.diff(t) <= 0.0
    else:
        begins = np.diff(draft.columns[column]) != 0.0
    t, episode = _one_after_the_other(draft.log, t, begins, set_back)
    return replace(draft, t=t, episode=episode)


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
    sentence = f"{n_episodes} one after the other, a second apart"
    if not begins.any():
        sentence = "the clock was set back while the motion goes on: continued"
    log.remark(sentence)
    return t + np.cumsum(np.append(0.0, added)), np.cumsum(np.append(0, begins))


def _without_idle_joints(run: Measurements, draft: Draft) -> Measurements:
    """Leave out the joints beyond the robot's whose torque is exactly zero in every row, a
    gripper's, or that do not move at all while the others do, another arm's."""
    n = draft.choice.n_logged
    if not draft.choice.joints or run.n <= n or not run.torque_logged or not len(run.t):
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
    draft.log.remark(f"{shown} of the log {what}: left out")
    joints = tuple(x for k, x in enumerate(run.joint_names) if k not in idle)
    return replace(run.without_joints(idle), joint_names=joints)


def _without_copies(run: Measurements, draft: Draft) -> Measurements:
    """Leave out rows like the one before, the stamp too, where they are few."""
    copies = _rows_like_the_one_before(run)
    n_rows = len(run.t)
    if draft.choice.as_written or not 0 < len(copies) < _MOST_GAPS * n_rows:
        return run
    many = formatting.count(len(copies), "row")
    draft.log.remark(f"{many} like the one before, the stamp too: left out")
    if run.file_rows is None:
        run = replace(run, file_rows=np.arange(2, n_rows + 2))
    is_first = np.ones(n_rows, bool)
    is_first[copies] = False
    return run.rows(is_first)


def _rows_like_the_one_before(run: Measurements) -> Indices:
    """Return the rows (K,) that are copies of the one before, with the same stamp."""
    parts = iter_chunks(run.t, overlap=1)
    rows = [first + 1 + np.flatnonzero(np.diff(part) == 0.0) for first, part in parts]
    copies = np.concatenate([np.zeros(0, np.intp), *rows])
    for x in run.groups.values() if len(copies) else ():
        copies = copies[(x[copies] == x[copies - 1]).all(axis=1)]
    return copies


def _with_even_stamps(run: Measurements, draft: Draft) -> Measurements:
    """Space rows evenly whose stamps were rounded to more than a row."""
    if draft.recognition.has_our_names or draft.choice.as_written:
        return run
    step = _rounded_to(run)
    if not step:
        return run
    run = replace(run, t=spaced_evenly(run.t, step))
    between_rows = float(np.median(np.diff(run.t)))
    steps = f"stamps were written in steps of {step:.3g} s"
    draft.log.remark(f"{steps}: rows are spaced evenly, {between_rows:.3g} s apart")
    return run


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


def _unwrapped(run: Measurements, draft: Draft) -> Measurements:
    """Continue positions in degrees where they were cut at a full turn."""
    scale = draft.recognition.scale
    if not scale:
        return run
    from sdp_vs_penalty.data.hypotheses.wrapping import POSITIONS, unwrapped
    from sdp_vs_penalty.data.words.units import UNITS

    in_degrees = {group_of(x) for x, y in scale.items() if y == UNITS["deg"]}
    in_degrees -= {*map(group_of, draft.choice.scale or {})}
    return unwrapped(run, draft.log.path, [x for x in POSITIONS if x in in_degrees])


#: From columns to blocks in SI: each step decides or changes one thing.
STEPS: tuple[Callable[[Draft], Draft], ...] = (
    _in_order_of_time,
    _with_stamps,
    _with_blocks,
    _with_the_same_joints,
    _in_order_of_robot,
    _with_units_of_angles,
    _from_zero_of_encoders,
    _with_unit_of_clock,
    _as_the_arm_says,
    _in_si,
    _with_velocities_in_unit_of_positions,
    _with_one_clock,
)
#: What then is left out of the run, and how its stamps and angles are continued.
STEPS_OF_RUN: tuple[Callable[[Measurements, Draft], Measurements], ...] = (
    _without_idle_joints,
    _without_copies,
    _with_even_stamps,
    _unwrapped,
)
