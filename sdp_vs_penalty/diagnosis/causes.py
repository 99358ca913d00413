"""What an error can depend on, as columns, and the stretches of a run in which it is large, by cause.

Causes are what a person sees in a log: a reversal, a standstill, high speed, a position, a wave per
turn, time, another joint. None is a physical effect; `diagnose` names those.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.effects.effect import smooth_sign
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.segments import SegmentedRuns
from sdp_vs_penalty.signals.standstill import STILL

REVERSAL, STANDSTILL, HIGH_SPEED = "reversal", "standstill", "high speed"
POSITION, VELOCITY, ACCELERATION, LOAD = "position", "velocity", "acceleration", "load"
WAVES, TIME, OTHER_JOINTS = "waves per turn", "time", "other joints"
#: The rows of a heat map, in this order.
CAUSES = (
    REVERSAL, STANDSTILL, HIGH_SPEED, VELOCITY, POSITION, WAVES, ACCELERATION, LOAD, TIME, OTHER_JOINTS,
)  # fmt: skip
#: What a stretch is called whose cause none of these explains.
UNNAMED = "no cause seen"
#: Seconds around a velocity reversal that count as near it, and those over which an error follows it.
NEAR, FOLLOWS = 0.15, 0.4
#: Share of the largest speed from which on a joint is fast.
_FAST = 0.75
#: Hat functions of a quantity; an odd number, so that one of them sits at the reversal itself.
_HATS = 9
#: A stretch fails where the error's RMS over 2 NEAR is so many noise floors, or times its own RMS where
#: the floor is not known; shorter ones than NEAR are not shown.
_TIMES = 2.0
#: Held-out share from which the error is said to depend on a quantity.
NAMED_SHARE = 0.05


class Stretch(NamedTuple):
    """Instants [s] of a run between which an error is large, and the cause that is seen there."""

    run: str
    start: float
    stop: float
    cause: str


def states(rows: SegmentedRuns) -> dict[str, Array]:
    """Filtered position, velocity, acceleration, torque and time of every row, each (M, n)."""

    def stack(name: str) -> Array:
        return np.concatenate([s.low_pass @ getattr(s.motion, name) for s in rows.segments])

    return {
        POSITION: stack("q"),
        VELOCITY: stack("dq"),
        ACCELERATION: stack("ddq"),
        "torque": stack("torque"),
        TIME: np.repeat(rows.t[:, None], rows.n, axis=1),
    }


def cause_columns(
    known: dict[str, Array], rows: SegmentedRuns, j: int, orders: Sequence[int]
) -> dict[str, Array]:
    """By cause the columns (M, k) of which a joint's error (from 0) may be a combination; orders : the
    waves per turn that its spectrum shows."""
    x = {name: values[:, j] for name, values in known.items()}
    direction = smooth_sign(x[VELOCITY])
    fast = np.maximum(np.abs(x[VELOCITY]) - _FAST * np.abs(x[VELOCITY]).max(), 0.0)
    still = np.asarray(rows.still[:, j] > STILL, float)
    others = [hats(known[name][:, i]) for i in range(rows.n) if i != j for name in (VELOCITY, POSITION)]
    return {
        REVERSAL: _after_reversals(x[VELOCITY], rows),
        STANDSTILL: np.column_stack([still, still * direction]),
        HIGH_SPEED: np.column_stack([fast, fast * direction]),
        VELOCITY: hats(x[VELOCITY]),
        POSITION: hats(x[POSITION]),
        WAVES: _waves(rows, j, orders),
        ACCELERATION: hats(x[ACCELERATION]),
        LOAD: np.hstack([hats(x["torque"]), hats(np.abs(x["torque"]) * direction)]),
        TIME: hats(x[TIME]),
        OTHER_JOINTS: np.hstack(others) if others else np.zeros((len(rows.t), 0)),
    }


def hats(x: Array) -> Array:
    """(N, count) piecewise linear functions that add up to one, knots at quantiles."""
    knots = np.unique(np.quantile(x, np.linspace(0.0, 1.0, _HATS)))
    if len(knots) < 2:
        return np.ones((len(x), 1))
    return np.column_stack([np.interp(x, knots, unit) for unit in np.eye(len(knots))])


def reversals(velocity: Array, rows: SegmentedRuns) -> NDArray[np.intp]:
    """The rows before which a joint's velocity (M,) has its last old sign."""
    same = rows.segment[1:] == rows.segment[:-1]
    return np.flatnonzero((np.sign(velocity[1:]) != np.sign(velocity[:-1])) & same)


def from_reversal(velocity: Array, rows: SegmentedRuns) -> tuple[Array, Array]:
    """(M,) seconds from the nearest reversal, below zero before it, infinite where there is none; and
    the direction after it."""
    away, direction = np.full(len(velocity), np.inf), np.zeros(len(velocity))
    span = max(1, round(FOLLOWS * rows.rate))
    for k in reversals(velocity, rows):
        at = np.arange(max(k - span + 1, 0), min(k + 1 + span, len(velocity)))
        at = at[rows.segment[at] == rows.segment[k]]
        seconds = rows.t[at] - 0.5 * (rows.t[k] + rows.t[k + 1])
        closer = np.abs(seconds) < np.abs(away[at])
        away[at[closer]] = seconds[closer]
        direction[at[closer]] = np.sign(velocity[k + 1])
    return away, direction


def _after_reversals(velocity: Array, rows: SegmentedRuns) -> Array:
    """Any function of the time from a reversal, and that times the direction after it."""
    away, direction = from_reversal(velocity, rows)
    knots = np.linspace(-FOLLOWS, FOLLOWS, _HATS)
    near = np.isfinite(away) & (np.abs(away) < FOLLOWS)
    shape = np.column_stack(
        [np.where(near, np.interp(away, knots, unit), 0.0) for unit in np.eye(len(knots))]
    )
    return np.hstack([shape, shape * direction[:, None]])


def _waves(rows: SegmentedRuns, j: int, orders: Sequence[int]) -> Array:
    """Filtered sine and cosine of each order of a joint's angle."""
    parts = []
    for s in rows.segments:
        q = s.motion.q[:, j]
        waves = [s.low_pass @ wave(k * q) for k in orders for wave in (np.cos, np.sin)]
        parts.append(np.column_stack(waves) if waves else np.zeros((len(s.t), 0)))
    return np.concatenate(parts)


def held_out_share(features: Array, error: Array, fold: NDArray[np.intp]) -> float:
    """1 - squared error of the prediction / squared error of none, over held-out folds; >= 0."""
    left = total = 0.0
    for f in np.unique(fold):
        out = fold == f
        if out.all() or not features.shape[1]:
            return 0.0
        A, b = features[~out], error[~out]
        ridge = 1e-3 * np.trace(A.T @ A) / A.shape[1]
        if ridge == 0.0:  # the cause does not occur
            return 0.0
        theta = np.linalg.solve(A.T @ A + ridge * np.eye(A.shape[1]), A.T @ b)
        left += float(np.sum((error[out] - features[out] @ theta) ** 2))
        total += float(np.sum(error[out] ** 2))
    return max(0.0, 1.0 - left / total) if total > 0.0 else 0.0


def failing_stretches(
    error: Array, floor: float | None, velocity: Array, still: Array, rows: SegmentedRuns,
    shares: dict[str, float],
) -> tuple[Stretch, ...]:  # fmt: skip
    """Where a joint's error (M,) is large, with the cause that is seen there."""
    width = max(1, round(2.0 * NEAR * rows.rate))
    size = np.sqrt(np.convolve(error**2, np.ones(width) / width, mode="same"))
    limit = _TIMES * (floor or float(np.sqrt(np.mean(error**2))))
    rest = {name: x for name, x in shares.items() if name not in (REVERSAL, STANDSTILL, HIGH_SPEED)}
    best = max(rest, key=lambda name: rest[name], default=UNNAMED)
    names = np.array([best if rest.get(best, 0.0) >= NAMED_SHARE else UNNAMED], dtype=object).repeat(
        len(error)
    )
    names[np.abs(velocity) > _FAST * np.abs(velocity).max()] = HIGH_SPEED
    names[np.abs(from_reversal(velocity, rows)[0]) <= NEAR] = REVERSAL
    names[still > STILL] = STANDSTILL
    names[size <= limit] = ""
    ends = np.flatnonzero((names[1:] != names[:-1]) | (rows.segment[1:] != rows.segment[:-1])) + 1
    edges = [0, *ends.tolist(), len(names)]
    found = [
        Stretch(rows.names[rows.run[a]], float(rows.t[a]), float(rows.t[b - 1]), str(names[a]))
        for a, b in pairwise(edges)
        if names[a]
    ]
    return tuple(s for s in found if s.stop - s.start >= NEAR)
