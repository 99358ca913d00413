"""What an estimate minimises: the squared residual, and what pulls beside it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sdp_vs_penalty.regression.regression import LeastSquares
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.constraint import Constraint, StackedCones, group_cones


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
        """P_0^-1 (links, 4, 4) and log det P_0 (links,) as the doubles that define the
        entropy, for both bounds alike."""
        inverse = np.asarray(np.linalg.inv(self.nominal), float)
        log_det = np.asarray(np.linalg.slogdet(self.nominal)[1], float)
        return 0.5 * (inverse + np.swapaxes(inverse, 1, 2)), log_det

    @cached_property
    def _roots(self) -> Array:
        """L^-1 (links, 4, 4) of P_0 = L L^T."""
        return np.linalg.inv(np.linalg.cholesky(self.nominal))

    @cached_property
    def entries(self) -> StackedCones:
        """The links' pseudo-inertias as functions of theta."""
        return StackedCones.from_groups(group_cones(self.links))

    def value(self, theta: Array) -> float:
        """The prior's value.

        Parameters
        ----------
        theta : (p,)
            Parameters of the model.

        Returns
        -------
        float
            Infinite outside of its domain.
        """
        matrices = self.entries.at(theta)[0].reshape(
            -1,
            4,
            4,
        )
        roots = self._roots
        ratios = np.linalg.eigvalsh(roots @ matrices @ np.swapaxes(roots, 1, 2))
        if (
            ratios.min() <= 0.0
        ):  # not the determinant's sign: two negative eigenvalues hide in it
            return np.inf
        return self.weight * float(np.sum(ratios - np.log(ratios) - 1.0))

    def gradient(self, theta: Array) -> Array:
        """The prior's slope.

        Parameters
        ----------
        theta : (p,)
            Parameters of the model.

        Returns
        -------
        (p,)
            By each parameter.
        """
        slope = self.nominal_terms[0] - np.linalg.inv(
            self.entries.at(theta)[0].reshape(-1, 4, 4)
        )
        return self.weight * self.entries.adjoint(slope.ravel(), len(theta))


@dataclass(frozen=True)
class Objective:
    """loss(theta) [+ entropy] [+ linear (p,) @ theta]: convex, with value and gradient.
    linear : what bounds are proved of (:mod:`extremes`); estimates have none."""

    least_squares: LeastSquares
    entropy: Entropy | None = None
    linear: Array | float = 0.0

    @classmethod
    def without_data(
        cls,
        p: int,
        linear: Array | float = 0.0,
    ) -> Objective:
        """A linear objective alone; zero is what infeasibility is proved of.

        Parameters
        ----------
        p : int
            Number of parameters.
        linear : (p,) or float
            Its slope.

        Returns
        -------
        Objective
            linear @ theta.
        """
        return cls(
            LeastSquares(
                np.zeros((0, p)),
                np.zeros(0),
                0.0,
                0.0,
                0,
            ),
            linear=linear,
        )

    def value(self, theta: Array) -> float:
        """The objective's value.

        Parameters
        ----------
        theta : (p,)
            Parameters of the model.

        Returns
        -------
        float
            Infinite outside of the prior's domain.
        """
        extra = 0.0 if self.entropy is None else self.entropy.value(theta)
        return (
            self.least_squares.loss(theta) + extra + float(np.sum(self.linear * theta))
        )

    def gradient(self, theta: Array) -> Array:
        """The objective's slope.

        Parameters
        ----------
        theta : (p,)
            Parameters of the model.

        Returns
        -------
        (p,)
            By each parameter.
        """
        gradient = self.least_squares.gradient(theta) + self.linear
        return (
            gradient
            if self.entropy is None
            else gradient + self.entropy.gradient(theta)
        )
