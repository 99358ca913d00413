"""Links that are consistent by construction: theta from variables without constraints, in two ways.

Each link has one matrix that must be positive definite, P = G G^T in units of an interior point; of a
link with a minimum thickness the 4x4 matrix of that demand, which contains the pseudo-inertia.

LogCholesky : G is triangular, the logarithms of its diagonal are variables (Rucker and Wensing, "Smooth
    parameterization of rigid-body inertia", RA-L 2022).
Geodesic : G exp(S) G^T with a symmetric S, a geodesic of the affine-invariant metric |S| (Lee, Wensing,
    Park, "Geometric robot dynamic identification", T-RO 2020); gradient and Hessian in S are Riemannian.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.constraints.constraint import Constraint
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.solvers.conic import svec, unsvec

#: Rows and columns of a link's ten variables in L, and which of them are logarithms.
ROWS, COLUMNS = np.tril_indices(4)
DIAGONAL = ROWS == COLUMNS
_SAME_COLUMN = COLUMNS[:, None] == COLUMNS[None, :]
_BASIS = unsvec(np.eye(10), 4)
#: (10, 10, 4, 4) symmetrised products of the basis of symmetric matrices.
_PRODUCTS = 0.5 * (
    np.einsum("aij,bjk->abik", _BASIS, _BASIS) + np.einsum("bij,ajk->abik", _BASIS, _BASIS)
)


def owners(constraints: Sequence[Constraint]) -> list[Constraint]:
    """One 4x4 demand of each link, which the chart fulfils."""
    found: dict[int, Constraint] = {}
    for c in constraints:
        whole = c.cone == "psd" and c.constant.shape == (4, 4) and len(c.indices) == 10
        if whole and (c.family == "minimum thickness" or int(c.indices[0]) not in found):
            found[int(c.indices[0])] = c
    return list(found.values())


@dataclass(frozen=True)
class Frame:
    """What both charts share: ten variables a link, then the other parameters in units of ``scale``.

    maps : (16, 10) from each link's matrix to its parameters; corners : (4,) units of each G's rows.
    """

    size: int
    links: tuple[Constraint, ...]
    maps: tuple[Array, ...]
    corners: tuple[Array, ...]
    others: NDArray[np.intp]
    scale: Array

    @classmethod
    def at(cls, links: Sequence[Constraint], inside: Array) -> Frame:
        """The frame in which the strictly feasible ``inside`` has factors with rows of length one."""
        covered = np.concatenate([np.zeros(0, np.intp), *(c.indices for c in links)]).astype(np.intp)
        others = np.setdiff1d(np.arange(len(inside)), covered)
        maps = tuple(np.asarray(np.linalg.pinv(c.coefficients.reshape(10, 16))) for c in links)
        corners = tuple(np.sqrt(np.diagonal(c.value(inside))) for c in links)
        scale = np.maximum(np.abs(inside[others]), 1e-2)
        return cls(len(inside), tuple(links), maps, corners, others, scale)

    def factors(self, theta: Array) -> Array:
        """(links, 4, 4) the triangular G of a strictly feasible theta. LinAlgError for another."""
        parts = zip(self.links, self.corners, strict=True)
        made = [np.linalg.cholesky(c.value(theta) / np.outer(u, u)) for c, u in parts]
        return np.array(made).reshape(-1, 4, 4)

    def theta(self, factors: Array, others: Array) -> Array:
        """(p,) from (links, 4, 4) G and the scaled parameters beside the links."""
        theta = np.zeros(self.size)
        for c, back, corner, factor in zip(self.links, self.maps, self.corners, factors, strict=True):
            matrix = factor @ factor.T * np.outer(corner, corner) - c.constant
            theta[c.indices] = matrix.ravel() @ back
        theta[self.others] = others * self.scale
        return theta

    def weights(self, slopes: Array) -> Iterator[Array]:
        """Of each link (r, 4, 4) symmetric W with slope^T dtheta = <W, d(G G^T)>; slopes (r, p)."""
        for c, back, corner in zip(self.links, self.maps, self.corners, strict=True):
            weights = (slopes[:, c.indices] @ back.T).reshape(-1, 4, 4) * np.outer(corner, corner)
            yield np.asarray(0.5 * (weights + np.swapaxes(weights, 1, 2)))


class Point(Protocol):
    """A place in a chart, and how theta moves with n variables about it.

    theta (p,); pull(J) : (r, n) derivatives from those (r, p) with respect to theta;
    curvature(slope) : (n, n) sum_k slope_k times the Hessian of theta_k.
    """

    @property
    def theta(self) -> Array: ...
    def pull(self, jacobian: Array) -> Array: ...
    def curvature(self, slope: Array) -> Array: ...
    def moved(self, step: Array) -> Point: ...


@dataclass(frozen=True)
class LogCholesky:
    """The point with variables x: each link's L, its diagonal as logarithms, then the others."""

    frame: Frame
    x: Array

    @classmethod
    def of(cls, frame: Frame, theta: Array) -> LogCholesky:
        entries = frame.factors(theta)[:, ROWS, COLUMNS]
        entries[:, DIAGONAL] = np.log(entries[:, DIAGONAL])
        return cls(frame, np.concatenate([entries.ravel(), theta[frame.others] / frame.scale]))

    @property
    def _factors(self) -> Array:
        entries = self.x[: 10 * len(self.frame.links)].reshape(-1, 10).copy()
        entries[:, DIAGONAL] = np.exp(np.clip(entries[:, DIAGONAL], -40.0, 40.0))
        factors = np.zeros((len(entries), 4, 4))
        factors[:, ROWS, COLUMNS] = entries
        return factors

    @property
    def theta(self) -> Array:
        return self.frame.theta(self._factors, self.x[10 * len(self.frame.links) :])

    def moved(self, step: Array) -> LogCholesky:
        return replace(self, x=self.x + step)

    def pull(self, jacobian: Array) -> Array:
        parts = []
        for weights, factor in zip(self.frame.weights(jacobian), self._factors, strict=True):
            # d<W, L L^T> = 2 <W L, dL> for a symmetric W
            part = (2.0 * weights @ factor)[:, ROWS, COLUMNS]
            part[:, DIAGONAL] *= factor[ROWS, COLUMNS][DIAGONAL]
            parts.append(part)
        return np.hstack([*parts, jacobian[:, self.frame.others] * self.frame.scale])

    def curvature(self, slope: Array) -> Array:
        blocks = []
        for (weight,), factor in zip(self.frame.weights(slope[None]), self._factors, strict=True):
            grows = np.where(DIAGONAL, factor[ROWS, COLUMNS], 1.0)  # dL / dx, entry by entry
            block = 2.0 * weight[np.ix_(ROWS, ROWS)] * _SAME_COLUMN * np.outer(grows, grows)
            again = np.where(DIAGONAL, 2.0 * (weight @ factor)[ROWS, COLUMNS] * grows, 0.0)
            blocks.append(block + np.diag(again))
        return _blocks(blocks, len(self.x))


@dataclass(frozen=True)
class Geodesic:
    """The point with factors G (links, 4, 4); variables are S of each link as svec, zero here."""

    frame: Frame
    factors: Array
    others: Array

    @classmethod
    def of(cls, frame: Frame, theta: Array) -> Geodesic:
        return cls(frame, frame.factors(theta), theta[frame.others] / frame.scale)

    @property
    def theta(self) -> Array:
        return self.frame.theta(self.factors, self.others)

    def moved(self, step: Array) -> Geodesic:
        """G exp(S / 2): exp(S) is its own square root twice."""
        count = 10 * len(self.factors)
        values, vectors = np.linalg.eigh(unsvec(step[:count].reshape(-1, 10), 4))
        grown = vectors * np.exp(np.clip(0.5 * values, -40.0, 40.0))[:, None, :]
        turned = self.factors @ grown @ np.swapaxes(vectors, 1, 2)
        return replace(self, factors=turned, others=self.others + step[count:])

    def pull(self, jacobian: Array) -> Array:
        pairs = zip(self.frame.weights(jacobian), self.factors, strict=True)
        parts = [svec(factor.T @ weights @ factor) for weights, factor in pairs]
        return np.hstack([*parts, jacobian[:, self.frame.others] * self.frame.scale])

    def curvature(self, slope: Array) -> Array:
        """G exp(t S) G^T bends by G S^2 G^T: <G^T W G, S S> in each link."""
        pairs = zip(self.frame.weights(slope[None]), self.factors, strict=True)
        blocks = [np.einsum("abij,ij", _PRODUCTS, g.T @ weight @ g) for (weight,), g in pairs]
        return _blocks(blocks, 10 * len(blocks) + len(self.others))


def _blocks(blocks: Sequence[Any], size: int) -> Array:
    out = np.zeros((size, size))
    for k, block in enumerate(blocks):
        out[10 * k : 10 * k + 10, 10 * k : 10 * k + 10] = block
    return out
