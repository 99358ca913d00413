"""A clock at another rate, or rows in reverse order: inertia beside the weight tells the rate, friction
the direction."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from sdp_vs_penalty.checks.constants import ODD_NUMBER, ODDS
from sdp_vs_penalty.checks.likelihood import Score
from sdp_vs_penalty.checks.repair import Repair
from sdp_vs_penalty.checks.transformation import Element, Number, Scene, Transformation

#: True time over the file's that is tried; those of doubled and halved rates come first.
_RATES, _ROUND = (0.5, 0.75, 1.4, 2.0), (0.5, 2.0)
#: Nearer to 1 (natural logarithm) none is named: the weight tells inertia's size to so much.
_KNOWN = 0.07


class Clock(Transformation):
    def proposals(self, scene: Scene, now: Repair, score: Score) -> Iterator[Repair]:
        yield replace(now, reversed=not now.reversed)
        for factor in _RATES if any(now.gravity) else ():
            yield replace(now, rate=now.rate * factor)

    def elements(self, scene: Scene, repair: Repair) -> Iterator[Element]:
        if repair.reversed:
            what = "the rows are in reverse order: friction would drive the motion."
            forward = replace(repair, reversed=False)
            yield Element(
                "time reversed", "error", (), what, "reverse q and tau in time", forward, ODDS,
                place="all rows",
            )  # fmt: skip
        if (factor := repair.rate) == 1.0:
            return
        word = "fast" if factor < 1.0 else "slow"
        odd = 0.0 if min(abs(factor - x) for x in _ROUND) < 1e-9 else ODD_NUMBER
        yield Element(
            "clock rate", "error", (),
            f"time runs {max(factor, 1.0 / factor):.3g} times too {word}: the inertia in the "
            "torques does not fit the weight.",
            f"multiply t by {factor:.3g} (find out the log's true rate)",
            replace(repair, rate=1.0), ODDS + odd,
            Number.factor(factor, lambda x: replace(repair, rate=x), _KNOWN, 0.4, _ROUND),
            place="column t", figures={"factor": factor},
        )  # fmt: skip
