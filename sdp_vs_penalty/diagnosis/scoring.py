"""How much of the residual a hypothesis explains, and whether that is more than chance.

All rows are white with unit variance, so that a drop of the squared residual is a chi-square. The
model's columns are partialled out (Frisch and Waugh 1933): with Q an orthonormal basis of them and
r, z what Q leaves of torque and candidate, the drop is (z'r)^2 / z'z. Everything below is small
linear algebra on sums over blocks of time.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.linalg
from numpy.typing import NDArray
from scipy import special

from sdp_vs_penalty.diagnosis.library import Library

Array = NDArray[np.float64]

#: A candidate of whose energy less than this share survives the model's columns is invisible.
_ROUNDING = 1e-9


@dataclass(frozen=True)
class Rows:
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

    def joint_sums(self, values: Array) -> Array:
        """(n, ...) sums over the rows of each joint."""
        return values.reshape(self.n, len(self.block), *values.shape[1:]).sum(axis=1)


def independent(columns: Array) -> Array:
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
    is noise to every hypothesis, and strongly coloured noise; zero where only noise is left.
    pieces : per joint the stretches of consecutive rows.
    """

    level: Array
    colour: Array
    pieces: tuple[tuple[NDArray[np.intp], ...], ...]

    @property
    def floor(self) -> Array:
        """(n,) variance of the noise behind the colour's filter, before the division."""
        return 1.0 + np.sum(self.colour**2, axis=1)

    def apply(self, columns: Array, joint: int) -> Array:
        """White rows (M, ...) of one joint, filtered and divided."""
        if not np.any(self.colour[joint]):
            return columns / self.level[joint]
        out = np.zeros_like(columns)
        order = self.colour.shape[1]
        for piece in self.pieces[joint]:
            x = columns[piece]
            y = x[order:].copy()
            for lag, a in enumerate(self.colour[joint], start=1):
                y -= a * x[order - lag : -lag]
            out[piece[order:]] = y / self.level[joint]
        return out

    def apply_all(self, columns: Array) -> Array:
        """(n M, ...) rows of all joints."""
        n = len(self.level)
        stacked = columns.reshape(n, -1, *columns.shape[1:])
        return np.concatenate([self.apply(c, j) for j, c in enumerate(stacked)])

    def library(self, white: Library) -> Library:
        """A white library's columns, weighted."""
        joints = tuple(self.apply(m, j) for j, m in enumerate(white.joints))
        robot = np.stack([self.apply(m, j) for j, m in enumerate(white.robot)])
        return Library(white.groups, joints, robot)


@dataclass(frozen=True)
class Fit:
    """The model fitted to weighted white rows.

    Q (n M, r) : orthonormal basis of the model's columns; residual (n M,) : what it leaves.
    """

    rows: Rows
    Q: Array
    residual: Array
    target: Array
    weighting: Weighting

    @classmethod
    def of(cls, rows: Rows, basis: Array, target: Array, weighting: Weighting) -> Fit:
        """Least squares on white columns (n M, r) of full rank, target white (n M,)."""
        q = np.linalg.qr(weighting.apply_all(basis))[0] if basis.shape[1] else basis
        weighted = weighting.apply_all(target)
        return cls(rows, q, weighted - q @ (q.T @ weighted), weighted, weighting)

    def scaled(self, columns: Array) -> Array:
        """White columns (n M, k), weighted."""
        return self.weighting.apply_all(columns)

    def partialled(self, columns: Array) -> Array:
        """(n M, k) what the model's columns leave of weighted others; twice, against rounding."""
        for _ in range(2):
            columns = columns - self.Q @ (self.Q.T @ columns)
        return columns

    def extended(self, columns: Array) -> Fit:
        """The fit with more weighted columns (n M, k)."""
        before = np.linalg.norm(columns, axis=0)
        fresh = self.partialled(columns)
        fresh = fresh[:, np.linalg.norm(fresh, axis=0) > 1e-4 * np.sqrt(_ROUNDING) * before]
        q = np.linalg.qr(fresh)[0] if fresh.shape[1] else fresh
        Q = np.column_stack([self.Q, q])
        residual = self.residual - q @ (q.T @ self.residual)
        return Fit(self.rows, Q, residual, self.target, self.weighting)

    def chi2_of(self, residual: Array) -> Array:
        """(n,) squared weighted residual of each joint, in units of (filtered) noise."""
        return self.weighting.level**2 * self.rows.joint_sums(residual**2)

    @cached_property
    def joint_chi2(self) -> Array:
        """(n,) what the model leaves: each joint's number of rows, if nothing is missing."""
        return self.chi2_of(self.residual)

    @cached_property
    def degrees(self) -> Array:
        """(n,) degrees of freedom of each joint: rows less its share of the model's rank."""
        leverage = self.rows.joint_sums(np.sum(self.Q**2, axis=1))
        return np.maximum(self.rows.count - leverage, 1.0)

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
        variance = np.maximum(chi2 / self.degrees, self.weighting.floor)
        return float(np.sum(self.degrees * np.log(variance) + chi2 / variance))


@dataclass(frozen=True)
class Scores:
    """Of every group: chi2 (the drop of the squared residual), beta, absorbed share of its energy."""

    chi2: Array
    beta: tuple[Array, ...]
    absorbed: Array


def score_library(fit: Fit, library: Library) -> Scores:
    """Score all groups of a library, white and scaled like the fit's rows."""
    n, M = fit.rows.n, len(fit.rows.block)
    residual = fit.residual.reshape(n, M)
    Q = fit.Q.reshape(n, M, -1)
    gram, raw, right = [], [], []
    for j in range(n):
        Z = library.joints[j]
        C = Q[j].T @ Z
        gram.append(Z.T @ Z - C.T @ C)
        raw.append(np.sum(Z**2, axis=0))
        right.append(Z.T @ residual[j])
    Z = library.robot.reshape(n * M, -1)
    C = fit.Q.T @ Z
    gram.append(Z.T @ Z - C.T @ C)
    raw.append(np.sum(Z**2, axis=0))
    right.append(Z.T @ fit.residual)
    chi2, absorbed = np.zeros(len(library.groups)), np.ones(len(library.groups))
    beta: list[Array] = []
    for g, group in enumerate(library.groups):
        at, c = (n if group.joint is None else group.joint), group.columns
        chi2[g], b, absorbed[g] = solve_group(gram[at][c, c], raw[at][c], right[at][c], group.signed)
        beta.append(b)
    return Scores(chi2, tuple(beta), absorbed)


def solve_group(gram: Array, raw: Array, right: Array, signed: bool) -> tuple[float, Array, float]:
    """chi2, coefficients and absorbed share from partialled gram (k, k), raw energies, z'r (k,)."""
    energy = float(raw.sum())
    if energy <= 0.0:
        return 0.0, np.zeros(len(raw)), 1.0
    if len(raw) == 1:
        left = float(gram[0, 0])
        absorbed = min(max(1.0 - left / energy, 0.0), 1.0)
        if left <= _ROUNDING * energy or (signed and right[0] < 0.0):
            return 0.0, np.zeros(1), absorbed
        return float(right[0] ** 2 / left), right / left, absorbed
    scale = 1.0 / np.sqrt(np.maximum(raw, 1e-300))
    values, vectors = np.linalg.eigh(gram * np.outer(scale, scale))
    good = values > _ROUNDING
    part = vectors[:, good].T @ (right * scale)
    beta = scale * (vectors[:, good] @ (part / values[good]))
    absorbed = min(max(1.0 - float(np.trace(gram)) / energy, 0.0), 1.0)
    return float(np.sum(part**2 / values[good])), beta, absorbed


def evidence(chi2: Array | float, k: Array | int) -> Array:
    """Twice the log Bayes factor for k columns against none, chi2 their drop of the squared residual.

    Zellner's g-prior with g chosen by the data (local empirical Bayes, George and Foster 2000):
    chi2 - k - k log(chi2 / k), zero below chi2 = k.
    """
    ratio = np.maximum(np.asarray(chi2, float) / k, 1.0)
    return k * (ratio - 1.0 - np.log(ratio))


@dataclass(frozen=True)
class BlockSums:
    """Of partialled columns z (n M, k) and the residual r, block by block: scores z_b'r_b (G, B, k)
    and grams z_b'z_b (G, B, k, k), for a batch of G groups of equal k."""

    scores: Array
    grams: Array

    @classmethod
    def of(cls, fit: Fit, partialled: Array, k: int) -> BlockSums:
        """From partialled columns (n M, G k) of G groups side by side."""
        rows = fit.rows
        scores = rows.block_sums(partialled * fit.residual[:, None])
        B, G = rows.blocks, partialled.shape[1] // k
        grams = np.empty((G, B, k, k))
        for a in range(k):
            for b in range(a, k):
                product = rows.block_sums(partialled[:, a::k] * partialled[:, b::k])
                grams[:, :, a, b] = grams[:, :, b, a] = product.T
        return cls(np.swapaxes(scores.reshape(B, G, k), 0, 1), grams)


def wald_exponent(sums: BlockSums, signs: Array | None = None) -> Array:
    """(G, S) -log10 p of the block-robust Wald test, for the true signs or rows of ``signs`` (S, B).

    With beta = (sum D_b)^-1 sum s_b, s_b the score and D_b the gram of block b, and u_b = s_b - D_b
    beta the score that beta leaves, W = (sum s_b)' V^-1 (sum s_b) with V = sum u_b u_b', the
    cluster-robust sandwich (Liang, Zeger 1986), which needs no noise model but independent blocks.
    Few blocks (an effect that shows only at reversals) can make the sandwich too small by chance:
    the smaller W of it and of V = sum D_b, noise of unit variance, counts. p is chi-square's.
    """
    s, D = sums.scores, sums.grams
    _, B, k = s.shape
    flips = np.ones((1, B)) if signs is None else signs
    total = D.sum(axis=1)
    trace = np.trace(total, axis1=1, axis2=2)
    alive = trace > 0.0
    ridge = np.where(alive, 1e-9 * trace, 1.0)[:, None, None] * np.eye(k)
    pull = np.einsum("sb,gbk->gsk", flips, s, optimize=True)
    beta = np.swapaxes(np.linalg.solve(total + ridge, np.swapaxes(pull, 1, 2)), 1, 2)
    # sum u u' = sum s s' - (sum eps D beta s' + transposed) + sum D beta beta' D.
    ss = np.einsum("gbk,gbl->gkl", s, s)
    if k == 1:
        d, x = D[:, :, 0, 0], s[:, :, 0]
        cross = flips @ (d * x).T  # (S, G)
        b = beta[:, :, 0]
        spread = ss[:, 0] - 2.0 * b * cross.T + b**2 * np.sum(d**2, axis=1)[:, None]
        floor = 1e-12 * ss[:, 0] + 1e-300
        W = pull[:, :, 0] ** 2 / np.maximum(spread, floor)
    else:
        u = flips[None, :, :, None] * s[:, None] - np.einsum("gbkl,gsl->gsbk", D, beta, optimize=True)
        spread = np.einsum("gsbk,gsbl->gskl", u, u, optimize=True)
        size = np.trace(spread, axis1=2, axis2=3)
        spread += (1e-9 * size + 1e-300)[:, :, None, None] * np.eye(k)
        W = np.sum(pull * np.linalg.solve(spread, pull[..., None])[..., 0], axis=2)
    W = np.minimum(W, np.sum(pull * beta, axis=2))
    p = special.chdtrc(k, np.maximum(W, 0.0))
    return np.where(alive[:, None], -np.log10(np.maximum(p, 1e-300)), 0.0)


def flip_threshold(fit: Fit, library: Library, seed: int, draws: int = 200) -> float:
    """99th percentile of the library's largest Wald exponent when blocks change sign at random."""
    rng = np.random.default_rng(seed)
    signs = rng.choice([-1.0, 1.0], (draws, fit.rows.blocks))
    n, M = fit.rows.n, len(fit.rows.block)
    Q = fit.Q.reshape(n, M, -1)
    largest = np.zeros(draws)
    for at in range(n + 1):
        mine = [g for g in library.groups if (n if g.joint is None else g.joint) == at]
        for k in sorted({g.k for g in mine}):
            index = np.concatenate([np.r_[g.columns] for g in mine if g.k == k])
            if at == n:
                columns = library.robot[:, :, index].reshape(n * M, -1)
                fresh = columns - fit.Q @ (fit.Q.T @ columns)
                energy = np.sum(columns**2, axis=0)
            else:
                Z = library.joints[at][:, index]
                fresh = np.negative(fit.Q @ (Q[at].T @ Z))
                fresh[at * M : (at + 1) * M] += Z
                energy = np.sum(Z**2, axis=0)
            seen = np.sum(fresh**2, axis=0) > 1e-7 * energy
            seen = np.repeat(seen.reshape(-1, k).all(axis=1), k)
            if seen.any():
                sums = BlockSums.of(fit, fresh[:, seen], k)
                largest = np.maximum(largest, wald_exponent(sums, signs).max(axis=0))
    return float(np.quantile(largest, 0.99))


def cross_validate(fit: Fit, shapes: Sequence[Array], signed: bool, folds: NDArray[np.intp]) -> Array:
    """(B,) gain of each block in squared white residual, from fits on the other folds.

    shapes : white columns (n M, k) of one hypothesis with different shape constants; each fold
    takes the one that explains its own training data best. folds : (M,) labels.
    """
    rows = fit.rows
    fold = np.tile(folds, rows.n)
    gain = np.zeros(len(fold))
    for f in np.unique(folds):
        out = fold == f
        Q_out, r_out = fit.Q[out], fit.target[out]
        inverse = _inverse(np.eye(fit.Q.shape[1]) - Q_out.T @ Q_out)
        right = fit.Q.T @ fit.target - Q_out.T @ r_out
        theta = inverse @ right
        error = r_out - Q_out @ theta
        best, change = 0.0, np.zeros(len(error))
        for Z in shapes:
            Z_out = Z[out]
            C = fit.Q.T @ Z - Q_out.T @ Z_out
            gram = Z.T @ Z - Z_out.T @ Z_out - C.T @ inverse @ C
            pull = Z.T @ fit.target - Z_out.T @ r_out - C.T @ theta
            chi2, beta, _ = solve_group(gram, np.sum(Z**2, axis=0), pull, signed)
            if chi2 > best:
                best = chi2
                change = (Z_out - Q_out @ (inverse @ C)) @ beta
        gain[out] = error**2 - (error - change) ** 2
    return rows.block_sums(gain)


def _inverse(gram: Array) -> Array:
    """Inverse on the directions that the training folds determine."""
    values, vectors = np.linalg.eigh(gram)
    good = values > 1e-6
    return (vectors[:, good] / values[good]) @ vectors[:, good].T
