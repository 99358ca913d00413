"""Torque later than the motion, or filtered."""

from collections.abc import Iterator
from functools import partial

import numpy as np

from sdp_vs_penalty.checks import constants as c
from sdp_vs_penalty.checks.arm_fit import ArmFit
from sdp_vs_penalty.checks.faults.fault import (
    Fault,
    FaultSize,
    Transformation,
    odds_against_one_of,
)
from sdp_vs_penalty.checks.likelihood import Likelihood
from sdp_vs_penalty.checks.repair import LogTransform

#: Search radius of a delay or a time constant [s]: the steps between those tried.
_SEARCH_RADIUS_S = 0.06
#: Times that are tried [s], by entry of a repair: by how much a torque is later than the
#: motion (``lead``), and time constants of a causal low-pass (``lag``).
_TIMES_TRIED = {
    "lead": (-0.12, -0.06, -0.025, -0.01, 0.01, 0.025, 0.06, 0.12),
    "lag": (0.01, 0.04, 0.1, 0.2),
}


class Delay(Transformation):
    """Torque later than the motion, or through a causal filter: one channel, or all.
    Nothing brings one channel ahead of the others: what looks like that is a law of its
    joint."""

    name = "delay"

    def propose(
        self, log: Likelihood, now: LogTransform, fit: ArmFit
    ) -> Iterator[LogTransform]:
        """Yield the repair ``now`` with a delay or a low-pass undone: of all torques,
        and of each joint's torque.

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
        for name, times in _TIMES_TRIED.items():
            for seconds in times:
                yield now.with_entries(name, range(log.n), seconds)
            if len(log.joints) == 1:
                continue
            # No logger brings one channel ahead of the others.
            delays = [seconds for seconds in times if seconds > 0.0]
            for j in log.joints:
                for seconds in delays:
                    yield now.with_entries(name, (j,), seconds)

    def list_faults(self, log: Likelihood, repair: LogTransform) -> Iterator[Fault]:
        """Yield a fault for each delay (entry ``lead``) and each low-pass (entry
        ``lag``) of torques that a repair undoes.

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
        for joints, seconds in repair.list_nonzero("lead"):
            yield _delay(log, repair, joints, seconds)
        for joints, seconds in repair.list_nonzero("lag"):
            yield _low_pass(log, repair, joints, seconds)


def _milliseconds(seconds: float) -> str:
    """Return a time [s] in words: "25 ms"."""
    return f"{1e3 * seconds:.0f} ms"


def _size(
    repair: LogTransform, name: str, joints: tuple[int, ...], seconds: float
) -> FaultSize:
    """Return the size [s] of a delay or a low-pass of some joints' torques.

    name : entry of the repair that holds it: "lead" (a delay) or "lag" (the time
    constant of a low-pass).
    """
    return FaultSize(
        value=seconds,
        repair_with=partial(repair.with_entries, name, joints),
        tolerance=c.USUAL_DELAY,
        search_radius=_SEARCH_RADIUS_S,
        in_words=_milliseconds,
    )


def _place(log: Likelihood, joints: tuple[int, ...]) -> str:
    """Return in words where the fault is: all channels; empty for a single joint, which
    the issue names by itself."""
    is_all = len(joints) == log.n > 1
    return "all torque channels" if is_all else ""


def _delay(
    log: Likelihood, repair: LogTransform, joints: tuple[int, ...], seconds: float
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
        severity="warning",
        joints=joints,
        what=f"{milliseconds} {when} than the motion: {channel}; {others} moved.",
        remedy=f"shift {channel} in time (and log all channels from one source)",
        removal=_size(repair, "lead", joints, seconds),
        log_odds_against=odds_against_one_of(log.n // len(joints)),
        place=_place(log, joints),
    )


def _low_pass(
    log: Likelihood, repair: LogTransform, joints: tuple[int, ...], seconds: float
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
        severity="warning",
        joints=joints,
        what=f"a causal low-pass of {hertz:.2g} Hz ({_milliseconds(seconds)}) on {channel};"
        f" {others} one.",
        remedy=f"log {channel} unfiltered, or filter every channel alike and without"
        " lag",
        removal=_size(repair, "lag", joints, seconds),
        log_odds_against=odds_against_one_of(log.n // len(joints)),
        place=_place(log, joints),
        is_repairable=False,
    )
