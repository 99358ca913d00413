"""One arm fitted to one repaired log, and the rows that it was fitted to."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sdp_vs_penalty.robot.arrays import Array, Mask, nonzero_or_one

#: A column of which less than this share of its square is outside the basis is spanned
#: by it: rounding errors are no column [-].
_SPANNED_SHARE = 1e-12
#: Columns whose singular value is a smaller share of the largest are dependent [-].
_DEPENDENT_SHARE = 1e-6

#: Share of a torque's energy below which what is left is that of filters and fits.
_LEAST_SHARE = 0.005**2


def text_of_share(share: float, digits: int = 3) -> str:
    """Return the root mean square that is left of a torque, by its share of the energy,
    in words: "2.05 %", or "below 0.5 %"."""
    least = f"below {100.0 * _LEAST_SHARE**0.5:g} %"
    return least if share < _LEAST_SHARE else f"{100.0 * share**0.5:.{digits}g} %"


@dataclass(frozen=True)
class RepairedRows:
    """M rows of n joints under one repair of the motion.

    Columns of one joint alone (friction, rotor, offset: "own" columns) are projected
    out of the s columns that joints share (links).
    """

    #: (n, M, k) orthonormal basis of each joint's own columns.
    basis: Array
    #: (n, M, s) shared columns.
    raw: Array
    #: (n, k, s) coefficients of the shared columns in the basis.
    in_basis: Array
    #: (n, s) whether a column is more than what the basis spans.
    is_shared: Mask
    #: (n, s, s) Gram matrices of ``projected``.
    gram: Array

    @classmethod
    def from_basis(cls, basis: Array, raw: Array) -> RepairedRows:
        """Project each joint's own columns, of orthonormal basis (..., n, M, k), out of
        the shared columns raw (..., n, M, s).

        Returns
        -------
        RepairedRows
            With the Gram matrices of what is left of the columns.
        """
        in_basis = np.swapaxes(basis, -1, -2) @ raw  # (..., n, k, s)
        gram = np.swapaxes(raw, -1, -2) @ raw
        squares = np.diagonal(gram, axis1=-2, axis2=-1).copy()  # (..., n, s)
        gram -= np.swapaxes(in_basis, -1, -2) @ in_basis
        squares_left = np.diagonal(gram, axis1=-2, axis2=-1)
        # Rounding errors of columns that the basis spans are no columns, nor are zeros.
        is_shared = squares_left > _SPANNED_SHARE * squares
        if not is_shared.all():
            gram *= is_shared[..., None, :] & is_shared[..., None]
        return cls(basis, raw, in_basis, is_shared, gram)

    @cached_property
    def projected(self) -> Array:
        """(n, M, s) shared columns with the basis projected out."""
        projected = self.raw - self.basis @ self.in_basis
        return projected * self.is_shared[..., None, :]

    def products_with(self, torques: Array) -> Array:
        """Return the products (n, K, s) of K torques (n, M, K), own columns projected
        out, with what is left of the shared columns."""
        return (torques.swapaxes(1, 2) @ self.raw) * self.is_shared[:, None]

    def project_out_own(self, y: Array) -> Array:
        """Return torques or columns with each joint's own columns projected out.

        It is y - B B^T y, with B (M, k) the joint's orthonormal basis of friction,
        rotor and offset.

        Parameters
        ----------
        y : (..., n, M, K) array
            K torques or columns of each joint.

        Returns
        -------
        (..., n, M, K) array
            Their parts orthogonal to the joint's own columns.
        """
        in_basis = np.swapaxes(self.basis, -1, -2) @ y
        return y - self.basis @ in_basis


@dataclass
class ArmFit:
    """One arm fitted to one repaired log of n joints and M rows."""

    #: (n,) which joints move.
    moving: Mask
    #: Columns of the rows under the repair.
    rows: RepairedRows
    #: (n, M) torque as repaired.
    channels: Array
    #: (s,) the arm's shared parameters.
    theta: Array
    #: (n,) sum over the rows of the squared residual [(N m)^2 or N^2].
    energy_left: Array
    #: (n,) sum over the rows of the squared torque [(N m)^2 or N^2].
    energy: Array

    @cached_property
    def unexplained_shares(self) -> Array:
        """(n,) share of each torque's energy that the arm leaves."""
        return self.energy_left / self.energy

    @property
    def unexplained(self) -> float:
        """Share of the energy of all moving joints' torques together that the arm
        leaves."""
        left = self.energy_left[self.moving].sum()
        return float(left / self.energy[self.moving].sum())

    @property
    def mean_unexplained_share(self) -> float:
        """Mean over the moving joints of the share of energy that the arm leaves."""
        return float(np.mean(self.unexplained_shares[self.moving]))

    @cached_property
    def residual(self) -> Array:
        """(n, M) torque that the arm and the joints' own columns leave [N m or N]."""
        without_own = self.rows.project_out_own(self.channels[:, :, None])[:, :, 0]
        return without_own - self.rows.projected @ self.theta


def orthonormal(columns: Array) -> Array:
    """Return an orthonormal basis of the columns of each of several joints.

    Parameters
    ----------
    columns : (n, M, k) array
        Columns of one joint alone, for each of n joints; k <= M.

    Returns
    -------
    (n, M, k) array
        Orthonormal columns; where columns are dependent, zeros in place of the missing
        vectors.
    """
    norms = np.linalg.norm(columns, axis=1, keepdims=True)
    scaled = columns / nonzero_or_one(norms)
    basis, sizes, _ = np.linalg.svd(scaled, full_matrices=False)  # (n, M, k), (n, k)
    is_independent = sizes > _DEPENDENT_SHARE * sizes.max(
        axis=1, keepdims=True, initial=0.0
    )
    return basis * is_independent[:, None]
