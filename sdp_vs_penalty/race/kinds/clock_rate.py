"""A clock at another rate, or rows in reverse order: inertia beside the weight tells the
rate, friction the direction."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from sdp_vs_penalty.race.chain import LogTransform
from sdp_vs_penalty.race.evidence import Evidence, ViewFit
from sdp_vs_penalty.race.fault import Fault, prior_of_one_of
from sdp_vs_penalty.race.likelihood import Likelihood
from sdp_vs_penalty.race.records import Hypothesis, at_sizes, factor_of

#: Rates that are tried: true time over the file's [-].
_RATES = (1.0, 0.5, 0.75, 1.4, 2.0)
_RATE = factor_of("rate", ())


def propose(evidence: Evidence, fit: ViewFit) -> Iterator[Hypothesis]:
    """Yield rows in reverse order, and the clock at other rates; both are rarer than other
    faults.

    Rates are proposed only under gravity: without weight a scale of time is the same as a
    scale of all torques.
    """
    current = fit.transform
    prior = 2.0 * prior_of_one_of(1)
    yield Hypothesis(
        kind="time reversed",
        joints=(),
        log_prior=prior,
        transform=replace(current, reversed=not current.reversed),
        tells_by_friction=not any(evidence.log.data.velocity_signs),
    )
    if not any(current.gravity):
        return
    yield from at_sizes("clock rate", prior, current, _RATE, np.log(_RATES))


def list_faults(log: Likelihood, transform: LogTransform) -> Iterator[Fault]:
    """Yield rows in reverse order, and a clock that runs too fast or too slow."""
    if transform.reversed:
        yield Fault(
            kind="time reversed",
            in_doubt="time reversed",
            joints=(),
            what="the rows are in reverse order: friction would drive the motion.",
            remedy="reverse q and tau in time",
            without=transform.with_defaults("reversed"),
            place="all rows",
            repaired_by=("reverse", "t"),
        )
    rate = transform.rate
    if rate != 1.0:
        yield Fault(
            kind="clock rate",
            in_doubt="clock rate",
            joints=(),
            what=f"{stamps_text(rate)}: inertia does not fit the weight.",
            remedy=f"multiply t by {rate:.3g} (find out the log's true rate)",
            without=replace(transform, rate=1.0),
            number=_RATE,
            in_words=lambda x: f"a factor of {np.exp(x):.3g}",
            place="column t",
            repaired_by=("clock", "t"),
        )


def stamps_text(rate: float) -> str:
    """Say how wrong time stamps are that ``rate``, true time over the file's, repairs."""
    where = "far apart" if rate < 1.0 else "close together"
    return f"the time stamps are {max(rate, 1.0 / rate):.3g} times too {where}"
