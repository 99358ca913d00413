"""Links that are consistent by construction: theta from log-Cholesky variables without constraints.

Each link has one matrix that must be positive definite, P = L L^T in units of an interior point; of a
link with a minimum thickness the 4x4 matrix of that demand, which contains the pseudo-inertia. L is
triangular and the logarithms of its diagonal are variables (Rucker and Wensing, "Smooth parameterization
of rigid-body inertia", RA-L 2022).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.constraints.constraint import Constraint
from sdp_vs_penalty.robot.arrays import Array

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
class LogCholesky:
    """Ten variables a link, then the other parameters in units of ``scale``.

    maps : (16, 10) from each link's matrix to its parameters; corners : (4,) units of each L's rows.
    """

    size: int
    links: tuple[Constraint, ...]
    maps: tuple[Array, ...]
    corners: tuple[Array, ...]
    others: NDArray[np.intp]
    scale: Array

    @classmethod
    def at(cls, links: Sequence[Constraint], inside: Array) -> LogCholesky:
        """The chart in which the strictly feasible ``inside`` has factors with rows of length one."""
        covered = np.concatenate([np.zeros(0, np.intp), *(c.indices for c in links)]).astype(np.intp)
        others = np.setdiff1d(np.arange(len(inside)), covered)
        maps = tuple(np.asarray(np.linalg.pinv(c.coefficients.reshape(10, 16))) for c in links)
        corners = tuple(np.sqrt(np.diagonal(c.value(inside))) for c in links)
        scale = np.maximum(np.abs(inside[others]), 1e-2)
        return cls(len(inside), tuple(links), maps, corners, others, scale)

    def variables(self, theta: Array) -> Array:
        """(n,) of a strictly feasible theta (p,). LinAlgError for another."""
        parts = zip(self.links, self.corners, strict=True)
        factors = [np.linalg.cholesky(c.value(theta) / np.outer(u, u)) for c, u in parts]
        entries = np.array(factors).reshape(-1, 4, 4)[:, ROWS, COLUMNS]
        entries[:, DIAGONAL] = np.log(entries[:, DIAGONAL])
        return np.concatenate([entries.ravel(), theta[self.others] / self.scale])

    def theta(self, x: Array) -> Array:
        """(p,) from the variables (n,)."""
        count = 10 * len(self.links)
        entries = x[:count].reshape(-1, 10).copy()
        entries[:, DIAGONAL] = np.exp(np.clip(entries[:, DIAGONAL], -40.0, 40.0))
        factors = np.zeros((len(entries), 4, 4))
        factors[:, ROWS, COLUMNS] = entries
        theta = np.zeros(self.size)
        for c, back, corner, factor in zip(self.links, self.maps, self.corners, factors, strict=True):
            matrix = factor @ factor.T * np.outer(corner, corner) - c.constant
            theta[c.indices] = matrix.ravel() @ back
        theta[self.others] = x[count:] * self.scale
        return theta
