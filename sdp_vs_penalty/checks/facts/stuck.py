"""Torques and positions that do not change: frozen, filled with zeros, at a limit, or the
truth.

What a channel repeats may be what was measured: a drive that is off makes no torque, one
at its limit no more than that. The arm that explains the other rows tells.
"""

from collections.abc import Iterator

import numpy as np

from sdp_vs_penalty.checks.certainty import likely, told_by
from sdp_vs_penalty.checks.constants import GAP, LONG_STRETCH, RUN, STUCK, STUCK_SECONDS
from sdp_vs_penalty.checks.glance import Rows, RunSummary, mask_of
from sdp_vs_penalty.checks.issue import Issue, make_issue
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.formatting import plain_unit
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.encoder import lattice_step
from sdp_vs_penalty.signals.runs import spans

#: Why a torque that does not change is the joint's.
_AS_ELSEWHERE = likely("the arm that explains the other rows explains it there as well")
_AT_EFFORT_LIMIT = likely("it is the joint's effort limit")
#: Why a torque is zero that the arm needs.
_NOT_MEASURED = "nothing was measured, or the drive was off"


def find_drives_off(glance: RunSummary) -> Iterator[Issue]:
    """Yield an issue about joints that move while their torque is exactly zero.

    It is a note that the drive was off where the arm explains a torque of zero.
    Elsewhere the zeros are false, or something that is not in the log moved the joint,
    such as a hand.
    """
    moved = {}
    for j in np.flatnonzero(glance.moving).tolist():
        x = glance.run.tau[:, j] if glance.run.torque_logged else np.ones(1)
        # A coarse channel stays at other values as long.
        others = np.diff(spans((np.diff(x) == 0.0) & (x[1:] != 0.0))).max(initial=1)
        parts = [
            (first, end)
            for first, end in spans(x == 0.0)
            if glance.run.t[end - 1] - glance.run.t[first] >= 2.0 * STUCK_SECONDS
            and end - first >= LONG_STRETCH * others
            and not glance.is_at_rest(j, first, end)
        ]
        is_off = mask_of(len(x), parts)
        if not 0.0 < is_off.mean() < 1.0:
            continue
        if not glance.holds_torque(j, is_off):
            moved[f"tau{j + 1}"] = is_off
            continue
        seconds = sum(glance.run.t[end - 1] - glance.run.t[a] for a, end in parts)
        yield make_issue(
            kind="drive off",
            severity="note",
            joints=[j],
            what=f"tau{j + 1} is exactly zero for {seconds:.3g} s, while the joint"
            " moves: the drive was off, and zero is the torque.",
            certainty=_AS_ELSEWHERE,
            remedy="",
            needs_action=False,
            where=f"tau{j + 1}",
            figures={
                "rows": int(is_off.sum()),
                "times": glance.one_arm_is_worse(j, is_off),
            },
        )
    what = (
        "{named} {are} exactly zero for {seconds:.3g} s, {times}, in motion: what moved"
        " the joint is not in the log."
    )
    at_zero = "it stays at no other value for nearly as long"
    sure = told_by(at_zero, glance.second_witness(moved))
    yield from glance.delete_rows("zeros", moved, what, sure, cause=_NOT_MEASURED)


def find_false_zeros(glance: RunSummary) -> Iterator[Issue]:
    """Yield an issue about exact zeros that a logger filled in because it had no
    sample.

    The joint moves, the channel jumps to zero and back to the same side, and to no
    other value does it jump so.

    A torque that changes its sign passes through zero, in steps of its drive's
    resolution exactly; a joint at rest, with its brake on, may need none; noise returns
    to other values as often.
    """
    bad = {}
    for name, j, x in glance.channels:
        if not glance.moving[j] or np.count_nonzero(x) < RUN or not np.ptp(x) > 0.0:
            continue
        zeros = _filled(x)
        if name.startswith("tau"):
            for first, end in spans(zeros):
                zeros[first:end] = not glance.is_at_rest(j, first, end)
            zeros &= not glance.holds_torque(j, zeros)
        bad[name] = zeros
    what = "{named} {are} exactly zero in {row_count}, and jump{s} there and back."
    jumps = "the channel jumps to no other value and back"
    sure = told_by(jumps, glance.second_witness(bad, "no joint moves like that"))
    yield from glance.delete_rows("zeros", bad, what, sure, cause=_NOT_MEASURED)


#: A channel drops to zero where so many times as many of its jumps there and back end at
#: zero as at other values, at which noise or packets end alike.
_ZEROS_OVER_OTHERS = 3.0


def _filled(x: Array) -> Rows:
    """Return the rows (N,) of zeros that a logger filled into a channel x (N,).

    Such zeros lie between samples far from zero on the same side. None are returned if
    the channel jumps to other values and back nearly as often.
    """
    if not np.any(x == 0.0):
        return np.zeros(len(x), bool)
    changes = np.abs(np.diff(x))
    usual = float(np.median(changes[changes > 0.0]))
    threshold = max(6.0 * usual, 3.0 * lattice_step(x[x != 0.0]))
    # Stretches of one value, from ``starts`` to before ``ends``, but for the first and
    # the last.
    edges = np.flatnonzero(changes > 0.0) + 1
    starts = edges[:-1]
    ends = edges[1:]
    before = x[starts - 1] - x[starts]
    after = x[ends] - x[starts]
    is_same_side = before * after > 0.0
    smaller_jump = np.minimum(np.abs(before), np.abs(after))
    comes_back = is_same_side & (smaller_jump > threshold)
    is_zero = comes_back & (x[starts] == 0.0)
    n_elsewhere = np.count_nonzero(comes_back & (x[starts] != 0.0))
    if n_elsewhere * _ZEROS_OVER_OTHERS > np.count_nonzero(is_zero):
        return np.zeros(len(x), bool)
    return mask_of(len(x), np.column_stack([starts, ends])[is_zero])


def find_frozen_channels(glance: RunSummary, word: str, name: str) -> Iterator[Issue]:
    """Yield an issue about channels that are frozen: they repeat a value bit by bit
    while the arm moves, and did not slow down before.

    word : "position" or "torque"; name : first letter of the channels' names.
    """
    is_position = name == "q"
    bad = {}
    for channel, j, x in glance.channels:
        is_judged = glance.moving[j] or not is_position
        if channel[0] == name and is_judged and np.ptp(x) > 0.0:
            frozen = _stuck(glance, j, x, is_position)
            is_true = not is_position and glance.holds_torque(j, frozen)
            bad[channel] = frozen & (not is_true)
    what = (
        "{named} repeat{s} one value for {seconds:.3g} s, {times}, while the arm"
        " moves: frozen."
    )
    goes_on = is_position and all(
        velocity_goes_on(glance.run, int(channel[1:]) - 1, first, end - 1)
        for channel, rows in bad.items()
        for first, end in spans(rows)
    )
    velocity = "its logged velocity goes on" if goes_on else ""
    second = glance.second_witness(bad, velocity)
    sure = told_by("elsewhere it never repeats for nearly as long", second)
    yield from glance.delete_rows(f"frozen {word}", bad, what, sure)


def _stuck(glance: RunSummary, j: int, x: Array, is_position: bool) -> Rows:
    """Return the rows (N,) in which the channel x (N,) of joint j is frozen.

    A long stretch of one value is a freeze if what comes behind it does not continue
    it: a position jumps by four usual steps, a torque jumps while the arm moves.
    A torque that stays until the end is frozen if its joint turns round meanwhile.
    """
    pauses = _long_pauses(glance, x)  # first and last rows
    if not pauses:
        return np.zeros(len(x), bool)
    steps = np.abs(np.diff(x))
    level = largest_step_of_resolution(x)
    frozen_parts = []
    position = glance.run.q[:, j]
    held = x[[first for first, _ in pauses]]
    for first, last in pauses:
        if x[first] in (x.min(), x.max()) or np.sum(held == x[first]) > 1:
            continue  # clipped there: a freeze stays at the value of its begin
        if not is_position and x[first] == 0.0:
            continue  # its drive is off there
        if is_position and velocity_goes_on(glance.run, j, first, last):
            is_frozen = True
        elif last == len(x) - 1 or glance.steps[last] > GAP * glance.usual_step:
            # The run ends with this value, or rows are missing behind it: only a torque
            # can be judged.
            turns_round = _joint_goes_round(position, first, last)
            is_frozen = turns_round and not is_position
        elif steps[last] < level:
            is_frozen = False
        elif is_position:
            is_frozen = steps[last] >= 4.0 * float(np.median(steps[steps > 0.0]))
        else:
            is_frozen = not _arm_rests(glance, first, last)
        if is_frozen:
            frozen_parts.append((first, last + 1))
    return mask_of(len(x), frozen_parts)


def largest_step_of_resolution(x: Array) -> float:
    """Return three steps of a channel's resolution: a change of x (N,) by less may be
    one of its counter."""
    return 3.0 * lattice_step(x)


def velocity_goes_on(run: Measurements, j: int, a: int, b: int) -> bool:
    """Whether joint j's logged velocity shows that it moves from row a to b.

    It does if two things hold. The mean square velocity there is at least a tenth of
    that elsewhere. And the velocity's integral leaves the position by more than steps of
    its encoder: a joint that is held still trembles by less.
    False if no velocity was logged.
    """
    if run.dq is None:
        return False
    velocity = run.dq[:, j]
    square = velocity**2
    elsewhere = np.delete(square, slice(a, b + 1))
    is_fast = square[a : b + 1].mean() > 0.1 * elsewhere.mean()
    steps = velocity[a:b] * np.diff(run.t[a : b + 1])
    travel = np.ptp(np.concatenate([[0.0], np.cumsum(steps)]))
    return bool(is_fast and travel > largest_step_of_resolution(run.q[:, j]))


def _joint_goes_round(q: Array, a: int, b: int) -> bool:
    """Whether a joint turns round between the rows a and b: it covers a tenth of the
    range of its positions q (N,), and goes a tenth of that back.

    Friction keeps a coarse torque constant only as long as the joint does not turn.
    """
    part = q[a : b + 1]
    travel = float(np.ptp(part))
    way_back = travel - abs(float(part[-1] - part[0]))
    return bool(travel > 0.1 * np.ptp(q) and way_back > 0.1 * travel)


def _arm_rests(glance: RunSummary, a: int, b: int) -> bool:
    """Whether no joint moves from row a to b by more than its resolution, or a
    thousandth of its range."""
    for q in glance.run.q[:, glance.moving].T:
        finest = max(largest_step_of_resolution(q), 1e-3 * float(np.ptp(q)))
        if np.ptp(q[a : b + 1]) > finest:
            return False
    return True


#: The longest stretch of one value is at most so many times as long as a freeze: freezes of
#: one logger last about as long, and a resolution makes far shorter stretches.
_LONGEST_OVER_FREEZE = 3.0


def _long_pauses(glance: RunSummary, x: Array) -> list[list[int]]:
    """List the first and last row of each long stretch in which a channel x (N,) is
    constant.

    Long are at least STUCK rows, a fifth of a second, and a third of the longest
    stretch: shorter ones come from the channel's resolution, and several freezes of
    about one length are all found.
    """
    parts = spans(np.diff(x) == 0.0)
    lengths = np.diff(parts)[:, 0]
    longest = lengths.max(initial=0)
    if longest < STUCK:
        return []
    parts = parts[lengths * _LONGEST_OVER_FREEZE > longest]
    seconds = np.diff(glance.run.t[parts])[:, 0]
    pauses: list[list[int]] = parts[seconds >= 2.0 * STUCK_SECONDS].tolist()
    return pauses


def find_bad_torque_channels(glance: RunSummary) -> Iterator[Issue]:
    """Yield issues about torque channels that never change, or that are clipped at a
    limit.
    """
    for j, x in enumerate(glance.run.tau.T):
        if not np.ptp(x):
            yield _dead(glance, j, float(x[0]))
        else:
            yield from _clipped(glance, j, x)


def _dead(glance: RunSummary, j: int, value: float) -> Issue:
    """Return the issue that the torque of joint j (from 0) has one value in every row:
    an error, or a note where the joint never moves."""
    unit = plain_unit(glance.robot.torque_units[j])
    return make_issue(
        kind="dead channel",
        severity="error" if glance.moving[j] else "note",
        joints=[j],
        what=f"tau{j + 1} is {value:g} {unit} in every row.",
        remedy="find out why the logger wrote a constant",
        where=f"tau{j + 1}",
    )


def _clipped(glance: RunSummary, j: int, x: Array) -> Iterator[Issue]:
    """Yield a warning where the torque x (N,) of joint j stays exactly at its largest
    or smallest value for long, and is never constant for as long elsewhere; a note where
    the arm explains it there as well."""
    parts = spans(np.diff(x) == 0.0)  # stretches of one value: first row, last row
    lengths = np.diff(parts)[:, 0] + 1
    values = x[parts[:, 0]]
    is_drive_off = values == 0.0
    is_extreme = np.isin(values, (x.min(), x.max())) & ~is_drive_off
    elsewhere = int(lengths[~is_extreme].max(initial=1))
    longest = int(lengths[is_extreme].max(initial=1))
    if longest < max(LONG_STRETCH * elsewhere, STUCK):
        return
    value = float(values[np.argmax(lengths * is_extreme)])
    are_long = is_extreme & (lengths >= STUCK)
    at_limits = mask_of(len(x), parts[are_long] + [0, 1])
    times = glance.one_arm_is_worse(j, at_limits)
    is_drives_limit = bool(np.isclose(abs(value), glance.robot.joints[j].effort))
    is_torque = is_drives_limit or glance.holds_torque(j, at_limits)
    unit = plain_unit(glance.robot.torque_units[j])
    severity, which = "warning", "the drive or the channel is"
    remedy = "record again, with a larger range"
    certainty = likely(
        f"elsewhere it is never constant for more than {elsewhere} samples"
    )
    if is_torque:
        severity, which = "note", "the drive is"
        remedy = "that is the torque"
        certainty = _AT_EFFORT_LIMIT if is_drives_limit else _AS_ELSEWHERE
    elif times is not None:
        which = "the channel is"
        remedy += ", or slower; delete those rows until then"
    yield make_issue(
        kind="saturation",
        explains_joints=True,
        severity=severity,
        joints=[j],
        what=f"tau{j + 1} stays at {value:.6g} {unit} for up to"
        f" {longest} samples in a row ({np.sum(x == value)} in total): {which} at its limit.",
        certainty=certainty,
        remedy=remedy,
        needs_action=not is_torque,
        where=f"tau{j + 1}",
        figures={"limit": value, "times": times},
    )
