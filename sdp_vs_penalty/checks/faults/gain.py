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
    in common is not seen by what joints share: see residual.py."""

    name = "gain"

    def proposals(
        self, log: Likelihood, now: LogTransform, score: ArmFit
    ) -> Iterator[LogTransform]:
        joints = log.joints if len(log.joints) > 1 else []
        # A small one is seen at its best value alone: a step of the grid off, the fit
        # is as bad.
        ats: list[At] = [partial(now.times, "gain", (j,)) for j in joints]
        steps, _ = log.screen.first_order_steps(
            now, ats, np.ones(len(ats)), np.full(len(ats), 0.01)
        )
        for at, best in zip(ats, np.clip(1.0 + steps, 0.5, 2.0).tolist(), strict=True):
            yield from map(at, (*_GAINS, best))

    def elements(self, log: Likelihood, repair: LogTransform) -> Iterator[Fault]:
        for j in np.flatnonzero(np.abs(repair.gain) != 1.0).tolist():
            x = abs(repair.gain[j])
            size = (
                f"{1.0 / x:.3g} times too large"
                if x < 1.0
                else f"{x:.3g} times too small"
            )
            what = (
                f"the torque of {joints_text([j])} is {size} beside those of its"
                " neighbours."
            )
            at = lambda v, j=j: repair.with_entries(  # noqa: E731
                "gain", (j,), v * np.sign(repair.gain[j])
            )
            yield Fault(
                "torque gain",
                "warning",
                (j,),
                what,
                f"multiply tau{j + 1} by {x:.3g}",
                FaultSize.factor(x, at, _DECIMALS),
                choices(log.n),
                figures={"factor": x},
            )
