"""Facts about the rows of a run: those that are no measurements."""

from collections.abc import Iterator
from functools import partial

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from sdp_vs_penalty import formatting
from sdp_vs_penalty.checks.certainty import told_by
from sdp_vs_penalty.checks.constants import LONG_STRETCH, RUN, SPIKE, STUCK
from sdp_vs_penalty.checks.facts.stuck import largest_step_of_resolution
from sdp_vs_penalty.checks.glance import Rows, RunSummary, mask_of, with_time_steps
from sdp_vs_penalty.checks.issue import Issue, make_issue, rows_text
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.robot.arrays import Array, Indices
from sdp_vs_penalty.signals.encoder import lattice_step
from sdp_vs_penalty.signals.runs import spans


def find_missing_numbers(glance: RunSummary) -> Iterator[Issue]:
    """Yield an error about rows in which some channel is no finite number, or one that
    no robot measures.
    """
    is_usable = glance.run.usable_rows
    what = (
        "{row_count} with values that are not finite numbers, or that no robot"
        " measures."
    )
    yield from glance.delete_rows("missing numbers", ~is_usable, what, unusable=True)


#: A drive pushes against its stop where the command lies so many times as far beyond the
#: joint's range as the position: a lag of the controller is smaller.
_PUSHED_BEYOND = 3.0


def find_end_stops(glance: RunSummary) -> Iterator[Issue]:
    """Yield an issue about rows in which a joint lies against its end stop: its logged
    command goes beyond the range, and it does not follow.

    No model has the torque of a stop. Where the joint follows the command, the stop is
    not at the end of the range.
    """
    if not glance.run.torque_logged:
        return
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
    sure = told_by("its command goes beyond the range", "it does not follow")
    yield from glance.delete_rows("end stop", bad, what, sure)


def find_interpolated_rows(glance: RunSummary) -> Iterator[Issue]:
    """Yield an issue about rows that lie on straight lines in every channel, while the
    arm moves: a gap that was filled in by interpolation.
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
        "{row_count} lie on straight lines in every channel: a gap was filled by"
        " interpolation."
    )
    sure = told_by("the arm moves, and no other rows do so")
    yield from glance.delete_rows(
        "interpolated rows", mask_of(len(inside), parts), what, sure
    )


def _on_lines(glance: RunSummary) -> Rows:
    """Return the inner rows (N - 2,) in which no channel changes its slope but for
    rounding, and some channel changes its value."""
    is_straight = np.ones(len(glance.steps) - 1, bool)
    changes = np.zeros(len(glance.steps) - 1, bool)
    for x in np.column_stack([*reversed(glance.run.groups.values())]).T:
        span = np.ptp(x)
        if span > 0.0:
            slope = np.diff(x) / np.maximum(glance.steps, 1e-300)
            size = np.maximum(np.abs(slope[1:]), np.abs(slope[:-1]))
            # Relative, and of the values of a file with nine digits.
            rounding = 1e-6 * size + 1e-8 * span / glance.steps[1:]
            is_straight &= np.abs(np.diff(slope)) <= rounding
            changes |= size > 0.0
        if not is_straight.any():
            break
    return is_straight & changes


def find_spikes(glance: RunSummary) -> Iterator[Issue]:
    """Yield an issue about single samples far from the median of the seven around them:
    flipped bits, torn packets.

    Samples within half a second of a start or stop of the arm are left out: there
    stiction makes jumps. A joint's torque may jump for a sample wherever the joint
    starts, stops or turns round: friction changes there, and its controller answers.
    Packets are torn at any time, so that one such sample in steady motion is asked for.
    """
    is_moving = glance.movement.at
    t = glance.run.t
    bad = {}
    times_usual, share_of_span = SPIKE
    rare = 1 / RUN  # share of the samples that spikes may be
    for name, j, x in glance.channels:
        if not glance.moving[j]:
            continue
        usual_span = float(np.ptp(np.quantile(x, [rare, 1.0 - rare])))
        threshold = share_of_span * usual_span + 1e-9
        # Edges are repeated, so that each sample has a window of seven around it.
        windows = sliding_window_view(np.pad(x, 3, "edge"), 7)  # (N, 7)
        # The median of all windows is slow: first only where a spike can be.
        rows = _near_large_steps(x, threshold / 3.0)
        distance = np.abs(x[rows] - np.median(windows[rows], axis=1))
        if not np.any(distance > threshold):
            continue
        distance = np.abs(x - np.median(windows, axis=1))
        usual_distance = np.quantile(distance, 0.9)
        # A joint that is held still trembles by up to three steps of its encoder.
        finest = 3.5 * lattice_step(x)
        is_far = distance > max(times_usual * usual_distance, threshold, finest)
        is_far &= is_moving(t - 0.5) & is_moving(t) & is_moving(t + 0.5)
        is_far[:3] = is_far[-3:] = False  # fewer than three samples on a side
        if not name.startswith("q"):  # no impulse moves a joint to and fro
            is_far &= _is_alone(distance)
            if not np.any(is_far & _is_steady(glance, j)):
                continue
        bad[name] = is_far & (is_far.mean() <= rare)
    what = "{named} {are} far from the samples on both sides in {row_count}."
    beside = "the samples around them go on"
    is_of_torque = any(x[0] == "t" and rows.any() for x, rows in bad.items())
    # A torque may be a knock's.
    sure = told_by(beside, "" if is_of_torque else "no joint moves like that")
    yield from glance.delete_rows("spikes", bad, what, sure)


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
    least = largest_step_of_resolution(q)
    goes_on = is_same_way & (shorter > least) & (longer <= 2.0 * shorter)
    return goes_on | (longer <= least)


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
    return neighbours < _NEIGHBOUR_OF_SPIKE * distance


def _near_large_steps(x: Array, least: float) -> Indices:
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
    yield make_issue(
        kind="lost rows",
        where=rows_text(glance.run, rows + 1),
        what=f"at {formatting.count(len(rows), 'place')} every joint skips ahead within"
        " one time step.",
        cause=f"about {lost.sum():.0f} rows are missing, and the clock was made again",
        certainty=told_by(
            "no joint moves like that",
            "all joints do so at once" if q.shape[1] > 1 else "",
        ),
        remedy="put the missing time back",
        repair=partial(_with_time, added=added),
        figures={
            "rows": glance.run.rows_of_file(rows[:100] + 1).tolist(),
            "missing": lost[:100].tolist(),
        },
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


def _skips(speed: Array, usual: Array, is_clear: Rows) -> Indices:
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
