"""Channels of other joints: positions, torques, or both exchanged."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations

from sdp_vs_penalty.checks.issue import joints_text
from sdp_vs_penalty.checks.likelihood import Score
from sdp_vs_penalty.checks.repair import Repair
from sdp_vs_penalty.checks.transformation import Element, Scene, Transformation, choices


class Exchange(Transformation):
    def proposals(self, scene: Scene, now: Repair, score: Score) -> Iterator[Repair]:
        poor = scene.poor(score)
        for a, b in combinations(scene.joints, 2):
            yield now.with_swap(a, b, positions=False, torques=True)
            if poor[a] or poor[b]:
                yield now.with_swap(a, b, positions=True, torques=False)
                yield now.with_swap(a, b, positions=True, torques=True)

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
