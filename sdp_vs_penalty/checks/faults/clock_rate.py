"""A clock at another rate, or rows in reverse order."""

from collections.abc import Iterator
from dataclasses import replace

from sdp_vs_penalty.checks import constants as c
from sdp_vs_penalty.checks.arm_fit import ArmFit
from sdp_vs_penalty.checks.faults.fault import Fault, FaultSize, Transformation
from sdp_vs_penalty.checks.likelihood import Likelihood
from sdp_vs_penalty.checks.repair import LogTransform

#: True time over the file's that is tried; the ends are round.
_RATES = (0.5, 0.75, 1.4, 2.0)


class Clock(Transformation):
    """A clock at another rate, or rows in reverse order: inertia beside the weight
    tells the rate, friction the direction."""

    name = "clock_rate"

    def proposals(
        self,
        log: Likelihood,
        now: LogTransform,
        score: ArmFit,
    ) -> Iterator[LogTransform]:
        """Propose repairs that correct one more fault of this kind than ``now`` does."""
        yield replace(now, reversed=not now.reversed)
        for factor in _RATES if any(now.gravity) else ():
            yield replace(now, rate=now.rate * factor)

    def elements(self, log: Likelihood, repair: LogTransform) -> Iterator[Fault]:
        """Yield the faults of this kind that a repair corrects."""
        if repair.reversed:
            what = "the rows are in reverse order: friction would drive the motion."
            remedy = "reverse q and tau in time"
            without = repair.reset("reversed")
            yield Fault(
                "time reversed",
                "warning",
                (),
                what,
                remedy,
                without,
                2.0 * c.ODDS,
                place="all rows",
            )
        if (x := repair.rate) != 1.0:
            word = "fast" if x < 1.0 else "slow"
            what = (
                f"time runs {max(x, 1.0 / x):.3g} times too {word}: inertia does not"
                " fit the weight."
            )
            remedy = f"multiply t by {x:.3g} (find out the log's true rate)"
            number = FaultSize.factor(
                x,
                repair.with_rate,
                (min(_RATES), max(_RATES)),
            )
            yield Fault(
                "clock rate",
                "warning",
                (),
                what,
                remedy,
                number,
                place="column t",
            )
