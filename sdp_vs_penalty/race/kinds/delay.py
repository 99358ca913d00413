"""Torque later than the motion, or through a causal filter: one channel, or all. Nothing
brings one channel ahead of the others: what looks like that is a law of its joint."""

from collections.abc import Iterator

import numpy as np

from sdp_vs_penalty.race import constants as c
from sdp_vs_penalty.race.chain import LogTransform
from sdp_vs_penalty.race.evidence import Evidence, ViewFit
from sdp_vs_penalty.race.fault import Fault, prior_of_one_of
from sdp_vs_penalty.race.likelihood import Likelihood
from sdp_vs_penalty.race.records import Hypothesis, Number

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
    """Return the delay or the time constant [s] of some joints' torques; of a single one
    it is not negative."""
    least = -1.0 if field == "lead" and len(joints) > 1 else 0.0
    limits = (least, 1.0)
    return Number(
        field,
        joints,
        _SD,
        usual=c.USUAL_DELAY,
        usual_below=c.USUAL_LEAD,
        step=1e-3,
        limits=limits,
    )


def propose(evidence: Evidence, fit: ViewFit) -> Iterator[Hypothesis]:
    """Yield a delay or a low-pass of all torques, and of each joint's torque."""
    log, now = evidence.log, fit.chain
    every = tuple(range(log.n))
    for field, times in _TIMES_TRIED.items():
        of_all, of_one = _KINDS[field]
        for time in times:
            chain = now.with_entries(field, every, time) if time else now
            number = _number(field, every)
            yield Hypothesis(of_all, every, prior_of_one_of(1), chain, number)
            if len(log.joints) == 1 or time < 0.0:
                continue
            for j in log.joints:
                chain = now.with_entries(field, (j,), time) if time else now
                number = _number(field, (j,))
                prior = prior_of_one_of(log.n)
                yield Hypothesis(of_one, (j,), prior, chain, number)


def list_faults(log: Likelihood, chain: LogTransform) -> Iterator[Fault]:
    """Yield a fault for each delay and each low-pass of torques."""
    for joints, seconds in chain.list_nonzero("lead"):
        yield _delay(log, chain, joints, seconds)
    for joints, seconds in chain.list_nonzero("lag"):
        yield _low_pass(log, chain, joints, seconds)


def _milliseconds(seconds: float) -> str:
    """Return a time [s] in words: "25 ms"."""
    return f"{1e3 * seconds:.0f} ms"


def _place(log: Likelihood, joints: tuple[int, ...]) -> str:
    """Return in words where the fault is: all channels; empty for a single joint, which
    the issue names by itself."""
    is_all = len(joints) == log.n > 1
    return "all torque channels" if is_all else ""


def _delay(
    log: Likelihood, chain: LogTransform, joints: tuple[int, ...], seconds: float
) -> Fault:
    """Return the fault that some joints' torques, or all, are later than the motion.

    seconds : by how much; negative where they are earlier.
    """
    is_all = len(joints) == log.n
    channel = "the torques" if is_all else f"tau{joints[0] + 1}"
    others = "the positions have not" if is_all else "the other torques have not"
    when = "later" if seconds > 0.0 else "earlier"
    milliseconds = f"{1e3 * abs(seconds):.0f} ms"
    return Fault(
        kind="delay" if is_all else "channel delay",
        joints=joints,
        what=f"{milliseconds} {when} than the motion: {channel}; {others} moved.",
        remedy=f"shift {channel} in time (and log all channels from one source)",
        without=chain.with_entries("lead", joints, 0.0),
        number=_number("lead", joints),
        in_words=_milliseconds,
        place=_place(log, joints),
    )


def _low_pass(
    log: Likelihood, chain: LogTransform, joints: tuple[int, ...], seconds: float
) -> Fault:
    """Return the fault that some joints' torques, or all, went through a causal
    low-pass.

    seconds : its time constant.
    """
    is_all = len(joints) == log.n
    channel = "the torques" if is_all else f"tau{joints[0] + 1}"
    others = "the positions have not" if is_all else "the other torques have not"
    hertz = 1.0 / (2.0 * np.pi * max(seconds, 1e-6))  # corner frequency
    return Fault(
        kind="torque filter" if is_all else "channel filter",
        joints=joints,
        what=f"a causal low-pass of {hertz:.2g} Hz ({_milliseconds(seconds)}) on {channel};"
        f" {others} one.",
        remedy=f"log {channel} unfiltered, or filter every channel alike and without"
        " lag",
        without=chain.with_entries("lag", joints, 0.0),
        number=_number("lag", joints),
        in_words=_milliseconds,
        place=_place(log, joints),
        is_repairable=False,
    )
