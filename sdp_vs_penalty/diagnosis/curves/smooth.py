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
#: Share that the data have in a direction, beside the prior, below which draws leave it alone.
_SAID = 1e-5


@dataclass(frozen=True)
class Factors:
    """White weighted columns Z (M, k) of a joint beside a fit: C = Q'Z (r, k), D (k, k), s (k,),
    raw = Z'Z (k, k); count : rows of the joint."""

    fit: WhiteFit
    joint: int
    Z: Array
    C: Array
    D: Array
    s: Array
    raw: Array
    count: float

    @classmethod
    def of(cls, fit: WhiteFit, Z: Array, joint: int) -> Factors:
        return cls.several(fit, Z, joint, 1)[0]

    @classmethod
    def several(cls, fit: WhiteFit, Z: Array, joint: int, count: int) -> list[Factors]:
        """Of ``count`` sets of columns side by side."""
        M, size, rows = len(Z), Z.shape[1] // count, float(fit.rows.count[joint])
        mine = slice(joint * M, (joint + 1) * M)
        every, pulls, out = fit.Q[mine].T @ Z, Z.T @ fit.residual[mine], []
        for own in (slice(at * size, (at + 1) * size) for at in range(count)):
            z, C = Z[:, own], every[:, own]
            raw = z.T @ z
            out.append(cls(fit, joint, z, C, raw - C.T @ C, pulls[own], raw, rows))
        return out

    def of_joint(self, values: Array) -> Array:
        """(M, ...) of values (n M, ...) those of the joint's rows."""
        M = len(self.Z)
        return values[self.joint * M : (self.joint + 1) * M]

    def priors(self, penalties: Sequence[Array], weights: Array) -> Array:
        """(W, k, k) P for each of W sets of weights, one a penalty of unit trace."""
        total = float(np.trace(self.raw))
        own = self.raw / max(self.count, 1.0) + 1e-10 * total * np.eye(len(self.s))
        rough = (total * w[:, None, None] * S for w, S in zip(weights.T, penalties, strict=True))
        return np.asarray(own[None] + sum(rough))


@dataclass(frozen=True)
class Smooth:
    """A penalised fit: P (k, k) the penalty; evidence : 2 log BF; weights : of the roughness."""

    factors: Factors
    P: Array
    evidence: float
    weights: Array

    @cached_property
    def c(self) -> Array:
        """(k,) coefficients."""
        f = self.factors
        return np.asarray(scipy.linalg.solve(f.D + self.P, f.s, assume_a="pos", check_finite=False))

    @cached_property
    def chi2(self) -> float:
        """Drop of the squared residual."""
        return float(2.0 * self.c @ self.factors.s - self.c @ self.factors.D @ self.c)

    @cached_property
    def edf(self) -> float:
        """Effective degrees of freedom."""
        return float(np.trace(np.linalg.solve(self.factors.D + self.P, self.factors.D)))

    @property
    def weight(self) -> float:
        """Of a pair's two weights the mean."""
        return float(np.exp(np.mean(np.log(self.weights)))) if len(self.weights) else 1.0


#: Of twice the log likelihood by drops (W,) of the squared residual; None where its variance is known.
Gain = Callable[[Array], Array] | None


def smooth(f: Factors, penalties: Sequence[Array], gain: Gain, near: float) -> Smooth:
    """The penalised fit with the most evidence, of a pair's two weights uphill from ``near``."""
    if len(penalties) < 2:
        return smooth_all([f], penalties, gain, _FINE)[0]
    seen: dict[tuple[int, ...], float] = {}
    at: tuple[int, ...] = (int(np.argmin(np.abs(np.log(_FINE_PAIR / near)))),) * 2
    while True:
        around = product(*(range(max(i - 1, 0), min(i + 2, len(_FINE_PAIR))) for i in at))
        fresh = [place for place in around if place not in seen]
        if fresh:
            values = _evidence([f], [f.priors(penalties, _FINE_PAIR[np.array(fresh)])], gain)
            seen.update(zip(fresh, values[0].tolist(), strict=True))
        highest = max(seen, key=lambda place: seen[place])
        if highest == at:
            weights = _FINE_PAIR[list(at)]
            return Smooth(f, f.priors(penalties, weights[None])[0], seen[at], weights)
        at = highest


def smooth_all(
    every: Sequence[Factors], penalties: Sequence[Array], gain: Gain, among: Array = _COARSE
) -> list[Smooth]:
    """The same of each of several, with one weight for all of the roughness."""
    weights = among[:, None] if penalties else np.zeros((1, 0))
    penalties = [np.sum(penalties, axis=0)] if penalties else []
    P = [f.priors(penalties, weights) for f in every]
    values = _evidence(every, P, gain)
    best = np.argmax(values, axis=1).tolist()
    found = zip(every, P, values, best, strict=True)
    return [Smooth(f, own[k], float(value[k]), weights[k]) for f, own, value, k in found]


def _evidence(every: Sequence[Factors], P: Sequence[Array], gain: Gain) -> Array:
    """(F, W) of fits with each of the penalties P (W, k, k)."""
    F, W, k = len(every), len(P[0]), len(every[0].s)
    # Bordered by s, the factor's last row is L^-1 s; the corner only has to be large enough.
    bordered, prior = np.empty((F, W, k + 1, k + 1)), np.array(P)
    bordered[..., :k, :k] = np.array([f.D for f in every])[:, None] + prior
    bordered[..., k, :k], bordered[..., k] = np.array([f.s for f in every])[:, None], 1e300
    after, before = np.linalg.cholesky(bordered), np.linalg.cholesky(prior)
    grown = np.einsum("fwkk->fwk", after)[..., :k] / np.einsum("fwkk->fwk", before)
    drops = np.sum(after[..., k, :k] ** 2, axis=2)
    gains = drops if gain is None else gain(drops.ravel()).reshape(F, W)
    return np.asarray(gains - 2.0 * np.sum(np.log(grown), axis=2))


def agreement(found: Smooth, overlap: Array) -> Array:
    """(B, B) G with T(e) = e' G e, what the blocks explain together when their scores change sign by
    e, without what each explains alone. No block counts for more than the upper quartile of them: a
    few stretches that are most of an error agree by chance in a large share of all draws.

    overlap (B, r) : block sums of Q r.
    """
    f = found.factors
    scores = f.fit.rows.products(f.Z, f.of_joint(f.fit.residual)) - overlap @ f.C
    G = scores @ np.linalg.solve(f.D + found.P, scores.T)
    own = np.maximum(np.diagonal(G), 1e-300)
    # np.quantile takes longer than all the rest.
    most = np.interp(_CUT * (len(own) - 1), np.arange(len(own)), np.sort(own))
    cut = np.sqrt(np.minimum(most / own, 1.0))
    out = G * np.outer(cut, cut)
    np.fill_diagonal(out, 0.0)
    return np.asarray(out)


def held_out_gain(f: Factors, P: Array) -> float:
    """Gain in squared white residual of all folds, each from fits on the others."""
    gain, folds = 0.0, f.fit.without_folds(f.fit.rows.fold)
    for part, (c, Z_out, overlap) in zip(folds, _without(f, P, folds), strict=True):
        change = np.negative(part.Q @ (part.inverse @ (overlap @ c))).reshape(f.fit.rows.n, -1)
        change[f.joint] += Z_out @ c
        gain += float((2.0 * part.error - change.ravel()) @ change.ravel())
    return gain


def fold_coefficients(f: Factors, P: Array, folds: NDArray[np.intp]) -> Array:
    """(F, k) for each fold of ``folds`` (M,) from the other folds."""
    return np.array([c for c, _, _ in _without(f, P, f.fit.without_folds(folds))])


def _without(f: Factors, P: Array, folds: Sequence[WithoutFold]) -> Iterator[tuple[Array, Array, Array]]:
    """Of each fold the coefficients (k,) from the others, its rows of Z, and the other rows' Q'Z."""
    n, target = f.fit.rows.n, f.of_joint(f.fit.target)
    pull_all = f.Z.T @ target
    for part in folds:
        held = part.out[: len(f.Z)]
        Z_out = f.Z[held]
        own = part.Q.reshape(n, len(Z_out), part.Q.shape[1])[f.joint]  # of a frozen model: no columns
        overlap = f.C - own.T @ Z_out
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


def draws(found: Smooth, seed: int, count: int) -> Array:
    """(count, k) errors of the coefficients.

    Two parts: blocks drawn with replacement (what the noise does, whatever its colour), and what
    smoothing may have cost, a normal with the covariance that the prior leaves beyond the noise's,
    (D + P)^-1 - (D + P)^-1 D (D + P)^-1 (Nychka, JASA 1988). In a draw of blocks directions of which
    the data say next to nothing stay where the prior has them.
    """
    f, P = found.factors, found.P
    fit, rng = f.fit, np.random.default_rng(seed)
    partialled = np.negative(fit.Q @ f.C)
    f.of_joint(partialled)[:] += f.Z
    left = fit.residual - partialled @ found.c
    A = f.D + P
    values, V = scipy.linalg.eigh(f.D, A, check_finite=False)
    V = V[:, values > _SAID]
    partialled, centre = partialled @ V, V.T @ (P @ found.c)
    u = fit.rows.block_sums(partialled * left[:, None])
    grams = _block_grams(fit, partialled)
    (B, k), rest = u.shape, V.T @ P @ V
    bias = np.linalg.solve(A, P) @ np.linalg.inv(A)
    values, vectors = np.linalg.eigh(0.5 * (bias + bias.T))
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    drawn = rng.integers(B, size=(count, B))
    weights = np.array([np.bincount(d, minlength=B) for d in drawn], float)
    out = rng.normal(size=(count, len(root))) @ root.T
    for part in np.array_split(np.arange(count), max(1, count * k * k // _AT_ONCE)):
        totals = (weights[part] @ grams.reshape(B, -1)).reshape(-1, k, k) + rest
        own = np.linalg.solve(totals, (weights[part] @ u - centre)[:, :, None])[:, :, 0]
        out[part] += own @ V.T
    return out


def _block_grams(fit: WhiteFit, columns: Array) -> Array:
    """(B, k, k)."""
    shaped = columns.reshape(fit.rows.n, len(fit.rows.block), -1)
    parts = (shaped[:, fit.rows.block == b] for b in range(fit.rows.blocks))
    return np.array([np.einsum("nmk,nml->kl", x, x, optimize=True) for x in parts])
