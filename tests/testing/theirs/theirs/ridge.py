"""Least squares with a pull of every parameter to the nominal one."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from sdp_vs_penalty.estimators.estimator import Estimator, Fit, Task


@dataclass(frozen=True)
class Ridge(Estimator):
    """Least squares pulled to the nominal parameters."""

    name: ClassVar[str] = "ridge"
    description: ClassVar[str] = "least squares pulled to the nominal parameters"

    #: Weight of the pull, relative to the torque.
    weight: float = 1e-3

    def fit(self, task: Task) -> Fit:
        """Minimise |R theta - rho|^2 + |scale (theta - nominal)|^2."""
        data = task.data
        scale = self.weight * np.sqrt(data.tau_squared) / np.maximum(task.bound, 1e-9)
        rows = np.vstack([data.R, np.diag(scale)])
        right = np.concatenate([data.rho, scale * task.nominal])
        theta = np.linalg.lstsq(rows, right, rcond=None)[0]
        return Fit(theta, task.problem)
