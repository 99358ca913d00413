"""Torque that changes its zero or its arm during a run: drift, a step, another load or arm, a knock."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from itertools import accumulate

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.check.evidence import Evidence, in_parts, settle, solve
from sdp_vs_penalty.check.hypothesis import HALF, Hypothesis, propose
from sdp_vs_penalty.check.issue import Issue, joints_text
from sdp_vs_penalty.check.physics import Physics
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.robot.arrays import Array

#: Instants, as shares of the run, at which a step is tried; and at which the run is cut in two.
_STEPS, _CUTS = np.linspace(0.15, 0.85, 29), np.linspace(0.15, 0.85, 15)
#: Share of the time on either side of a step that the joint has to move each way.
_WAYS = 0.15
#: Gain of the score (its median over the joints, for each of them) by which two arms, one after the
#: other, must explain a run better than two that take turns in so many stripes of it.
_TWO = 3.0
_STRIPES = 20
#: Two arms that leave less than a ninth of the energy that one does are an error.
_FAR_FROM_ONE = 9.0


def drift(physics: Physics, moving: NDArray[np.bool_]) -> Iterator[Hypothesis]:
    """A torque channel that drifts with time, or that steps once (a contact, a load, a re-zeroing).

    By a score test: of each joint's column the part that the arm's columns do not explain, against the
    residual; the best one is then applied and judged like any other hypothesis.
    """
    t, physics = physics.motion.t, physics.sliding
    u = (t - t[0]) / max(float(t[-1] - t[0]), 1e-300)
    shapes: dict[float | None, Array] = {None: u - 0.5}
    shapes |= {float(s): (u > s) - 0.5 for s in _STEPS}
    evidence = physics.evidence
    weights = 1.0 / (evidence.shares * evidence.energy)
    gram = np.tensordot(weights, evidence.gram, 1)
    best: dict[bool, tuple[float, int, float | None]] = {}
    every = np.column_stack(list(shapes.values()))
    for j in np.flatnonzero(moving).tolist():
        columns = physics.columns[j]
        assert physics.heard is not None
        x = physics.heard[:, j, None] * every
        residual = physics.counted[:, j] - columns @ evidence.theta
        shared = columns.T @ x
        own = np.sum(x**2, axis=0) - weights[j] * np.sum(shared * solve(gram, shared), axis=0)
        found = weights[j] * (residual @ x) ** 2 / np.maximum(own, 1e-6 * np.sum(x**2, axis=0))
        found[1:] *= _both_ways(physics.motion.dq[:, j], u)
        for k, at in enumerate(shapes):
            best[at is None] = max(best.get(at is None, (0.0, 0, None)), (float(found[k]), j, at),
                                   key=lambda b: b[0])  # fmt: skip
    for _, j, at in best.values():
        yield _stepped(physics, j, at)


def _both_ways(dq: Array, u: Array) -> NDArray[np.bool_]:
    """Per instant whether the joint moves both ways on either side: else a step is friction's."""
    rows = np.searchsorted(u, _STEPS, "right")
    before = np.append(0, np.cumsum(dq > 0.0))[rows]
    after = np.sum(dq > 0.0) - before
    forth = np.array([before / np.maximum(rows, 1), after / np.maximum(len(u) - rows, 1)])
    return np.asarray(np.min(np.minimum(forth, 1.0 - forth), axis=0) > _WAYS)


def _stepped(physics: Physics, j: int, at: float | None) -> Hypothesis:
    """The drift (at None) or the step after that share of the run, of a size that is fitted anew."""
    t0, length = float(physics.motion.t[0]), float(physics.motion.t[-1] - physics.motion.t[0])

    def shape(t: Array) -> Array:
        u = (t - t0) / max(length, 1e-300)
        return np.asarray(u if at is None else (u > at).astype(float))

    def apply(p: Physics) -> Physics:
        columns, y, x = p.columns[j], p.counted[:, j], shape(p.motion.t)
        x = x if p.heard is None else p.heard[:, j] * x
        # Together with the arm's own columns on that joint, at the parameters that all joints share.
        e = p.evidence
        others = (np.arange(p.n) != j) / (e.shares * e.energy)
        gram = np.tensordot(others, e.gram, 1)
        wide = np.column_stack([columns, x])
        weight = 1.0 / (e.alone[j] * e.energy[j])
        full = np.zeros((gram.shape[0] + 1,) * 2)
        full[:-1, :-1] = gram
        full += weight * wide.T @ wide
        right = np.append(others @ e.cross, 0.0) + weight * wide.T @ y
        size = float(solve(full, right[:, None])[-1, 0])
        out = np.zeros_like(p.channels)
        out[:, j] = size * shape(p.motion.t)
        return p.without(out)

    moved = physics.channels[:, j] - apply(physics).channels[:, j]
    size = float(moved[-1] - moved[0])
    unit = physics.model.robot.torque_units[j]
    if at is None:
        texts = (
            "torque drift", joints_text([j]),
            f"the torque of joint {j + 1} drifts by {size:.3g} {unit} over the run.",
            "zero the sensor, let it warm up, and record again; or add the effect drift_offset",
        )  # fmt: skip
    else:
        texts = (
            "torque step", joints_text([j]),
            f"the torque of joint {j + 1} steps by {size:.3g} {unit} at t = {t0 + at * length:.4g} s "
            "and stays: a contact, a load, or a sensor that was zeroed.",
            "identify from one part of the run: --window cuts it there",
        )  # fmt: skip
    return propose(
        apply, 2, texts, None, severity="warning", once=True, joints=[j + 1], size=size,
        t=None if at is None else t0 + at * length,
    )  # fmt: skip


def two_parts(physics: Physics, cutoff: float) -> Iterator[Issue]:
    """Two parts of a run that no one arm explains: a load picked up, or two arms' logs in one file.

    cutoff : of the torque [Hz]; independent samples have to outnumber the parameters in every part.
    """
    # Rotors and friction of other laws have no part in it: in a short part they would explain anything.
    # What they explain of the whole run needs no second arm, though.
    wide, physics, count = physics.evidence, physics.narrow, len(physics.motion.t)
    cuts = [s for s in _CUTS if physics.determined(cutoff, float(min(s, 1.0 - s)))]
    if not cuts:
        return
    one = physics.evidence
    best: tuple[float, int, Array] = (np.inf, 0, one.shares)
    edges = [0, *(int(share * count) for share in cuts), count]
    pieces = in_parts(physics.columns, physics.channels, edges)
    before, after = list(accumulate(pieces)), list(accumulate(pieces[::-1]))[::-1]
    settle([*before[:-1], *after[1:]])
    for cut, *parts in zip(edges[1:-1], before, after[1:], strict=False):
        left = sum(part.shares * part.energy for part in parts) / one.energy
        score = float(np.log(np.maximum(left, 1e-5)).sum())
        if score < best[0]:
            best = (score, cut, left)
    score, cut, left = best
    # What as many parameters explain that are spread over the whole run: the model's own small errors.
    odd = (np.arange(count) * _STRIPES // count) % 2 == 1
    stripes = [physics.part(np.flatnonzero(rows)).evidence for rows in (odd, ~odd)]
    spread = sum(part.shares * part.energy for part in stripes) / one.energy
    # Most joints have to say so: a wrist's friction is no other arm. And at the outermost cut it is the
    # start or the end of the run that differs.
    spread = np.minimum(spread, wide.left / wide.energy)
    change = np.log(np.maximum(spread, 1e-5) / np.maximum(left, 1e-5))
    outermost = cut in (edges[1], edges[-2])
    if physics.n * float(np.median(change)) < _TWO or outermost:
        return
    # Each has to explain what it was not fitted to: in a short part an arm explains anything.
    two = [physics.part(rows).left_out for rows in (slice(0, cut), slice(cut, None))]
    unseen = np.log(physics.left_out).mean(axis=0) - np.log(np.vstack(two)).mean(axis=0)
    if physics.n * float(np.median(unseen)) < HALF * _TWO:
        return
    with_load = _with_load(physics, cut)
    last = physics.n
    t = float(physics.motion.t[cut])
    sure = (
        "likely: two arms leave "
        f"{100.0 * np.sqrt(np.mean(left)):.3g} % of the torques unexplained, one leaves "
        f"{100.0 * np.sqrt(np.mean(one.shares)):.3g} %"
    )
    if one.score - with_load.score > 0.7 * (one.score - score):
        kind, what = "load step", f"from t = {t:.4g} s on link {last} carries another load than before."
    else:
        kind, what = "two arms", f"before and after t = {t:.4g} s these are not the torques of one arm."
    remedy = "cut the run there and use each part by itself (--window)"
    # Where one arm leaves not much more than two do, its model is not meaningless.
    severity = "error" if np.sum(one.shares) > _FAR_FROM_ONE * np.sum(left) else "warning"
    yield Issue(kind, severity, f"t = {t:.4g} s", what, sure, remedy, None, {"t": t})


def _with_load(physics: Physics, cut: int) -> Evidence:
    """The evidence where the last link has ten parameters of its own after the cut."""
    last = physics.model.rigid_indices[-10:]
    after = (np.arange(len(physics.motion.t)) >= cut)[:, None]
    whole = replace(physics, independent=None).columns
    columns = [np.hstack([c, x[:, last] * after]) for c, x in zip(physics.columns, whole, strict=True)]
    return Evidence.of(columns, physics.channels)


#: An event is a peak of the error this many times higher than every other one. Two peaks of one
#: cause (a reversal of friction) differ far less.
_ALONE = 3.0
#: ... and this many standard deviations of the error elsewhere.
_FAR = 12.0
#: A joint slides at this share of its usual speed.
_SLIDES = 0.3
#: Errors this close to a peak belong to it [s].
_WIDTH = 1.0


def knock(physics: Physics) -> Iterator[Issue]:
    """A moment at which the error is far larger than at any other: contact, a push, a lost packet."""
    t = physics.motion.t
    found: dict[int, list[tuple[int, float]]] = {}
    # Where a joint turns round or rests, friction errs as it likes.
    slides = np.abs(physics.motion.dq) > _SLIDES * np.sqrt(np.mean(physics.motion.dq**2, axis=0))
    for j, columns in enumerate(physics.columns):
        y = physics.channels[:, j]
        error = np.abs(y - columns @ solve(columns.T @ columns, (columns.T @ y)[:, None])[:, 0])
        k = int(np.argmax(np.where(slides[:, j], error, 0.0)))
        if min(t[k] - t[0], t[-1] - t[k]) < 0.5 * _WIDTH:
            continue  # the arm starts or comes to rest there: stiction
        elsewhere = error[np.abs(t - t[k]) > _WIDTH]
        if len(elsewhere) and error[k] > max(_ALONE * elsewhere.max(), _FAR * np.std(elsewhere)):
            near = next((at for at in found if abs(t[at] - t[k]) < _WIDTH), k)
            found.setdefault(near, []).append((j, float(error[k])))
    for k, joints in found.items():
        sizes = ", ".join(
            f"{size:.3g} {physics.model.robot.torque_units[j]} in joint {j + 1}" for j, size in joints
        )
        at = float(t[k])

        yield Issue(
            "one-off event", "warning", f"t = {at:.3g} s, {joints_text(j for j, _ in joints)}",
            f"a one-off event at t = {at:.3g} s (a knock, a contact, a lost packet): the error there "
            f"is {sizes}, over {_ALONE:g} times that at any other moment.",
            "likely: an effect of the arm itself would recur", f"exclude {_WIDTH:g} s around it",
            partial(_without, at=at),
            {"t": at, "joints": [j + 1 for j, _ in joints]},
        )  # fmt: skip


def _without(run: Measurements, at: float) -> Measurements:
    return run.rows(np.abs(run.t - at) > 0.5 * _WIDTH)
