"""Torque channels too large or too small."""

from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import numpy as np

from sdp_vs_penalty.checks.arm_fit import ArmFit
from sdp_vs_penalty.checks.faults.fault import (
    UNITS,
    Fault,
    FaultSize,
    Transformation,
    odds_against_one_of,
)
from sdp_vs_penalty.checks.issue import joints_text
from sdp_vs_penalty.checks.likelihood import At, Likelihood
from sdp_vs_penalty.checks.repair import LogTransform

#: Factors that count as round values.
_DECIMALS = (1e-3, 1e-2, 0.1)
#: Factors that are tried beside the nearest: units, and a grid whose steps the
#: refinement bridges.
_GAINS = (*UNITS, 0.1, 0.3, 3, 100, 1e3)
#: Step of the difference quotient by a factor [-].
_DIFFERENCE = 0.01
#: Factors for which a first-order step from one is trusted.
_FIRST_ORDER = (0.5, 2.0)


class Gain(Transformation):
    """Channels too large or too small beside their neighbours'. A factor that all have
    in common is not seen by what joints share: see torque_size.py."""

    name = "gain"

    def propose(
        self, log: Likelihood, now: LogTransform, fit: ArmFit
    ) -> Iterator[LogTransform]:
        """Yield the repair ``now`` with each joint's torque multiplied by a factor:
        units, a coarse grid, and the factor of a first-order step. Nothing for a single
        joint.

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
        if len(log.joints) < 2:
            return
        # The grid is too coarse for factors near one: a Gauss-Newton step from one gives
        # a further candidate.
        repairs_by_factor: list[At] = [
            partial(now.with_multiplied, "gain", (j,)) for j in log.joints
        ]
        ones = np.ones(len(repairs_by_factor))
        steps = log.on_third_of_rows.first_order_steps(
            now, repairs_by_factor, ones, _DIFFERENCE * ones
        )[0]
        nearest = np.clip(1.0 + steps, *_FIRST_ORDER).tolist()
        for repair_by, nearest_factor in zip(repairs_by_factor, nearest, strict=True):
            for factor in (*_GAINS, nearest_factor):
                yield repair_by(factor)

    def list_faults(self, log: Likelihood, repair: LogTransform) -> Iterator[Fault]:
        """Yield a fault for each joint whose torque a repair scales, apart from its
        sign.

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
        for j in np.flatnonzero(np.abs(repair.gain) != 1.0).tolist():
            yield _gain(log, repair, j)


def _gain(log: Likelihood, repair: LogTransform, j: int) -> Fault:
    """Return the fault that joint j's torque is off by a factor; a sign is a fault of
    its own."""
    factor = abs(repair.gain[j])
    sign = float(np.sign(repair.gain[j]))

    def repair_with_factor(other: float) -> LogTransform:
        return repair.with_entries("gain", (j,), other * sign)

    return Fault(
        kind="torque gain",
        severity="warning",
        joints=(j,),
        what=f"the torque of {joints_text([j])} is {_times(factor)} beside those of its"
        " neighbours.",
        remedy=f"multiply tau{j + 1} by {factor:.3g}",
        removal=replace(
            FaultSize.of_factor(factor, repair_with_factor, _DECIMALS),
            in_words=lambda log_factor: _times(float(np.exp(log_factor))),
            number_told=abs,
        ),
        log_odds_against=odds_against_one_of(log.n),
        figures={"factor": factor},
    )


def _times(factor: float) -> str:
    """Say how wrong a torque is that has to be multiplied by a factor."""
    if factor < 1.0:
        return f"{1.0 / factor:.3g} times too large"
    return f"{factor:.3g} times too small"
