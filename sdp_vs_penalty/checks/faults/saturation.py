"""A torque channel that bends towards a limit."""

from collections.abc import Iterator

import numpy as np

from sdp_vs_penalty.checks.arm_fit import ArmFit
from sdp_vs_penalty.checks.faults.fault import (
    Fault,
    FaultSize,
    Transformation,
    _percent,
    odds_against_one_of,
)
from sdp_vs_penalty.checks.issue import joints_text
from sdp_vs_penalty.checks.likelihood import Likelihood
from sdp_vs_penalty.checks.repair import LogTransform

#: Below this bend, the largest logged torque over the limit, a channel is as straight
#: as sensors are.
_STRAIGHT = 0.2
#: Largest bend that is tried: at 1 the torque behind the limit would be infinite.
_SHARPEST = 0.995


class Saturation(Transformation):
    """A channel that bends towards a limit: tau_log = s tanh(tau / s), an amplifier
    near its end."""

    name = "saturation"

    def propose(
        self, log: Likelihood, now: LogTransform, fit: ArmFit
    ) -> Iterator[LogTransform]:
        """Yield the repair ``now`` with the torque of each joint straightened, for an
        amplifier whose limit the largest torque comes near to.

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
        for j in log.joints:
            # Torques that come to 90 and to 98 % of the limit.
            for distance in (0.5 * _STRAIGHT, 0.1 * _STRAIGHT):
                yield now.with_entries("bend", (j,), 1.0 - distance)

    def list_faults(self, log: Likelihood, repair: LogTransform) -> Iterator[Fault]:
        """Yield a fault for each joint whose torque a repair straightens.

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
        for j in np.flatnonzero(repair.bend).tolist():
            yield _saturated(log, repair, j)


def _saturated(log: Likelihood, repair: LogTransform, j: int) -> Fault:
    """Return the fault that joint j's torque bends towards its amplifier's limit.

    The limit is that of the raw channel, multiplied by the channel's gain: so it has
    the unit of the joint's torque also where the channel was logged in another.
    """
    bend = repair.bend[j]
    largest_logged = log.data.largest[repair.tau_order[j]]
    limit = abs(repair.gain[j]) * largest_logged / bend
    unit = log.problem.robot.torque_units[j]

    def with_bend(value: float) -> LogTransform:
        return repair.with_entries("bend", (j,), float(np.clip(value, 0.0, _SHARPEST)))

    return Fault(
        kind="saturation",
        severity="warning",
        joints=(j,),
        what=f"the torque of {joints_text([j])} bends towards its amplifier's limit of"
        f" {limit:.3g} {unit}.",
        remedy="record again with a larger range, or slower",
        removal=FaultSize(
            value=bend,
            repair_with=with_bend,
            tolerance=_STRAIGHT,
            search_radius=0.25,
            in_words=lambda value: f"{_percent(value)} of the limit is reached",
        ),
        log_odds_against=odds_against_one_of(log.n),
        is_repairable=False,
    )
