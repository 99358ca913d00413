"""The convex problem that estimates, bounds, ranges and proofs share: what is minimised
over which theta."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sdp_vs_penalty.regression.regression import LeastSquares
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.constraint import (
    Constraint,
    ConstraintSet,
    StackedCones,
    group_cones,
)


@dataclass(frozen=True)
class Entropy:
    """weight * sum over links of the Bregman divergence of -log det from P_0 to
    P(theta).

    D(P || P0) = -log det P + tr(P0^-1 P) + log det P0 - 4 (Lee, Wensing, Park, T-RO
    2020, eq. 25): convex, coordinate-free, infinite at the boundary of consistency.
    """

    weight: float
    links: tuple[Constraint, ...]  # each link's pseudo-inertia
    nominal: Array  # (links, 4, 4)

    @cached_property
    def nominal_terms(self) -> tuple[Array, Array]:
        """P_0^-1 (links, 4, 4) and log det P_0 (links,) of the nominal pseudo-inertias.

        These doubles define the prior, so that upper and lower bound use the same
        numbers.
        """
        inverse = np.asarray(np.linalg.inv(self.nominal), float)
        log_det = np.asarray(np.linalg.slogdet(self.nominal)[1], float)
        return 0.5 * (inverse + np.swapaxes(inverse, 1, 2)), log_det

    @cached_property
    def _roots(self) -> Array:
        """L^-1 (links, 4, 4) of the Cholesky factors P_0 = L L^T."""
        return np.linalg.inv(np.linalg.cholesky(self.nominal))

    @cached_property
    def entries(self) -> StackedCones:
        """Pseudo-inertias of the links as functions of theta."""
        return StackedCones.from_groups(group_cones(self.links))

    def value(self, theta: Array) -> float:
        """Return the value of the prior, w sum (tr(P_0^-1 P) - log det(P_0^-1 P) - 4).

        The sum is over the links' pseudo-inertias P(theta) (4x4), P_0 the nominal ones.
        With the eigenvalues r of P_0^-1 P it is w sum (r - ln r - 1).

        Returns
        -------
        float
            Infinite unless all pseudo-inertias are positive definite.
        """
        pseudo_inertias = self.entries.at(theta)[0].reshape(-1, 4, 4)
        roots = self._roots  # L^-1 with P_0 = L L^T
        # Eigenvalues r of P_0^-1 P: a determinant's sign hides two negative ones.
        ratios = np.linalg.eigvalsh(roots @ pseudo_inertias @ np.swapaxes(roots, 1, 2))
        if ratios.min() <= 0.0:
            return np.inf
        return self.weight * float(np.sum(ratios - np.log(ratios) - 1.0))

    def gradient(self, theta: Array) -> Array:
        """Return the gradient of the prior.

        Returns
        -------
        (p,)
            Gradient weight (P_0^-1 - P(theta)^-1), as derivatives by the parameters.
        """
        pseudo_inertias = self.entries.at(theta)[0].reshape(-1, 4, 4)
        nominal_inverse, _ = self.nominal_terms
        slope = nominal_inverse - np.linalg.inv(pseudo_inertias)
        return self.weight * self.entries.adjoint(slope.ravel(), len(theta))


@dataclass(frozen=True)
class ConvexProblem:
    """Minimise loss(theta) [+ entropy] [+ linear @ theta] over the convex constraints.

    |theta_k| <= bound_k follows from them; nothing else is known of the set.
    """

    #: The sum of squared (weighted) residuals.
    least_squares: LeastSquares
    #: What theta has to fulfil; those that are not convex are only judged.
    constraints: ConstraintSet
    #: (p,) with |theta_k| <= bound_k for every feasible theta.
    bound: Array
    #: The entropic prior; None without one.
    entropy: Entropy | None = None
    #: Slope (p,) of a linear term, of which bounds are proved (:mod:`extremes`);
    #: estimates have none.
    linear: Array | float = 0.0

    @classmethod
    def without_data(
        cls, constraints: ConstraintSet, bound: Array, linear: Array | float = 0.0
    ) -> ConvexProblem:
        """Return the problem of the least linear @ theta, without data. With a linear
        of zero it proves infeasibility."""
        nothing = LeastSquares(np.zeros((0, len(bound))), np.zeros(0), 0.0, 0.0, 0)
        return cls(nothing, constraints, bound, linear=linear)

    def value(self, theta: Array) -> float:
        """Return the objective at theta (p,): loss, prior and linear term; infinite
        outside of the prior's domain."""
        prior = 0.0 if self.entropy is None else self.entropy.value(theta)
        linear = float(np.sum(self.linear * theta))
        return self.least_squares.loss(theta) + prior + linear

    def gradient(self, theta: Array) -> Array:
        """Return the gradient (p,) of the objective by theta (p,)."""
        gradient = self.least_squares.gradient(theta) + self.linear
        if self.entropy is None:
            return gradient
        return gradient + self.entropy.gradient(theta)

    @cached_property
    def essential(self) -> tuple[Constraint, ...]:
        """The convex constraints without those that others or the data imply.

        The range of a parameter is implied if reaching its end makes more torque than
        was measured, whatever the other parameters do. Redundant rows leave the dual
        undetermined, which costs a solver digits; feasibility and certificate use all
        constraints.
        """
        torque = self.least_squares.own_torque
        largest = np.sqrt(self.least_squares.tau_squared)

        def can_be_reached(c: Constraint) -> bool:
            """Return whether the end of a range needs no more torque than was
            measured."""
            # From the rows themselves, so that it holds in any system of units.
            reach = float(np.min(c.constant / np.abs(c.coefficients).max(axis=0)))
            return bool(np.any(reach * torque[c.indices] <= largest))

        return tuple(
            c
            for c in self.constraints.essential
            if c.family != "range" or can_be_reached(c)
        )
