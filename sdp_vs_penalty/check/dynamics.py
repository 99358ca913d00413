"""The search for gross mistakes: hypotheses compete for what the arm's dynamics cannot explain."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.check import gravity, motion, order, signs
from sdp_vs_penalty.check.hypothesis import ABOUT_SAME, BETTER, Hypothesis
from sdp_vs_penalty.check.issue import Issue
from sdp_vs_penalty.check.physics import Physics

#: A hypothesis has to help at least so much in each half of the run.
_HELPS = 0.75
#: From this share unexplained on something is badly wrong, though nothing says what.
_BAD = 0.1
#: An arm whose torques are explained up to this share of their energy has nothing gross wrong.
_ENOUGH = 0.01
#: Above this share of the energy, half of the torque, the arm's dynamics do not make these torques.
_UNRELATED = 0.25
#: At most so many things wrong at once are looked for.
_ROUNDS = 4


def find(physics: Physics, moving: NDArray[np.bool_]) -> Iterator[Issue]:
    """Issues in the order in which to mend them, if together they explain the torque.

    Where nothing does, the one issue is that: a cause that leaves most in the dark is no cause.
    """
    first = physics.unexplained_of(moving)
    recorded, found = physics, []
    for _ in range(_ROUNDS):
        hypothesis = best_hypothesis(physics, moving)
        if hypothesis is None:
            break
        found.append(hypothesis.issue)
        physics = hypothesis.apply(physics)
    if len(found) > 1:
        # One position turned may look like two other mistakes: a mirrored arm is an arm too.
        for hypothesis in motion.turned_or_exchanged(recorded, moving):
            mended = hypothesis.apply(recorded)
            enough = ABOUT_SAME * physics.unexplained
            if mended.unexplained < enough and best_hypothesis(mended, moving) is None:
                found, physics = [hypothesis.issue], mended
    left = physics.unexplained_of(moving)
    if left < _BAD:
        yield from found
        return
    unrelated = left > _UNRELATED
    yield Issue(
        "torque not explained" if unrelated else "torque badly explained",
        "error" if unrelated else "warning",
        "all torque channels",
        f"{100.0 * first:.0f} % of the energy of the moving joints' torques has nothing to do with how "
        "this arm should move under them, whatever its inertias and friction.",
        "certain: none of the tried signs, orders, units and directions of gravity helps",
        "check that this is the right robot, that the columns are joint torques, and that positions "
        "and torques come from the same recording",
        None,
        {"unexplained_percent": 100.0 * first, "at_best_percent": 100.0 * left},
    )


def best_hypothesis(physics: Physics, moving: NDArray[np.bool_]) -> Hypothesis | None:
    """The simplest of the hypotheses that explain the torque best, or None where none does."""
    base = physics.unexplained
    found: list[tuple[float, Hypothesis]] = []
    cheap = (motion.degrees, motion.delay, signs.signs, gravity.direction)
    dear = (order.exchanged, motion.turned_or_exchanged)
    # Where next to nothing is unexplained, only what acts on it weakly can be wrong.
    for make in (*cheap, *dear) if base > _ENOUGH else (signs.signs, gravity.direction):
        # An explanation that leaves next to nothing makes the dearer ones unnecessary. The cheap ones
        # compete: with gravity turned round, one sign turned may leave little as well.
        if make in dear and found and min(found, key=lambda f: f[0])[0] < _ENOUGH:
            break
        for hypothesis in make(physics, moving):
            after = hypothesis.apply(physics).unexplained
            if after < BETTER * base:
                found.append((after, hypothesis))
    best = min((after for after, _ in found), default=np.inf)
    near = [f for f in found if f[0] <= ABOUT_SAME * best]
    for _, hypothesis in sorted(near, key=lambda f: f[1].simplicity):
        if _holds_in_both_halves(physics, hypothesis):
            return hypothesis
    return signs.weak_signs(physics) or gravity.hanging(physics)


def _holds_in_both_halves(physics: Physics, hypothesis: Hypothesis) -> bool:
    half = len(physics.motion.t) // 2
    for rows in (slice(0, half), slice(half, None)):
        part = physics.part(rows)
        if hypothesis.apply(part).unexplained > _HELPS * part.unexplained:
            return False
    return True
