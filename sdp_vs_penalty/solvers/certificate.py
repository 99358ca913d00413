"""Our own judgement of an estimate, independent of whoever computed it.

Primal side: the worst violation of every constraint family, those included that the method never
received. Dual side: for a convex objective f and any multipliers S_i in the (self-dual) cones,

    f(theta) >= l0 + l^T theta                               (a tangent of f)
             >= l0 - sum <S_i, F_i0> + e^T theta             (theta feasible, <S_i, F_i(theta)> >= 0)
             >= l0 - sum <S_i, F_i0> - |e|^T B,              e = l - sum F_i^*(S_i), |theta_k| <= B_k

so that any multipliers, projected onto their cones, give a lower bound on the optimum; good ones
give a tight one. Nothing a solver says about itself enters.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.constraints import ConstraintSet, cone_margin, project
from sdp_vs_penalty.solvers.conic import Objective

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Certificate:
    """violations : worst violation of each family, in its own units (kg, kg m, kg m^2, ...).

    loss : the sum of squared (weighted) torque errors of the estimate; upper : the objective of
    the nearest feasible point towards the interior; lower : a lower bound on the optimum of the
    convex problem; gap : (upper - lower) / max(loss, 1e-12 |tau|^2); positive_mass_matrices : the
    share of random poses at which M(q) is positive definite. None where it does not apply.
    """

    violations: dict[str, float]
    loss: float
    upper: float | None = None
    lower: float | None = None
    gap: float | None = None
    positive_mass_matrices: float | None = None
    smallest_thickness: float | None = None

    def to_dict(self) -> dict[str, Any]:
        return asdict(self)

    @property
    def worst(self) -> float:
        return max(self.violations.values(), default=0.0)


def lower_bound(
    objective: Objective,
    constraints: ConstraintSet,
    multipliers: Sequence[Array],
    theta: Array,
    bound: Array,
) -> float:
    """A lower bound on min objective over the constraints, from multipliers near the dual optimum.

    theta : where the objective is linearised (the closer to the optimum, the tighter the bound);
    bound : (p,) |theta_k| <= bound_k for every feasible theta.
    """
    combined = np.zeros(len(bound))
    constant = 0.0
    for constraint, raw in zip(constraints.convex, multipliers, strict=True):
        multiplier = project(constraint.cone, raw)
        combined[constraint.indices] += constraint.adjoint(multiplier)
        constant -= float(np.sum(multiplier * constraint.constant))
    data = objective.least_squares
    slope = -combined
    if objective.entropy is not None:
        value, gradient = objective.entropy.value(theta), objective.entropy.gradient(theta)
        constant += value - float(gradient @ theta)
        slope = slope + gradient
    # |r|^2 >= 2 y^T r - y^T y for every y. Start from the residual at theta and shift y so that
    # what is left of the slope vanishes wherever the data determine theta.
    y = data.R @ theta - data.rho
    leftover = slope + 2.0 * data.R.T @ y
    shift = np.linalg.lstsq(2.0 * (data.R * bound).T, -bound * leftover, rcond=1e-12)[0]
    y = y + shift
    leftover = slope + 2.0 * data.R.T @ y
    constant += data.floor**2 - 2.0 * float(y @ data.rho) - float(y @ y)
    return constant - float(np.abs(leftover) @ bound)


def repair(constraints: ConstraintSet, theta: Array, interior: Array) -> Array:
    """The first feasible point on the way from theta to an interior point; theta itself if feasible."""

    def feasible(step: float) -> bool:
        point = theta + step * (interior - theta)
        return all(
            cone_margin_batch(stack.cone, stack.values(point)) >= 0.0 for stack in constraints.stacks
        )

    if feasible(0.0):
        return theta
    # Convex: feasible steps are an interval that ends at 1. Search its start by its exponent first,
    # because a solver's violation asks for a tiny step.
    high = 1e-14
    while not feasible(high):
        high *= 10.0
        if high > 1.0:
            high = 1.0
            break
    low = high / 10.0
    for _ in range(30):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if feasible(middle) else (middle, high)
    return theta + high * (interior - theta)


def cone_margin_batch(cone: str, values: Array) -> float:
    """The smallest margin among equal cones, values (g, ...)."""
    if cone == "psd":
        return float(np.linalg.eigvalsh(values).min())
    if cone == "soc":
        return float(np.min(values[:, 0] - np.linalg.norm(values[:, 1:], axis=1)))
    if cone == "nonnegative":
        return float(values.min())
    return min(cone_margin(cone, v) for v in values)
