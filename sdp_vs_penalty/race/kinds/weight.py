"""The arm's weight taken out of one channel, or of all, by the controller."""

from collections.abc import Iterator

from sdp_vs_penalty.race import constants as c
from sdp_vs_penalty.race.chain import LogTransform
from sdp_vs_penalty.race.evidence import Evidence, ViewFit
from sdp_vs_penalty.race.fault import Fault, joints_text, percent_text, prior_of_one_of
from sdp_vs_penalty.race.likelihood import Likelihood
from sdp_vs_penalty.race.records import Hypothesis, Number, at_sizes


def _number(joints: tuple[int, ...]) -> Number:
    """Return the share of the weight that some joints' torques lack."""
    return Number(
        "missing_weight", joints, sd=1.0, usual=c.CALIBRATED_GAIN, round_sizes=(1.0,)
    )


def propose(evidence: Evidence, fit: ViewFit) -> Iterator[Hypothesis]:
    """Yield missing weight: all of it or 80 % from all torques, and all of it from each
    revolute joint's torque.

    80 % is tried because a little weight beside much inertia looks like another clock rate.
    """
    log, current = evidence.log, fit.transform
    if not any(current.gravity):
        return
    kind, number = "gravity removed", _number(tuple(range(log.n)))
    yield from at_sizes(kind, prior_of_one_of(1), current, number, (1.0, 0.8))
    if log.n == 1:
        return  # the only joint is all joints
    prior = prior_of_one_of(log.n)
    for j in log.revolute:
        yield from at_sizes(kind, prior, current, _number((j,)), (1.0,))


def list_faults(log: Likelihood, transform: LogTransform) -> Iterator[Fault]:
    """Yield a fault for the torques from which weight is missing."""
    for joints, share in transform.list_nonzero("missing_weight"):
        torques = f"the torque of {joints_text(joints)}"
        remedy = "log the torques before gravity compensation"
        if len(joints) == log.n:
            torques = "the torques"
            vector = ", ".join(f"{g:g}" for g in transform.gravity_left)
            remedy = f"{remedy}, or set gravity to ({vector}) m/s^2"
        yield Fault(
            kind="gravity removed",
            in_doubt="gravity removed",
            joints=joints,
            what=f"{percent_text(share)} of the weight is missing from {torques}.",
            remedy=remedy,
            without=transform.with_entries("missing_weight", joints, 0.0),
            number=_number(joints),
            in_words=percent_text,
            gravity=transform.gravity_left,
        )
