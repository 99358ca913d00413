"""Torque later than the motion, or through a causal filter: one channel, or all. Nothing
brings one channel ahead of the others: what looks like that is a law of its joint."""

from collections.abc import Iterator

import numpy as np

from sdp_vs_penalty.race import constants as c
from sdp_vs_penalty.race.chain import LogTransform
from sdp_vs_penalty.race.evidence import Evidence, ViewFit
from sdp_vs_penalty.race.fault import Fault, prior_of_one_of
from sdp_vs_penalty.race.likelihood import Likelihood
from sdp_vs_penalty.race.records import Hypothesis, Number, at_sizes

#: Times that are tried [s], by entry of a transform: by how much a torque is later than
#: the motion (``lead``), and time constants of a causal low-pass (``lag``).
_TIMES_TRIED = {
    "lead": (0.0, -0.12, -0.06, -0.025, 0.025, 0.06, 0.12),
    "lag": (0.0, 0.04, 0.1, 0.2),
}
#: What each is called where all torques have it, and where one has.
_KINDS = {
    "lead": ("delay", "channel delay"),
    "lag": ("torque filter", "channel filter"),
}
#: Standard deviation of a time beforehand [s].
_SD = 0.05


def _number(field: str, joints: tuple[int, ...]) -> Number:
    """Describe the size that is estimated: delay or time constant [s] of some joints'
    torques. That of a single joint is not negative."""
    may_be_negative = field == "lead" and len(joints) > 1
    return Number(
        field,
        joints,
        sd=_SD,
        usual=c.USUAL_DELAY,
        usual_below=c.USUAL_LEAD,
        step=1e-3,
        limits=(-1.0 if may_be_negative else 0.0, 1.0),
    )


def propose(evidence: Evidence, fit: ViewFit) -> Iterator[Hypothesis]:
    """Yield a delay or a low-pass of all torques, and of each joint's torque."""
    log, now = evidence.log, fit.chain
    every = tuple(range(log.n))
    for field, times in _TIMES_TRIED.items():
        of_all, of_one = _KINDS[field]
        yield from at_sizes(
            of_all, prior_of_one_of(1), now, _number(field, every), times
        )
        late = [time for time in times if time >= 0.0]
        for j in log.joints if len(log.joints) > 1 else ():
            number = _number(field, (j,))
            yield from at_sizes(of_one, prior_of_one_of(log.n), now, number, late)


def list_faults(log: Likelihood, chain: LogTransform) -> Iterator[Fault]:
    """Yield a fault for each delay and each low-pass of torques."""
    for field, kinds in _KINDS.items():
        for joints, seconds in chain.list_nonzero(field):
            is_all = len(joints) == log.n
            channel = "the torques" if is_all else f"tau{joints[0] + 1}"
            others = "the positions" if is_all else "the other torques"
            if field == "lead":
                when, back = (
                    ("late", "earlier") if seconds > 0.0 else ("early", "later")
                )
                time = _milliseconds(abs(seconds))
                comes = f"joint {joints[0] + 1}'s torque comes"
                comes = "the torques come" if is_all else comes
                what = f"{comes} {time} {when}; {others} are in time."
                shift = f"shift {channel} {time} {back}"
                remedy = f"{shift} (and log all channels from one source)"
            else:
                hertz = 1.0 / (2.0 * np.pi * max(seconds, 1e-6))  # corner frequency
                low_pass = f"{hertz:.2g} Hz ({_milliseconds(seconds)})"
                what = f"a causal low-pass of {low_pass} on {channel}; {others} have not one."
                remedy = (
                    f"log {channel} unfiltered, or filter every channel alike and without"
                    " lag"
                )
            yield Fault(
                kind=kinds[0] if is_all else kinds[1],
                joints=joints,
                what=what,
                remedy=remedy,
                without=chain.with_entries(field, joints, 0.0),
                number=_number(field, joints),
                in_words=_milliseconds,
                # A single joint is named by the issue itself.
                place="all torque channels" if is_all and log.n > 1 else "",
                is_repairable=field == "lead",
            )


def _milliseconds(seconds: float) -> str:
    """Return a time [s] in words: "25 ms"."""
    return f"{1e3 * seconds:.0f} ms"
