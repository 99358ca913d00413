"""The model fitted to white rows, and the linear algebra that every candidate is judged by.

All rows are white with unit variance, so that a drop of the squared residual is a chi-square. The
model's columns are partialled out (Frisch and Waugh 1933): with Q an orthonormal basis of them and
r, z what Q leaves of torque and candidate, the drop is (z'r)^2 / z'z.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from sdp_vs_penalty.diagnosis.library import Library
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.autoregression import Pieces, innovations

#: The model's parameters, as they were identified, count as this share of the rows against training
#: folds: their columns are orthonormal, so that a direction which one fold alone determines has none.
HELD = 0.003
#: A candidate of whose energy less than this share survives the model's columns is invisible.
ROUNDING = 1e-9


@dataclass(frozen=True)
class RowLabels:
    """White rows of all joints one below the other: row j M + m is row m of joint j.

    block : (M,) labels of time blocks, 0, 1, ... in order; fold : (M,) labels of cross-validation
    folds; count (n,) : rows that carry information.
    """

    n: int
    block: NDArray[np.intp]
    fold: NDArray[np.intp]
    count: Array

    @property
    def blocks(self) -> int:
        return int(self.block.max()) + 1

    @property
    def folds(self) -> int:
        return int(self.fold.max()) + 1

    def block_sums(self, values: Array) -> Array:
        """(B, ...) sums over the rows of each block, of values (n M, ...)."""
        shaped = values.reshape(self.n, len(self.block), *values.shape[1:]).sum(axis=0)
        return self.sums(shaped)

    def sums(self, values: Array) -> Array:
        """(B, ...) sums over the rows of each block, of values (M, ...)."""
        starts = np.searchsorted(self.block, np.arange(self.blocks))
        return np.add.reduceat(values, starts, axis=0)

    def products(self, values: Array, weights: Array) -> Array:
        """(B, k) sums over each block of values (M, k) times weights (M,)."""
        ends = np.searchsorted(self.block, np.arange(self.blocks + 1))
        return np.array([weights[a:b] @ values[a:b] for a, b in pairwise(ends.tolist())])

    def joint_sums(self, values: Array) -> Array:
        """(n, ...) sums over the rows of each joint."""
        return values.reshape(self.n, len(self.block), *values.shape[1:]).sum(axis=1)


def orthonormal(columns: Array) -> Array:
    """An orthonormal basis (n M, r) of columns (n M, p), their rank found by a pivoted QR."""
    norms = np.linalg.norm(columns, axis=0)
    seen = norms > 1e-12 * norms.max(initial=0.0)
    if not seen.any():
        return np.zeros((len(columns), 0))
    q, r, _ = scipy.linalg.qr(
        columns[:, seen] / norms[seen], mode="economic", pivoting=True, check_finite=False
    )
    diagonal = np.abs(np.diagonal(r))
    return np.ascontiguousarray(q[:, diagonal > 1e-8 * diagonal[0]])


@dataclass(frozen=True)
class Weighting:
    """What white rows go through before they are fitted.

    level (n,) : the rows of each joint are divided by it, so that a joint whose error the model does
    not explain does not outvote the others because its sensor is quiet. colour (n, order) : before
    that, an autoregression of the unexplained error itself is taken out: error that nothing explains
    is noise to every candidate, and strongly coloured noise; zero where only noise is left.
    pieces : per joint the stretches of consecutive rows.
    """

    level: Array
    colour: Array
    pieces: tuple[Pieces, ...]

    @property
    def noise_variance(self) -> Array:
        """(n,) variance of the noise behind the colour's filter, before the division."""
        return 1.0 + np.sum(self.colour**2, axis=1)

    def apply(self, columns: Array, joint: int) -> Array:
        """White rows (M, ...) of one joint, filtered and divided."""
        if not np.any(columns):
            return columns
        if np.any(self.colour[joint]):
            columns = innovations(columns, self.colour[joint], self.pieces[joint])
        return columns / self.level[joint]

    def apply_all(self, columns: Array) -> Array:
        """(n M, ...) rows of all joints."""
        n = len(self.level)
        stacked = columns.reshape(n, len(columns) // n, *columns.shape[1:])
        return np.concatenate([self.apply(c, j) for j, c in enumerate(stacked)])

    def library(self, white: Library) -> Library:
        """A white library's columns, weighted."""
        joints = tuple(self.apply(m, j) for j, m in enumerate(white.joints))
        robot = np.stack([self.apply(m, j) for j, m in enumerate(white.robot)])
        return replace(white, joints=joints, robot=robot)


@dataclass(frozen=True)
class WhiteFit:
    """The model fitted to weighted white rows.

    Q (n M, r) : orthonormal basis of the model's columns; residual (n M,) : what it leaves; base : the
    fit of which this is an extension, its columns first.
    """

    rows: RowLabels
    Q: Array
    residual: Array
    target: Array
    weighting: Weighting
    base: WhiteFit | None = None

    @classmethod
    def of(cls, rows: RowLabels, basis: Array, target: Array, weighting: Weighting) -> WhiteFit:
        """Least squares on white columns (n M, r) of full rank, target white (n M,)."""
        return Coloured.of(basis, target, weighting).fit(rows, weighting)

    def scaled(self, columns: Array) -> Array:
        """White columns (n M, k), weighted."""
        return self.weighting.apply_all(columns)

    def partialled(self, columns: Array) -> Array:
        """(n M, k) what the model's columns leave of weighted others; twice, against rounding."""
        for _ in range(2):
            columns = columns - self.Q @ (self.Q.T @ columns)
        return columns

    def extended(self, *groups: Array) -> WhiteFit:
        """The fit with more weighted columns (n M, k), group after group."""
        if not groups:
            return self
        fresh = np.split(
            self.partialled(np.hstack(groups)), np.cumsum([g.shape[1] for g in groups])[:-1], axis=1
        )
        new = np.zeros((len(self.residual), 0))
        for group, own in zip(groups, fresh, strict=True):
            for _ in range(2 if new.shape[1] else 0):
                own = own - new @ (new.T @ own)
            seen = 1e-4 * np.sqrt(ROUNDING) * np.linalg.norm(group, axis=0)
            own = own[:, np.linalg.norm(own, axis=0) > seen]
            if own.shape[1] == 1:
                own = own / np.linalg.norm(own)
            elif own.shape[1]:
                own = np.linalg.qr(own)[0]
            new = np.column_stack([new, own])
        residual = self.residual - new @ (new.T @ self.residual)
        Q = np.column_stack([self.Q, new])
        return WhiteFit(self.rows, Q, residual, self.target, self.weighting, self)

    def overlaps(self, library: Library) -> tuple[Array, ...]:
        """Q_j'z_j of a weighted library's columns on each joint j (r, C_j), and of those on several
        (n, r, C); kept for the next time, and for fits that extend this one."""
        if id(library) not in self._overlaps:
            first = 0 if self.base is None else self.base.Q.shape[1]
            parts = np.split(self.Q[:, first:], self.rows.n)
            own = [q.T @ z for q, z in zip(parts, library.joints, strict=True)]
            own.append(np.stack([q.T @ z for q, z in zip(parts, library.robot, strict=True)]))
            if self.base is not None:
                before = self.base.overlaps(library)
                own = [np.concatenate(x, axis=-2) for x in zip(before, own, strict=True)]
            self._overlaps[id(library)] = library, tuple(own)
        return self._overlaps[id(library)][1]

    @cached_property
    def _overlaps(self) -> dict[int, tuple[Library, tuple[Array, ...]]]:
        return {}

    def without_folds(self, folds: NDArray[np.intp]) -> list[WithoutFold]:
        """The model fitted without each of the folds (M,) in turn; kept for the next candidate."""
        key = folds.tobytes()
        if key not in self._without:
            fold = np.tile(folds, self.rows.n)
            found = []
            for f in np.unique(folds):
                out = fold == f
                Q, target = self.Q[out], self.target[out]
                inverse = _inverse(np.eye(Q.shape[1]) - Q.T @ Q)
                theta = inverse @ (self.Q.T @ self.target - Q.T @ target)
                found.append(WithoutFold(out, Q, target, inverse, theta, target - Q @ theta))
            self._without[key] = found
        return self._without[key]

    @cached_property
    def _without(self) -> dict[bytes, list[WithoutFold]]:
        return {}

    def weighted(self, white: Library) -> Library:
        """A white library weighted like these rows; kept for the next time."""
        if id(white) not in self._weighted:
            self._weighted[id(white)] = white, self.weighting.library(white)
        return self._weighted[id(white)][1]

    @cached_property
    def _weighted(self) -> dict[int, tuple[Library, Library]]:
        return {}

    def chi2_of(self, residual: Array) -> Array:
        """(n,) squared weighted residual of each joint, in units of (filtered) noise."""
        return self.weighting.level**2 * self.rows.joint_sums(residual**2)

    @cached_property
    def joint_chi2(self) -> Array:
        """(n,) what the model leaves: each joint's number of rows, if nothing is missing."""
        return self.chi2_of(self.residual)

    @cached_property
    def joint_products(self) -> tuple[Array, Array]:
        """(n, r, r) Q'Q and (n, r) Q'r of each joint's rows."""
        n = self.rows.n
        Q, r = self.Q.reshape(n, len(self.Q) // n, -1), self.residual.reshape(n, -1, 1)
        across = Q.transpose(0, 2, 1)
        return across @ Q, (across @ r)[:, :, 0]

    @cached_property
    def degrees(self) -> Array:
        """(n,) degrees of freedom of each joint: rows less its share of the model's rank."""
        leverage = self.rows.joint_sums(np.sum(self.Q**2, axis=1))
        return np.maximum(self.rows.count - leverage, 1.0)

    def joint_gains(self, joint: int, chi2: Array) -> Array:
        """(G,) :meth:`likelihood_gain` of candidates on one joint's error only, from the chi2 (G,) that
        they take from the weighted residual."""
        before = self.joint_chi2[joint]
        after = np.maximum(before - chi2 * self.weighting.level[joint] ** 2, 0.0)
        noise, degrees = self.weighting.noise_variance[joint], self.degrees[joint]

        def deviance(x: Array) -> Array:
            variance = np.maximum(x / degrees, noise)
            return np.asarray(degrees * np.log(variance) + x / variance)

        return deviance(before) - deviance(after)

    def likelihood_gain(self, after: Array) -> float:
        """Twice the gain of log likelihood when the joints' squared residuals fall to ``after`` (n,).

        The variance of each joint is whatever remains, but at least the noise: for R = joint_chi2
        and N degrees, -2 log L = sum_j N log v + R / v with v = max(noise, R / N). Near the noise that
        is the chi-square itself; far above, the logarithm of the error's reduction.
        """
        return float(self._deviance - self._deviance_of(after))

    @cached_property
    def _deviance(self) -> float:
        return self._deviance_of(self.joint_chi2)

    def _deviance_of(self, chi2: Array) -> float:
        variance = np.maximum(chi2 / self.degrees, self.weighting.noise_variance)
        return float(np.sum(self.degrees * np.log(variance) + chi2 / variance))


@dataclass(frozen=True)
class Coloured:
    """The model's white columns (n, M, r) and the torque (n, M) behind the colour's filter, not yet
    divided by the joints' levels; factors : triangular, of each joint's columns."""

    columns: Array
    target: Array
    factors: tuple[Array, ...]

    @classmethod
    def of(cls, basis: Array, target: Array, weighting: Weighting) -> Coloured:
        """From white columns (n M, r) of full rank and white torque (n M,)."""
        n, (N, r) = len(weighting.level), basis.shape
        only = replace(weighting, level=np.ones(n))
        columns = only.apply_all(basis).reshape(n, N // n, r)
        factors = tuple(np.asarray(np.linalg.qr(c, mode="r")) for c in columns)
        return cls(columns, only.apply_all(target).reshape(n, -1), factors)

    def fit(self, rows: RowLabels, weighting: Weighting) -> WhiteFit:
        """Least squares with these levels; the orthonormal basis by the joints' triangular factors."""
        level = weighting.level[:, None]
        Y, target = self.columns / level[:, :, None], (self.target / level).ravel()
        q = Y.reshape(len(target), Y.shape[2])
        if q.shape[1]:
            parts = [R / v for R, v in zip(self.factors, weighting.level, strict=True)]
            R = np.linalg.qr(np.concatenate(parts), mode="r")
            size = np.abs(np.diagonal(R))
            if size.min() > 1e-8 * size.max():
                q = scipy.linalg.solve_triangular(R, q.T, trans="T", check_finite=False).T
            else:
                q = np.linalg.qr(q)[0]
        return WhiteFit(rows, q, target - q @ (q.T @ target), target, weighting)


@dataclass(frozen=True)
class WithoutFold:
    """The model fitted without one fold: out (n M,) its rows, Q (m, r) and what theta (r,) leaves of
    them, error (m,); inverse (r, r) of the gram of all other rows."""

    out: NDArray[np.bool_]
    Q: Array
    target: Array
    inverse: Array
    theta: Array
    error: Array


def _inverse(gram: Array) -> Array:
    """Inverse of the training folds' gram, the estimate that they are beside held by HELD of the rows:
    without it, what a fold alone determines would be anything there."""
    values, vectors = np.linalg.eigh(gram)
    return (vectors / (np.maximum(values, 0.0) + HELD)) @ vectors.T
