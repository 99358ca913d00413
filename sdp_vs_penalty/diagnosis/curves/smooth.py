"""Penalised splines on white rows: fitted, weighed and bootstrapped on compressed factors.

With Z the white columns of a basis on one joint's rows, Q the model's (orthonormal, all joints) and r
what the model leaves, everything follows from D = Z'Z - (Q'Z)'Q'Z and s = Z'r, in all and block by
block: c = (D + P)^-1 s, P = lambda S + Z'Z / M. S is the roughness of the splines (second differences),
the last term a prior worth one row (unit information), which also settles what the model's own columns
can make: there D is nothing, and c the smallest curve. lambda maximises the marginal likelihood (REML):

    2 log BF = s' (D + P)^-1 s - log |D + P| / |P|

where the residual r'r (N) is noise of variance 1; where it is mostly what the curve takes,
N log(r'r / (r'r - s' (D + P)^-1 s)) stands in the place of the first term (conjugate prior).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from sdp_vs_penalty.diagnosis.fit import WhiteFit, WithoutFold
from sdp_vs_penalty.robot.arrays import Array

#: Weights of the roughness that are tried, relative to the data's.
_COARSE = 10.0 ** np.arange(-4.0, 5.0, 2.0)
_FINE = 10.0 ** np.arange(-5.0, 5.5, 0.75)
#: Of a pair each roughness has its own.
_FINE_PAIR = 10.0 ** np.arange(-4.0, 4.5, 1.5)
#: Quantile of the blocks' own sums at which they are cut.
_CUT = 0.75
#: Numbers that draws of the bootstrap hold at once.
_AT_ONCE = 2_000_000
#: Share of a direction's energy below which the model's columns make it.
ABSORBED = 0.02


@dataclass(frozen=True)
class Factors:
    """D (k, k), s (k,), raw = Z'Z (k, k); count : rows of the joint."""

    D: Array
    s: Array
    raw: Array
    count: float

    @classmethod
    def of(cls, fit: WhiteFit, Z: Array, joint: int) -> tuple[Factors, Array]:
        """From white weighted columns (M, k) of one joint; also C = Q'Z (r, k)."""
        M = len(fit.rows.block)
        mine = slice(joint * M, (joint + 1) * M)
        C = fit.Q[mine].T @ Z
        raw = Z.T @ Z
        return cls(raw - C.T @ C, Z.T @ fit.residual[mine], raw, float(fit.rows.count[joint])), C

    def priors(self, penalties: Sequence[Array], weights: Array) -> Array:
        """(W, k, k) P for each of W sets of weights, one a penalty of unit trace."""
        total = float(np.trace(self.raw))
        own = self.raw / max(self.count, 1.0) + 1e-10 * total * np.eye(len(self.s))
        rough = (total * w[:, None, None] * S for w, S in zip(weights.T, penalties, strict=True))
        return np.asarray(own[None] + sum(rough))


@dataclass(frozen=True)
class Smooth:
    """c (k,) : coefficients; P, D (k, k) : the penalty, and what the data say; evidence : 2 log BF;
    chi2 : drop of the squared residual."""

    c: Array
    P: Array
    evidence: float
    chi2: float
    D: Array

    @cached_property
    def edf(self) -> float:
        """Effective degrees of freedom."""
        return float(np.trace(np.linalg.solve(self.D + self.P, self.D)))


def smooth(
    f: Factors,
    penalties: Sequence[Array],
    fine: bool = False,
    gain: Callable[[Array], Array] = lambda x: x,
) -> Smooth:
    """The penalised fit with the most evidence; gain : of twice the log likelihood by drops (W,) of the
    squared residual, which are the gain where its variance is known."""
    if fine and len(penalties) > 1:
        weights = np.array(list(product(_FINE_PAIR, repeat=len(penalties))))
    else:
        weights = (_FINE if fine else _COARSE)[:, None]
        penalties = [np.sum(penalties, axis=0)] if penalties else []
    P = f.priors(penalties, weights if penalties else np.zeros((1, 0)))
    k = len(f.s)
    # Bordered by s, the factor's last row is L^-1 s; the corner only has to be large enough.
    bordered = np.full((len(P), k + 1, k + 1), 1e300)
    bordered[:, :k, :k], bordered[:, k, :k], bordered[:, :k, k] = f.D + P, f.s, f.s
    after, before = (np.linalg.cholesky(X) for X in (bordered, P))
    half, after = after[:, k, :k], after[:, :k, :k]
    size = [2.0 * np.sum(np.log(np.diagonal(L, axis1=1, axis2=2)), axis=1) for L in (after, before)]
    values = gain(np.sum(half**2, axis=1)) - size[0] + size[1]
    best = int(np.argmax(values))
    P, value = P[best], float(values[best])
    c = scipy.linalg.solve_triangular(after[best], half[best], trans="T", lower=True, check_finite=False)
    return Smooth(c, P, value, float(2.0 * c @ f.s - c @ f.D @ c), f.D)


def block_scores(fit: WhiteFit, Z: Array, C: Array, joint: int, overlap: Array) -> Array:
    """(B, k) s of each block; overlap (B, r) : block sums of Q r."""
    M = len(fit.rows.block)
    mine = fit.residual[joint * M : (joint + 1) * M]
    return np.asarray(fit.rows.sums(Z * mine[:, None]) - overlap @ C)


def agreement(scores: Array, A: Array) -> Array:
    """(B, B) G with T(e) = e' G e, what the blocks explain together when their scores change sign by
    e, without what each explains alone. No block counts for more than the upper quartile of them: a
    few stretches that are most of an error agree by chance in a large share of all draws."""
    G = scores @ np.linalg.solve(A, scores.T)
    own = np.maximum(np.diagonal(G), 1e-300)
    cut = np.sqrt(np.minimum(np.quantile(own, _CUT) / own, 1.0))
    out = G * np.outer(cut, cut)
    np.fill_diagonal(out, 0.0)
    return np.asarray(out)


def held_out_gain(fit: WhiteFit, Z: Array, C: Array, f: Factors, P: Array, joint: int) -> float:
    """Gain in squared white residual of all folds, each from fits on the others."""
    gain, folds = 0.0, fit.without_folds(fit.rows.fold)
    for part, (c, Z_out, overlap) in zip(folds, _without(fit, folds, Z, C, f, P, joint), strict=True):
        change = np.negative(part.Q @ (part.inverse @ (overlap @ c))).reshape(fit.rows.n, -1)
        change[joint] += Z_out @ c
        gain += float(np.sum(part.error**2) - np.sum((part.error - change.ravel()) ** 2))
    return gain


def fold_coefficients(
    fit: WhiteFit, Z: Array, C: Array, f: Factors, P: Array, joint: int, folds: NDArray[np.intp]
) -> list[Array]:
    """Per fold of ``folds`` (M,) the coefficients (k,) from the other folds."""
    return [c for c, _, _ in _without(fit, fit.without_folds(folds), Z, C, f, P, joint)]


def _without(
    fit: WhiteFit, folds: Sequence[WithoutFold], Z: Array, C: Array, f: Factors, P: Array, joint: int
) -> Iterator[tuple[Array, Array, Array]]:
    """Of each fold the coefficients (k,) from the others, its rows of Z, and the other rows' Q'Z."""
    n, M = fit.rows.n, len(fit.rows.block)
    target = fit.target[joint * M : (joint + 1) * M]
    pull_all = Z.T @ target
    for part in folds:
        held = part.out[:M]
        Z_out = Z[held]
        own = part.Q.reshape(n, len(Z_out), part.Q.shape[1])[joint]  # of a frozen model: no columns
        overlap = C - own.T @ Z_out
        gram = f.raw - Z_out.T @ Z_out - overlap.T @ part.inverse @ overlap
        pull = pull_all - Z_out.T @ target[held] - overlap.T @ part.theta
        yield np.linalg.solve(gram + P, pull), Z_out, overlap


def identifiable(f: Factors, P: Array) -> Array:
    """(k, k) projector onto what the model's own columns cannot make, nor the smoothing alone decides,
    in the metric of Z'Z + P: where few measurements lie, Z'Z alone lets a curve grow without limit."""
    metric = f.raw + P
    values, vectors = scipy.linalg.eigh(f.D, metric)
    kept = vectors[:, values > ABSORBED]
    return np.asarray(kept @ kept.T @ metric)


def draws(fit: WhiteFit, Z: Array, C: Array, found: Smooth, joint: int, seed: int, count: int) -> Array:
    """(count, k) errors of the coefficients.

    Two parts: blocks drawn with replacement (what the noise does, whatever its colour), and what
    smoothing may have cost, a normal with the covariance that the prior leaves beyond the noise's,
    (D + P)^-1 - (D + P)^-1 D (D + P)^-1 (Nychka, JASA 1988).
    """
    M = len(fit.rows.block)
    partialled = np.negative(fit.Q @ C)
    partialled[joint * M : (joint + 1) * M] += Z
    left = fit.residual - partialled @ found.c
    u = fit.rows.block_sums(partialled * left[:, None])
    grams = _block_grams(fit, partialled)
    rng = np.random.default_rng(seed)
    B, k = u.shape
    centre = found.P @ found.c
    D = grams.sum(axis=0)
    A = D + found.P
    bias = np.linalg.solve(A, found.P) @ np.linalg.inv(A)
    values, vectors = np.linalg.eigh(0.5 * (bias + bias.T))
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    drawn = rng.integers(B, size=(count, B))
    weights = np.array([np.bincount(d, minlength=B) for d in drawn], float)
    out = rng.normal(size=(count, k)) @ root.T
    for part in np.array_split(np.arange(count), max(1, count * k * k // _AT_ONCE)):
        totals = (weights[part] @ grams.reshape(B, -1)).reshape(-1, k, k) + found.P
        out[part] += np.linalg.solve(totals, (weights[part] @ u - centre)[:, :, None])[:, :, 0]
    return out


def _block_grams(fit: WhiteFit, columns: Array) -> Array:
    """(B, k, k)."""
    rows = fit.rows
    shaped = columns.reshape(rows.n, len(rows.block), -1)
    out = []
    for b in range(rows.blocks):
        part = shaped[:, rows.block == b].reshape(-1, shaped.shape[2])
        out.append(part.T @ part)
    return np.array(out)
