"""The model fitted to white rows, and the linear algebra that every candidate is judged by.

All rows are white with unit variance, so that a drop of the squared residual is a chi-square. The
model's columns are partialled out (Frisch and Waugh 1933): with Q an orthonormal basis of them and
r, z what Q leaves of torque and candidate, the drop is (z'r)^2 / z'z.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise

import numpy as np
import scipy.linalg
from numpy.typing import NDArray
from scipy.linalg import lapack

from sdp_vs_penalty.diagnosis.extension import (
    Added,
    Extension,
    PerLibrary,
    Source,
    factored,
    products,
)
from sdp_vs_penalty.diagnosis.library import Library
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.autoregression import Pieces, innovations

#: The model's parameters, as they were identified, count as this share of the rows against training
#: folds: their columns are orthonormal, so that a direction which one fold alone determines has none.
HELD = 0.003
#: What a model leaves less of than this share of its norm is worked out twice, from all rows.
_LITTLE = 0.03
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
        return self.filter_of(joint)(columns) / self.level[joint] if columns.any() else columns

    def filter_of(self, joint: int) -> Callable[[Array], Array]:
        """What a joint's white rows (M, ...) go through before they are divided."""
        colour, pieces = self.colour[joint], self.pieces[joint]
        return (lambda x: innovations(x, colour, pieces)) if colour.any() else lambda x: x

    def apply_all(self, columns: Array) -> Array:
        """(n M, ...) rows of all joints."""
        n = len(self.level)
        stacked = columns.reshape(n, len(columns) // n, *columns.shape[1:])
        return np.concatenate([self.apply(c, j) for j, c in enumerate(stacked)])

    def library(self, white: Library) -> Library:
        """A white library's columns, weighted."""
        return white.coloured(self.colour, self.pieces).divided(self.level)


@dataclass(frozen=True)
class WhiteFit:
    """The model fitted to weighted white rows.

    Q (n M, r) : orthonormal basis of the model's columns; residual (n M,) : what it leaves; source :
    where products with a library are known from; more : what it adds to the fit ``base``, behind the
    columns of that one.
    """

    rows: RowLabels
    Q: Array
    residual: Array
    target: Array
    weighting: Weighting
    source: Source | None = None
    base: WhiteFit | None = None
    more: Extension | None = None
    _added: dict[int, Added] = field(default_factory=dict, init=False)
    _overlaps: PerLibrary = field(default_factory=PerLibrary, init=False)
    _pulls: PerLibrary = field(default_factory=PerLibrary, init=False)
    _weighted: dict[int, tuple[Library, Library]] = field(default_factory=dict, init=False)
    _without: dict[bytes, list[WithoutFold]] = field(default_factory=dict, init=False)

    def scaled(self, columns: Array) -> Array:
        """White columns (n M, k), weighted."""
        return self.weighting.apply_all(columns)

    def partialled(self, columns: Array) -> Array:
        """(n M, k) what the model leaves of weighted columns; of little twice, against rounding."""
        return self._parted(columns)[1]

    def _parted(self, columns: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
        """Products with the orthonormal columns, what these leave, and of which that is little."""
        along = self.Q.T @ columns
        left = columns - self.Q @ along
        little = np.linalg.norm(left, axis=0) < _LITTLE * np.linalg.norm(columns, axis=0)
        if little.any():
            left[:, little] -= self.Q @ (self.Q.T @ left[:, little])
        return along, left, little

    def extended(self, *white: Array) -> WhiteFit:
        """The fit with more columns: groups (n M, k) of white ones, kept for other fits."""
        if not white:
            return self
        added = self._beside(white)
        rest, least = np.hstack([a.rest for a in added]), np.concatenate([a.least for a in added])
        new, R, kept = factored(rest, least)
        taken = new.T @ self.residual
        more = Extension(added, kept, np.asarray(np.linalg.inv(R)), taken)
        residual, Q = self.residual - new @ taken, np.hstack([self.Q, new])
        return WhiteFit(self.rows, Q, residual, self.target, self.weighting, self.source, self, more)

    def _beside(self, white: Sequence[Array]) -> tuple[Added, ...]:
        """Groups of white columns beside this fit, those that are new all at once."""
        fresh = [w for w in white if id(w) not in self._added]
        if fresh:
            whole = np.hstack([self.scaled(w) for w in fresh])
            least = 1e-4 * np.sqrt(ROUNDING) * np.linalg.norm(whole, axis=0, keepdims=True)
            ends = np.cumsum([w.shape[1] for w in fresh])[:-1]
            along, left, little = self._parted(whole)
            each = (np.split(x, ends, axis=1) for x in (along, left, least, little[None]))
            for w, own, rest, small, few in zip(fresh, *each, strict=True):
                self._added[id(w)] = Added(w, None if few.any() else own, rest, small[0])
        return tuple(self._added[id(w)] for w in white)

    def overlaps(self, library: Library, joint: int | None) -> Array:
        """Q_j'z_j of a weighted library's columns on a joint j (r, C_j), on several (n, r, C); kept."""

        def made() -> Array:
            if self.base is None or self.more is None:
                if self.source is not None:
                    return self.source.model(library, joint)
                return products(self.Q, library, joint)
            both = self.base.overlaps(library, joint), self.more.overlaps(self.base, library, joint)
            return np.concatenate(both, axis=-2)

        return self._overlaps.of(library, joint, made)

    def pulls(self, library: Library, joint: int | None) -> Array:
        """z_j'r_j of the same columns with the residual: (C_j,), on several (n, C)."""

        def made() -> Array:
            if self.base is None or self.more is None:
                if self.source is not None:
                    taken = self.Q.T @ self.target @ self.overlaps(library, joint)
                    return np.asarray(self.source.torque(library, joint) - taken)
                return products(self.residual[:, None], library, joint)[..., 0, :]
            taken = self.more.taken @ self.more.overlaps(self.base, library, joint)
            return np.asarray(self.base.pulls(library, joint) - taken)

        return self._pulls.of(library, joint, made)

    def without_folds(self, folds: NDArray[np.intp]) -> list[WithoutFold]:
        """The model fitted without each of the folds (M,) in turn; kept for the next candidate."""
        key = folds.tobytes()
        if key not in self._without:
            fold = np.tile(folds, self.rows.n)
            found = []
            for f in np.unique(folds):
                out = fold == f
                Q, target = self.Q[out], self.target[out]
                # The estimate that they are beside is held by HELD of the rows: without it, what a fold
                # alone determines would be anything there.
                inverse = _inverse((1.0 + HELD) * np.eye(Q.shape[1]) - Q.T @ Q)
                theta = inverse @ (self.Q.T @ self.target - Q.T @ target)
                found.append(WithoutFold(out, Q, target, inverse, theta, target - Q @ theta))
            self._without[key] = found
        return self._without[key]

    def weighted(self, white: Library) -> Library:
        """A white library weighted like these rows; kept for the next time."""
        if id(white) not in self._weighted:
            self._weighted[id(white)] = white, self.weighting.library(white)
        return self._weighted[id(white)][1]

    def release(self) -> None:
        """Forget what was kept for the next time."""
        for kept in (self._added, self._overlaps.kept, self._pulls.kept, self._weighted, self._without):
            kept.clear()
        if self.base is not None:
            self.base.release()

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
        if self.base is None:
            return across @ Q, (across @ r)[:, :, 0]
        first = self.base.Q.shape[1]
        sides = across @ Q[:, :, first:]
        whole = np.concatenate([sides[:, :first].transpose(0, 2, 1), sides[:, first:]], axis=2)
        top = np.concatenate([self.base.joint_products[0], sides[:, :first]], axis=2)
        return np.concatenate([top, whole], axis=1), (across @ r)[:, :, 0]

    @cached_property
    def degrees(self) -> Array:
        """(n,) degrees of freedom of each joint: rows less its share of the model's rank."""
        return np.maximum(self.rows.count - self._leverage, 1.0)

    @cached_property
    def _leverage(self) -> Array:
        """(n,) share of the rank that each joint's rows have."""
        new = self.Q if self.base is None else self.Q[:, self.base.Q.shape[1] :]
        own = self.rows.joint_sums(np.einsum("nr,nr->n", new, new))
        return own if self.base is None else own + self.base._leverage

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

    def likelihood_gain(self, after: Array) -> Array:
        """Twice the gain of log likelihood when the joints' squared residuals are ``after`` (n, ...).

        The variance of each joint is whatever remains, but at least the noise: for R = joint_chi2
        and N degrees, -2 log L = sum_j N log v + R / v with v = max(noise, R / N). Near the noise that
        is the chi-square itself; far above, the logarithm of the error's reduction.
        """
        return self._deviance - self._deviance_of(after)

    @cached_property
    def _deviance(self) -> Array:
        return self._deviance_of(self.joint_chi2)

    def _deviance_of(self, chi2: Array) -> Array:
        known = self.degrees, self.weighting.noise_variance
        degrees, least = (x.reshape(-1, *(1,) * (chi2.ndim - 1)) for x in known)
        variance = np.maximum(chi2 / degrees, least)
        return np.asarray(np.sum(degrees * np.log(variance) + chi2 / variance, axis=0))


def _inverse(A: Array) -> Array:
    """Of a positive definite matrix, by Cholesky's triangle: half the work."""
    if not len(A):
        return A
    lower = lapack.dpotri(lapack.dpotrf(A, lower=1)[0], lower=1)[0]
    return np.asarray(np.tril(lower) + np.tril(lower, -1).T)


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
