"""Torque channels that are too large or too small beside the others. A factor that all
channels have in common is not seen here: links of other masses fit it as well."""

from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import numpy as np

from sdp_vs_penalty.race.chain import LogTransform
from sdp_vs_penalty.race.evidence import Evidence, ViewFit
from sdp_vs_penalty.race.fault import (
    UNITS,
    Fault,
    joints_text,
    prior_of_one_of,
    times_text,
)
from sdp_vs_penalty.race.likelihood import Likelihood
from sdp_vs_penalty.race.records import Hypothesis, Number, at_sizes, factor_of

#: Factors that are tried beside those near one: units, and a grid whose steps the
#: refinement bridges.
_GAINS = (*UNITS, 0.1, 0.3, 3.0, 100.0, 1e3)
#: Factors that count as round values.
_DECIMALS = (1e-3, 1e-2, 0.1)
#: Standard deviation beforehand (natural logarithm) of a drive's gain, and of a unit.
_SD, _SD_OF_UNITS = 0.5, 2.0


def _number(joints: tuple[int, ...], sd: float = _SD) -> Number:
    """Return the factor of some joints' torques."""
    return replace(
        factor_of("gain", joints),
        sd=sd,
        round_sizes=tuple(np.log(_DECIMALS).tolist()),
        limits=(-7.5, 7.5),
    )


#: Hypotheses about a factor of torques, one for each size.
_of_sizes = partial(at_sizes, "torque gain", may_begin_in_run=True)


def propose(evidence: Evidence, fit: ViewFit) -> Iterator[Hypothesis]:
    """Yield a factor of each joint's torque, near one and of a unit."""
    log, current = evidence.log, fit.transform
    if log.n == 1:
        return  # a factor of all torques is not seen
    prior = prior_of_one_of(log.n)
    for j in log.joints:
        yield from _of_sizes(prior, current, _number((j,)))
        unit, factors = _number((j,), _SD_OF_UNITS), np.log(_GAINS)
        yield from _of_sizes(prior - np.log(2.0), current, unit, factors)


def of_all_torques(current: LogTransform) -> Iterator[Hypothesis]:
    """Yield hypotheses about one factor of all torques, near one and of a unit. It shows in
    a part of the rows only, by comparison with the others."""
    number = _number(tuple(range(current.n)), _SD_OF_UNITS)
    sizes = np.log([1.0, 1e-3, 1e3])
    return _of_sizes(prior_of_one_of(1), current, number, sizes)


def list_faults(log: Likelihood, transform: LogTransform) -> Iterator[Fault]:
    """Yield a fault for each joint whose torque the transform scales; a wrong sign is
    another fault."""
    for j in np.flatnonzero(np.abs(transform.gain) != 1.0).tolist():
        factor = abs(transform.gain[j])
        yield Fault(
            kind="torque gain",
            joints=(j,),
            what=f"the torque of {joints_text([j])} is {times_text(factor)} beside those of"
            " its neighbours.",
            remedy=f"multiply tau{j + 1} by {factor:.3g}",
            without=_number((j,)).at(transform, 0.0),
            number=_number((j,)),
            in_words=lambda log_factor: times_text(float(np.exp(log_factor))),
            sort_key=abs,
            repaired_by=("gain", "tau"),
            figures={"factor": factor},
        )
