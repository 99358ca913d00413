"""Compressed data as products of columns, for many fits with some of the columns.

A fit under constraints needs the products R'R and R'rho, not the triangle R: to leave a
column out is to leave out its row and column, where a triangle is factorised anew.
Products know squared errors to a share of 1e-13 of the squared torque: enough to compare
models, not for a certificate.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import scipy
from numpy.typing import ArrayLike

from sdp_vs_penalty.effects.effect import Parameter
from sdp_vs_penalty.regression.regression import LeastSquares, Regression
from sdp_vs_penalty.robot.arrays import Array, Indices, Mask, nonzero_or_one

#: Ridge relative to the squares of each column, above rounding of the products:
#: directions in which columns of unit length differ by less than its root count as
#: undetermined.
_RIDGE = 1e-13


@dataclass(frozen=True)
class ProductSquares(LeastSquares):
    """A least-squares problem by its products; R (p, p) is their triangle, with a ridge
    that keeps its diagonal above zero."""

    #: (p + 1, p + 1) [Y tau]' [Y tau], the torque last.
    products: Array = field(default_factory=lambda: np.zeros((1, 1)))

    @classmethod
    def from_products(
        cls, products: Array, rows: int, tau_squared: float
    ) -> ProductSquares:
        """Return the problem with these products.

        Parameters
        ----------
        products
            (p + 1, p + 1) products of columns and torque.
        rows
            Number of rows of the data.
        tau_squared
            Squared torque [(N m)^2] of the data.
        """
        gram = products[:-1, :-1]
        scale = nonzero_or_one(np.sqrt(np.diagonal(gram)))
        scaled = gram / scale[:, None] / scale
        scaled[np.diag_indices_from(scaled)] += _RIDGE
        R = np.linalg.cholesky(scaled).T * scale
        rho = scipy.linalg.solve_triangular(
            R, products[:-1, -1], trans="T", check_finite=False
        )
        unexplained = max(float(products[-1, -1] - rho @ rho), 0.0)
        return cls(
            R=R,
            rho=rho,
            residual_norm=unexplained**0.5,
            tau_squared=tau_squared,
            rows=rows,
            products=products,
        )

    @cached_property
    def curvature(self) -> Array:
        """(p, p) Hessian of the loss, 2 Y'Y."""
        return 2.0 * self.products[:-1, :-1]

    def nearest(self, near: ArrayLike) -> Array:
        """Return the least-squares theta (p,) [SI] near ``near``, from which it moves
        only in directions that the data determine.
        """
        theta = np.broadcast_to(np.asarray(near, float), self.rho.shape)
        # The ridge is in R alone: it holds what the data do not determine at theta.
        slope = self.products[:-1, -1] - self.products[:-1, :-1] @ theta
        return theta + scipy.linalg.cho_solve((self.R, False), slope)

    def with_prior(self, scale: ArrayLike, weight: float) -> ProductSquares:
        """Return the data with a prior that pulls parameters to zero.

        Parameters
        ----------
        scale
            (p,) size of each parameter [SI]; infinite: no pull.
        weight
            Weight of the squares [(N m)^2].
        """
        products = self.products.copy()
        diagonal = products.ravel()[:: len(products) + 1]  # a view, the torque's last
        diagonal[:-1] += weight * (1.0 / np.asarray(scale, float)) ** 2
        return self.from_products(products, self.rows, self.tau_squared)

    def with_observations(
        self, rows: Array, values: Array, weight: float
    ) -> ProductSquares:
        """Return the data with observations (k,) of linear functions of the parameters.

        Parameters
        ----------
        rows
            (k, p) coefficients of the functions.
        weight
            Weight of the squares [(N m)^2].
        """
        observations = np.column_stack([rows, values])
        products = self.products + weight * (observations.T @ observations)
        return self.from_products(products, self.rows, self.tau_squared)

    def given(self, values: Mapping[int, float]) -> ProductSquares:
        """Return the data in the other parameters, when some are known.

        Parameters
        ----------
        values
            The known values [SI] by their index in theta.
        """
        known = list(values)
        map_to_others = np.eye(len(self.products))  # from all columns and the torque
        map_to_others[known, known] = 0.0
        map_to_others[known, -1] = [-value for value in values.values()]
        products = map_to_others.T @ self.products @ map_to_others
        return self.from_products(products, self.rows, self.tau_squared)


@dataclass(frozen=True)
class ProductRegression(Regression):
    """The data of one model as the products of its columns; it has no factors."""

    #: (n, p + 1, p + 1) [Y tau]' [Y tau] of each joint, the torque last.
    products: Array = field(default_factory=lambda: np.zeros((0, 1, 1)))
    #: (n,) number of rows of each joint.
    counts: Indices = field(default_factory=lambda: np.zeros(0, np.int64))

    @classmethod
    def from_rows(
        cls, parameters: tuple[Parameter, ...], rows: Sequence[Array]
    ) -> ProductRegression:
        """Multiply the columns and the torque of rows.

        Parameters
        ----------
        parameters
            The p parameters of the columns.
        rows
            Of each of n joints the rows (r, p + 1) [Y tau].
        """
        return cls(
            parameters,
            joints=len(rows),
            blocks=(),
            factors=(),
            oversampling=1.0,
            products=np.stack([of_joint.T @ of_joint for of_joint in rows]),
            counts=np.array([len(of_joint) for of_joint in rows], np.int64),
        )

    def keeping(self, kept_columns: Mask) -> ProductRegression:
        """Return the data in some of the parameters, in the same order.

        Parameters
        ----------
        kept_columns
            (p,) flags: which parameters to keep.
        """
        places = np.flatnonzero(np.append(kept_columns, True))
        return replace(
            self,
            parameters=tuple(self.parameters[k] for k in places[:-1]),
            products=self.products[:, places[:, None], places],
        )

    def least_squares(self, weights: ArrayLike | None = None) -> LeastSquares:
        """Return the rows of all joints as one least-squares problem.

        Parameters
        ----------
        weights
            (n,) factor of each joint's rows; default: 1.
        """
        scale = np.ones(self.joints) if weights is None else np.asarray(weights, float)
        products = np.tensordot(scale**2, self.products, axes=1)
        n_rows = int(self.counts.sum())
        return ProductSquares.from_products(products, n_rows, float(products[-1, -1]))

    def joint_losses(self, theta: ArrayLike) -> Array:
        """Return the squared torque error (n,) of each joint [(N m)^2] with parameters
        theta (p,) [SI]."""
        signed = np.append(np.asarray(theta, float), -1.0)
        return np.maximum((self.products @ signed) @ signed, 0.0)

    def joint_rows(self) -> Indices:
        """Return (n,) the number of rows of each joint."""
        return self.counts

    def column_norms(self) -> Array:
        """Return (n, p + 1) the norm of each joint's columns, the torque last [N m]."""
        return np.sqrt(np.diagonal(self.products, axis1=1, axis2=2))

    def torque_norms(self, theta: ArrayLike) -> Array:
        """Return (n,) the norm of each joint's modelled torque [N m] with parameters
        theta (p,) [SI]."""
        of_columns = np.append(np.asarray(theta, float), 0.0)
        squares = (self.products @ of_columns) @ of_columns
        return np.sqrt(np.maximum(squares, 0.0))
