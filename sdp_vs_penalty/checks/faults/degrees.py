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
        self,
        log: Likelihood,
        now: LogTransform,
        score: ArmFit,
    ) -> Iterator[LogTransform]:
        """Propose repairs that correct one more fault of this kind than ``now`` does."""
        reach = np.abs(now.positions(log.data.motion.q)).max(axis=0)
        far = [j for j in log.revolute if reach[j] > 2.0 * np.pi]
        if not far:
            return
        factor = float(np.radians(1.0))
        yield now.times("scale", log.revolute, factor)
        for j in far if log.n > 1 else ():
            yield now.times("scale", (j,), factor)

    def elements(self, log: Likelihood, repair: LogTransform) -> Iterator[Fault]:
        """Yield the faults of this kind that a repair corrects."""
        joints = tuple(np.flatnonzero(np.abs(repair.scale) < 0.1).tolist())
        if not joints:
            return
        without = repair.times(
            "scale",
            joints,
            float(np.degrees(1.0)),
        )
        logged = without.positions(log.data.motion.q)[:, joints]
        is_all = joints == tuple(log.revolute)
        channels = ", ".join(f"q{j + 1}" for j in joints)
        yield Fault(
            kind="positions in degrees" if is_all else "position unit",
            severity="warning",
            joints=joints,
            what=f"the position of {joints_text(joints)} is in degrees: it reaches"
            f" {np.abs(logged).max():.4g}.",
            remedy=f"multiply {channels} (and dq) by pi / 180",
            of=without,
            cost=c.ODDS if is_all else len(joints) * choices(log.n),
            place=channels,
        )
