"""The interval that contains an instance's optimum, proved once, or the proof that there is none."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimators.sdp_fit import solve_sdp
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.shootout.instance import Instance
from sdp_vs_penalty.solvers import clarabel, verified
from sdp_vs_penalty.solvers.identification import largest_margin, least_squares_sdp

#: A relative gap below which the interval is not narrowed any further.
_NARROW = 1e-9


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
    """Bound the optimum of an instance by our own path, as tightly as a few attempts can."""
    interior = instance.interior
    if interior is None:
        verdict = "infeasible" if _proved_infeasible(instance) else "unknown"
        return Reference(verdict, 0.0, np.inf, 1.0)
    if not verified.certainly_feasible(instance.constraints.convex, interior):
        return Reference("unknown", 0.0, np.inf, 1.0)
    lower = 0.0 if instance.objective.entropy is None else -np.inf
    upper, best = np.inf, interior
    for theta, bound in _attempts(instance, interior):
        lower = max(lower, bound)
        point = verified.feasible_point(instance.constraints.convex, theta, interior)
        if point is not None:
            value = verified.upper_bound(instance.objective, point)
            if value < upper:
                upper, best = value, point
        scale = max(instance.data.loss_scale(best), 1e-300)
        if (upper - lower) / scale <= _NARROW:
            break
    return Reference("feasible", lower, upper, scale)


def _attempts(instance: Instance, interior: Array):  # type: ignore[no-untyped-def]
    """(theta, rigorous lower bound) of the default path, then about other centres and scales."""
    objective, task = instance.objective, instance.task
    around = interior
    try:
        fit = solve_sdp(task, objective, instance.constraints, "clarabel", 1e-10)
        assert fit.multipliers is not None
        around = fit.theta
        yield fit.theta, instance.lower_bound(fit.theta, fit.multipliers, fit.entropy_slopes)
    except InputError:
        pass
    data = instance.data
    sent = list(instance.constraints.convex)
    for fine in (True, False):
        for accuracy in (1e-9, 1e-12, 1e-7):
            least = data.loss_scale(around)
            sdp = least_squares_sdp(objective, sent, interior, task.bound, around, fine, least)
            solution = clarabel.solve(sdp.conic, accuracy)
            theta = sdp.theta(solution)
            if solution.claims in ("infeasible", "unbounded") or not np.all(np.isfinite(theta)):
                continue
            multipliers, slopes = sdp.multipliers(solution), sdp.entropy_slopes(solution)
            yield theta, instance.lower_bound(theta, multipliers, slopes)


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
