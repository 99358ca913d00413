"""The arm's weight taken out of the torques."""

from collections.abc import Iterator
from functools import partial

from sdp_vs_penalty.checks import constants as c
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


class Weight(Transformation):
    """The arm's weight taken out of one channel, or of all, by the controller."""

    name = "weight"

    def propose(
        self, log: Likelihood, now: LogTransform, fit: ArmFit
    ) -> Iterator[LogTransform]:
        """Yield the repair ``now`` with the arm's weight missing from the torques: all
        of it or 80 %, of all torques, and all of it of single joints that bear much
        weight.

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
        if not any(now.gravity):
            return
        # A little weight that is left makes the rest look like inertia under another
        # clock.
        for share in (1.0, 0.8):
            yield now.with_entries("lacks", range(log.n), share)
        for j in log.revolute:
            yield now.with_entries("lacks", (j,), 1.0)

    def list_faults(self, log: Likelihood, repair: LogTransform) -> Iterator[Fault]:
        """Yield a fault for the torques from which a repair takes the weight to be
        missing.

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
        for joints, share in repair.list_nonzero("lacks"):
            yield _gravity_removed(log, repair, joints, share)


def _gravity_removed(
    log: Likelihood, repair: LogTransform, joints: tuple[int, ...], share: float
) -> Fault:
    """Return the fault that a share of the arm's weight is missing from some torques,
    or all."""
    torques = f"the torque of {joints_text(joints)}"
    remedy = "log the torques before gravity compensation"
    if len(joints) == log.n:
        torques = "the torques"
        left = [float(round((1.0 - share) * g, 3)) + 0.0 for g in repair.gravity]
        vector = ", ".join(f"{g:g}" for g in left)
        remedy = f"{remedy}, or set gravity to ({vector}) m/s^2"
    number = FaultSize(
        value=share,
        repair_with=partial(repair.with_entries, "lacks", joints),
        tolerance=c.CALIBRATED_GAIN,
        search_radius=0.4,
        in_words=_percent,
        round_values=(1.0,),
    )
    return Fault(
        kind="gravity removed",
        severity="warning",
        joints=joints,
        what=f"{_percent(share)} of the weight is missing from {torques}.",
        remedy=remedy,
        removal=number,
        log_odds_against=odds_against_one_of(log.n // len(joints)),
        is_repairable=False,
    )
