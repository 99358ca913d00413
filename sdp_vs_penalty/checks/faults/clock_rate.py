"""A clock at another rate, or rows in reverse order."""

from collections.abc import Iterator
from dataclasses import replace

from sdp_vs_penalty.checks import constants as c
from sdp_vs_penalty.checks.arm_fit import ArmFit
from sdp_vs_penalty.checks.faults.fault import Fault, FaultSize, Transformation
from sdp_vs_penalty.checks.likelihood import Likelihood
from sdp_vs_penalty.checks.repair import LogTransform

#: Rates that are tried: true time over the file's [-]. The first and the last, a factor
#: of two, count as round values.
_RATES = (0.5, 0.75, 1.4, 2.0)


class Clock(Transformation):
    """A clock at another rate, or rows in reverse order: inertia beside the weight
    tells the rate, friction the direction."""

    name = "clock_rate"

    def propose(
        self, log: Likelihood, now: LogTransform, fit: ArmFit
    ) -> Iterator[LogTransform]:
        """Yield the repair ``now`` with time reversed, and with the clock at other
        rates.

        Rates are tried only under gravity: inertia compared with weight shows the rate.

        Parameters
        ----------
        log : Likelihood
            Rows that repairs are judged on.
        fit : ArmFit
            The arm fitted to the rows under ``now``.

        Returns
        -------
        iterator of LogTransform
            Repairs to fit arms to, with all corrections of ``now``.
        """
        yield replace(now, reversed=not now.reversed)
        if not any(now.gravity):
            return  # without weight a time scale is a scale of all torques
        for factor in _RATES:
            yield replace(now, rate=now.rate * factor)

    def list_faults(self, log: Likelihood, repair: LogTransform) -> Iterator[Fault]:
        """Yield the faults that a repair's clock corrects: rows in reverse order, and a
        clock that runs too fast or too slow; nothing where the repair leaves the clock
        as it is.

        Parameters
        ----------
        log : Likelihood
            Rows that repairs are judged on.
        repair : LogTransform
            A complete repair, with faults of any kinds.

        Returns
        -------
        iterator of Fault
            With the words for the user.
        """
        if repair.reversed:
            what = "the rows are in reverse order: friction would drive the motion."
            remedy = "reverse q and tau in time"
            log_odds = 2.0 * c.LOG_ODDS_AGAINST_FAULT  # rarer than other faults
            yield Fault(
                kind="time reversed",
                severity="warning",
                joints=(),
                what=what,
                remedy=remedy,
                removal=repair.with_defaults("reversed"),
                log_odds_against=log_odds,
                place="all rows",
            )
        rate = repair.rate
        if rate != 1.0:
            word = "fast" if rate < 1.0 else "slow"
            factor = max(rate, 1.0 / rate)
            what = (
                f"time runs {factor:.3g} times too {word}: inertia does not fit the"
                " weight."
            )
            remedy = f"multiply t by {rate:.3g} (find out the log's true rate)"
            round_rates = (min(_RATES), max(_RATES))
            yield Fault(
                kind="clock rate",
                severity="warning",
                joints=(),
                what=what,
                remedy=remedy,
                removal=FaultSize.of_factor(rate, repair.with_rate, round_rates),
                place="column t",
            )
