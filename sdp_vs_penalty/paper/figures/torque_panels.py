"""What Figures 1, 3 and 9 share: measured and estimated torque with the error beside it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.diagnosis.comparison import predicted
from sdp_vs_penalty.paper.figures.style import LOOKS
from sdp_vs_penalty.paper.tables.study import Data, Study
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.preprocessing import filtered_torque


@dataclass(frozen=True)
class Torques:
    """t (M,) s; measured and each method's torque (M, n), behind the same filters."""

    t: Array
    measured: Array
    estimated: dict[str, Array]

    @classmethod
    def of(cls, study: Study, data: Data, run: Measurements, methods: tuple[str, ...]) -> Torques:
        rows = filtered_torque(run, data.model, data.preprocessing)
        estimated = {m: predicted(rows, study.result(m, data).theta) for m in methods}
        return cls(rows.motion.t - run.t[0], rows.torque, estimated)

    def relative_error(self, method: str) -> float:
        """100 |tau - tau_hat| / |tau| over all joints [%]."""
        error = self.measured - self.estimated[method]
        return 100.0 * float(np.linalg.norm(error) / np.linalg.norm(self.measured))

    def draw(self, joint: int, torque_axis: Any, error_axis: Any | None, name: str) -> None:
        """Torque of one joint on one axis, errors of all methods on the other."""
        torque_axis.plot(self.t, self.measured[:, joint], label=name, **LOOKS["measured"])
        for method, torque in self.estimated.items():
            torque_axis.plot(self.t, torque[:, joint], label=method, **LOOKS[method])
            if error_axis is not None:
                error = torque[:, joint] - self.measured[:, joint]
                error_axis.plot(self.t, error, label=method, **LOOKS[method])
        torque_axis.margins(x=0)
        if error_axis is not None:
            error_axis.margins(x=0)
