"""Torque channels too large or too small."""

from collections.abc import Iterator
from functools import partial

import numpy as np

from sdp_vs_penalty.checks.arm_fit import ArmFit
from sdp_vs_penalty.checks.faults.fault import (
    UNITS,
    Fault,
    FaultSize,
    Transformation,
    choices,
)
from sdp_vs_penalty.checks.issue import joints_text
from sdp_vs_penalty.checks.likelihood import At, Likelihood
from sdp_vs_penalty.checks.repair import LogTransform

#: Factors that are tried beside the nearest: units, and a grid whose steps the
#: refinement bridges.
_DECIMALS = (1e-3, 1e-2, 0.1)
_GAINS = (*UNITS, 0.1, 0.3, 3, 100, 1e3)


class Gain(Transformation):
    """Channels too large or too small beside their neighbours'. A factor that all have
    in common is not seen by what joints share: see torque_size.py."""

    name = "gain"

    def proposals(
        self, log: Likelihood, now: LogTransform, score: ArmFit
    ) -> Iterator[LogTransform]:
        """One more thing of this kind, from the repair as it is now."""
        if len(log.joints) < 2:
            return
        # A small one is seen at its best value alone: a step of the grid off, the fit
        # is as bad.
        ats: list[At] = [partial(now.times, "gain", (j,)) for j in log.joints]
        ones = np.ones(len(ats))
        steps = log.screen.first_order_steps(now, ats, ones, 0.01 * ones)[0]
        nearest = np.clip(1.0 + steps, 0.5, 2.0).tolist()
        for at, factor in zip(ats, nearest, strict=True):
            yield from map(at, (*_GAINS, factor))

    def elements(self, log: Likelihood, repair: LogTransform) -> Iterator[Fault]:
        """What the repair does of this kind."""
        for j in np.flatnonzero(np.abs(repair.gain) != 1.0).tolist():
            yield _gain(log, repair, j)


def _gain(log: Likelihood, repair: LogTransform, j: int) -> Fault:
    """Joint j's torque, off by a factor."""
    x = abs(repair.gain[j])
    sign = float(np.sign(repair.gain[j]))
    size = f"{x:.3g} times too small"
    if x < 1.0:
        size = f"{1.0 / x:.3g} times too large"

    def at(factor: float) -> LogTransform:
        return repair.with_entries("gain", (j,), factor * sign)

    return Fault(
        kind="torque gain",
        severity="warning",
        joints=(j,),
        what=f"the torque of {joints_text([j])} is {size} beside those of its"
        " neighbours.",
        remedy=f"multiply tau{j + 1} by {x:.3g}",
        of=FaultSize.factor(x, at, _DECIMALS),
        cost=choices(log.n),
        figures={"factor": x},
    )
