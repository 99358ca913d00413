"""Torques that are logged later than the motion, or behind a causal filter: one channel, or
all. No cause makes a single channel earlier than the others: what looks like that is a law
of its joint."""

from collections.abc import Iterator

import numpy as np

from sdp_vs_penalty.race import constants as c
from sdp_vs_penalty.race.chain import LogTransform
from sdp_vs_penalty.race.evidence import Evidence, ViewFit
from sdp_vs_penalty.race.fault import Fault, prior_of_one_of
from sdp_vs_penalty.race.likelihood import Likelihood
from sdp_vs_penalty.race.records import Hypothesis, Number, at_sizes

#: Times that the race begins from [s], by field of a transform: by how much a torque is
#: later than the motion (``lead``), and time constants of a causal low-pass (``lag``).
_TIMES_TRIED = {
    "lead": (0.0, -0.12, -0.06, -0.025, 0.025, 0.06, 0.12),
    "lag": (0.0, 0.04, 0.1, 0.2),
}
#: Kind of the fault of all torques, and of one torque, by field of a transform.
_KIND_OF_ALL_AND_OF_ONE = {
    "lead": ("delay", "channel delay"),
    "lag": ("torque filter", "channel filter"),
}
#: Prior standard deviation of a time [s].
_PRIOR_SD = 0.05


def _time_number(field: str, joints: tuple[int, ...]) -> Number:
    """Describe the size that is estimated: delay or time constant [s] of some joints'
    torques. Only a delay of several joints may be negative."""
    may_be_negative = field == "lead" and len(joints) > 1
    return Number(
        field,
        joints,
        sd=_PRIOR_SD,
        usual=c.USUAL_DELAY,
        usual_below=c.USUAL_LEAD,
        step=1e-3,
        limits=(-1.0 if may_be_negative else 0.0, 1.0),
    )


def propose(evidence: Evidence, fit: ViewFit) -> Iterator[Hypothesis]:
    """Yield a delay or a low-pass of all torques, and of each joint's torque."""
    log, transform = evidence.log, fit.transform
    all_joints = tuple(range(log.n))
    for field, times in _TIMES_TRIED.items():
        kind_of_all, kind_of_one = _KIND_OF_ALL_AND_OF_ONE[field]
        number = _time_number(field, all_joints)
        yield from at_sizes(kind_of_all, prior_of_one_of(1), transform, number, times)
        if len(log.joints) == 1:
            continue  # its torque is all torques
        # A single channel is never earlier than the others (see the module).
        times_of_one = [time for time in times if time >= 0.0]
        prior = prior_of_one_of(log.n)
        for j in log.joints:
            number = _time_number(field, (j,))
            yield from at_sizes(kind_of_one, prior, transform, number, times_of_one)


def list_faults(log: Likelihood, transform: LogTransform) -> Iterator[Fault]:
    """Yield a fault for each delay and each low-pass of torques."""
    for field, (kind_of_all, kind_of_one) in _KIND_OF_ALL_AND_OF_ONE.items():
        for joints, seconds in transform.list_nonzero(field):
            is_all = len(joints) == log.n
            if is_all:
                channel, others = "the torques", "the positions"
                comes = "the torques come"
            else:
                channel, others = f"tau{joints[0] + 1}", "the other torques"
                comes = f"joint {joints[0] + 1}'s torque comes"
            if field == "lead":
                time = _milliseconds(abs(seconds))
                is_late = seconds > 0.0
                when, shift = ("late", "earlier") if is_late else ("early", "later")
                what = f"{comes} {time} {when}; {others} are in time."
                remedy = (
                    f"shift {channel} {time} {shift} (and log all channels from one"
                    " source)"
                )
            else:
                hertz = 1.0 / (2.0 * np.pi * max(seconds, 1e-6))  # corner frequency
                low_pass = f"{hertz:.2g} Hz ({_milliseconds(seconds)})"
                what = f"a causal low-pass of {low_pass} on {channel}; {others} have not one."
                remedy = (
                    f"log {channel} unfiltered, or filter every channel alike and without"
                    " lag"
                )
            yield Fault(
                kind=kind_of_all if is_all else kind_of_one,
                joints=joints,
                what=what,
                remedy=remedy,
                without=transform.with_entries(field, joints, 0.0),
                number=_time_number(field, joints),
                in_words=_milliseconds,
                # A single joint is named by the issue itself.
                place="all torque channels" if is_all and log.n > 1 else "",
                repaired_by=("delay", "tau") if field == "lead" else None,
            )


def _milliseconds(seconds: float) -> str:
    """Return a time [s] in words: "25 ms"."""
    return f"{1e3 * seconds:.0f} ms"
