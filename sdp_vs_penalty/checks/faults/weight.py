"""The arm's weight taken out of the torques."""

from collections.abc import Iterator
from functools import partial

import numpy as np

from sdp_vs_penalty.checks import constants as c
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


class Weight(Transformation):
    """The arm's weight taken out of one channel, or of all, by the controller."""

    name = "weight"

    def proposals(
        self, log: Likelihood, now: LogTransform, score: ArmFit
    ) -> Iterator[LogTransform]:
        # The weight that a wrist's last link holds is within the error of its
        # friction's law: of one channel alone it has to be half (8 s of the real Panda,
        # tests/test_docs.py::test_the_tutorial).
        held = np.sqrt(np.mean(log.nominal(now, 0.0) ** 2, axis=0))
        logged = np.sqrt(np.mean(log.data.torque(log.data.motion.t) ** 2, axis=0))
        each = [(j,) for j in np.flatnonzero(held > 0.5 * logged).tolist()]
        every = range(log.n)
        # A little weight that is left makes the rest look like inertia under another
        # clock.
        for joints, lacks in (
            (every, 1.0),
            (every, 0.8),
            *((one, 1.0) for one in each),
        ):
            if any(now.gravity):
                yield now.with_entries("lacks", joints, lacks)

    def elements(self, log: Likelihood, repair: LogTransform) -> Iterator[Fault]:
        for joints, x in repair.changed("lacks"):
            of = f"the torque of {joints_text(joints)}"
            how = ""
            if len(joints) == log.n:
                left = ",".join(
                    f"{float(round((1.0 - x) * v, 3)) + 0.0:g}" for v in repair.gravity
                )
                of = "the torques"
                how = f", or identify with --gravity {left}"
            what = f"{_percent(x)} of the weight is missing from {of}."
            remedy = f"log the torques before gravity compensation{how}"
            at = partial(repair.with_entries, "lacks", joints)
            number = FaultSize(x, at, c.CALIBRATED_GAIN, 0.4, _percent, (1.0,))
            cost = choices(log.n // len(joints))
            yield Fault(
                "gravity removed",
                "warning",
                joints,
                what,
                remedy,
                number,
                cost,
                mends=False,
            )
