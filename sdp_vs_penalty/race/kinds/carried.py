"""A joint whose motor sits on the link before (a parallelogram, a belt): its logged angle is
q_j + q_{j-1} or q_j - q_{j-1}, and its torque acts on the joint before as well."""

from collections.abc import Iterator

import numpy as np

from sdp_vs_penalty.race.chain import LogTransform
from sdp_vs_penalty.race.evidence import Evidence, ViewFit
from sdp_vs_penalty.race.fault import Fault, prior_of_one_of
from sdp_vs_penalty.race.likelihood import Likelihood
from sdp_vs_penalty.race.records import Hypothesis


def propose(evidence: Evidence, fit: ViewFit) -> Iterator[Hypothesis]:
    """Yield for each pair of revolute neighbours that the second one's motor sits before
    the first, in either sense; nothing if the arm is well explained."""
    log, current = evidence.log, fit.transform
    if not fit.is_poorly_explained.any():
        return
    for j in log.revolute:
        if j - 1 in log.revolute:
            for turn in (1.0, -1.0):
                transform = current.with_entries(
                    "carried", (j,), current.carried[j] + turn
                )
                prior = prior_of_one_of(2 * log.n)
                yield Hypothesis("motor on the base", (j,), prior, transform)


def list_faults(log: Likelihood, transform: LogTransform) -> Iterator[Fault]:
    """Yield a fault for each joint whose motor turns with the joint before as well."""
    for j in np.flatnonzero(transform.carried).tolist():
        one, before = j + 1, j  # numbers from 1
        is_sum = transform.carried[j] > 0.0
        motors = [f"q{k + 1}" for k in range(log.n)]
        motors[j] = f"q{before}+q{one}" if is_sum else f"q{one}-q{before}"
        sign, back = ("+", "-") if is_sum else ("-", "+")
        yield Fault(
            kind="motor on the base",
            joints=(j,),
            what=f"the motor of joint {one} does not turn with joint {before} (a"
            f" parallelogram, a belt): q{one} of the log is {motors[j]} of the joints, and"
            f" tau{one} acts on joint {before} as well.",
            remedy=f"identify with --motors {','.join(motors)}, or replace q{one} by"
            f" q{one} {back} q{before} and tau{before} by tau{before} {sign} tau{one}",
            without=transform.with_entries("carried", (j,), 0.0),
            repaired_by=("motor", "joint"),
        )
