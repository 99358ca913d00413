"""Sousa and Cortesao's chain of convex problems: the nearest feasible point, then the torque SDP."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

from sdp_vs_penalty.estimators.estimator import Estimator, Fit, Task
from sdp_vs_penalty.estimators.sdp_fit import solve_sdp
from sdp_vs_penalty.solvers.objective import Objective


@dataclass(frozen=True)
class LmiSdpTwoStep(Estimator):
    """Sousa and Cortesao's chain (IJRR 2014), each step a feasible set and a distance:

    beta'   nearest feasible base parameters to the OLS estimate, Euclidean in the symbols;
    beta*   the torque SDP with pseudo-inertias only;
    beta*e  the torque SDP with centre-of-mass and mass bounds as well;
    delta   standard parameters with base parameters beta*e (their eq. 49).
    """

    name = "lmi-sdp-two-step"
    description = "Sousa and Cortesao's chain: beta', beta*, beta*e, delta"

    solver: str = "clarabel"
    accuracy: float = 1e-10

    #: What beta' and beta* are subject to.
    _physics: ClassVar[tuple[str, ...]] = ("pseudo-inertia", "sign")

    def fit(self, task: Task) -> Fit:
        # Families that only bound the feasible set stay: without them it is open to infinity.
        physics = task.constraints.with_families(
            lambda family: family in (*self._physics, "range", "trace", "bounding ellipsoid", "mass")
        )
        nearest = solve_sdp(task, Objective(task.base_distance), physics, self.solver, self.accuracy)
        torque = Objective(task.data)
        best = solve_sdp(task, torque, physics, self.solver, self.accuracy)
        bounded = solve_sdp(task, torque, task.constraints, self.solver, self.accuracy)
        chain = {
            name: (task.base @ fit.theta).tolist()
            for name, fit in (("beta_prime", nearest), ("beta_star", best), ("beta_star_e", bounded))
        }
        details = {**bounded.details, **chain, "loss_beta_prime": task.data.loss(nearest.theta)}
        return replace(bounded, details=details)
