"""Torque channels with the wrong sign, or of other joints."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from itertools import combinations, product

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.check.hypothesis import AGREES, NEAR, SIGNIFICANT, Hypothesis, propose
from sdp_vs_penalty.check.issue import joints_text
from sdp_vs_penalty.check.physics import Physics
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.robot.arrays import Array


def signs(physics: Physics, moving: NDArray[np.bool_]) -> Iterator[Hypothesis]:
    """The signs that the coupling between the joints prefers; friction decides where that is silent."""
    flipped = np.flatnonzero(choose_signs(physics) < 0.0).tolist()
    if flipped:
        yield _flip(physics, flipped)
    for j in np.flatnonzero(moving).tolist():
        if [j] != flipped:
            yield _flip(physics, [j])


def time_reversed(physics: Physics, moving: NDArray[np.bool_]) -> Hypothesis | None:
    """Rows in reverse order: friction drives every joint, yet inertia and weight have the right sign."""
    power, deviation = physics.dissipation
    z = power / deviation
    known = moving & (np.abs(z) > SIGNIFICANT)
    driven = known & (z < 0.0)
    if driven.sum() < max(0.6 * known.sum(), 1.0) or driven.sum() < 0.4 * moving.sum():
        return None
    # With every torque's sign turned instead, inertia or weight would be negative.
    inertia, weight = float(physics.inertia.sum()), physics.agreement_with_weight()
    if inertia < -SIGNIFICANT or weight < 0.0 or (inertia < SIGNIFICANT and weight < AGREES):
        return None

    def repair(run: Measurements) -> Measurements:
        back = run.rows(np.arange(len(run.t))[::-1])
        return replace(back, t=run.t[0] + run.t[-1] - back.t, dq=None if back.dq is None else -back.dq)

    return propose(
        lambda p: p.reversed(), 1, ("time reversed", "all rows",
        "the rows are in reverse order: friction would drive the motion.",
        "reverse q and tau in time"), repair,
        certainty=f"likely: friction would drive {joints_text(np.flatnonzero(driven))}, while inertia "
        "and weight have the right sign",
    )  # fmt: skip


def choose_signs(physics: Physics) -> Array:
    """Signs among those that explain the torque about as well as the best ones.

    Of a set of signs and its opposite, and of signs of joints that nothing couples, physics knows the
    right ones: friction takes power, and inertia is positive. Where both are silent, as few signs are
    turned as possible.
    """
    n = physics.n
    power, deviation = physics.dissipation
    z = power / deviation
    knows = np.where(np.abs(z) > SIGNIFICANT, np.clip(z, -20.0, 20.0), 0.0)
    if n <= 12:
        candidates = np.array(list(product((1.0, -1.0), repeat=n)))
    else:  # one joint at a time
        candidates = np.vstack([np.ones(n), -np.ones(n), 1.0 - 2.0 * np.eye(n), 2.0 * np.eye(n) - 1.0])
    losses = np.einsum("ka,ab,kb->k", candidates, physics.form, candidates)
    near = candidates[losses <= NEAR * max(float(losses.min()), 1e-12)]
    inertia = near @ physics.inertia
    inertia = np.where(np.abs(inertia) > SIGNIFICANT, np.clip(inertia, -20.0, 20.0), 0.0)
    score = near @ knows + inertia - 1e-3 * np.sum(near < 0.0, axis=1)
    return np.asarray(near[int(np.argmax(score))], float)


def weak_signs(physics: Physics) -> Hypothesis | None:
    """Joints whose friction would drive the motion, although the coupling does not tell."""
    # The coupling ties some signs to each other: with those that physics turns, others turn.
    signs = choose_signs(physics)
    joints = [int(j) for j in np.flatnonzero(signs < 0.0)]
    if not joints:
        return None
    half = len(physics.motion.t) // 2
    parts = [physics.part(slice(0, half)), physics.part(slice(half, None))]
    power, deviation = physics.dissipation
    drives = power < -SIGNIFICANT * deviation
    backwards = float(physics.inertia.sum()) < -SIGNIFICANT
    for part in parts:
        drives &= part.dissipation[0] < 0.0
        backwards &= float(part.inertia.sum()) < 0.0
    driven = ", ".join(f"{-power[j]:.3g} W in joint {j + 1}" for j in joints if drives[j])
    if driven:
        return _flip(physics, joints, f"likely: as recorded, friction would drive the motion ({driven})")
    if backwards:
        return _flip(physics, joints, "likely: as recorded, the arm's inertia would be negative")
    return None


def _flip(physics: Physics, joints: list[int], certainty: str = "") -> Hypothesis:
    signs = np.ones(physics.n)
    signs[joints] = -1.0
    same = np.arange(physics.n)
    every = len(joints) == physics.n
    return propose(
        lambda p: p.with_channels(signs, same), len(joints), ("torque sign", joints_text(joints),
        f"the torque of {'every joint' if every else joints_text(joints)} has the wrong sign.",
        "flip the sign of " + ", ".join(f"tau{j + 1}" for j in joints)),
        lambda run: replace(run, tau=run.tau * signs), certainty=certainty,
        joints=[j + 1 for j in joints],
    )  # fmt: skip


Order = NDArray[np.intp]


def _given_out(costs: Array) -> Order:
    """(n,) the channel that each joint gets so that all together cost least."""
    cheapest: Order = np.argmin(costs, axis=1)
    if len(set(cheapest.tolist())) == len(costs):
        return cheapest
    from scipy.optimize import linear_sum_assignment

    return np.asarray(linear_sum_assignment(costs)[1], np.intp)


def exchanged(physics: Physics, moving: NDArray[np.bool_]) -> Iterator[Hypothesis]:
    """Torque channels in another order: each pair exchanged, and the order that fits joint by joint."""
    n = physics.n
    orders = []
    for a, b in combinations(np.flatnonzero(moving), 2):
        order: Order = np.arange(n, dtype=np.intp)
        order[[a, b]] = order[[b, a]]
        # Only where both channels suit the other joint at least as well, each joint by itself.
        own = physics.alone[a, a] * physics.alone[b, b]
        if physics.alone[a, b] * physics.alone[b, a] < own:
            orders.append(order)
    # For each joint the channel that its columns alone explain best, all channels given out.
    orders.append(_given_out(np.log(physics.alone)))
    for order in orders:
        changed = np.flatnonzero(order != np.arange(n))
        if not len(changed) or not np.all(moving[changed]):
            continue
        swapped = physics.with_channels(np.ones(n), order)
        signs = choose_signs(swapped)
        turned = np.flatnonzero(signs < 0.0)
        swap = len(changed) == 2
        named = ", ".join(f"tau{order[j] + 1} is that of joint {j + 1}" for j in changed)
        what = (
            f"the torques of {joints_text(changed)} are swapped."
            if swap
            else f"the torque channels are in another order: {named}."
        )
        also = (
            f", and flip the sign of {', '.join(f'tau{j + 1}' for j in turned)}" if len(turned) else ""
        )

        def repair(run: Measurements, order: Order = order, signs: Array = signs) -> Measurements:
            return replace(run, tau=run.tau[:, order] * signs)

        yield propose(
            partial(Physics.with_channels, scale=signs, order=order), len(changed) + len(turned),
            ("torque order", joints_text(changed), what, f"rename the torque columns{also}"), repair,
            order=(order + 1).tolist(), joints=[int(j) + 1 for j in changed], signs=signs.tolist(),
        )  # fmt: skip
