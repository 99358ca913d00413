"""The search for gross mistakes: hypotheses compete for what one arm cannot explain of its channels."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.check import channels, gravity, motion, signs, steps
from sdp_vs_penalty.check.hypothesis import ABOUT_SAME, GROSS, Hypothesis, few_rows
from sdp_vs_penalty.check.issue import Issue
from sdp_vs_penalty.check.physics import Physics, settled

#: Above this share of the energy, half of the torque, the arm's dynamics do not make these torques.
_UNRELATED = 0.25
#: At most so many things wrong at once are looked for.
_ROUNDS = 4
#: Those that leave the motion as it is cost little; the others need new columns each.
_FAMILIES = (
    motion.degrees, signs.signs, gravity.direction, signs.exchanged, channels.gain,
    channels.late, channels.weight, steps.drift, motion.clock, motion.turned,
    motion.exchanged, motion.offsets,
)  # fmt: skip
#: Hypotheses that are judged side by side: as many as the cache holds.
_AT_ONCE = 8
#: Families with many members, for data that nothing else explains.
_LAST = (motion.two_quarters,)


def find(physics: Physics, moving: NDArray[np.bool_], cutoff: float) -> Iterator[Issue]:
    """Issues in the order in which to mend them, if together they explain the torque.

    cutoff : of the torque [Hz]. Where nothing does, the one issue is that: a cause that leaves most in
    the dark is no cause.
    """
    first, found = unexplained(physics, moving), []
    for _ in range(_ROUNDS):
        hypothesis = best_hypothesis(physics, moving)
        if hypothesis is None:
            break
        found.append(hypothesis.stated(physics))
        physics = hypothesis.apply(physics)
    left = unexplained(physics, moving)
    if left < _UNRELATED:
        yield from found
        yield from steps.two_parts(physics, cutoff)
        return
    yield Issue(
        "torque not explained", "error", "all torque channels",
        f"No inertia and friction of this arm explain {100.0 * first:.0f} % of the torque energy.",
        "certain: none of the tried signs, orders, units, zeros, delays and directions of gravity helps",
        "check that this is the right robot, that the columns are joint torques, and that positions "
        "and torques come from the same recording", None,
        {"unexplained_percent": 100.0 * first, "at_best_percent": 100.0 * left},
    )  # fmt: skip


def unexplained(physics: Physics, joints: NDArray[np.bool_]) -> float:
    """Mean share of these joints' energy that one arm leaves over."""
    return float(np.mean(physics.evidence.shares[joints])) if joints.any() else 0.0


def best_hypothesis(physics: Physics, moving: NDArray[np.bool_]) -> Hypothesis | None:
    """The simplest of the hypotheses that explain the torque best, or None where none does."""
    reversed_ = signs.time_reversed(physics, moving)
    if reversed_ is not None:
        return reversed_
    few = physics.part(few_rows(physics))
    found = _worth_a_look(few, moving, _FAMILIES)
    if not found and unexplained(few, moving) > 0.05:
        found = _worth_a_look(few, moving, _LAST)
    # On all rows, the most promising ones only.
    found = sorted(found, key=lambda f: -f[0])
    judged = [(h.gain(physics), h) for _, h in _promising(found)]
    best = max((gain for gain, _ in judged), default=0.0)
    near = [(g, h) for g, h in judged if g >= best - max(ABOUT_SAME[0], ABOUT_SAME[1] * best)]
    # What is known from elsewhere (simplicity 0) need not explain more than everything else does.
    known = [(g, h) for g, h in judged if not h.simplicity and g >= h.needed_for(physics)]
    for gain, hypothesis in known + sorted(near, key=lambda f: f[1].simplicity):
        if gain < hypothesis.needed_for(physics):
            continue
        if hypothesis.pays(physics, gain) and hypothesis.determined(physics):
            return hypothesis
    numbers = [(gain, h) for gain, h in judged if h.number is not None and gain > h.number.least]
    for gain, hypothesis in sorted(numbers, key=lambda f: -f[0]):
        if hypothesis.pays(physics, gain) and hypothesis.determined(physics):
            return replace(hypothesis, issue=replace(hypothesis.issue, severity="warning"))
    return signs.weak_signs(physics) or gravity.hanging(physics)


def _promising(found: list[tuple[float, Hypothesis]]) -> list[tuple[float, Hypothesis]]:
    """The best six, the best number, and what is known from elsewhere; ``found`` the best first."""
    number = next((f for f in found if f[1].number is not None), None)
    return found[:6] + [f for f in found[6:] if not f[1].simplicity or f is number]


def _worth_a_look(
    few: Physics, moving: NDArray[np.bool_], families: tuple[motion.Family, ...]
) -> list[tuple[float, Hypothesis]]:
    found = []
    for family in families:
        made = list(family(few, moving))
        for k in range(0, len(made), _AT_ONCE):
            some = made[k : k + _AT_ONCE]
            after = settled(h.apply(h.where(few)) for h in some)
            for hypothesis, evidence in zip(some, after, strict=True):
                gain = hypothesis.where(few).evidence.score - evidence.score
                number, least = hypothesis.number, 0.6 * min(hypothesis.needed, GROSS)
                least = least if number is None else min(least, number.least)
                if gain > least:
                    found.append((gain, hypothesis))
    return found
