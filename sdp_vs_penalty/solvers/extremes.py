"""The smallest value of a linear function over feasible parameters, certified from the
dual.

A :class:`Slice` is the feasible set cut by equalities, theta = interior + basis x. Its
constraints in x are ordinary ones, each scaled so that the interior point becomes its
unit: Clarabel then sees a problem of size one whatever the units, and
:mod:`fit` makes a lower bound of its multipliers.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.constraint import Constraint, ConstraintSet
from sdp_vs_penalty.solvers import make_solver
from sdp_vs_penalty.solvers.convex_problem import ConvexProblem
from sdp_vs_penalty.solvers.fit import Fit, dual_evidence, repair
from sdp_vs_penalty.solvers.identification import (
    SdpProblem,
    conic_problem,
    largest_margin,
    scaled,
)
from sdp_vs_penalty.solvers.rigorous_bounds import lower_bound

#: Decimals of a direction of length one in which directions are told apart.
_SAME_DIRECTION = 12


@dataclass(frozen=True)
class Extreme:
    """The smallest value of a linear function on a slice."""

    #: Value that ``theta`` attains.
    value: float
    #: Proved lower bound: no feasible theta is below it.
    bound: float
    #: (p,) feasible parameters that attain the value.
    theta: Array


class Slice:
    """All feasible parameters with the same equalities @ theta as a given theta (p,).

    They are ``interior`` + ``basis`` x, with basis (p, k) and coordinates x (k,), whose
    |x_k| <= ``limit``_k. ``reduced`` are the constraints in x, ``sdp`` their conic form.
    """

    def __init__(
        self, constraints: ConstraintSet, equalities: Array, theta: Array, bound: Array
    ) -> None:
        """Find an interior point of the slice, a basis of it, and limits of its
        coordinates. Raises InputError if the slice has no interior point.

        Parameters
        ----------
        equalities : (e, p) array
            Rows whose products with theta hold the slice.
        theta : (p,) array
            A point of the slice, feasible or not.
        bound : (p,) array
            |theta_k| <= bound_k wherever the constraints hold.
        """
        self.solver = make_solver("clarabel")
        # Directions free (p, k) that change no equality.
        rows = equalities / np.linalg.norm(equalities, axis=1, keepdims=True)
        free = scipy.linalg.null_space(rows, rcond=1e-10)
        if free.shape[1] == 0:
            raise InputError(
                "the equalities leave no parameter free", "leave some of them out"
            )
        self.constraints = constraints
        self.interior = _interior(constraints, free, theta, bound)
        # All constraints have about the same scale in a basis in which the columns of
        # all scaled constraints together are orthonormal.
        on_slice = [_reduced(c, free, self.interior) for c in constraints.convex]
        columns = _posed(on_slice).conic.A
        r = np.linalg.qr(columns.toarray(), mode="r")
        self.basis = scipy.linalg.solve_triangular(r, free.T, trans="T").T
        self.reduced = ConstraintSet(
            tuple(_reduced(c, self.basis, self.interior) for c in constraints.convex)
        )
        self.sdp = _posed(self.reduced.convex)
        # Limits of x = r free^T (theta - interior), since free is orthonormal.
        largest_step = bound + np.abs(self.interior)
        self.limit = np.abs(r @ free.T) @ largest_step
        self.limit = np.minimum(self.limit, self._certified_limits())
        #: Direction g, minimiser and lower bound of each problem solved, by rounded g.
        self._solutions: dict[bytes, tuple[Array, Array, float]] = {}

    def _certified_limits(self) -> Array:
        """Return limits (k,) of |x_k| from certified lower bounds of x_k and of -x_k."""
        lowest = []
        for axis in np.eye(len(self.limit)):
            _, lower = self._solve(axis)
            _, minus_upper = self._solve(-axis)
            lowest.append(min(lower, minus_upper))
        return -np.array(lowest)

    def minimum(self, slope: Array) -> Extreme:
        """Return the smallest value of a linear function over the slice.

        Parameters
        ----------
        slope : (p,)
            Coefficients of the function slope^T theta.

        Returns
        -------
        Extreme
            Value, the point theta that attains it, and a certified lower bound.
        """
        g = self.basis.T @ slope
        size = float(np.linalg.norm(g))
        value_at_interior = float(slope @ self.interior)
        terms = slope * (np.abs(self.interior) + 1e-12)
        if size <= 1e-12 * float(np.linalg.norm(terms)):
            # The function is constant on the slice up to rounding, which this bound
            # contains.
            spread = float(np.abs(g) @ self.limit)
            return Extreme(value_at_interior, value_at_interior - spread, self.interior)
        theta, lower = self._minimiser_and_bound(g / size)
        return Extreme(float(slope @ theta), value_at_interior + size * lower, theta)

    def maximum(self, slope: Array) -> Extreme:
        """Return the largest value of a linear function over the slice.

        Parameters
        ----------
        slope : (p,)
            Coefficients of the function slope^T theta.

        Returns
        -------
        Extreme
            Value, the point theta that attains it, and a certified upper bound.
        """
        minimum = self.minimum(-slope)
        return replace(minimum, value=-minimum.value, bound=-minimum.bound)

    def _minimiser_and_bound(self, g: Array) -> tuple[Array, float]:
        """Return a feasible minimiser theta (p,) of g^T x, with |g| = 1, and a certified
        lower bound of the minimum.

        Each direction g (k,), up to rounding, is solved for once, and read then: where a
        function of time scales the coefficients, most directions come again.
        """
        key = (np.round(g, _SAME_DIRECTION) + 0.0).tobytes()  # no negative zeros
        if key not in self._solutions:
            x, lower = self._solve(g)
            optimum = self.interior + self.basis @ x
            theta = repair(self.constraints, optimum, self.interior)
            self._solutions[key] = g, theta, lower
        solved_for, theta, lower = self._solutions[key]
        # The bound is that of the direction that was solved for.
        return theta, lower - float(np.abs(g - solved_for) @ self.limit)

    def _solve(self, g: Array) -> tuple[Array, float]:
        """Minimise g^T x over the slice's coordinates x (k,), with |g| = 1.

        Returns the solver's x (k,) and a certified lower bound of the minimum, from the
        solver's multipliers and the limits |x_k| <= limit_k.
        """
        problem = replace(self.sdp.conic, q=g)
        solution = self.solver.solve(problem, 1e-10)
        multipliers = self.reduced.stack_multipliers(self.sdp.multipliers(solution))
        linear = ConvexProblem.without_data(self.reduced, self.limit, g)
        evidence = dual_evidence(Fit(solution.x, linear, multipliers))
        return solution.x, lower_bound(linear, evidence)


def _interior(
    constraints: ConstraintSet, free: Array, theta: Array, bound: Array
) -> Array:
    """Return the point of the slice through theta with the largest scaled margin.

    ``free`` (p, k) spans the slice. Raises InputError if no point is strictly inside.
    """
    reduced = [_reduced(c, free, theta) for c in constraints.convex]
    reach = np.abs(free.T) @ (bound + np.abs(theta))
    problem = largest_margin(reduced, np.zeros(free.shape[1]), reach)
    solution = make_solver("clarabel").solve(problem.conic, 1e-9)
    point = theta + free @ problem.theta(solution)
    margin = constraints.margin(point)
    if not margin > 0.0:
        raise InputError(
            "No parameters with these equalities lie strictly inside all constraints"
            f" (largest margin {margin:.1e})",
            "start from an estimate with a minimum thickness, or relax the bounds that"
            " it touches",
        )
    return point


def _reduced(constraint: Constraint, free: Array, origin: Array) -> Constraint:
    """Return a constraint on theta as one on x (k,), with theta = origin + free x.

    constant' = F(origin), coefficients'_k = sum_i free_ik F_i; free is (p, k).
    """
    coefficients = np.tensordot(
        free[constraint.indices].T, constraint.coefficients, axes=(1, 0)
    )
    return replace(
        constraint,
        indices=np.arange(free.shape[1]),
        constant=constraint.value(origin),
        coefficients=coefficients,
    )


def _posed(reduced: Sequence[Constraint]) -> SdpProblem:
    """Return constraints in x as a conic problem without objective, cones scaled at x =
    0.
    """
    k = len(reduced[0].indices)
    groups, placed = scaled(reduced, np.zeros(k), np.ones(k), np.zeros(k))
    return SdpProblem(
        conic_problem(groups, None, np.zeros(k)),
        centre=np.zeros(k),
        theta_scale=np.ones(k),
        loss_scale=1.0,
        placed=placed,
    )
