"""Facts about the rows of a run: those that are no measurements."""

from collections.abc import Iterator
from functools import partial

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from sdp_vs_penalty.checks.certainty import certain
from sdp_vs_penalty.checks.constants import (
    LONG_STRETCH,
    RUN,
    SPIKE,
    STUCK,
    STUCK_SECONDS,
)
from sdp_vs_penalty.checks.glance import (
    READ,
    Rows,
    RunSummary,
    mask_of,
    with_time_steps,
)
from sdp_vs_penalty.checks.issue import Issue, rows_text
from sdp_vs_penalty.data.measurements import LARGEST_VALUE, Measurements
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.encoder import lattice_step
from sdp_vs_penalty.signals.runs import spans


def find_missing_numbers(glance: RunSummary) -> Iterator[Issue]:
    """Yield an error about rows in which some channel is no finite number, or one that
    no robot measures.

    Parameters
    ----------
    glance : RunSummary
        The run with its clock and channels, as repaired by earlier rules.

    Returns
    -------
    iterator of Issue
        Issues to report; none if nothing is wrong.
    """
    channels = {"t": glance.run.t[:, None], **glance.run.groups}
    is_usable = np.ones(len(glance.run.t), bool)
    for name, x in channels.items():
        # A comparison with NaN is false.
        is_usable &= np.all(np.abs(x) <= LARGEST_VALUE[name], axis=1)
    what = (
        "{rows} rows with values that are not finite numbers, or that no robot"
        " measures."
    )
    yield from glance.delete_rows("missing numbers", ~is_usable, what, unusable=True)


def find_repeated_run(glance: RunSummary) -> Iterator[Issue]:
    """Yield an issue where a part of the run is in the file twice: RUN rows or more
    that equal, bit by bit, the rows a fixed distance earlier.

    Where a motion repeats and its columns are coarse, single rows are equal by chance.

    Parameters
    ----------
    glance : RunSummary
        The run with its clock and channels, as repaired by earlier rules.

    Returns
    -------
    iterator of Issue
        Issues to report; none if nothing is wrong.
    """
    # Equal rows have equal numbers; a lag is a row's distance from its first equal.
    number = glance.row_numbers
    first_row_of_number = np.unique(number, return_index=True)[1]
    lags = np.arange(len(number)) - first_row_of_number[number]
    lags = lags[lags > RUN]
    if not len(lags):
        return
    lag = int(np.argmax(np.bincount(lags)))  # the most frequent distance [rows]
    is_same = np.concatenate([np.zeros(lag, bool), number[lag:] == number[:-lag]])
    # One pose, held by a simulator without noise, is no copy.
    q = glance.run.q
    least_travel = 0.05 * np.ptp(q, axis=0).max()
    moving_parts = [
        (first, end)
        for first, end in spans(is_same)
        if end - first >= RUN and np.ptp(q[first:end], axis=0).max() >= least_travel
    ]
    is_copy = mask_of(len(is_same), moving_parts)
    if not is_copy.any():
        return
    what = (
        "{rows} rows are copies, bit by bit, of rows {lag} earlier: a part of the run is"
        " in the file twice, and would count as a repetition without noise."
    )
    yield from glance.delete_rows("repeated run", is_copy, what, lag=lag)


def find_held_rows(glance: RunSummary) -> Iterator[Issue]:
    """Yield issues about rows that are copies of the row before: packets that did not
    come for long, or else single rows that were doubled.

    Parameters
    ----------
    glance : RunSummary
        The run with its clock and channels, as repaired by earlier rules.

    Returns
    -------
    iterator of Issue
        Issues to report; none if nothing is wrong.
    """
    is_held = np.concatenate([[False], np.diff(glance.row_numbers) == 0])
    frozen = _frozen_packets(glance, is_held)
    which = "all channels repeat"
    if not frozen.any():
        frozen = _frozen_measurements(glance)
        which = "positions and torques repeat"
    what = f"{which} one row for up to {{seconds:.3g}} s, {{times}}: no packets came."
    yield from glance.delete_rows("frozen packets", frozen, what)
    # A logger that is a little faster than its source repeats samples as well, but its
    # stamps are uneven.
    is_even = (
        bool(glance.usual_step) and np.ptp(glance.steps) <= 1e-3 * glance.usual_step
    )
    if is_even and not frozen.any():
        yield from _doubled_rows(glance, is_held & glance.movement.moves)


def _frozen_measurements(glance: RunSummary) -> Rows:
    """Return the rows (N,) in which no packet came: positions and torques repeat the
    row before for long, while a logged velocity shows that its joint moves on."""
    frozen = _frozen_packets(glance, glance.repeats_measured)
    if not frozen.any():
        return frozen
    level_by_joint = {
        j: _largest_step_of_resolution(glance.run.q[:, j])
        for j in np.flatnonzero(glance.moving).tolist()
    }
    parts = []
    for first, end in spans(frozen):
        goes_on = [
            _velocity_goes_on(glance.run, j, first, end - 1, level)
            for j, level in level_by_joint.items()
        ]
        if any(goes_on):
            parts.append((first, end))
    return mask_of(len(frozen), parts)


def _frozen_packets(glance: RunSummary, is_held: Rows) -> Rows:
    """Return the rows (N,) of long stretches that repeat the row before (``is_held``),
    if a joint moves by more than four usual steps behind the stretch.

    Usual steps are those of a joint that moves: an arm that waits between the steps of
    its command stands still in most rows."""
    parts = spans(is_held)
    lengths = np.diff(parts)[:, 0]
    steps = np.abs(np.diff(glance.run.q, axis=0))
    moving_steps = np.where(steps > 0.0, steps, np.nan)
    moving_steps[:, ~np.any(steps > 0.0, axis=0)] = 0.0
    far = 4.0 * np.nanmedian(moving_steps, axis=0)
    # A logger faster than its source holds every sample for some rows: that is usual.
    usual = float(np.median(lengths)) if len(parts) > 2 * STUCK else 1.0
    is_long = lengths >= max(STUCK, LONG_STRETCH * usual)
    frozen_parts = [
        (first, end)
        for first, end in parts[is_long].tolist()
        if end < len(glance.run.q) and np.any(steps[end - 1] > far)
    ]
    return mask_of(len(glance.run.q), frozen_parts)


#: Rows are doubled where so many times as many repeat the row before as chance makes of a
#: coarse resolution.
_TIMES_BY_CHANCE = 3.0


def _doubled_rows(glance: RunSummary, same: Rows) -> Iterator[Issue]:
    """Yield a warning about rows that repeat the row before, while the arm moves and
    time steps are even.

    same (N,) : which rows do. There are two causes. If a packet was lost and the last
    one written again, the motion skips ahead after the copy. If a row was written twice
    and the clock made anew, the motion goes on after it.
    """
    span = 2 * STUCK  # rows to either side of a copy that are compared
    single = np.flatnonzero(same[span:-span]) + span
    single = single[~same[single - 1] & ~same[single + 1]]
    # A share of 0.2 % may be chance; at four in five the position hardly moves.
    if not 0.1 / RUN <= same.mean() <= 0.8 or not len(single):
        return
    by_chance = _chances_of_equal_rows(glance)[glance.movement.moves].sum()
    if same.sum() <= _TIMES_BY_CHANCE * by_chance:
        return
    # Travel over the two steps around a copy: that of two usual steps where it skips
    # (far is the mean of two of them), and of one where it does not.
    q = glance.run.q
    near = np.linalg.norm(q[single + 1] - q[single - 1], axis=1)
    far = np.linalg.norm(q[single + span] - q[single - span], axis=1) / span
    skips = bool(np.median(near / np.maximum(far, 1e-300)) > 0.75)
    # From half of the rows on the source is slower than the logger: no packet is lost.
    if skips and not 1 / RUN < same.mean() < 0.5:
        return
    if skips:
        after = "skips ahead"
        how = "packets were lost, the last one was written again"
        remedy = "delete the copies"
    else:
        after = "does not skip ahead"
        how = "rows were doubled and the clock was made again"
        remedy = "delete the copies and their time"
    yield Issue(
        kind="doubled rows",
        severity="warning",
        where=rows_text(np.flatnonzero(same) + 2),
        what=f"{same.sum()} rows are copies of the row before, and the motion {after}"
        f" after them: {how}.",
        certainty=READ,
        remedy=remedy,
        repair=partial(_without_copies, same=same, keeps_time=skips),
        figures={"rows": int(same.sum())},
    )


#: Rounds in which the chance of equal rows settles.
_ROUNDS_OF_CHANCE = 30


def _chances_of_equal_rows(glance: RunSummary) -> Array:
    """Return the chance (N,) that a row equals the row before because all its channels
    are coarse, and change slowly there.

    Channels change independently of each other: none changes with the chance

        h = prod_k (1 - p_k).

    p_k is the share of the steps around in which channel k changes. Of the steps that
    may be copies nothing is known, so that only those count in which some channel
    changes: a share p_k / (1 - h) of these. h is the smallest solution of both, and 1
    where no channel changes. A row that was doubled lies between rows that differ: there
    h is almost 0.
    """
    columns = np.column_stack([*glance.run.groups.values()])
    is_change = np.diff(columns, axis=0) != 0.0  # (N - 1, channels)
    is_new = np.any(is_change, axis=1)
    n_new = _sum_around(is_new[:, None], STUCK)
    shares = _sum_around(is_change, STUCK) / np.maximum(n_new, 1.0)
    chance = np.zeros(len(shares))
    for _ in range(_ROUNDS_OF_CHANCE):
        chance = np.prod(1.0 - shares * (1.0 - chance)[:, None], axis=1)
    return np.concatenate([[0.0], chance])


def _sum_around(x: Array | Rows, reach: int) -> Array:
    """Return of each row of x (N, n) the sum over the rows at most ``reach`` away."""
    total = np.cumsum(np.pad(x, ((reach + 1, reach), (0, 0))), axis=0, dtype=float)
    width = 2 * reach + 1
    return np.asarray(total[width:] - total[:-width])


def _without_copies(run: Measurements, same: Rows, keeps_time: bool) -> Measurements:
    """Return the run without the copies; their time goes as well, unless packets were
    lost (``keeps_time``)."""
    timed = run if keeps_time else with_time_steps(run, same[1:], 0.0)
    return timed.rows(~same)


#: A drive pushes against its stop where the command lies so many times as far beyond the
#: joint's range as the position: a lag of the controller is smaller.
_PUSHED_BEYOND = 3.0


def find_end_stops(glance: RunSummary) -> Iterator[Issue]:
    """Yield an issue about rows in which a joint lies against its end stop: its logged
    command goes beyond the range, and it does not follow.

    No model has the torque of a stop. Where the joint follows the command, the stop is
    not at the end of the range.

    Parameters
    ----------
    glance : RunSummary
        The run with its clock and channels, as repaired by earlier rules.

    Returns
    -------
    iterator of Issue
        Issues to report; none if nothing is wrong.
    """
    low = np.array([joint.lower for joint in glance.robot.joints])
    high = np.array([joint.upper for joint in glance.robot.joints])
    command = glance.run.commanded.get("qcmd", glance.run.q)
    beyond = np.maximum(low - glance.run.q, glance.run.q - high)
    commanded_beyond = np.maximum(low - command, command - high)
    bad = {}
    for j in range(glance.run.n):
        held = []
        for first, end in spans(commanded_beyond[:, j] > 0.0):
            farthest = beyond[first:end, j].max()
            if farthest * _PUSHED_BEYOND < commanded_beyond[first:end, j].max():
                held.append((first, end))
        is_pushed = np.abs(beyond[:, j]) * _PUSHED_BEYOND < commanded_beyond[:, j]
        bad[f"q{j + 1}"] = is_pushed & mask_of(len(is_pushed), held)
    what = (
        "{named} lies against its end stop for up to {seconds:.3g} s: its command goes"
        " beyond it."
    )
    sure = certain("the drive pushes against its stop")
    yield from glance.delete_rows("end stop", bad, what, sure)


def find_interpolated_rows(glance: RunSummary) -> Iterator[Issue]:
    """Yield an issue about rows that lie on straight lines in every channel, while the
    arm moves: a gap that was filled in by interpolation.

    Parameters
    ----------
    glance : RunSummary
        The run with its clock and channels, as repaired by earlier rules.

    Returns
    -------
    iterator of Issue
        Issues to report; none if nothing is wrong.
    """
    if not glance.run.torque_logged:
        return  # coarse positions alone lie on straight lines by themselves
    is_straight = _on_lines(glance)
    if not is_straight.any():
        return
    inside = np.concatenate([[False], is_straight, [False]])
    edges = spans(inside)
    # A converter that interpolates every row makes lines everywhere; a gap is far
    # longer than those.
    usual = float(np.median(np.diff(edges))) if inside.mean() > 0.3 else 0.0
    moves = glance.movement.moves
    shortest = max(STUCK, LONG_STRETCH * usual)
    parts = [
        (first, end)
        for first, end in edges
        if end - first >= shortest and moves[first:end].mean() > 0.5
    ]
    what = (
        "{rows} rows lie on straight lines in every channel: a gap was filled by"
        " interpolation."
    )
    yield from glance.delete_rows(
        "interpolated rows", mask_of(len(inside), parts), what
    )


def _on_lines(glance: RunSummary) -> Rows:
    """Return the inner rows (N - 2,) in which no channel changes its slope but for
    rounding, and some channel changes its value."""
    is_straight = np.ones(len(glance.steps) - 1, bool)
    changes = np.zeros(len(glance.steps) - 1, bool)
    for _, _, x in reversed(glance.channels):
        span = np.ptp(x)
        if span > 0.0:
            slope = np.diff(x) / np.maximum(glance.steps, 1e-300)
            size = np.maximum(np.abs(slope[1:]), np.abs(slope[:-1]))
            # Relative, and of the values of a file with nine digits.
            rounding = 1e-6 * size + 1e-9 * span / glance.steps[1:]
            is_straight &= np.abs(np.diff(slope)) <= rounding
            changes |= size > 0.0
        if not is_straight.any():
            break
    return is_straight & changes


def find_false_zeros(glance: RunSummary) -> Iterator[Issue]:
    """Yield an issue about exact zeros that a logger filled in because it had no
    sample.

    The joint moves, the channel jumps to zero and back to the same side, and to no
    other value does it jump so.

    A torque that changes its sign passes through zero, in steps of its drive's
    resolution exactly; a joint at rest, with its brake on, may need none; noise returns
    to other values as often.

    Parameters
    ----------
    glance : RunSummary
        The run with its clock and channels, as repaired by earlier rules.

    Returns
    -------
    iterator of Issue
        Issues to report; none if nothing is wrong.
    """
    bad = {}
    for name, j, x in glance.channels:
        if glance.moving[j] and np.count_nonzero(x) >= RUN and np.ptp(x) > 0.0:
            filled = _filled(x)
            bad[name] = (
                filled if name.startswith("q") else filled & ~glance.is_at_rest(j)
            )
    what = (
        "{rows} rows of {named} are exactly zero, and jump there and back: nothing was"
        " measured."
    )
    sure = certain("the channel jumps to no other value and back")
    yield from glance.delete_rows("zeros", bad, what, sure)


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


def find_spikes(glance: RunSummary) -> Iterator[Issue]:
    """Yield an issue about single samples far from the median of the seven around them:
    flipped bits, torn packets.

    Samples within half a second of a start or stop of the arm are left out: there
    stiction makes jumps. A joint's torque may jump for a sample wherever the joint
    starts, stops or turns round: friction changes there, and its controller answers.
    Packets are torn at any time, so that one such sample in steady motion is asked for.

    Parameters
    ----------
    glance : RunSummary
        The run with its clock and channels, as repaired by earlier rules.

    Returns
    -------
    iterator of Issue
        Issues to report; none if nothing is wrong.
    """
    moves = glance.movement.at
    t = glance.run.t
    bad = {}
    times_usual, share_of_span = SPIKE
    rare = 1 / RUN  # share of the samples that spikes may be
    for name, j, x in glance.channels:
        if not glance.moving[j]:
            continue
        usual_span = float(np.ptp(np.quantile(x, [rare, 1.0 - rare])))
        threshold = share_of_span * usual_span + 1e-9
        windows = sliding_window_view(np.pad(x, 3, "edge"), 7)  # (N, 7)
        rows = _near_large_steps(x, threshold / 3.0)
        distance = np.abs(x[rows] - np.median(windows[rows], axis=1))
        if not np.any(distance > threshold):
            continue
        distance = np.abs(x - np.median(windows, axis=1))
        usual_distance = np.quantile(distance, 0.9)
        # A joint that is held still trembles by a few steps of its encoder.
        finest = 3.5 * lattice_step(x)
        is_far = distance > max(times_usual * usual_distance, threshold, finest)
        is_far &= moves(t - 0.5) & moves(t) & moves(t + 0.5)
        is_far[:3] = is_far[-3:] = False  # fewer than three samples on a side
        if not name.startswith("q"):  # no impulse moves a joint to and fro
            is_far &= _is_alone(distance)
            if not np.any(is_far & _is_steady(glance, j)):
                continue
        bad[name] = is_far & (is_far.mean() <= rare)
    what = "{rows} samples of {named} lie far from the samples on both sides."
    yield from glance.delete_rows(
        "spikes", bad, what, certain("no joint moves like that")
    )


#: A controller settles within so long after its joint starts, stops or turns [s].
_SETTLES = 0.03


def _is_steady(glance: RunSummary, j: int) -> Rows:
    """Return the rows (N,) at which joint j goes on as before.

    In the time _SETTLES before a row and in that after it (at least three rows each) it
    travels the same way, and by no more than twice as far in the one as in the other; or
    it rests: it travels a few steps of its encoder at most.
    """
    t = glance.run.t
    q = glance.run.q[:, j]
    reach = max(_SETTLES, 3.0 * glance.usual_step)
    before = q - np.interp(t - reach, t, q)
    after = np.interp(t + reach, t, q) - q
    shorter = np.minimum(np.abs(before), np.abs(after))
    longer = np.maximum(np.abs(before), np.abs(after))
    is_same_way = before * after > 0.0
    least = _largest_step_of_resolution(q)
    goes_on = is_same_way & (shorter > least) & (longer <= 2.0 * shorter)
    return np.asarray(goes_on | (longer <= least))


#: A sample is alone if its neighbours lie less far than this share of its distance.
_NEIGHBOUR_OF_SPIKE = 0.2


def _is_alone(distance: Array) -> Rows:
    """Return which samples (N,) lie far from both neighbours as well.

    distance (N,) : from the median of the seven samples around each. A torn packet
    spoils one row. A controller's impulse, such as at the start of a move, lasts for
    some rows behind the filter of the drive.
    """
    padded = np.pad(distance, 1)
    neighbours = np.maximum(padded[:-2], padded[2:])
    return np.asarray(neighbours < _NEIGHBOUR_OF_SPIKE * distance)


def _near_large_steps(x: Array, least: float) -> NDArray[np.intp]:
    """Return the rows of a channel x (N,) at most three rows from a step of more than
    ``least``.

    Three steps lead from the median of seven samples to any of them: no other row can
    be three times ``least`` away from the median.
    """
    large = np.flatnonzero(np.abs(np.diff(x)) > least)
    rows = np.unique(large[:, None] + np.arange(-2, 4))
    return rows[(rows >= 0) & (rows < len(x))]


#: A single joint has to skip so many times: several joints that skip at once are no chance.
_FEWEST_SKIPS_OF_ONE_JOINT = 3


def find_lost_rows(glance: RunSummary) -> Iterator[Issue]:
    """Yield a warning where all joints skip ahead within one time step of a usual
    length: rows are missing, and the clock was made anew.

    A skip of k steps has k times the usual speed, so that k - 1 rows are missing. Rows
    that repeat a position (a packet sent twice) do not count: steps are those between
    new positions. Only joints that move well above the scatter of their speed can show
    a skip; three in four of them have to. A joint that moves alone has to skip at three
    places: once, its encoder may have slipped.

    Parameters
    ----------
    glance : RunSummary
        The run with its clock and channels, as repaired by earlier rules.

    Returns
    -------
    iterator of Issue
        Issues to report; none if nothing is wrong.
    """
    q = glance.run.q[:, glance.moving]
    # Rows whose position is not that of the row before.
    is_new = np.any(np.diff(q, axis=0) != 0.0, axis=1)
    fresh = np.flatnonzero(np.concatenate([[True], is_new]))
    if len(fresh) < RUN:
        return
    # Speed of each joint in each step between them, and three times its usual scatter.
    steps = np.diff(glance.run.t[fresh])
    speed = np.abs(np.diff(q[fresh], axis=0)) / np.maximum(steps, 1e-300)[:, None]
    scatter = 3.0 * np.quantile(np.abs(np.diff(speed, axis=0)), 0.9, axis=0)
    # Mean speed of the five steps before and the five behind each.
    usual = _mean_of_neighbours(speed, 5)
    is_clear = usual > scatter  # (steps, joints)
    places = _skips(speed, usual, is_clear)
    # A long step is a gap that the clock shows.
    places = places[steps[places] < 3.0 * np.median(steps)]
    fewest = _FEWEST_SKIPS_OF_ONE_JOINT if q.shape[1] == 1 else 1
    if len(places) < fewest:
        return
    # Length of each skip in steps: a mean over the joints that move clearly, weighted
    # by one over their scatter.
    weights = (is_clear / scatter)[places]
    weighted_speed = (speed[places] * weights).sum(axis=1)
    steps_long = weighted_speed / (usual[places] * weights).sum(axis=1)
    lost = np.round(steps_long - 1.0)  # rows, at each place
    rows = fresh[places + 1] - 1  # the row before each skip's end
    added = np.zeros(len(glance.steps))  # [s] after each row
    added[rows] = lost * np.median(steps)
    yield Issue(
        kind="lost rows",
        severity="warning",
        where=rows_text(rows + 3),
        what=f"at {len(rows)} places every joint skips ahead within one time step: about"
        f" {lost.sum():.0f} rows are missing and the clock was made again.",
        certainty=certain("all joints skip by the same time"),
        remedy="put the missing time back",
        repair=partial(_with_time, added=added),
        figures={"rows": (rows + 3)[:100].tolist(), "missing": lost[:100].tolist()},
    )


def _mean_of_neighbours(x: Array, reach: int) -> Array:
    """Return of each row of x (N, n) the mean of ``reach`` rows before it and as many
    behind it; NaN near the ends, which have not as many."""
    padded = np.pad(x, ((reach, reach), (0, 0)), constant_values=np.nan)
    total = np.zeros_like(x)
    for first in range(2 * reach + 1):
        if first != reach:
            total += padded[first : first + len(x)]
    return total / (2 * reach)


def _skips(speed: Array, usual: Array, is_clear: Rows) -> NDArray[np.intp]:
    """Return the numbers of steps in which three in four joints move more than twice as
    far as in the steps around.

    speed, usual (K, n) : speeds in each step, and around it; is_clear (K, n) : joints
    that move well above their scatter, which alone are counted.
    """
    ratio = np.divide(speed, usual, out=np.full_like(speed, np.nan), where=is_clear)
    n_skip = np.sum(np.round(ratio) > 2.0, axis=1)
    n_clear = is_clear.sum(axis=1)
    n_joints = speed.shape[1]
    are_enough = n_clear >= min(n_joints, max(2, (n_joints + 1) // 2))
    return np.flatnonzero(are_enough & (n_skip > 0.74 * n_clear))  # three in four


def _with_time(run: Measurements, added: Array) -> Measurements:
    """Return the run with ``added`` (N - 1,) seconds inserted after its rows; 0 leaves
    the step from a row to the next as it is."""
    return with_time_steps(run, added > 0.0, np.diff(run.t) + added)


def find_frozen_channels(glance: RunSummary, word: str, name: str) -> Iterator[Issue]:
    """Yield an issue about channels that are frozen: they repeat a value bit by bit
    while the arm moves, and did not slow down before.

    word : "position" or "torque"; name : first letter of the channels' names.
    """
    is_position = name == "q"
    bad = {
        channel: _stuck(glance, j, x, is_position)
        for channel, j, x in glance.channels
        if channel[0] == name
        and (glance.moving[j] or not is_position)
        and np.ptp(x) > 0.0
    }
    what = (
        "{named} repeats one value for {seconds:.3g} s, {times}, while the arm"
        " moves: the channel was frozen."
    )
    sure = certain("elsewhere it never repeats for nearly as long")
    yield from glance.delete_rows(f"frozen {word}", bad, what, sure)


def _stuck(glance: RunSummary, j: int, x: Array, is_position: bool) -> Rows:
    """Return the rows (N,) in which the channel x (N,) of joint j is frozen.

    A long stretch of one value is a freeze if what comes behind it does not continue
    it: a position jumps without having slowed down, a torque jumps while the arm moves.
    A torque that stays until the end is frozen if its joint turns round meanwhile.
    """
    pauses = _long_pauses(glance, x)  # first and last rows
    if not pauses:
        return np.zeros(len(x), bool)
    steps = np.abs(np.diff(x))
    level = _largest_step_of_resolution(x)
    frozen_parts = []
    position = glance.run.q[:, j]
    for first, last in pauses:
        if x[first] in (x.min(), x.max()):
            continue  # clipped there
        if is_position and _velocity_goes_on(glance.run, j, first, last, level):
            is_frozen = True
        elif last == len(x) - 1:
            # The run ends with this value: only a torque can be judged.
            turns_round = _joint_goes_round(position, first, last)
            is_frozen = turns_round and not is_position
        elif steps[last] < level:
            is_frozen = False
        elif is_position:
            is_frozen = not _comes_to_rest(x, steps, first, steps[last])
        elif _arm_rests(glance, first, last):
            is_frozen = False
        else:
            is_frozen = not _is_constant_friction(position, steps, level, last)
        if is_frozen:
            frozen_parts.append((first, last + 1))
    return mask_of(len(x), frozen_parts)


def _largest_step_of_resolution(x: Array) -> float:
    """Return three steps of a channel's resolution: a change of x (N,) by less may be
    one of its counter."""
    return 3.0 * lattice_step(x)


def _velocity_goes_on(run: Measurements, j: int, a: int, b: int, level: float) -> bool:
    """Whether joint j's logged velocity shows that it moves from row a to b.

    It does if two things hold. The mean square velocity there is at least a tenth of
    that elsewhere. And the velocity's integral leaves the position by more than ``level``
    [rad, m]: a joint that is held still trembles by less than its encoder's resolution.
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
    return bool(is_fast and travel > level)


def _joint_goes_round(q: Array, a: int, b: int) -> bool:
    """Whether a joint turns round from row a to b: of positions q (N,) it covers a
    tenth of the range, and goes a tenth of that back.

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
        finest = max(_largest_step_of_resolution(q), 1e-3 * float(np.ptp(q)))
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


def _comes_to_rest(x: Array, steps: Array, a: int, jump: float) -> bool:
    """Whether a position x (N,) comes to rest at row a by itself: it slows down before,
    and starts again slowly.

    steps (N - 1,) : absolute changes of x from row to row; jump : the first change
    after the rest, which is small for a joint that starts to move.
    """
    usual = float(np.median(steps[steps > 0.0]))
    travel_before = abs(x[a] - x[max(a - STUCK, 0)])
    slows_down = travel_before < 0.5 * STUCK * usual
    return bool(jump < 4.0 * usual and slows_down)


def _is_constant_friction(q: Array, steps: Array, level: float, b: int) -> bool:
    """Whether dry friction explains that a torque is constant up to row b.

    It does if the channel is coarse (``steps`` (N - 1,), its absolute changes, are
    usually below ``level``), and the joint at q (N,) turns round at b.
    """
    usual = float(np.median(steps[steps > 0.0]))
    before = q[b] - q[max(b - STUCK, 0)]
    after = q[min(b + STUCK, len(q) - 1)] - q[b]
    turns_round = after * before <= 0.0
    return bool(usual < level and turns_round)
