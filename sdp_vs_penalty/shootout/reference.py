"""The interval that contains an instance's optimum, proved once, or the proof that there is none."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimators.lmi_sdp import LmiSdp
from sdp_vs_penalty.estimators.sdp_fit import solve_sdp
from sdp_vs_penalty.shootout.instance import Instance
from sdp_vs_penalty.solvers import clarabel, verified
from sdp_vs_penalty.solvers.identification import largest_margin


@dataclass(frozen=True)
class Reference:
    """lower <= optimum <= upper, both rigorous; scale : what gaps are relative to.

    verdict : "feasible" (a strictly feasible point is proved), "infeasible" (proved) or "unknown".
    """

    verdict: str
    lower: float
    upper: float
    scale: float

    @property
    def gap(self) -> float:
        return (self.upper - self.lower) / self.scale


def reference(instance: Instance) -> Reference:
    """Bound the optimum of an instance by our own path."""
    interior = instance.interior
    if interior is None:
        verdict = "infeasible" if _proved_infeasible(instance) else "unknown"
        return Reference(verdict, 0.0, np.inf, 1.0)
    if not verified.certainly_feasible(instance.constraints.convex, interior):
        return Reference("unknown", 0.0, np.inf, 1.0)
    lower = 0.0 if instance.objective.entropy is None else -np.inf
    theta = interior
    with suppress(InputError):
        fit = solve_sdp(
            instance.task, instance.objective, instance.constraints, "clarabel", LmiSdp.accuracy
        )
        assert fit.multipliers is not None
        theta = fit.theta
        lower = max(lower, instance.lower_bound(theta, fit.multipliers, fit.entropy_slopes))
    point = verified.feasible_point(instance.constraints.convex, theta, interior)
    upper = np.inf if point is None else verified.upper_bound(instance.objective, point)
    scale = instance.data.loss_scale(interior if point is None else point)
    return Reference("feasible", lower, upper, max(scale, 1e-300))


def _proved_infeasible(instance: Instance) -> bool:
    """Farkas multipliers from the problem of the largest margin."""
    convex, bound = instance.constraints.convex, instance.task.bound
    for accuracy in (1e-8, 1e-10, 1e-12):
        sdp = largest_margin(convex, instance.task.nominal, bound)
        solution = clarabel.solve(sdp.conic, accuracy)
        if np.all(np.isfinite(solution.z)) and verified.proves_infeasible(
            convex, sdp.multipliers(solution), bound
        ):
            return True
    return False
