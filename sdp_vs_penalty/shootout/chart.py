"""Every link's matrix as L L^T with a positive diagonal: theta from variables without constraints.

The log-Cholesky parametrisation of Rucker and Wensing ("Smooth parameterization of rigid-body
inertia", RA-L 2022): consistency holds by construction. A link with a minimum thickness gets the 4x4
matrix of that demand, which contains the pseudo-inertia. L is in units of an interior point.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.constraints.constraint import Constraint

Array = NDArray[np.float64]

#: Rows and columns of a link's ten variables in L, and which of them are logarithms.
ROWS, COLUMNS = np.tril_indices(4)
DIAGONAL = ROWS == COLUMNS


def owners(constraints: Sequence[Constraint]) -> list[Constraint]:
    """One 4x4 demand of each link, which the chart fulfils."""
    found: dict[int, Constraint] = {}
    for c in constraints:
        whole = c.cone == "psd" and c.constant.shape == (4, 4) and len(c.indices) == 10
        if whole and (c.family == "minimum thickness" or int(c.indices[0]) not in found):
            found[int(c.indices[0])] = c
    return list(found.values())


@dataclass(frozen=True)
class Chart:
    """x holds ten variables a link, then the other parameters in units of ``scale``.

    maps : (16, 10) from each link's matrix to its parameters; corners : (4,) units of each L's rows.
    """

    size: int
    links: tuple[Constraint, ...]
    maps: tuple[Array, ...]
    corners: tuple[Array, ...]
    others: NDArray[np.intp]
    scale: Array

    @classmethod
    def at(cls, links: Sequence[Constraint], inside: Array) -> Chart:
        """The chart in which the strictly feasible ``inside`` has factors with rows of length one."""
        covered = np.concatenate([np.zeros(0, np.intp), *(c.indices for c in links)]).astype(np.intp)
        others = np.setdiff1d(np.arange(len(inside)), covered)
        maps = tuple(np.asarray(np.linalg.pinv(c.coefficients.reshape(10, 16))) for c in links)
        corners = tuple(np.sqrt(np.diagonal(c.value(inside))) for c in links)
        scale = np.maximum(np.abs(inside[others]), 1e-2)
        return cls(len(inside), tuple(links), maps, corners, others, scale)

    def variables(self, theta: Array) -> Array:
        """The variables of a strictly feasible theta. Raises LinAlgError for another."""
        parts = []
        for c, corner in zip(self.links, self.corners, strict=True):
            factor = np.linalg.cholesky(c.value(theta) / np.outer(corner, corner))
            x = factor[ROWS, COLUMNS]
            x[DIAGONAL] = np.log(x[DIAGONAL])
            parts.append(x)
        return np.concatenate([*parts, theta[self.others] / self.scale])

    def _factors(self, x: Array) -> Array:
        """(links, 4, 4) L of each link."""
        entries = x[: 10 * len(self.links)].reshape(-1, 10).copy()
        entries[:, DIAGONAL] = np.exp(np.clip(entries[:, DIAGONAL], -40.0, 40.0))
        factors = np.zeros((len(entries), 4, 4))
        factors[:, ROWS, COLUMNS] = entries
        return factors

    def theta(self, x: Array) -> Array:
        theta = np.zeros(self.size)
        parts = zip(self.links, self.maps, self.corners, self._factors(x), strict=True)
        for c, back, corner, factor in parts:
            matrix = factor @ factor.T * np.outer(corner, corner) - c.constant
            theta[c.indices] = matrix.ravel() @ back
        theta[self.others] = x[10 * len(self.links) :] * self.scale
        return theta

    def pull(self, x: Array, jacobian: Array) -> Array:
        """(r, len x) derivatives with respect to x from those (r, p) with respect to theta."""
        out = np.zeros((len(jacobian), len(x)))
        parts = zip(self.links, self.maps, self.corners, self._factors(x), strict=True)
        for k, (c, back, corner, factor) in enumerate(parts):
            # d<W, L L^T> = 2 <W L, dL> for a symmetric W
            pulled = 2.0 * self._weights(jacobian[:, c.indices], back, corner) @ factor
            part = pulled[:, ROWS, COLUMNS]
            part[:, DIAGONAL] *= factor[ROWS, COLUMNS][DIAGONAL]
            out[:, 10 * k : 10 * k + 10] = part
        out[:, 10 * len(self.links) :] = jacobian[:, self.others] * self.scale
        return out

    @staticmethod
    def _weights(slopes: Array, back: Array, corner: Array) -> Array:
        """(r, 4, 4) symmetric W with slope^T dtheta = <W, d(L L^T)>."""
        weights = (slopes @ back.T).reshape(-1, 4, 4) * np.outer(corner, corner)
        return np.asarray(0.5 * (weights + np.swapaxes(weights, 1, 2)))

    def curvature(self, x: Array, slope: Array) -> Array:
        """(len x, len x) sum_k slope_k times the Hessian of theta_k: blocks of ten."""
        out = np.zeros((len(x), len(x)))
        same_column = COLUMNS[:, None] == COLUMNS[None, :]
        parts = zip(self.links, self.maps, self.corners, self._factors(x), strict=True)
        for k, (c, back, corner, factor) in enumerate(parts):
            (weight,) = self._weights(slope[c.indices][None], back, corner)
            grows = np.where(DIAGONAL, factor[ROWS, COLUMNS], 1.0)  # dL / dx, entry by entry
            block = 2.0 * weight[np.ix_(ROWS, ROWS)] * same_column * np.outer(grows, grows)
            again = np.where(DIAGONAL, 2.0 * (weight @ factor)[ROWS, COLUMNS] * grows, 0.0)
            out[10 * k : 10 * k + 10, 10 * k : 10 * k + 10] = block + np.diag(again)
        return out
