"""Rows that come twice: in one run, in two, or each behind itself."""

from collections.abc import Iterator, Sequence
from functools import partial

import numpy as np

from sdp_vs_penalty.checks.constants import LONG_STRETCH, RUN, STUCK
from sdp_vs_penalty.checks.facts.noise import shows_noise
from sdp_vs_penalty.checks.facts.stuck import velocity_goes_on
from sdp_vs_penalty.checks.glance import (
    Rows,
    RunSummary,
    mask_of,
    numbers_of_rows,
    repeat_row_before,
    with_time_steps,
)
from sdp_vs_penalty.checks.issue import Issue, make_issue, rows_text
from sdp_vs_penalty.checks.velocity import velocity_ratio
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.results.remedy import Change
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.runs import spans


def find_repeated_run(glance: RunSummary) -> Iterator[Issue]:
    """Yield an issue where a part of the run is in the file twice: RUN rows or more
    that equal, bit by bit, the rows a fixed distance earlier.

    Where a motion repeats and its columns are coarse, single rows are equal by chance.
    Without noise all rows are equal one period later: then only a part that begins with
    a jump of the motion is a copy.
    """
    # Equal rows have equal numbers; a lag is a row's distance from its first equal.
    numbers = numbers_of_rows([*glance.run.groups.values()])
    first_equal = np.unique(numbers, return_index=True)[1][numbers]
    lags = np.arange(len(numbers)) - first_equal
    long_lags = lags[lags > RUN]
    if not len(long_lags):
        return
    lag = int(np.argmax(np.bincount(long_lags)))  # the most frequent distance [rows]
    is_same = np.concatenate([np.zeros(lag, bool), numbers[lag:] == numbers[:-lag]])
    steps = np.abs(np.diff(glance.run.q, axis=0))
    is_jump = np.any(steps > _JUMP * np.quantile(steps, 0.99, axis=0), axis=1)
    has_noise = _has_noise(glance.run)
    parts = [
        (first, end)
        for first, end in _moving_parts(glance.run, is_same)
        if has_noise or is_jump[first - 1]
    ]
    what = (
        "{row_count} are copies, bit by bit, of rows {lag} earlier, and would count as a"
        " repetition without noise."
    )
    is_copy = mask_of(len(is_same), parts)
    yield from glance.delete_rows("repeated run", is_copy, what, lag=lag, cause=_TWICE)


_TWICE = "a part of the run is in the file twice"
#: A motion jumps by so many times what it goes from row to row where it is fastest.
_JUMP = 3.0


def _has_noise(run: Measurements) -> bool:
    """Return whether any channel of a run carries noise."""
    return any(shows_noise(x) for group in run.groups.values() for x in group.T)


def _moving_parts(run: Measurements, is_same: Rows) -> list[tuple[int, int]]:
    """List the stretches of RUN rows or more, first and end row each, in which some joint
    moves: one pose, held by a simulator without noise, is no copy."""
    least_travel = 0.05 * np.ptp(run.q, axis=0).max()
    return [
        (first, end)
        for first, end in spans(is_same).tolist()
        if end - first >= RUN and np.ptp(run.q[first:end], axis=0).max() >= least_travel
    ]


def find_overlaps(runs: Sequence[Measurements]) -> Iterator[tuple[int, Issue]]:
    """Yield a warning, with the number of its run, where a run holds RUN rows or more of
    an earlier one, bit by bit; without noise only those with the same stamps.

    Equal rows of one motion that two files hold would count as its repetition.
    """
    if len(runs) < 2:
        return
    ends = np.cumsum([len(run.t) for run in runs])
    samples = np.concatenate([run.q for run in runs])
    if all(run.torque_logged for run in runs):
        samples = np.column_stack([samples, np.concatenate([run.tau for run in runs])])
    # Equal rows have one number; of each row the place of the first that equals it.
    numbers = numbers_of_rows([samples])
    firsts = np.unique(numbers, return_index=True)[1][numbers]
    for k in range(1, len(runs)):
        run, start = runs[k], int(ends[k - 1])
        of_run = firsts[start : ends[k]]
        # A copy of a motion equals one earlier row after the other.
        is_next = np.diff(of_run, prepend=of_run[:1] - 1) == 1
        is_earlier = is_next & (of_run < start)
        parts = _moving_parts(run, is_earlier)
        if not parts:
            continue
        first, _ = max(parts, key=lambda part: part[1] - part[0])
        # The run that holds the original, and the row there.
        other = int(np.searchsorted(ends, of_run[first], "right"))
        row = int(of_run[first] - ends[other] + len(runs[other].t))
        if not _has_noise(run) and run.t[first] != runs[other].t[row]:
            continue
        yield k, _overlap(run, runs[other].names[0], parts)


def _overlap(run: Measurements, other: str, parts: Sequence[tuple[int, int]]) -> Issue:
    """Return the warning that parts of a run, first and end row each, are rows of an
    ``other`` one as well."""
    is_copy = mask_of(len(run.t), parts)
    name = run.names[0]
    spans_of_time = [run.t[[first, end - 1]].tolist() for first, end in parts]
    cut = Change(
        "cut", f"leave these rows out of {name}", {"run": name, "spans": spans_of_time}
    )
    return make_issue(
        kind="overlapping runs",
        where=rows_text(run, np.flatnonzero(is_copy)),
        what=f"{is_copy.sum()} rows are rows of {other} as well, bit by bit: the files"
        " overlap, and what both hold would count as a repetition without noise.",
        remedy="leave these rows out of one of the two",
        figures={"rows": int(is_copy.sum()), "of": other},
        changes=() if is_copy.all() else (cut,),
    )


def find_held_rows(glance: RunSummary) -> Iterator[Issue]:
    """Yield issues about rows that are copies of the row before: packets that did not
    come for long, or else single rows that were doubled.
    """
    is_held = repeat_row_before([*glance.run.groups.values()])
    frozen = _frozen_packets(glance, is_held)
    which = "all channels repeat"
    if not frozen.any():
        frozen = _frozen_measurements(glance)
        which = "positions and torques repeat"
    what = f"{which} one row for up to {{seconds:.3g}} s, {{times}}."
    yield from glance.delete_rows(
        "frozen packets", frozen, what, cause="no packets came"
    )
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
    measured = [glance.run.q]
    if glance.run.torque_logged:
        measured.append(glance.run.tau)
    frozen = _frozen_packets(glance, repeat_row_before(measured))
    joints = np.flatnonzero(glance.moving).tolist()
    parts = [
        (first, end)
        for first, end in spans(frozen)
        if any(velocity_goes_on(glance.run, j, first, end - 1) for j in joints)
    ]
    return mask_of(len(frozen), parts)


def _frozen_packets(glance: RunSummary, is_held: Rows) -> Rows:
    """Return the rows (N,) of long stretches that repeat the row before (``is_held``),
    if a joint moves by more than four usual steps behind the stretch.

    Usual steps are those of a joint that moves: an arm that waits between the steps of
    its command stands still in most rows.
    """
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
    # An arm that comes to rest repeats a row by itself.
    q = glance.run.q
    places = np.arange(len(q))
    around = q[(places + span).clip(max=len(q) - 1)] - q[(places - span).clip(min=0)]
    travel = np.linalg.norm(around, axis=1)
    same = same & (travel > glance.standstill * travel.max())
    copies = np.flatnonzero(same[span:-span]) + span
    single = copies[~same[copies - 1] & ~same[copies + 1]]
    # A share of 0.2 % may be chance; at four in five the position hardly moves.
    share = same.mean()
    if not 0.1 / RUN <= share <= 0.8 or not len(single):
        return
    by_chance = _chances_of_equal_rows(glance)[glance.movement.moves].sum()
    if same.sum() <= _TIMES_BY_CHANCE * by_chance:
        return
    # Travel over the two steps around a copy: that of two usual steps where it skips
    # (far is the mean of two of them), and of one where it does not.
    near = np.linalg.norm(q[single + 1] - q[single - 1], axis=1)
    far = travel[single] / span
    skips = bool(np.median(near / np.maximum(far, 1e-300)) > 0.75)
    # From half of the rows on the source is slower than the logger: no packet is lost. So
    # it is where the logged velocities confirm the stamps.
    if skips and not 1 / RUN < share < 0.5:
        return
    if not skips and _velocities_confirm_stamps(glance, float(share)):
        return
    if skips:
        after = "skips ahead"
        how = "packets were lost, the last one was written again"
        remedy = "delete the copies"
    else:
        after = "does not skip ahead"
        how = "rows were doubled and the clock was made again"
        remedy = "delete the copies and their time"
    yield make_issue(
        kind="doubled rows",
        where=rows_text(glance.run, np.flatnonzero(same)),
        what=f"{same.sum()} rows are copies of the row before, and the motion {after}"
        " after them.",
        cause=how,
        remedy=remedy,
        repair=partial(_without_copies, same=same, keeps_time=skips),
        figures={"rows": int(same.sum())},
    )


def _velocities_confirm_stamps(glance: RunSummary, share: float) -> bool:
    """Return whether the logged velocities are nearer to the derivative of the positions
    by the stamps than by stamps from which a share of time is taken."""
    ratio = velocity_ratio(glance)
    return ratio is not None and abs(ratio) < (1.0 - share) ** -0.5


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
    return total[width:] - total[:-width]


def _without_copies(run: Measurements, same: Rows, keeps_time: bool) -> Measurements:
    """Return the run without the copies; their time goes as well, unless packets were
    lost (``keeps_time``)."""
    timed = run if keeps_time else with_time_steps(run, same[1:], 0.0)
    return timed.rows(~same)
