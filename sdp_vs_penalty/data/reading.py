"""A run of a log, and what is said of it: which column was taken for what, in which unit
and why, and the command that states it."""

from __future__ import annotations

import re
import warnings
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace

import numpy as np

from sdp_vs_penalty import formatting
from sdp_vs_penalty.data.columns import Choice, channels_of, with_counter
from sdp_vs_penalty.data.hypotheses.channels import Recognition
from sdp_vs_penalty.data.log import Log
from sdp_vs_penalty.data.measurements import Measurements, columns_of
from sdp_vs_penalty.data.recorder import Recorder
from sdp_vs_penalty.data.values import run_of_columns
from sdp_vs_penalty.data.words.tokens import group_of
from sdp_vs_penalty.errors import ColumnsRemark, InputError

# What only foreign files need is imported where they are read.

#: Desired positions are at most so far from the measured ones, over their motion.
_FOLLOWS = 0.1
#: Rates that velocities and the clock tell are the same up to this share.
_SAME_RATE = 0.1
#: Rows by which a derivative is judged.
_LEAST_ROWS = 50
#: Rows that are shown of columns that were guessed, and orders of columns that are tried.
_ROWS_SHOWN, _MOST_ORDERS = 5, 12


def run_of(log: Log, choice: Choice | None = None) -> Measurements:
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
    choice = (choice or Choice()).for_columns(log.names)
    columns = tuple(log.names)
    log, run, recognition = run_and_reading(log, choice)
    if not (choice.as_written or choice.rename or choice.scale):
        recorder = _recorder(columns, run, recognition)
        if recorder == choice.recorder:  # another log has told it
            recorder = choice.recorder
        run = replace(run, recorders=(recorder,))
    n = choice.n_logged
    of_first_joints = ""
    if run.n == n + 1 > 1 and not (run.joint_names or choice.is_of_motors):
        of_first_joints = _command_of_first_joints(log, recognition, choice, n)
        what = f"{run.n} joints, the robot has {n}, and no name tells which"
        how = f"where the last is a gripper's, convert it by `{of_first_joints}`"
        log.remark(f"{what}: {how}")
    if recognition.is_identity:
        return replace(run, unit_command=of_first_joints)
    sentence, with_command = sentence_and_command(log, recognition, choice)
    others = {
        name: columns
        for name, columns in recognition.torques.items()
        if not columns.items() <= recognition.rename.items()
    }
    remark = ColumnsRemark(
        with_command, _rows_shown(run, recognition.rename), recognition.rename, others
    )
    warnings.warn(remark, stacklevel=2)
    run = replace(run, reading=f"{log.path.name}: {sentence}")
    is_asked = (
        "q" in recognition.unsaid and not recognition.is_of_arm
    ) or recognition.is_possible
    asked = _asking_command(log, recognition, choice) if is_asked else ""
    return replace(run, unit_command=of_first_joints or asked)


def _recorder(
    columns: tuple[str, ...], run: Measurements, recognition: Recognition
) -> Recorder:
    """Return what the arm has told of a log that is so for others of its recorder."""
    order = recognition.rename.items() if recognition.is_confirmed else ()
    return Recorder(
        columns,
        recognition.unit_by_arm,
        tuple(order),
        recognition.has_sign_bit,
        run.names[0],
    )


def _command_of_first_joints(
    log: Log, recognition: Recognition, choice: Choice, n: int
) -> str:
    """Format the command that takes the first n joints of a log, columns of blocks too."""
    rename = {x: y for x, y in recognition.rename.items() if group_of(x) == "t"}
    for k in range(1, n + 1):
        for ours, theirs in recognition.rename.items():
            group = group_of(ours)
            if ours == f"{group}{k}":
                rename[ours] = theirs
            elif ours == group != "t":
                rename[f"{group}{k}"] = f"{theirs}_{k}"
    scale = {x: y for x, y in recognition.scale.items() if x in (*rename, group_of(x))}
    return repeating_command(
        log, replace(recognition, rename=rename, scale=scale), choice
    )


def _asking_command(log: Log, recognition: Recognition, choice: Choice) -> str:
    """Format the command that states the unit of positions, which nothing says."""
    stated = {} if recognition.is_possible else {"q": "UNIT"}
    stated |= recognition.possible_scale
    for group in stated:
        recognition = recognition.without_unit(group)
    options = (*recognition.possible_options, *choice.options)
    scale = {**(choice.scale or {}), **stated}
    asking = replace(choice, scale=scale, options=options)
    return repeating_command(log, recognition, asking)


def run_and_reading(log: Log, choice: Choice) -> tuple[Log, Measurements, Recognition]:
    """Return the run of a log, what its columns were taken for, and the log, perhaps with
    a column a joint."""
    log, recognition = channels_of(log, choice)
    recognition, choice = _with_rate(log, recognition, choice)
    recognition = _with_stated_units(log, recognition, choice)
    if choice.as_written and recognition.unless_confirmed is not None:
        raise recognition.unless_confirmed
    recognition = _in_order_of_recorder(recognition, choice.recorder)
    if recognition.others:
        recognition = _confirmed_order(log, recognition, choice)
    refusal = recognition.unless_confirmed
    try:
        run, recognition = run_of_columns(log, recognition, choice)
    except InputError as error:
        raise refusal or error from None
    if recognition.unless_confirmed is not None:
        raise recognition.unless_confirmed
    if not (recognition.has_our_names or choice.rename) and _follows_positions(run):
        log.remark("what is called velocity follows the positions: left out")
        run = replace(run, dq=None)
    if not (choice.rename or choice.as_written) and _are_exchanged(run):
        recognition = _with_exchanged_velocities(recognition)
        run, recognition = run_of_columns(log, recognition, choice)
    return log, run, recognition


def _with_rate(
    log: Log, recognition: Recognition, choice: Choice
) -> tuple[Recognition, Choice]:
    """Take what counts rows for a clock that is missing, or the rate of the file's header."""
    if choice.rate is None and "t" not in recognition.rename:
        recognition = with_counter(log, recognition)
        if "t" not in recognition.rename and log.rate is not None:
            log.remark(f"{log.rate:g} rows a second, as the file's header says")
            choice = replace(choice, rate=log.rate)
    return recognition, choice


def _with_stated_units(
    log: Log, recognition: Recognition, choice: Choice
) -> Recognition:
    """Leave out the units of groups that ``--scale`` states, and remark on a factor that
    stands beside a unit of the file."""
    for name, word in (choice.scale or {}).items():
        unit = recognition.units.get(group_of(name))
        if unit is not None and not re.search("(?i)(?<![0-9.])[a-z]", word):
            what = f"--scale {name}={word} makes SI of the numbers as written"
            log.remark(f"{what}, not of {unit.answer}, {unit.why}")
    return recognition.without_units_of(choice.groups_scaled)


def _with_exchanged_velocities(recognition: Recognition) -> Recognition:
    """Take the columns of positions for velocities, and those of velocities for positions."""
    other = {"q": "dq", "dq": "q"}
    rename = dict[str, str]()
    for ours in recognition.rename:
        group = group_of(ours)
        exchanged = other.get(group, group) + ours.removeprefix(group)
        rename[ours] = recognition.rename[exchanged]
    what = "q and dq are exchanged: what is called q is the derivative of dq"
    return replace(recognition.with_sentences(what), rename=rename)


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


def _in_order_of_recorder(recognition: Recognition, recorder: Recorder) -> Recognition:
    """Return the order of columns that the arm has confirmed in another log of the recorder,
    where the values allow it."""
    if recognition.unless_confirmed is None or not recorder.order:
        return recognition
    for order in (recognition, *recognition.others):
        if order.rename == dict(recorder.order):
            sentence = f"the columns of {recorder.run}, of which the arm tells it"
            order = replace(order, unless_confirmed=None, others=(), is_confirmed=True)
            return order.with_sentences(sentence)
    return recognition


def _confirmed_order(log: Log, recognition: Recognition, choice: Choice) -> Recognition:
    """Return the order of columns that values and arm confirm far more than others; without
    a robot the likeliest one. Raises its error where they confirm none, or several."""
    from sdp_vs_penalty.data.hypotheses.arm import N_PARTS
    from sdp_vs_penalty.data.hypotheses.weighing import CERTAIN

    if getattr(choice.joints, "robot", None) is None:
        return recognition
    explained = list[tuple[Recognition, float]]()
    for order in (recognition, *recognition.others)[:_MOST_ORDERS]:
        if explained and order.weight * CERTAIN < recognition.weight:
            break
        with warnings.catch_warnings(action="ignore"), suppress(InputError):
            explained.append((order, run_of_columns(log, order, choice)[1].share))
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
    if recognition.unless_confirmed is not None and not is_confirmed:
        raise recognition.unless_confirmed
    return ranked[0] if ranked else recognition


def _motion_columns(recognition: Recognition) -> tuple[str, ...]:
    """Return the columns that a reading takes for what is no torque."""
    return tuple(y for x, y in recognition.rename.items() if group_of(x) != "tau")


def sentence_and_command(
    log: Log, recognition: Recognition, choice: Choice
) -> tuple[str, str]:
    """Format what was taken for what, in which unit and why; and the same with the file's
    path and the `convert` command that states it. Both are "" where nothing was guessed.
    """
    if recognition.is_identity:
        return "", ""
    from sdp_vs_penalty.data.hypotheses.renaming import by_group

    shown = list[str]()
    for pairs in by_group(recognition.rename).values():
        ours, theirs = ("..", " .. ") if len(pairs) > 1 else ("", "")
        ends = [[*x][:: max(len(x) - 1, 1)] for x in (pairs, pairs.values())]
        shown.append(f"{ours.join(ends[0])} = {theirs.join(ends[1])}")
    units = (
        f"{group} in {x.answer}, {x.why}" for group, x in recognition.units.items()
    )
    sentences = [
        f"columns recognised ({recognition.logger or 'as chosen'}): {', '.join(shown)}"
    ]
    sentences += [*units, *recognition.said]
    if recognition.logger and "tau" not in map(group_of, recognition.rename):
        sentences.append(
            "no torque is in the file: log it as well, or identify the servos from their"
            " commands with --known, such as a mass"
        )
    named_above = {x.split(" ")[0] for x in (*recognition.units, *recognition.said)}
    if unsaid := sorted(recognition.unsaid - named_above):
        sentences.append(
            f"no name says the unit of {formatting.words(unsaid)}: taken as SI"
        )
    if recognition.joints:
        other = " in the file's order, for the robot's have other names"
        sentences.append(
            f"joints {', '.join(recognition.joints)}{other if recognition.has_other_joints else ''}"
        )
    sentence = "; ".join(sentences)
    is_possible = recognition.is_possible
    format_command = _asking_command if is_possible else repeating_command
    command = "" if log.remedy else format_command(log, recognition, choice)
    how = "if so, convert it by" if is_possible else "the same by"
    repeated = f"; {how} `{command}`" if command else ""
    return sentence, f"{log.path}: {sentence}{repeated}"


def repeating_command(log: Log, recognition: Recognition, choice: Choice) -> str:
    """Format the `convert` command that states a reading of the columns explicitly; ""
    where no command does."""
    from sdp_vs_penalty.data.hypotheses.renaming import convert_options

    words = list[str]()
    if (
        recognition.is_of_arm
    ):  # the arm decides again if the command names the robot, no columns
        if "--problem" not in choice.options:
            return ""
    else:
        rate = choice.rate or recognition.rate
        text = f"{rate:.12g}" if rate else ""
        words = convert_options(recognition, log.names, text, choice.scale or {})
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
