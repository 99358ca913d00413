"""Torque later than the motion, or filtered."""

from collections.abc import Iterator
from functools import partial

import numpy as np

from sdp_vs_penalty.checks import constants as c
from sdp_vs_penalty.checks.arm_fit import ArmFit
from sdp_vs_penalty.checks.faults.fault import Fault, FaultSize, Transformation, choices
from sdp_vs_penalty.checks.likelihood import Likelihood
from sdp_vs_penalty.checks.repair import LogTransform

#: Delays (``lead`` of a repair) and time constants (``lag``) that are tried [s].
_LATE = {
    "lead": (-0.12, -0.06, -0.025, -0.01, 0.01, 0.025, 0.06, 0.12),
    "lag": (0.01, 0.04, 0.1, 0.2),
}


class Delay(Transformation):
    """Torque later than the motion, or through a causal filter: one channel, or all.
    Nothing brings one channel ahead of the others: what looks like that is a law of its
    joint."""

    name = "delay"

    def proposals(
        self,
        log: Likelihood,
        now: LogTransform,
        score: ArmFit,
    ) -> Iterator[LogTransform]:
        """Propose repairs that correct one more fault of this kind than ``now`` does."""
        for name, times in _LATE.items():
            for x in times:
                yield now.with_entries(name, range(log.n), x)
            if len(log.joints) == 1:
                continue
            for j in log.joints:
                for x in times:
                    if x > 0.0:
                        yield now.with_entries(name, (j,), x)

    def elements(self, log: Likelihood, repair: LogTransform) -> Iterator[Fault]:
        """Yield the faults of this kind that a repair corrects."""
        for joints, x in repair.changed("lead"):
            yield _delay(log, repair, joints, x)
        for joints, x in repair.changed("lag"):
            yield _filter(log, repair, joints, x)


def _milliseconds(x: float) -> str:
    return f"{1e3 * x:.0f} ms"


def _number(
    repair: LogTransform,
    name: str,
    joints: tuple[int, ...],
    x: float,
) -> FaultSize:
    return FaultSize(
        value=x,
        at=partial(repair.with_entries, name, joints),
        tolerance=c.USUAL_DELAY,
        search_radius=0.06,
        text=_milliseconds,
    )


def _place(log: Likelihood, joints: tuple[int, ...]) -> str:
    """Where all channels are late: of one joint, its channel."""
    is_all = len(joints) == log.n > 1
    return "all torque channels" if is_all else ""


def _delay(
    log: Likelihood,
    repair: LogTransform,
    joints: tuple[int, ...],
    x: float,
) -> Fault:
    """Torques of some joints so much later than the motion [s]."""
    is_all = len(joints) == log.n
    channel = "the torques" if is_all else f"tau{joints[0] + 1}"
    others = "the positions have not" if is_all else "the other torques have not"
    when = "later" if x > 0.0 else "earlier"
    return Fault(
        kind="delay" if is_all else "channel delay",
        severity="warning",
        joints=joints,
        what=f"{1e3 * abs(x):.0f} ms {when} than the motion: {channel}; {others} moved.",
        remedy=f"shift {channel} in time (and log all channels from one source)",
        of=_number(repair, "lead", joints, x),
        cost=choices(log.n // len(joints)),
        place=_place(log, joints),
    )


def _filter(
    log: Likelihood,
    repair: LogTransform,
    joints: tuple[int, ...],
    x: float,
) -> Fault:
    """Torques of some joints behind a low-pass of that time constant [s]."""
    is_all = len(joints) == log.n
    channel = "the torques" if is_all else f"tau{joints[0] + 1}"
    others = "the positions have not" if is_all else "the other torques have not"
    hertz = 1.0 / (2.0 * np.pi * max(x, 1e-6))
    return Fault(
        kind="torque filter" if is_all else "channel filter",
        severity="warning",
        joints=joints,
        what=f"a causal low-pass of {hertz:.2g} Hz ({_milliseconds(x)}) on {channel};"
        f" {others} one.",
        remedy=f"log {channel} unfiltered, or filter every channel alike and without"
        " lag",
        of=_number(repair, "lag", joints, x),
        cost=choices(log.n // len(joints)),
        place=_place(log, joints),
        mends=False,
    )
