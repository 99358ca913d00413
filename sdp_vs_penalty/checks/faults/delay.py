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
        self, log: Likelihood, now: LogTransform, score: ArmFit
    ) -> Iterator[LogTransform]:
        each = [(j,) for j in log.joints] if len(log.joints) > 1 else []
        for name, tried in _LATE.items():
            yield from (now.with_entries(name, range(log.n), x) for x in tried)
            yield from (
                now.with_entries(name, one, x) for one in each for x in tried if x > 0.0
            )

    def elements(self, log: Likelihood, repair: LogTransform) -> Iterator[Fault]:
        for name, joints, x in (
            (k, *found) for k in _LATE for found in repair.changed(k)
        ):
            place = ""
            channel = f"tau{joints[0] + 1}"
            beside = "the other torques have not"
            kind = f"channel {'delay' if name == 'lead' else 'filter'}"
            whole = len(joints) == log.n
            if whole:
                kind = "delay" if name == "lead" else "torque filter"
                place = "all torque channels" if log.n > 1 else ""
                channel = "the torques"
                beside = "the positions have not"
            low = f"{1.0 / (2.0 * np.pi * max(x, 1e-6)):.2g} Hz ({1e3 * x:.0f} ms)"
            what = f"a causal low-pass of {low} on {channel}; {beside} one."
            remedy = (
                f"log {channel} unfiltered, or filter every channel alike and"
                " without lag"
            )
            if name == "lead":
                later = "later" if x > 0.0 else "earlier"
                what = (
                    f"{1e3 * abs(x):.0f} ms {later} than the motion: {channel};"
                    f" {beside} moved."
                )
                remedy = (
                    f"shift {channel} in time (and log all channels from one source)"
                )
            at = partial(repair.with_entries, name, joints)
            number = FaultSize(x, at, c.USUAL_DELAY, 0.06, in_milliseconds)
            cost = choices(log.n // len(joints))
            yield Fault(
                kind,
                "warning",
                joints,
                what,
                remedy,
                number,
                cost,
                place,
                mends=name == "lead",
            )


def in_milliseconds(seconds: float) -> str:
    """A time in words."""
    return f"{1e3 * seconds:.0f} ms"
