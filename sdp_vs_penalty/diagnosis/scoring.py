"""How much of the residual a hypothesis explains, and whether that is more than chance.

All rows are white with unit variance, so that a drop of the squared residual is a chi-square. The
model's columns are partialled out (Frisch and Waugh 1933): with Q an orthonormal basis of them and
r, z what Q leaves of torque and candidate, the drop is (z'r)^2 / z'z. Everything below is small
linear algebra on sums over blocks of time.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
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
        if not np.any(columns):
            return columns
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
        return replace(white, joints=joints, robot=robot)


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

    def without_folds(self, folds: NDArray[np.intp]) -> list[_WithoutFold]:
        """The model fitted without each of the folds (M,) in turn; kept for the next hypothesis."""
        key = folds.tobytes()
        if key not in self._without:
            fold = np.tile(folds, self.rows.n)
            found = []
            for f in np.unique(folds):
                out = fold == f
                Q, target = self.Q[out], self.target[out]
                inverse = _inverse(np.eye(Q.shape[1]) - Q.T @ Q)
                theta = inverse @ (self.Q.T @ self.target - Q.T @ target)
                found.append(_WithoutFold(out, Q, target, inverse, theta, target - Q @ theta))
            self._without[key] = found
        return self._without[key]

    @cached_property
    def _without(self) -> dict[bytes, list[_WithoutFold]]:
        return {}

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

    def joint_gains(self, joint: int, chi2: Array) -> Array:
        """(G,) :meth:`likelihood_gain` of hypotheses on one joint's error only, from the chi2 (G,) that
        they take from the weighted residual."""
        before = self.joint_chi2[joint]
        after = np.maximum(before - chi2 * self.weighting.level[joint] ** 2, 0.0)
        floor, degrees = self.weighting.floor[joint], self.degrees[joint]

        def deviance(x: Array) -> Array:
            variance = np.maximum(x / degrees, floor)
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
    sums = [_sums(Q[j], library.joints[j], residual[j]) for j in range(n)]
    sums.append(_sums(fit.Q, library.robot.reshape(n * M, -1), fit.residual))
    chi2, absorbed = np.zeros(len(library.groups)), np.ones(len(library.groups))
    beta: list[Array] = [np.zeros(0)] * len(library.groups)
    for batch in library.batches:
        gram, raw, right = sums[n if batch.joint is None else batch.joint]
        c = batch.columns
        found = solve_groups(gram[c[:, :, None], c[:, None, :]], raw[c], right[c], batch.signed)
        chi2[batch.groups], absorbed[batch.groups] = found[0], found[2]
        for g, b in zip(batch.groups, found[1], strict=True):
            beta[g] = b
    return Scores(chi2, tuple(beta), absorbed)


def _sums(Q: Array, Z: Array, residual: Array) -> tuple[Array, Array, Array]:
    """Partialled gram, raw energies and scores of columns Z."""
    C = Q.T @ Z
    return Z.T @ Z - C.T @ C, np.sum(Z**2, axis=0), Z.T @ residual


def solve_group(gram: Array, raw: Array, right: Array, signed: bool) -> tuple[float, Array, float]:
    """chi2, coefficients and absorbed share from partialled gram (k, k), raw energies, z'r (k,)."""
    chi2, beta, absorbed = solve_groups(gram[None], raw[None], right[None], signed)
    return float(chi2[0]), beta[0], float(absorbed[0])


def solve_groups(gram: Array, raw: Array, right: Array, signed: bool) -> tuple[Array, Array, Array]:
    """chi2 (G,), coefficients (G, k), absorbed shares (G,) of G groups of k columns.

    From partialled grams (G, k, k), raw energies (G, k) and z'r (G, k); ``signed`` : a single
    coefficient that may not be negative.
    """
    energy = raw.sum(axis=1)
    alive = energy > 0.0
    safe = np.where(alive, energy, 1.0)
    trace = np.trace(gram, axis1=1, axis2=2)
    absorbed = np.where(alive, np.clip(1.0 - trace / safe, 0.0, 1.0), 1.0)
    if raw.shape[1] == 1:
        left, pull = gram[:, 0, 0], right[:, 0]
        used = alive & (left > _ROUNDING * energy) & ~(signed & (pull < 0.0))
        beta = np.where(used, pull / np.where(used, left, 1.0), 0.0)
        return beta * pull, beta[:, None], absorbed
    scale = 1.0 / np.sqrt(np.maximum(raw, 1e-300))
    values, vectors = np.linalg.eigh(gram * scale[:, :, None] * scale[:, None, :])
    good = (values > _ROUNDING) & alive[:, None]
    part = np.where(good, np.einsum("gij,gi->gj", vectors, right * scale), 0.0)
    weighted = part / np.where(good, values, 1.0)
    beta = np.where(alive[:, None], scale * np.einsum("gij,gj->gi", vectors, weighted), 0.0)
    return np.sum(part * weighted, axis=1), beta, absorbed


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


def wald_exponent(sums: BlockSums) -> Array:
    """(G,) -log10 p of the block-robust Wald test; p is chi-square's with k degrees of freedom."""
    k = sums.scores.shape[2]
    return _exponent(wald(sums), k)


def _exponent(W: Array, k: int) -> Array:
    p = special.chdtrc(k, np.maximum(W, 0.0))
    return np.asarray(-np.log10(np.maximum(p, 1e-300)))


def wald(sums: BlockSums) -> Array:
    """(G,) the block-robust Wald statistic.

    With beta = (sum D_b)^-1 sum s_b, s_b the score and D_b the gram of block b, and u_b = s_b - D_b
    beta the score that beta leaves, W = (sum s_b)' V^-1 (sum s_b) with V = sum u_b u_b', the
    cluster-robust sandwich (Liang, Zeger 1986), which needs no noise model but independent blocks.
    Few blocks (an effect that shows only at reversals) can make the sandwich too small by chance:
    the smaller W of it and of V = sum D_b, noise of unit variance, counts.
    """
    s, D = sums.scores, sums.grams
    pull = s.sum(axis=1)
    beta = np.linalg.solve(_ridged(D.sum(axis=1)), pull[:, :, None])[:, :, 0]
    u = s - np.einsum("gbkl,gl->gbk", D, beta)
    spread = np.einsum("gbk,gbl->gkl", u, u)
    return _wald(pull[:, None], beta[:, None], spread[:, None], s)[:, 0]


def largest_wald(sums: BlockSums, signs: Array) -> Array:
    """(S,) the largest statistic :func:`wald` of all groups when the blocks' scores change sign by
    the rows of ``signs`` (S, B).

    V = sum s s' - (C + C') + Q with C = sum eps_b s_b (D_b beta)' and Q = sum D_b beta beta' D_b: sums
    over blocks that do not depend on the signs, or are linear in them.
    """
    s, D = sums.scores, sums.grams
    G, B, k = s.shape
    pull = (signs @ s.transpose(1, 0, 2).reshape(B, G * k)).reshape(-1, G, k).transpose(1, 0, 2)
    inverse = np.linalg.inv(_ridged(D.sum(axis=1)))
    beta = pull @ inverse  # (G, S, k); the gram is symmetric
    products = np.einsum("gbk,gblm->bgklm", s, D).reshape(B, G * k**3)
    linear = (signs @ products).reshape(-1, G, k, k, k)
    cross = np.einsum("sgklm,gsm->gskl", linear, beta, optimize=True)
    flat = D.reshape(G, B, k * k)
    fourth = (flat.transpose(0, 2, 1) @ flat).reshape(G, k, k, k, k)  # [k, m, l, n] of D_km D_ln
    squares = (beta[..., :, None] * beta[..., None, :]).reshape(G, -1, k * k)
    kernel = fourth.transpose(0, 2, 4, 1, 3).reshape(G, k * k, k * k)  # [(m, n), (k, l)]
    quadratic = (squares @ kernel).reshape(G, -1, k, k)
    fixed = np.einsum("gbk,gbl->gkl", s, s)
    spread = fixed[:, None] - cross - np.swapaxes(cross, 2, 3) + quadratic
    return np.asarray(_wald(pull, beta, spread, s).max(axis=0))


def _ridged(total: Array) -> Array:
    trace = np.trace(total, axis1=1, axis2=2)
    ridge = np.where(trace > 0.0, 1e-9 * trace, 1.0)
    return total + ridge[:, None, None] * np.eye(total.shape[1])


def _wald(pull: Array, beta: Array, spread: Array, scores: Array) -> Array:
    """(G, S) from pull, beta (G, S, k), spread (G, S, k, k) and all scores (G, B, k)."""
    k = pull.shape[2]
    # The sums above cancel to rounding only: the spread is never smaller than that.
    size = np.trace(spread, axis1=2, axis2=3)
    floor = 1e-12 * np.sum(scores**2, axis=(1, 2))[:, None] + 1e-300
    spread = spread + (1e-9 * np.maximum(size, 0.0) + floor)[:, :, None, None] * np.eye(k)
    robust = np.sum(pull * np.linalg.solve(spread, pull[..., None])[..., 0], axis=2)
    return np.minimum(robust, np.sum(pull * beta, axis=2))


def flip_threshold(fit: Fit, library: Library, seed: int, draws: int = 200) -> float:
    """99th percentile of the library's largest Wald exponent when blocks change sign at random."""
    rng = np.random.default_rng(seed)
    signs = rng.choice([-1.0, 1.0], (draws, fit.rows.blocks))
    n, M = fit.rows.n, len(fit.rows.block)
    Q = fit.Q.reshape(n, M, -1)
    largest: dict[int, Array] = {}
    for batch in library.batches:
        at, index, k = batch.joint, batch.columns.ravel(), batch.columns.shape[1]
        if at is None:
            Z = library.robot[:, :, index].reshape(n * M, -1)
            fresh = Z - fit.Q @ (fit.Q.T @ Z)
        else:
            Z = library.joints[at][:, index]
            fresh = np.negative(fit.Q @ (Q[at].T @ Z))
            fresh[at * M : (at + 1) * M] += Z
        energy = np.sum(Z**2, axis=0)
        seen = np.sum(fresh**2, axis=0) > 1e-7 * energy
        seen = np.repeat(seen.reshape(-1, k).all(axis=1), k)
        if seen.any():
            W = largest_wald(BlockSums.of(fit, fresh[:, seen], k), signs)
            largest[k] = np.maximum(largest.get(k, 0.0), W)
    exponents = [_exponent(W, k) for k, W in largest.items()]
    return float(np.quantile(np.max(exponents, axis=0), 0.99)) if exponents else 0.0


@dataclass(frozen=True)
class _WithoutFold:
    """The model fitted without one fold: out (n M,) its rows, Q (m, r) and what theta (r,) leaves of
    them, error (m,); inverse (r, r) of the gram of all other rows."""

    out: NDArray[np.bool_]
    Q: Array
    target: Array
    inverse: Array
    theta: Array
    error: Array


def cross_validate(fit: Fit, shapes: Sequence[Array], signed: bool, folds: NDArray[np.intp]) -> Array:
    """(B,) gain of each block in squared white residual, from fits on the other folds.

    shapes : white columns (n M, k) of one hypothesis with different shape constants; each fold
    takes the one that explains its own training data best. folds : (M,) labels.
    """
    gain = np.zeros(len(fit.target))
    whole = [(Z, fit.Q.T @ Z, Z.T @ Z, Z.T @ fit.target, np.sum(Z**2, axis=0)) for Z in shapes]
    for f in fit.without_folds(folds):
        best, change = 0.0, np.zeros(len(f.error))
        for Z, overlap, square, right, raw in whole:
            Z_out = Z[f.out]
            C = overlap - f.Q.T @ Z_out
            gram = square - Z_out.T @ Z_out - C.T @ f.inverse @ C
            pull = right - Z_out.T @ f.target - C.T @ f.theta
            chi2, beta, _ = solve_group(gram, raw, pull, signed)
            if chi2 > best:
                best = chi2
                change = (Z_out - f.Q @ (f.inverse @ C)) @ beta
        gain[f.out] = f.error**2 - (f.error - change) ** 2
    return fit.rows.block_sums(gain)


def _inverse(gram: Array) -> Array:
    """Inverse on the directions that the training folds determine."""
    values, vectors = np.linalg.eigh(gram)
    good = values > 1e-6
    return (vectors[:, good] / values[good]) @ vectors[:, good].T
