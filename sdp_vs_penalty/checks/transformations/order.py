"""Channels of other joints: positions, torques, or both exchanged."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations

import numpy as np

from sdp_vs_penalty.checks.constants import FLOOR
from sdp_vs_penalty.checks.issue import joints_text
from sdp_vs_penalty.checks.likelihood import Score
from sdp_vs_penalty.checks.repair import Order, Repair
from sdp_vs_penalty.checks.transformations.transformation import Element, Scene, Transformation, choices


class Exchange(Transformation):
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
        told = [
            ("position order", "the positions", "q and dq", p, replace(repair, order=none)),
            ("torque order", "the torques", "tau", s, replace(repair, tau_order=none)),
        ]
        if p == s:
            without = replace(repair, order=none, tau_order=none)
            told = [("joint order", "positions and torques", "q, dq and tau", p, without)]
        for kind, word, names, order, without in told:
            changed = tuple(j for j, k in enumerate(order) if j != k)
            how = ", ".join(f"column {order[j] + 1} is joint {j + 1}'s" for j in changed)
            what = f"{word} of {joints_text(changed)} are swapped" if changed else ""
            if changed:
                yield Element(
                    kind, "error", changed, f"{what}{'' if len(changed) == 2 else f': {how}'}.",
                    f"rename the columns of {names}", without, (len(changed) - 1) * choices(count),
                    figures={"order": [k + 1 for k in order]},
                )  # fmt: skip


def _given_out(scene: Scene, now: Repair, score: Score) -> Order:
    """The order of torque channels in which each joint by itself explains its own best."""
    costs, y = np.zeros((scene.n, scene.n)), score.channels.T
    for j in range(scene.n):
        columns, _ = np.linalg.qr(np.hstack([score.rows.basis[j], score.rows.columns[j]]))
        left = np.sum(y**2, axis=0) - np.sum((columns.T @ y) ** 2, axis=0)
        costs[j] = np.log(np.maximum(left / score.whole, FLOOR))
    chosen = costs.argmin(axis=1)  # the best order, where nobody's own best is another's as well
    if len(np.unique(chosen)) < scene.n:
        from scipy.optimize import linear_sum_assignment  # its import takes longer than the rest

        chosen = linear_sum_assignment(costs)[1]
    return tuple(now.tau_order[k] for k in chosen)
