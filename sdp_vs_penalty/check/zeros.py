"""Exact zeros in a channel of fine steps: rows that a logger filled in because it had no sample.

A channel that counts in steps of d passes exactly through zero about as often as through any other
level near it. Zeros that are far more frequent than their neighbouring levels, with a jump into them
and out of them, are no measurement, whatever a fit says of the rows.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty import show
from sdp_vs_penalty.check.issue import Issue, rows_text
from sdp_vs_penalty.check.signals import lattice_step
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.robot import Robot
from sdp_vs_penalty.signals.runs import movement, moving_joints, spans

#: Levels to either side that tell how often to expect a zero; so many times as many are no chance.
_LEVELS, _TIMES = 20, 10.0
#: A jump is so many times the median step of so many rows around.
_JUMP, _AROUND = 6.0, 10
#: A torque at zero for so many rows, and so many times longer than elsewhere at one value, while the
#: joint moves at this share of its usual speed, needs no jump.
_ALONE, _TIMES_HELD, _TRAVEL = 4, 4, 0.2
#: Longer parts [s] are deleted, shorter ones interpolated.
_SHORT = 0.02


def find(run: Measurements, robot: Robot, standstill: float) -> Iterator[Issue]:
    """One issue for all zeros that no measurement made, of joints that move."""
    found: dict[str, NDArray[np.bool_]] = {}
    motion = movement(run, standstill)
    moves = motion.at(run.t - 0.5) & motion.moves & motion.at(run.t + 0.5)
    travel = np.abs(np.gradient(run.q, axis=0))
    for name, values in (("q", run.q), ("tau", run.tau)):
        for j in np.flatnonzero(moving_joints(run)).tolist():
            bad = _filled(values[:, j], travel[:, j] if name == "tau" else np.zeros(len(run.t))) & moves
            # One torque at zero is an outlier as any other, and harms no fit; one position does.
            if bad.sum() > (name == "tau"):
                found[f"{name}{j + 1}"] = bad
    if not found:
        return
    steps = np.gradient(run.t)
    long = np.zeros(len(run.t), bool)
    for bad in found.values():
        for a, b in spans(bad):
            long[a:b] |= steps[a:b].sum() > _SHORT

    rows = np.flatnonzero(np.any(list(found.values()), axis=0))
    named, be = ", ".join(found), "is" if len(found) == 1 else "are"
    joints = sorted({int(name.lstrip("qtau")) for name in found})
    yield Issue(
        "zeros", "error",
        f"{named}, {rows_text(rows[0] + 2, len(rows))}",
        f"{named} {be} exactly zero in {show.count(len(rows), 'row')}, and jumps there or stays while "
        "the joint moves: nothing was measured.",
        "certain: the channel hardly ever takes any other value near zero",
        "replace single rows by interpolation, delete longer parts",
        lambda r: interpolated(r, found).rows(~long),
        {"channels": list(found), "joints": joints, "rows": len(rows)},
    )  # fmt: skip


def interpolated(run: Measurements, found: Mapping[str, NDArray[np.bool_]]) -> Measurements:
    """With these samples (N,) of the channels q1, tau1 ... made from their neighbours."""
    q, tau = run.q.copy(), run.tau.copy()
    for name, bad in found.items():
        column = (q if name[0] == "q" else tau)[:, int(name.lstrip("qtau")) - 1]
        column[bad] = np.interp(run.t[bad], run.t[~bad], column[~bad])
    return replace(run, q=q, tau=tau)


def _filled(x: Array, travel: Array) -> NDArray[np.bool_]:
    """(N,) which samples of a channel are zeros that it does not pass through; travel : row by row."""
    zero, bad = x == 0.0, np.zeros(len(x), bool)
    parts, other = spans(zero), np.flatnonzero(~zero)
    changes = np.abs(np.diff(x))
    if not len(parts) or len(other) < 2 * _AROUND or not changes.any():
        return bad
    usual = float(np.median(changes[changes > 0.0]))
    held = spans((changes == 0.0) & ~zero[1:])
    alone = max(_ALONE, _TIMES_HELD * int(np.diff(held).max(initial=0)))
    moved = _TRAVEL * float(np.median(travel))
    for a, b in parts:
        stays = b - a >= alone and float(travel[a:b].mean()) > moved
        bad[a:b] = _jumps(x, int(a), int(b), usual) or (stays and a > 0 and b < len(x))
    near = other[np.abs(x[other]) <= _LEVELS * lattice_step(x[other])]
    near = near[(near > 0) & (near < len(x) - 1)]
    far = near[0.5 * (changes[near - 1] + changes[near]) > _JUMP * usual]  # few can jump at all
    by_chance = sum(_jumps(x, k, k + 1, usual) for k in far.tolist()) / (2 * _LEVELS)
    return bad if bad.sum() > _TIMES * by_chance else np.zeros(len(x), bool)


def _jumps(x: Array, a: int, b: int, usual: float) -> bool:
    """Whether a channel jumps into these rows and out of them."""
    before, after = x[max(a - _AROUND, 0) : a], x[b : b + _AROUND]
    if not len(before) or not len(after):
        return False  # before the first sample, or behind the last
    local = np.concatenate([np.abs(np.diff(before)), np.abs(np.diff(after)), [0.0]])
    away = 0.5 * (abs(before[-1] - x[a]) + abs(after[0] - x[b - 1]))
    return bool(away > _JUMP * max(usual, float(np.median(local))))
