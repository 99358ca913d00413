"""Reverse engineering: least squares on what a black box answers instead of on measured torque."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sdp_vs_penalty.estimators.estimator import Estimator, Fit, Task
from sdp_vs_penalty.estimators.ols import condition_number
from sdp_vs_penalty.solvers.objective import Objective


@dataclass(frozen=True)
class ReverseEngineering(Estimator):
    """pi_RE = argmin |W pi - (g, M)|^2 over configurations (Gaz et al. 2019, sec. III).

    W stacks, for each configuration, the n rows of g(q) and the n (n + 1) / 2 upper-triangle entries
    of M(q), newton metres beside kg m^2 as in the paper. The condition number of W in the base
    parameters and the relative error in percent come with the estimate.
    """

    name = "reverse-engineering"
    description = "least squares on gravity torques and inertia matrices of a black box (an .npz file)"
    needs_black_box = True

    def fit(self, task: Task) -> Fit:
        details = {
            "condition_number": condition_number(task),
            "relative_error_percent": 100.0
            * float(np.sqrt(task.data.loss(task.ols) / task.data.tau_squared)),
        }
        return Fit(task.ols, Objective(task.data), task.constraints, details=details)
