"""A command that the drive did not reach, logged in the place of the torque."""

from collections.abc import Iterator

import numpy as np

from sdp_vs_penalty.race.chain import LogTransform
from sdp_vs_penalty.race.evidence import Evidence, ViewFit
from sdp_vs_penalty.race.fault import Fault, prior_of_one_of
from sdp_vs_penalty.race.likelihood import Likelihood
from sdp_vs_penalty.race.records import Hypothesis

#: A torque above this many times its drive's limit is beyond it [-]: drives exceed their
#: limits by less.
_ABOVE_LIMIT = 1.05
#: A torque above this many times the limit has another unit (N cm are 100 times N m) [-].
_OTHER_UNIT = 30.0


def propose(evidence: Evidence, fit: ViewFit) -> Iterator[Hypothesis]:
    """Yield the effort limit of each joint whose torque lies beyond it; nothing if the
    torques of most joints do: they have another unit."""
    log, current = evidence.log, fit.transform
    largest = np.abs(log.torques(current)).max(axis=1)  # (n,)
    limits = np.array([joint.effort or np.inf for joint in log.problem.robot.joints])
    n_beyond = np.count_nonzero(largest > _ABOVE_LIMIT * limits)
    if log.n > 1 and 2 * n_beyond > log.n:
        return
    for j in log.joints:
        limit = float(limits[j])
        if _ABOVE_LIMIT * limit < largest[j] < _OTHER_UNIT * limit:
            transform = current.with_entries("limit", (j,), limit)
            prior = prior_of_one_of(log.n)
            yield Hypothesis("command beyond the limit", (j,), prior, transform)


def list_faults(log: Likelihood, transform: LogTransform) -> Iterator[Fault]:
    """Yield a fault for each joint whose commands the transform replaces by its limit."""
    for j in np.flatnonzero(transform.limit).tolist():
        factor = abs(transform.torque_factors[j])
        largest = factor * log.data.largest[transform.tau_order[j]]
        unit = log.torque_unit(j)
        yield Fault(
            kind="command beyond the limit",
            joints=(j,),
            what=f"tau{j + 1} reaches {largest:.3g} {unit} at a limit of"
            f" {transform.limit[j]:.3g}: a command that the drive did not reach.",
            remedy="log the measured torque, or put the limit in the command's place",
            without=transform.with_entries("limit", (j,), 0.0),
            place=f"tau{j + 1}",
            repaired_by=("limit", "tau"),
        )
