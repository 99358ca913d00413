"""A channel that bends towards a limit: tau_log = s tanh(tau / s), an amplifier near its
end."""

from collections.abc import Iterator

import numpy as np

from sdp_vs_penalty.race.chain import LogTransform
from sdp_vs_penalty.race.evidence import Evidence, ViewFit
from sdp_vs_penalty.race.fault import Fault, joints_text, percent_text, prior_of_one_of
from sdp_vs_penalty.race.likelihood import Likelihood
from sdp_vs_penalty.race.records import Hypothesis, Number, at_sizes

#: Below this bend, the largest logged torque over the limit, a channel is as straight
#: as sensors are.
_STRAIGHT = 0.2
#: Bends from which a size is sought.
_BENDS = 0.9, 0.98
#: Largest bend: at 1 the torque behind the limit would be infinite.
_SHARPEST = 0.995


def _number(j: int) -> Number:
    """Describe the size that is estimated: the bend of joint j's channel."""
    limits = (0.0, _SHARPEST)
    return Number("bend", (j,), sd=0.5, usual=_STRAIGHT, step=4e-3, limits=limits)


def propose(evidence: Evidence, fit: ViewFit) -> Iterator[Hypothesis]:
    """Yield for each joint that its amplifier bends the torque near its limit."""
    for j in evidence.log.joints:
        prior = prior_of_one_of(evidence.log.n)
        yield from at_sizes("saturation", prior, fit.transform, _number(j), _BENDS)


def list_faults(log: Likelihood, transform: LogTransform) -> Iterator[Fault]:
    """Yield a fault for each joint whose torque the transform straightens, with the limit
    of its amplifier."""
    for j in np.flatnonzero(transform.bend).tolist():
        largest_logged = log.data.largest[transform.tau_order[j]]
        # A bend is the largest logged torque over the limit. The gain brings the limit
        # from the unit of the log to that of the joint's torque.
        limit = abs(transform.gain[j]) * largest_logged / transform.bend[j]
        unit = log.torque_unit(j)
        yield Fault(
            kind="saturation",
            joints=(j,),
            what=f"the torque of {joints_text([j])} bends towards its amplifier's limit"
            f" of {limit:.3g} {unit}.",
            remedy="record again with a larger range, or slower",
            without=transform.with_entries("bend", (j,), 0.0),
            number=_number(j),
            in_words=lambda value: f"{percent_text(value)} of the limit is reached",
        )
