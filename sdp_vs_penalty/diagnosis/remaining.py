"""What a search leaves: events, hums, and what comes back whenever the motion does."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.diagnosis.events import Event, intervals, spectral_lines
from sdp_vs_penalty.diagnosis.stage import Stage
from sdp_vs_penalty.diagnosis.state import SearchState
from sdp_vs_penalty.diagnosis.verdict import Remainder, remainder
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.noise import FAINT, RESIDUAL, SAME_PHASE, differences, rate_features
from sdp_vs_penalty.signals.outliers import local_excess, lone_windows, noise_profile, robust_scale
from sdp_vs_penalty.signals.repetition import consecutive, later_rows
from sdp_vs_penalty.signals.segments import SegmentedRuns
from sdp_vs_penalty.signals.stillness import SLOW, STILL

Mask = NDArray[np.bool_]

#: Events are rare: what fills more than this share of a joint's rows is something else.
MOST_EVENTS = 0.15
#: Hz: below, lines are the motion's own harmonics.
_SLOWEST_HUM = 0.8
#: In units of the row rate: above, what the low-pass folds has no flat surroundings.
_FASTEST_HUM = 0.45


def remaining(state: SearchState) -> tuple[Remainder, tuple[Event, ...]]:
    """What is left once events are set aside, and the events.

    Windows of too much energy are events only if they are few and nothing repeatable is left
    beside them: otherwise they are the peaks of the model's error.
    """
    fit, stage = state.fit, state.stage
    rows, noise = stage.rows, stage.noise
    n, M, turning = rows.n, len(rows.t), rows.slow > SLOW
    white = (fit.residual.reshape(n, M) * fit.weighting.level[:, None]).T
    left = remainder(fit, rows, noise, state.residual)
    mask, faint, lone = np.zeros((3, M, n), bool)
    rates = rate_features(rows)
    for j in range(n):
        steady = white[:, j] / noise_profile(white[:, j], rates[j], rates[j])
        # The noise may be larger than the repetition let on; its median does not see an event.
        steady /= max(robust_scale(steady[steady != 0.0]), 1.0)
        # Friction that turns round lets go a little elsewhere each time.
        slow = turning[:, j]
        steady[slow] /= max(np.sqrt(np.mean(steady[slow] ** 2)), 1.0) if slow.any() else 1.0
        degrees = float(noise.degrees[j])
        found = local_excess(steady, rows.pieces(j), n, degrees)
        if found.any():
            lone[:, j] = _lone(white[:, j], rows, j)
            found &= lone[:, j] | (noise.source != RESIDUAL)
        if found.sum() < MOST_EVENTS * rows.keep[:, j].sum():
            mask[:, j] = found
            faint[:, j] = found | local_excess(FAINT * steady, rows.pieces(j), n, degrees)
    repeats = _repeating(mask, faint, stage)
    mask &= ~repeats
    repeats &= rows.still <= STILL
    if repeats.any():
        where = {*left.joints, *np.flatnonzero(repeats.any(axis=0)).tolist()}
        left = replace(left, remains=True, joints=tuple(sorted(where)))
    if mask.any():
        without = remainder(fit, rows, noise, state.residual, mask)
        if without.remains:
            mask[:] = False
        else:
            left = without
    mask &= lone | ~_of_reversals(mask, state.residual**2, rows)
    mask |= _odd_ones(state)
    whole = rows.with_masked(np.zeros((0, 0), bool))
    events = [
        Event(j, start, end)
        for j in range(n)
        for start, end in intervals(mask[:, j], rows.t, whole.pieces(j), gap=1.0)
    ]
    events += _hums(state)
    return left, tuple(sorted(events, key=lambda e: (e.t_start, e.joint)))


def _lone(white: Array, rows: SegmentedRuns, joint: int) -> Mask:
    """(M,) windows that stand out of a joint's own error, where nothing tells it from noise."""
    slow = (rows.slow[:, joint] > SLOW) | (rows.still[:, joint] > 0.0)
    jerk = np.concatenate(
        [s.low_pass @ np.gradient(s.motion.ddq[:, joint], s.motion.t) for s in rows.segments]
    )
    return lone_windows(white, rows.pieces(joint), slow, jerk, rows.rate, rows.n)


def _of_reversals(mask: Mask, energy: Array, rows: SegmentedRuns) -> Mask:
    """(M, n) the windows of which most energy (M, n) is of rows in which the joint is slow: friction
    turns round a little elsewhere each time."""
    out = np.zeros_like(mask)
    for j in range(rows.n):
        slowly, marked = energy[:, j] * (rows.slow[:, j] > SLOW), np.flatnonzero(mask[:, j])
        for piece in np.split(marked, np.flatnonzero(np.diff(marked) != 1) + 1):
            out[piece, j] = slowly[piece].sum() > 0.5 * energy[piece, j].sum()
    return out


def _hums(state: SearchState) -> list[Event]:
    """One event a run for each joint in whose residual a spectral line stands.

    Where the motion repeats it is looked for in what does not: a model's error is a comb of lines. The
    residual is not whitened for it: an autoregression takes a sine for its own colour.
    """
    rows, repeats = state.stage.rows, state.stage.noise.repeats
    slow = rows.slow > SLOW  # reversals are harmonics of the motion
    if repeats:
        left, found = differences(rows, rows.residual, repeats), consecutive(repeats)
        slow = np.concatenate([slow[r.rows] for r in repeats])
    else:
        left = state.residual
    left = np.where(slow, 0.0, left)
    out = []
    for j in range(rows.n):
        every = found if repeats else rows.pieces(j)
        longest = max((len(p) for p in every), default=0)
        series = [left[p, j] for p in every if 2 * len(p) > longest]
        lines = [
            f
            for f in spectral_lines(series, rows.rate, rows.n, _SLOWEST_HUM)
            if f < _FASTEST_HUM * rows.rate
        ]
        for segment in rows.segments if lines else ():
            out.append(Event(j, float(segment.t[0]), float(segment.t[-1]), "hum", lines[0]))
    return out


def _repeating(mask: Mask, faint: Mask, stage: Stage) -> Mask:
    """Rows (M, n) of windows that come back at the same phase of the motion, if only faintly: error of
    the model, no event."""
    out, near = np.zeros_like(mask), _widened(faint, stage)
    for repeat in stage.noise.repeats:
        later = later_rows(stage.rows, repeat)
        out[repeat.rows] |= mask[repeat.rows] & near[later]
        back = np.zeros_like(mask)
        np.logical_or.at(back, later, near[repeat.rows])
        out |= mask & back
    return out


def _odd_ones(state: SearchState) -> Mask:
    """(M, n) where the repetitions of a motion differ: an event, in the one that leaves more error."""
    stage = state.stage
    rows, repeats, suspect = stage.rows, stage.noise.repeats, stage.noise.suspect
    if not suspect.any():
        return suspect
    pairs = [(r.rows, later_rows(rows, r)) for r in repeats]
    apart = np.zeros(suspect.shape)
    for one, other in pairs:
        for at in (one, other):
            np.maximum.at(apart, at, (state.residual[one] - state.residual[other]) ** 2)
    suspect = suspect & ~_of_reversals(suspect, apart, rows)
    out, near = suspect.copy(), _widened(suspect, stage)
    width = np.ones(2 * _reach(stage) + 1)
    energy = np.array([np.convolve(x, width, mode="same") for x in (state.residual**2).T]).T
    for one, other in pairs:
        first_less = energy[one] <= energy[other]
        out[one] &= ~(near[other] & first_less)
        lost = np.zeros_like(out)
        np.logical_or.at(lost, other, near[one] & ~first_less)
        out &= ~lost
    return out


def _reach(stage: Stage) -> int:
    """Rows within which two windows are at the same phase."""
    return max(1, round(SAME_PHASE * stage.rows.rate))


def _widened(mask: Mask, stage: Stage) -> Mask:
    width = np.ones(2 * _reach(stage) + 1)
    return np.array([np.convolve(m, width, mode="same") > 0 for m in mask.T]).T
