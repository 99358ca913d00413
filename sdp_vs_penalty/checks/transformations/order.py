"""Channels of other joints: positions, torques, or both exchanged."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations

import numpy as np

from sdp_vs_penalty.checks.issue import joints_text
from sdp_vs_penalty.checks.likelihood import FLOOR, Score
from sdp_vs_penalty.checks.repair import Order, Repair
from sdp_vs_penalty.checks.transformations.transformation import (
    Element,
    Scene,
    Transformation,
    choices,
)


class Exchange(Transformation):
    """Pairs exchanged one by one, and the order of torques that fits joint by joint."""

    def proposals(self, scene: Scene, now: Repair, score: Score) -> Iterator[Repair]:
        poor = scene.poor(score)
        for a, b in combinations(scene.joints, 2):
            yield now.with_swap(a, b, positions=False, torques=True)
            if poor[a] or poor[b]:
                yield now.with_swap(a, b, positions=True, torques=False)
                yield now.with_swap(a, b, positions=True, torques=True)
        if poor.any() and scene.n > 2:
            yield replace(now, tau_order=_given_out(scene, now, score))

    def elements(self, scene: Scene, repair: Repair) -> Iterator[Element]:
        count, none = scene.n * (scene.n - 1) // 2, tuple(range(scene.n))
        p, s = repair.order, repair.tau_order
        if p == s and p != none:
            yield self._element(
                scene, p, "joint order", "positions and torques alike", "q, dq and tau", count,
                replace(repair, order=none, tau_order=none),
            )  # fmt: skip
            return
        for kind, word, names, order, without in (
            ("position order", "the positions of ", "q and dq", p, replace(repair, order=none)),
            ("torque order", "the torques of ", "tau", s, replace(repair, tau_order=none)),
        ):
            if order != none:
                yield self._element(scene, order, kind, word, names, count, without)

    def _element(
        self, scene: Scene, order: Order, kind: str, word: str, names: str, count: int, without: Repair
    ) -> Element:
        changed = tuple(j for j, k in enumerate(order) if j != k)
        joints = joints_text(changed)
        both = kind == "joint order"
        if len(changed) == 2:
            what = f"{joints} are swapped, {word}." if both else f"{word}{joints} are swapped."
        else:
            named = ", ".join(f"column {order[j] + 1} is joint {j + 1}'s" for j in changed)
            what = (
                f"{'the channels' if both else word.removesuffix(' of ')} are in another order: {named}."
            )
        return Element(
            kind, "error", changed, joints, what, f"rename the columns of {names}", without,
            (len(changed) - 1) * choices(count),
            figures={"order": [k + 1 for k in order], "joints": [j + 1 for j in changed]},
        )  # fmt: skip


def _given_out(scene: Scene, now: Repair, score: Score) -> Order:
    """The order of torque channels in which each joint by itself explains its own best."""
    from scipy.optimize import linear_sum_assignment

    costs = np.zeros((scene.n, scene.n))
    for j, x in enumerate(score.joints):
        columns, _ = np.linalg.qr(np.hstack([x.basis, x.columns]))
        y = score.channels
        left = np.sum(y**2, axis=0) - np.sum((columns.T @ y) ** 2, axis=0)
        costs[j] = np.log(np.maximum(left / score.whole, FLOOR))
    _, chosen = linear_sum_assignment(costs)
    return tuple(now.tau_order[k] for k in chosen)
