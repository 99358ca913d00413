"""The one place that cuts recordings where their clock does not advance steadily.

A step far longer than the usual one is a gap: samples are missing, and nothing may be
filtered or interpolated across it. A gap of more than a second is a pause, and so is a
clock that was set ahead or back: what lies behind is a run by itself, as if it stood in
a file of its own. So a run lasts about as long as its samples do, whatever its stamps
say, and a grid over it has about as many points.
"""

import numpy as np

from sdp_vs_penalty.data.store import PART, iter_chunks
from sdp_vs_penalty.robot.arrays import Array, Indices, Mask, nonzero_or_one

#: A step this long is no sampling but a gap [s], and so many usual steps are.
GAP = 0.05
USUAL_STEPS = 20.0
#: A gap this long is a pause [s].
PAUSE = 1.0
#: Where stamps come in bursts, the usual step is at least this share of the mean one.
FINEST = 10.0
#: Fewest rows of a run: fewer rows between two steps back in time are misplaced.
FEWEST_ROWS = 50
#: Steps between sorted rows are usual ones within so many times; their motion is longer
#: than as it stands by less than so many times.
REGULAR, SMOOTH = 1.9, 1.2
#: Steps of a clock in a gap are longer by so many times.
_GAP = 3.0
#: Steps of a long run that are looked at for the usual one.
_STEPS_OF_LONG_RUN = 8 * PART


def usual_step(t: Array) -> float:
    """Return the usual time step [s] of stamps t (N,): the median one.

    Of a long run the steps of parts spread over it are used. Where stamps come in
    bursts the median step is nearly 0: the result is at least the mean step over
    FINEST, in which gaps count as short ones. A single stamp has no step: NaN.
    """
    if len(t) < 2:
        return np.nan
    n_parts = 1
    size = len(t)
    if size > _STEPS_OF_LONG_RUN:
        n_parts = _STEPS_OF_LONG_RUN // PART
        size = PART
    starts = np.linspace(0, len(t) - size, n_parts).astype(int)
    steps = np.concatenate([np.diff(t[k : k + size]) for k in starts])
    middle = float(np.median(steps))
    mean = float(np.mean(np.clip(steps, 0.0, max(GAP, USUAL_STEPS * middle))))
    return max(middle, mean / FINEST)


def rows_behind_gaps(t: Array, shortest: float = GAP) -> Indices:
    """Return the rows (K,) behind the gaps of stamps t (N,): steps of more than 20
    usual ones and of more than ``shortest`` seconds, and steps back in time."""
    longest = max(USUAL_STEPS * usual_step(t), shortest)
    rows = [np.zeros(0, np.intp)]
    for first, part in iter_chunks(t, overlap=1):
        steps = np.diff(part)
        rows.append(first + 1 + np.flatnonzero((steps > longest) | (steps < 0.0)))
    return np.concatenate(rows)


def rows_behind_pauses(t: Array) -> Indices:
    """Return the rows (K,) at which stamps t (N,) begin anew: behind gaps of more than
    a second, and where the clock was set back."""
    return rows_behind_gaps(t, PAUSE)


def rows_before_steps_back(t: Array) -> Indices:
    """Return the rows (K,) of stamps t (N,) behind which the next stamp is an earlier one."""
    parts = iter_chunks(t, overlap=1)
    rows = [first + np.flatnonzero(np.diff(part) < 0.0) for first, part in parts]
    return np.concatenate([np.zeros(0, np.intp), *rows])


def is_set_back(t: Array) -> bool:
    """Return whether a clock with stamps t (N,) was set back, once or more: more than
    FEWEST_ROWS rows lie before, between and behind its steps back in time."""
    rows = rows_before_steps_back(t)
    lengths = np.diff(rows, prepend=0, append=len(t) - 1)
    return len(rows) > 0 and bool(np.all(lengths > FEWEST_ROWS))


def stray_rows(t: Array) -> Mask:
    """Return which rows (N,) of stamps t are of another clock: fewer than FEWEST_ROWS
    between steps that are longer than all that was recorded."""
    behind = rows_behind_pauses(t)
    if not len(behind):
        return np.zeros(len(t), bool)
    far = behind[np.abs(t[behind] - t[behind - 1]) > recorded_seconds(t)]
    lengths = np.diff(far, prepend=0, append=len(t))
    is_stray = lengths < FEWEST_ROWS
    if is_stray.all():
        return np.zeros(len(t), bool)
    return np.repeat(is_stray, lengths)


def goes_on(q: Array, rows: Indices) -> Mask:
    """Return at which of K steps (numbers of the rows before them) the arm moves no
    farther than in the ten steps before and behind: the motion q (N, n) goes on there."""
    scaled = q / nonzero_or_one(np.ptp(q, axis=0))
    travel = np.linalg.norm(np.diff(scaled, axis=0), axis=1)
    usual = [float(np.median(travel[max(k - 10, 0) : k + 11])) for k in rows]
    # A thousandth of the range allows for noise at rest.
    return np.asarray(travel[rows] < 3.0 * np.array(usual) + 1e-3)


def order_of_time(t: Array, q: Array) -> Indices | None:
    """Return the order (N,) of rows that are mixed, by their stamps t (N,): None where
    sorting makes gaps, dense rows or a rougher motion q (N, n), as where a clock was set
    back."""
    order = np.argsort(t, kind="stable")
    is_moved = order != np.arange(len(t))
    is_beside = is_moved[1:] | is_moved[:-1]
    steps, as_written = np.diff(t[order]), np.diff(t)
    usual = float(np.median(steps)) if is_beside.any() else 0.0
    # Two rows tell no order.
    if len(t) < 3 or not usual > 0.0 or not steps[is_beside].min() > 0.0:
        return None
    longest = REGULAR * usual
    makes_gaps = np.sum(steps > longest) > np.sum(as_written > longest)
    is_dense = np.median(steps[is_beside]) * REGULAR < usual
    sizes = np.ptp(q, axis=0) + 1e-300
    travel, sorted_travel = (
        float(np.nansum(np.abs(np.diff(x, axis=0))[is_beside] / sizes))
        for x in (q, q[order])
    )
    is_smooth = 0.0 < sorted_travel <= SMOOTH * travel
    return order if is_smooth and not (makes_gaps or is_dense) else None


def recorded_seconds(t: Array) -> float:
    """Return how long a run with stamps t (N,) lasts [s], pauses left out."""
    behind = rows_behind_pauses(t)
    return float(t[-1] - t[0] - np.sum(t[behind] - t[behind - 1]))


def spaced_evenly(t: Array, step: float) -> Array:
    """Return stamps (N,) [s] that a clock of the resolution ``step`` wrote, spaced evenly
    between gaps.

    A gap is a step longer than three times the resolution, and than three times almost all
    other steps (their 97 % quantile).
    """
    steps = np.diff(t)
    pause = _GAP * max(step, float(np.quantile(steps, 0.97)))
    edges = np.flatnonzero(steps > pause) + 1
    return np.concatenate([_even(x) for x in np.split(t, edges)])


def _even(t: Array) -> Array:
    """Return evenly spaced times (N,) of times t (N,) that were written with too few
    digits.

    They are on the line t = a + step row, by least squares, through the rows at which
    the written time changes: there the clock passed the written digit less than a step
    ago. The first and the last written time are cut short, and do not count. Where
    fewer than two times change, the line goes through all rows.
    """
    if len(t) <= 2:
        return t
    row = np.arange(len(t))
    changes = np.flatnonzero(np.diff(t)) + 1
    used = changes if len(changes) > 1 else row
    middle = np.mean(used)
    centred = used - middle
    step = float(centred @ (t[used] - t[0])) / float(centred @ centred)
    return np.mean(t[used]) + step * (row - middle)
