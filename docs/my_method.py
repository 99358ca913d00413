"""A method of one's own: least squares under all convex constraints, by CVXPY, certified."""

from dataclasses import dataclass
from typing import ClassVar

import cvxpy as cp
import numpy as np

from sdp_vs_penalty import register
from sdp_vs_penalty.estimators.estimator import Estimator, Fit
from sdp_vs_penalty.estimators.lmi_sdp import interior_point


def in_cone(constraint, theta):
    """Return what CVXPY calls the constraint F_0 + sum theta_i F_i in its cone."""
    parts = zip(constraint.indices, constraint.coefficients, strict=True)
    F = constraint.constant + sum(theta[int(k)] * F_k for k, F_k in parts)
    if constraint.cone == "soc":
        return cp.SOC(F[0], F[1:])
    return F >> 0 if constraint.cone == "psd" else F >= 0


@register
@dataclass(frozen=True)
class PlainSdp(Estimator):
    """Least squares under all convex constraints, without a prior."""

    name: ClassVar[str] = "plain-sdp"
    description: ClassVar[str] = "least squares under all convex constraints, by CVXPY"

    def fit(self, task):
        theta = cp.Variable(len(task.nominal))
        loss = task.data.loss(task.ols)  # the unit: solvers like numbers near 1
        R, rho = task.data.R / np.sqrt(loss), task.data.rho / np.sqrt(loss)
        demands = {c: in_cone(c, theta) for c in task.constraints.convex}
        objective = cp.Minimize(cp.sum_squares(R @ theta - rho))
        cp.Problem(objective, [*demands.values()]).solve(solver="CLARABEL")
        multipliers = {c: multiplier(demand, loss) for c, demand in demands.items()}
        stacked = task.constraints.stack_multipliers(multipliers)
        interior = interior_point(task, task.constraints)
        return Fit(theta.value, task.problem, stacked, interior=interior)


def multiplier(demand, loss):
    """Return the multiplier S of a constraint, of the loss and not of its share."""
    parts = demand.dual_value if isinstance(demand, cp.SOC) else [demand.dual_value]
    return loss * np.concatenate([np.ravel(x) for x in parts])
