"""Channels of other joints."""

from collections.abc import Iterator
from itertools import combinations

from sdp_vs_penalty.checks.arm_fit import ArmFit
from sdp_vs_penalty.checks.faults.fault import Fault, Transformation, choices
from sdp_vs_penalty.checks.issue import joints_text
from sdp_vs_penalty.checks.likelihood import Likelihood
from sdp_vs_penalty.checks.repair import LogTransform


class Exchange(Transformation):
    """Channels of other joints: positions, torques, or both exchanged."""

    name = "order"

    def proposals(
        self, log: Likelihood, now: LogTransform, score: ArmFit
    ) -> Iterator[LogTransform]:
        for a, b in combinations(log.joints, 2):
            yield now.with_swap(a, b, "tau_order")
            if score.poor[a] or score.poor[b]:
                yield now.with_swap(a, b, "order")
                yield now.with_swap(a, b, "order", "tau_order")

    def elements(self, log: Likelihood, repair: LogTransform) -> Iterator[Fault]:
        told: list[tuple[str, str, str, tuple[str, ...]]] = [
            ("position order", "the positions", "q and dq", ("order",)),
            ("torque order", "the torques", "tau", ("tau_order",)),
        ]
        if repair.order == repair.tau_order:
            told = [
                (
                    "joint order",
                    "positions and torques",
                    "q, dq and tau",
                    ("order", "tau_order"),
                )
            ]
        for kind, word, columns, names in told:
            order = getattr(repair, names[0])
            if changed := tuple(j for j, k in enumerate(order) if j != k):
                how = ", ".join(
                    f"column {order[j] + 1} is joint {j + 1}'s" for j in changed
                )
                how = "" if len(changed) == 2 else f": {how}"
                what = f"{word} of {joints_text(changed)} are swapped{how}."
                cost = (len(changed) - 1) * choices(log.n * (log.n - 1) // 2)
                remedy = f"rename the columns of {columns}"
                yield Fault(
                    kind, "warning", changed, what, remedy, repair.reset(*names), cost
                )
