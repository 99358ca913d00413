"""Identification without an SDP: every link's matrix as L L^T with a positive diagonal.

The log-Cholesky parametrisation of Rucker and Wensing ("Smooth parameterization of rigid-body
inertia", RA-L 2022): consistency holds by construction. A link with a minimum thickness gets the
4x4 matrix of that demand, which contains the pseudo-inertia. What remains (bounds, cones) is
imposed by SciPy's SLSQP, which is started again from where it stops until it gains nothing; the
problem is no longer convex.
"""

from __future__ import annotations

import time
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import optimize

from sdp_vs_penalty.constraints.constraint import Constraint
from sdp_vs_penalty.shootout.instance import Instance
from sdp_vs_penalty.shootout.judge import Answer

Array = NDArray[np.float64]

_RESTARTS = 3
_LOWER = np.tril_indices(4)
_DIAGONAL = _LOWER[0] == _LOWER[1]


def solve(instance: Instance, accuracy: float) -> Answer:
    """Minimise the objective over log-Cholesky variables by SLSQP from the interior point."""
    start = time.perf_counter()
    interior = instance.interior
    if interior is None:
        nothing = np.full(len(instance.task.bound), np.nan)
        return Answer(nothing, "failed", "no interior point to start from", 0, 0.0, 0.0)
    links, remaining = _split(instance.constraints.convex)
    chart = _Chart(links, instance.task.bound, interior)
    objective = instance.objective
    data = objective.least_squares
    size = max(data.loss(instance.task.ols), 1e-9 * data.tau_squared, 1e-300)

    def value(x: Array) -> float:
        return objective.value(chart.theta(x)) / size

    def slope(x: Array) -> Array:
        return chart.pull(x, objective.gradient(chart.theta(x))) / size

    demands = []
    if remaining:
        rows = _Rows(remaining, interior)
        demands = [
            {
                "type": "ineq",
                "fun": lambda x: rows.values(chart.theta(x)),
                "jac": lambda x: chart.pull_rows(x, rows.jacobian(chart.theta(x))),
            }
        ]
    begin = chart.variables(interior)
    ready = time.perf_counter()
    x, steps = begin, 0
    reached, message, success = value(begin), "", False
    for _ in range(_RESTARTS):
        result = optimize.minimize(
            value,
            x,
            jac=slope,
            method="SLSQP",
            constraints=demands,
            options={"maxiter": 300, "ftol": 1e-2 * accuracy},
        )
        steps += int(result.nit)
        message, success = str(result.message), bool(result.success)
        gained = reached - float(result.fun)
        if not np.isfinite(result.fun) or gained <= 0.0:
            break
        x, reached = result.x, float(result.fun)
        if gained <= accuracy * max(reached, 1e-12 * data.tau_squared / size):
            break
    end = time.perf_counter()
    claims = "optimal" if success else "failed"
    return Answer(chart.theta(x), claims, message, steps, ready - start, end - ready)


def _split(convex: Sequence[Constraint]) -> tuple[list[Constraint], list[Constraint]]:
    """One 4x4 demand of each link for the chart, and what has to be imposed beside it."""
    owner: dict[int, Constraint] = {}
    for c in convex:
        whole = c.cone == "psd" and c.constant.shape == (4, 4) and len(c.indices) == 10
        if whole and (c.family == "minimum thickness" or int(c.indices[0]) not in owner):
            owner[int(c.indices[0])] = c
    kept = [c for c in convex if c.cone != "psd"]
    return list(owner.values()), kept


class _Chart:
    """theta from unconstrained variables: ten log-Cholesky a link, the others scaled by their size."""

    def __init__(self, links: Sequence[Constraint], bound: Array, inside: Array) -> None:
        self.links = links
        self.inside = inside
        covered = np.concatenate([np.zeros(0, np.intp), *(c.indices for c in links)]).astype(np.intp)
        self.others = np.setdiff1d(np.arange(len(bound)), covered)
        self.scale = np.maximum(np.abs(inside[self.others]), 1e-2)
        self.maps, self.corners = [], []
        for c in links:
            flat = c.coefficients.reshape(10, 16)
            self.maps.append(np.asarray(np.linalg.pinv(flat), float))  # (16, 10): theta from the matrix
            self.corners.append(np.sqrt(np.diagonal(c.value(inside))))

    def variables(self, theta: Array) -> Array:
        """The variables of a strictly feasible theta."""
        parts = []
        for c, corner in zip(self.links, self.corners, strict=True):
            factor = np.linalg.cholesky(c.value(theta) / np.outer(corner, corner))
            x = factor[_LOWER]
            x[_DIAGONAL] = np.log(x[_DIAGONAL])
            parts.append(x)
        return np.concatenate([*parts, theta[self.others] / self.scale])

    def _factors(self, x: Array) -> list[Array]:
        out = []
        for k in range(len(self.links)):
            part = x[10 * k : 10 * k + 10].copy()
            part[_DIAGONAL] = np.exp(np.clip(part[_DIAGONAL], -40.0, 40.0))
            factor = np.zeros((4, 4))
            factor[_LOWER] = part
            out.append(factor)
        return out

    def theta(self, x: Array) -> Array:
        theta = np.zeros(len(self.inside))
        for c, back, corner, factor in zip(
            self.links, self.maps, self.corners, self._factors(x), strict=True
        ):
            matrix = factor @ factor.T * np.outer(corner, corner) - c.constant
            theta[c.indices] = matrix.reshape(16) @ back
        theta[self.others] = x[10 * len(self.links) :] * self.scale
        return theta

    def pull(self, x: Array, gradient: Array) -> Array:
        """Gradient in x from the gradient in theta."""
        return self.pull_rows(x, gradient[None])[0]

    def pull_rows(self, x: Array, jacobian: Array) -> Array:
        """(r, len x) from (r, p), by the chain rule through L L^T."""
        out = np.zeros((len(jacobian), len(x)))
        for k, (c, back, corner, factor) in enumerate(
            zip(self.links, self.maps, self.corners, self._factors(x), strict=True)
        ):
            weight = (jacobian[:, c.indices] @ back.T).reshape(-1, 4, 4) * np.outer(corner, corner)
            weight = weight + np.swapaxes(weight, 1, 2)
            part = np.einsum("rab,bc->rac", weight, factor)[:, _LOWER[0], _LOWER[1]]
            part[:, _DIAGONAL] *= np.diagonal(factor)[_LOWER[0][_DIAGONAL]]
            out[:, 10 * k : 10 * k + 10] = part
        out[:, 10 * len(self.links) :] = jacobian[:, self.others] * self.scale
        return out


class _Rows:
    """The constraints that are not matrices as g(theta) >= 0, each of about unit size."""

    def __init__(self, constraints: Sequence[Constraint], inside: Array) -> None:
        self.linear = [c for c in constraints if c.cone == "nonnegative"]
        self.cones = [c for c in constraints if c.cone == "soc"]
        self.p = len(inside)
        self.size = np.maximum(np.abs(self._raw(inside)), 1e-6)

    def _raw(self, theta: Array) -> Array:
        parts = [c.value(theta) for c in self.linear]
        for c in self.cones:
            v = c.value(theta)
            parts.append(np.array([v[0] - np.sqrt(v[1:] @ v[1:] + 1e-24)]))
        return np.concatenate(parts)

    def values(self, theta: Array) -> Array:
        return self._raw(theta) / self.size

    def jacobian(self, theta: Array) -> Array:
        rows = []
        for c in self.linear:
            part = np.zeros((len(c.constant), self.p))
            part[:, c.indices] = c.coefficients.T
            rows.append(part)
        for c in self.cones:
            v = c.value(theta)
            direction = np.concatenate([[1.0], -v[1:] / np.sqrt(v[1:] @ v[1:] + 1e-24)])
            part = np.zeros((1, self.p))
            part[0, c.indices] = c.coefficients @ direction
            rows.append(part)
        return np.concatenate(rows) / self.size[:, None]
