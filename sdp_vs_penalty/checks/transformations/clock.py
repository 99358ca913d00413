"""A clock at another rate, or rows in reverse order."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from sdp_vs_penalty.checks.likelihood import Score
from sdp_vs_penalty.checks.repair import Repair
from sdp_vs_penalty.checks.transformations.transformation import (
    ODD_NUMBER,
    ODDS,
    Element,
    Number,
    Scene,
    Transformation,
)

#: True time over the file's that is tried, and nearer to 1 none is named (natural logarithm): the weight
#: tells inertia's size to so much where friction is as large.
_RATES, _KNOWN = (0.3, 0.5, 0.7, 0.85, 1.2, 1.5, 2.0, 3.3), 0.07


#: Rates that come first; and how much rarer others are with each e-th part (natural logarithm): a
#: controller that takes nine tenths of the weight out looks like a clock that is 3.2 times too slow.
_ROUND, _FAR = (0.5, 2.0), 2.0


class Clock(Transformation):
    """Inertia beside the weight tells the rate, friction the direction."""

    def proposals(self, scene: Scene, now: Repair, score: Score) -> Iterator[Repair]:
        yield replace(now, reversed=not now.reversed)
        if any(now.gravity):
            for factor in _RATES:
                yield replace(now, rate=now.rate * factor)

    def elements(self, scene: Scene, repair: Repair) -> Iterator[Element]:
        if repair.reversed:
            yield Element(
                "time reversed", "error", (), "all rows",
                "the rows are in reverse order: friction would drive the motion.",
                "reverse q and tau in time", replace(repair, reversed=False), ODDS,
            )  # fmt: skip
        if repair.rate != 1.0:
            factor = repair.rate
            word = "fast" if factor < 1.0 else "slow"
            yield Element(
                "clock rate", "error", (), "column t",
                f"time runs {max(factor, 1.0 / factor):.3g} times too {word}: the inertia in the "
                "torques does not fit the weight.",
                f"multiply t by {factor:.3g} (find out the log's true rate)",
                replace(repair, rate=1.0),
                ODDS + (0.0 if min(abs(factor - x) for x in _ROUND) < 1e-9 else ODD_NUMBER) + _FAR *
                abs(float(np.log(factor))), number=Number(
                    float(np.log(factor)), lambda v: replace(repair, rate=float(np.exp(v))),
                    _KNOWN, 0.4, lambda v: f"a factor of {np.exp(v):.3g}",
                    tuple(float(np.log(x)) for x in _ROUND),
                ),
                figures={"factor": factor},
            )  # fmt: skip
