"""A torque channel that bends towards a limit."""

from collections.abc import Iterator

import numpy as np

from sdp_vs_penalty.checks.arm_fit import ArmFit
from sdp_vs_penalty.checks.faults.fault import (
    Fault,
    FaultSize,
    Transformation,
    _percent,
    choices,
)
from sdp_vs_penalty.checks.issue import joints_text
from sdp_vs_penalty.checks.likelihood import Likelihood
from sdp_vs_penalty.checks.repair import LogTransform

#: Below this bend, the largest logged torque over the limit, a channel is as straight
#: as sensors are.
_STRAIGHT = 0.2


class Saturation(Transformation):
    """A channel that bends towards a limit: tau_log = s tanh(tau / s), an amplifier
    near its end."""

    name = "saturation"

    def proposals(
        self, log: Likelihood, now: LogTransform, score: ArmFit
    ) -> Iterator[LogTransform]:
        """One more thing of this kind, from the repair as it is now."""
        for j in log.joints:
            for x in (0.5 * _STRAIGHT, 0.1 * _STRAIGHT):
                yield now.with_entries("bend", (j,), 1.0 - x)

    def elements(self, log: Likelihood, repair: LogTransform) -> Iterator[Fault]:
        """What the repair does of this kind."""
        for j in np.flatnonzero(repair.bend).tolist():
            x = repair.bend[j]
            k = repair.tau_order[j]
            limit = f"{log.data.largest[k] / x:.3g} {log.problem.robot.torque_units[j]}"
            what = (
                f"the torque of {joints_text([j])} bends towards its amplifier's limit"
                f" of {limit}."
            )
            remedy = "record again with a larger range, or slower"
            at = lambda v, j=j: repair.with_entries(  # noqa: E731
                "bend", (j,), float(np.clip(v, 0.0, 0.995))
            )
            number = FaultSize(
                x,
                at,
                _STRAIGHT,
                0.25,
                lambda v: f"{_percent(v)} of the limit is reached",
            )
            yield Fault(
                "saturation",
                "warning",
                (j,),
                what,
                remedy,
                number,
                choices(log.n),
                mends=False,
            )
