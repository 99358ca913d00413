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
#: Step of the difference quotient by a factor [-].
_DIFFERENCE = 0.01
#: Factors for which a first-order step from one is trusted.
_FIRST_ORDER = (0.5, 2.0)


class Gain(Transformation):
    """Channels too large or too small beside their neighbours'. A factor that all have
    in common is not seen by what joints share: see torque_size.py."""

    name = "gain"

    def proposals(
        self,
        log: Likelihood,
        now: LogTransform,
        score: ArmFit,
    ) -> Iterator[LogTransform]:
        """Propose repairs that correct one more fault of this kind than ``now`` does."""
        if len(log.joints) < 2:
            return
        # The grid is too coarse for factors near one: a Gauss-Newton step from one gives
        # a further candidate.
        repairs_by_factor: list[At] = [
            partial(now.times, "gain", (j,)) for j in log.joints
        ]
        ones = np.ones(len(repairs_by_factor))
        steps = log.screen.first_order_steps(
            now,
            repairs_by_factor,
            ones,
            _DIFFERENCE * ones,
        )[0]
        nearest = np.clip(1.0 + steps, *_FIRST_ORDER).tolist()
        for repair_by, factor in zip(repairs_by_factor, nearest, strict=True):
            yield from map(repair_by, (*_GAINS, factor))

    def elements(self, log: Likelihood, repair: LogTransform) -> Iterator[Fault]:
        """Yield the faults of this kind that a repair corrects."""
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
