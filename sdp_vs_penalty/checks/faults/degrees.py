"""Positions in degrees."""

from collections.abc import Iterator

import numpy as np

from sdp_vs_penalty.checks import constants as c
from sdp_vs_penalty.checks.arm_fit import ArmFit
from sdp_vs_penalty.checks.faults.fault import Fault, Transformation, choices
from sdp_vs_penalty.checks.issue import joints_text
from sdp_vs_penalty.checks.likelihood import Likelihood
from sdp_vs_penalty.checks.repair import LogTransform


class Degrees(Transformation):
    """Positions in degrees: of all revolute joints, or of one of them."""

    name = "degrees"

    def proposals(
        self, log: Likelihood, now: LogTransform, score: ArmFit
    ) -> Iterator[LogTransform]:
        reach = np.abs(now.positions(log.data.motion.q)).max(axis=0)
        far = [j for j in log.revolute if reach[j] > 2.0 * np.pi]
        for joints in [log.revolute, *([j] for j in far if log.n > 1)] if far else ():
            yield now.times("scale", joints, float(np.radians(1.0)))

    def elements(self, log: Likelihood, repair: LogTransform) -> Iterator[Fault]:
        if not (joints := tuple(np.flatnonzero(np.abs(repair.scale) < 0.1).tolist())):
            return
        without = repair.times("scale", joints, float(np.degrees(1.0)))
        reach = float(np.abs(without.positions(log.data.motion.q)[:, joints]).max())
        every = joints == tuple(log.revolute)
        named = ", ".join(f"q{j + 1}" for j in joints)
        kind = "positions in degrees"
        cost = c.ODDS
        if not every:
            kind = "position unit"
            cost = len(joints) * choices(log.n)
        what = (
            f"the position of {joints_text(joints)} is in degrees: it reaches"
            f" {reach:.4g}."
        )
        remedy = f"multiply {named} (and dq) by pi / 180"
        yield Fault(kind, "warning", joints, what, remedy, without, cost, named)
