"""The standard conic form that every solver gets.

    minimise 1/2 x^T P x + q^T x   subject to   A x + s = b,  s in K = K_1 x K_2 x ...

K_i is one of "zero", "nonnegative", "soc" (axis first), "psd" (svec: upper triangle column by
column, off-diagonals times sqrt(2)), "exp" {(x, y, z): y exp(x / y) <= z}.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from sdp_vs_penalty.robot.arrays import Array


@dataclass(frozen=True)
class Cone:
    """One factor of K: its kind and size (the order d of a psd cone, else the length)."""

    kind: str
    size: int

    @property
    def rows(self) -> int:
        return self.size * (self.size + 1) // 2 if self.kind == "psd" else self.size


@dataclass(frozen=True)
class ConicProblem:
    """P (m, m) upper triangle, q (m,), A (rows, m), b (rows,), cones in the order of the rows."""

    P: sparse.csc_matrix
    q: Array
    A: sparse.csc_matrix
    b: Array
    cones: tuple[Cone, ...]


@dataclass(frozen=True)
class Solution:
    """What a solver returned and claims; nothing here is believed before it is certified.

    x (m,) primal, z (rows,) dual of A x + s = b with z in K*; claims : "optimal", "inaccurate",
    "infeasible", "unbounded" or "failed"; status : the solver's own word.
    """

    x: Array
    z: Array
    claims: str
    status: str
    iterations: int

    @classmethod
    def none(
        cls, problem: ConicProblem, status: str, claims: str = "failed", iterations: int = 0
    ) -> Solution:
        """What a solver that gave up returned."""
        x, z = np.full(len(problem.q), np.nan), np.full(len(problem.b), np.nan)
        return cls(x, z, claims, status, iterations)


@cache
def triangle(d: int) -> tuple[NDArray[np.intp], NDArray[np.intp], Array]:
    """Rows, columns and weights of svec's entries."""
    j, i = np.tril_indices(d)  # column by column of the upper triangle
    return i, j, np.where(i == j, 1.0, np.sqrt(2.0))


def svec(matrix: Array) -> Array:
    """Upper triangle of symmetric (..., d, d), column by column, off-diagonals times sqrt(2)."""
    i, j, weight = triangle(matrix.shape[-1])
    return matrix[..., i, j] * weight


def unsvec(vector: Array, d: int) -> Array:
    """Inverse of :func:`svec`."""
    i, j, weight = triangle(d)
    out = np.zeros((*vector.shape[:-1], d, d))
    out[..., i, j] = out[..., j, i] = vector / weight
    return out
