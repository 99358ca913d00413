"""The smallest value of a linear function over feasible parameters, certified from the dual.

A :class:`Slice` is the feasible set cut by equalities, theta = interior + basis x. In x,

    minimise g^T x   subject to   F_i(interior) + sum_k x_k <basis_k, F_i> in K_i

is a small conic problem. Every cone is scaled so that the interior point becomes its unit, and x so
that all columns together are orthonormal: Clarabel then sees a problem of size one whatever the
units. Any multipliers z in the (self-dual) cones bound it, with |x_k| <= X_k on the slice:

    g^T x >= -<z, b> + (g - A^T z)^T x >= -<z, b> - |g - A^T z|^T X.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg
from scipy import sparse

from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.constraint import Constraint, ConstraintSet, project
from sdp_vs_penalty.solvers import clarabel
from sdp_vs_penalty.solvers.certificate import repair
from sdp_vs_penalty.solvers.conic import Cone, ConicProblem, svec, unsvec
from sdp_vs_penalty.solvers.identification import largest_margin

#: Share of the largest singular value below which an equality repeats the others.
_RANK = 1e-10
#: Rounds of pushing the dual's residual into the multipliers; each gives a valid bound.
_DUAL_ROUNDS = 4


@dataclass(frozen=True)
class Extreme:
    """The smallest value of a linear function on a slice.

    value : attained by the feasible ``theta`` (p,); bound : no feasible theta is below it.
    """

    value: float
    bound: float
    theta: Array


@dataclass(frozen=True)
class Slice:
    """Feasible theta (p,) = interior + basis x, basis (p, k) with A^T A = 1 after scaling.

    cones : kind and size of each constraint; A (rows, k), b (rows,) : -F(theta) scaled, as
    A x + s = b with s in the cones; limit (k,) : |x_k| <= limit_k on the slice.
    """

    constraints: ConstraintSet
    interior: Array
    basis: Array
    cones: tuple[Cone, ...]
    A: Array
    b: Array
    limit: Array

    @classmethod
    def of(cls, constraints: ConstraintSet, equalities: Array, theta: Array, bound: Array) -> Slice:
        """All feasible parameters with the same equalities @ theta as the given one.

        equalities (e, p); theta (p,), feasible or not; bound (p,) : |theta_k| <= bound_k wherever
        the constraints hold. Raises InputError where the slice has no interior point.
        """
        free = _null_space(equalities / np.linalg.norm(equalities, axis=1, keepdims=True))
        if free.shape[1] == 0:
            raise InputError("the equalities leave no parameter free", "leave some of them out")
        interior = _interior(constraints, free, theta, bound)
        cones, rows, b = _scaled(constraints.convex, free, interior)
        q, r = np.linalg.qr(rows)
        basis = scipy.linalg.solve_triangular(r, free.T, trans="T").T
        # x = r free^T (theta - interior): free has orthonormal columns.
        limit = np.abs(r @ free.T) @ (bound + np.abs(interior))
        return cls(constraints, interior, basis, cones, q, b, limit)._tightened()

    def _tightened(self) -> Slice:
        """The same slice with limits from its own certified extremes: implied ones are generous."""
        limit = self.limit.copy()
        for k, row in enumerate(np.eye(len(limit))):
            lower, upper = (self._solve(sign * row)[1] for sign in (1.0, -1.0))
            limit[k] = min(limit[k], max(-lower, -upper))
        return replace(self, limit=limit)

    def minimum(self, slope: Array) -> Extreme:
        """min slope^T theta over the slice; slope (p,)."""
        g = self.basis.T @ slope
        size = float(np.linalg.norm(g))
        middle = float(slope @ self.interior)
        if size <= 1e-12 * float(np.linalg.norm(slope * (np.abs(self.interior) + 1e-12))):
            # The function is constant on the slice up to rounding, which this bound contains.
            spread = float(np.abs(g) @ self.limit)
            return Extreme(middle, middle - spread, self.interior)
        x, lower = self._solve(g / size)
        theta = repair(self.constraints, self.interior + self.basis @ x, self.interior)
        return Extreme(float(slope @ theta), middle + size * lower, theta)

    def maximum(self, slope: Array) -> Extreme:
        """max slope^T theta: no feasible theta is above its ``bound``."""
        found = self.minimum(-slope)
        return replace(found, value=-found.value, bound=-found.bound)

    def _solve(self, g: Array) -> tuple[Array, float]:
        """A solver's minimiser of g^T x, |g| = 1, and our own lower bound of that minimum."""
        quadratic = sparse.csc_matrix((len(g), len(g)))
        problem = ConicProblem(quadratic, g, sparse.csc_matrix(self.A), self.b, self.cones)
        solution = clarabel.solve(problem, 1e-10)
        return solution.x, self._bound(g, solution.z)

    def _bound(self, g: Array, z: Array) -> float:
        best = -np.inf
        z = self._projected(z)
        for _ in range(_DUAL_ROUNDS):
            leftover = g + self.A.T @ z
            best = max(best, -float(z @ self.b) - float(np.abs(leftover) @ self.limit))
            # A has orthonormal columns: this step removes the residual, up to the projection.
            z = self._projected(z - self.A @ leftover)
        return best

    def _projected(self, z: Array) -> Array:
        out, start = np.empty_like(z), 0
        for cone in self.cones:
            part = z[start : start + cone.rows]
            if cone.kind == "psd":
                part = svec(project("psd", unsvec(part, cone.size)))
            else:
                part = project(cone.kind, part)
            out[start : start + cone.rows] = part
            start += cone.rows
        return out


def _null_space(matrix: Array) -> Array:
    _, s, vt = np.linalg.svd(matrix)
    rank = int(np.sum(s > _RANK * s[0])) if len(s) else 0
    return np.asarray(vt[rank:].T)


def _interior(constraints: ConstraintSet, free: Array, theta: Array, bound: Array) -> Array:
    """The point of the slice through theta with the largest scaled margin."""
    reduced = [_reduced(c, free, theta) for c in constraints.convex]
    reach = np.abs(free.T) @ (bound + np.abs(theta))
    problem = largest_margin(reduced, np.zeros(free.shape[1]), reach)
    solution = clarabel.solve(problem.conic, 1e-9)
    point = theta + free @ problem.theta(solution)
    margin = constraints.margin(point)
    if not margin > 0.0:
        raise InputError(
            "No parameters with these equalities lie strictly inside all constraints (largest "
            f"margin {margin:.1e})",
            ("start from an estimate with a minimum thickness, or relax the bounds that it touches"),
        )
    return point


def _reduced(c: Constraint, free: Array, origin: Array) -> Constraint:
    """The constraint in x with theta = origin + free x."""
    coefficients = np.tensordot(free[c.indices].T, c.coefficients, axes=(1, 0))
    return replace(
        c, indices=np.arange(free.shape[1]), constant=c.value(origin), coefficients=coefficients
    )


def _scaled(
    constraints: Sequence[Constraint], free: Array, interior: Array
) -> tuple[tuple[Cone, ...], Array, Array]:
    """Cones, rows and right hand side with F(interior) turned into the unit of each cone."""
    cones, rows, right = [], [], []
    for c in constraints:
        at = c.value(interior)
        coefficients = _reduced(c, free, interior).coefficients
        if c.cone == "psd":
            half = np.linalg.inv(np.linalg.cholesky(at))
            cones.append(Cone("psd", len(at)))
            rows.append(-svec(half @ coefficients @ half.T).T)
            right.append(svec(np.eye(len(at))))
        else:
            scale = 1.0 / at if c.cone == "nonnegative" else np.full(len(at), 1.0 / at[0])
            cones.append(Cone(c.cone, len(at)))
            rows.append(-(coefficients * scale).T)
            right.append(at * scale)
    return tuple(cones), np.vstack(rows), np.concatenate(right)
