"""Penalised splines on one joint's white rows, beside a fit, by the score of all other forms.

With z the white columns of a basis, Q the fit's and r what it leaves, everything follows from
D = z'z - (Q'z)'Q'z and s = z'r: c = (D + P)^-1 s, P = lambda S + z'z / N, S the roughness of the splines
(Eilers, Marx 1996), the last term a prior worth one row. The score is that of :mod:`..score` with the
effective degrees of freedom tr (D + P)^-1 D in the place of k; lambda is where it is highest.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from sdp_vs_penalty.diagnosis.constants import ABSORBED_CURVE, ALPHA
from sdp_vs_penalty.diagnosis.curves.bases import Basis
from sdp_vs_penalty.diagnosis.score import Fit, Score
from sdp_vs_penalty.robot.arrays import Array

#: Weights of the roughness that are tried, relative to the data's.
_WEIGHTS = 10.0 ** np.arange(-5.0, 5.5, 1.0)
#: Prior, as a share of the rows, of the model's own parameters in fits without a fold.
_HELD = 0.003


@dataclass(frozen=True)
class Columns:
    """Weighted white columns z (M, k) of a joint beside a fit: C = Q'z (r, k), D (k, k), s (k,), raw =
    z'z; count : rows of the joint, v : how many of them are worth one."""

    fit: Fit
    joint: int
    z: Array
    C: Array
    D: Array
    s: Array
    raw: Array
    count: float
    v: float

    @classmethod
    def of(cls, score: Score, fit: Fit, white: Array, joint: int, robust: bool = True) -> Columns:
        z = white / fit.level[joint]
        C, raw = fit.basis[joint].T @ z, z.T @ z
        D, s = raw - C.T @ C, z.T @ fit.residual[joint]
        count = float(fit.degrees[joint])
        v = 1.0
        if robust and len(s):
            T = fit.beside({joint: z})
            inverse = np.linalg.inv(D + raw / count + 1e-9 * np.trace(raw) * np.eye(len(s)))
            c = inverse @ s
            freedom = max(float(np.trace(inverse @ D)), 1.0)
            v = score.worth_of_one(T, fit.residual - T @ c, inverse, freedom)
        return cls(fit, joint, z, C, D, s, raw, count, v + count / ALPHA)

    def score(self, drop: float, freedom: float, looked: int) -> float:
        """The score of something that takes ``drop`` of the weighted squared error with so much freedom,
        of so many looked at."""
        fit, N, rss = self.fit, max(self.count / self.v, 3.0), self.fit.rss.copy()
        rss[self.joint] = max(rss[self.joint] - drop * fit.level[self.joint] ** 2, 0.0)
        gain = fit.deviance(fit.rss) - fit.deviance(rss)
        return gain / self.v - freedom * np.log(N) - 2.0 * np.log(max(looked, 1))

    def without_fold(self, fold: NDArray[np.intp], P: Array) -> Array:
        """(F, k) coefficients from the rows outside of each fold (M,), the fit's columns refitted
        there."""
        Q, y, r = self.fit.basis, self.fit.target, self.fit.basis.shape[2]
        out = []
        for f in np.unique(fold):
            train = fold != f
            q = Q[:, train].reshape(-1, r)
            G = np.zeros((r + len(self.s),) * 2)
            G[:r, :r] = q.T @ q + _HELD * np.eye(r)
            G[:r, r:] = Q[self.joint][train].T @ self.z[train]
            G[r:, :r] = G[:r, r:].T
            G[r:, r:] = self.z[train].T @ self.z[train] + P
            own = y[:, train].ravel()
            # The fit's own parameters are held where they were.
            theta = np.tensordot(Q, y, axes=((0, 1), (0, 1)))
            pull = np.concatenate([q.T @ own + _HELD * theta, self.z[train].T @ y[self.joint][train]])
            out.append(np.linalg.solve(G, pull)[r:])
        return np.array(out)


@dataclass(frozen=True)
class SplineFit:
    """A curve of one joint over a basis: raw (M, k) its columns, not white; P (k, k) the penalty; J."""

    basis: Basis
    raw: Array
    columns: Columns
    P: Array
    J: float

    @property
    def joint(self) -> int:
        return self.columns.joint

    @cached_property
    def c(self) -> Array:
        """(k,) coefficients."""
        return np.asarray(np.linalg.solve(self.columns.D + self.P, self.columns.s))

    @cached_property
    def projector(self) -> Array:
        """(k, k) onto what the model's own columns cannot make, nor the smoothing alone decides."""
        metric = self.columns.raw + self.P
        values, vectors = scipy.linalg.eigh(self.columns.D, metric)
        kept = vectors[:, values > ABSORBED_CURVE]
        return np.asarray(kept @ kept.T @ metric)

    @property
    def coefficients(self) -> Array:
        """(k,) of what the model's own columns cannot make."""
        return np.asarray(self.projector @ self.c)


def smoothed(basis: Basis, raw: Array, columns: Columns, looked: int) -> SplineFit:
    """The curve with the roughness that scores most."""
    own = columns.raw / max(columns.count, 1.0) + 1e-10 * np.trace(columns.raw) * np.eye(len(columns.s))
    rough = sum(basis.penalties, np.zeros_like(own))
    best: tuple[float, Array] | None = None
    for weight in _WEIGHTS if rough.any() else (1.0,):
        P = own + weight * np.trace(columns.raw) * rough
        factor = scipy.linalg.cho_factor(columns.D + P, check_finite=False)
        c = scipy.linalg.cho_solve(factor, columns.s, check_finite=False)
        freedom = float(np.trace(scipy.linalg.cho_solve(factor, columns.D, check_finite=False)))
        drop = float(2.0 * c @ columns.s - c @ (columns.D @ c))
        J = columns.score(drop, freedom, looked)
        if best is None or best[0] < J:
            best = J, P
    assert best is not None
    return SplineFit(basis, raw, columns, best[1], best[0])


def band(found: SplineFit, grid: Array, seed: int, level: float = 0.95, draws: int = 300) -> Array:
    """(P,) half width of the band that holds ``level`` of whole curves on grid (P, k): draws of the
    coefficients, normal with the covariance v (D + P)^-1 (Nychka, JASA 1988)."""
    rng = np.random.default_rng(seed)
    A = found.columns.D + found.P
    values, vectors = np.linalg.eigh(A)
    root = vectors / np.sqrt(np.maximum(values, 1e-12 * values[-1]))
    spread = np.sqrt(max(found.columns.v - found.columns.count / ALPHA, 1.0))
    errors = spread * rng.normal(size=(draws, len(A))) @ root.T @ found.projector.T @ grid.T
    deviation = np.maximum(errors.std(axis=0), 1e-300)
    largest = np.max(np.abs(errors) / deviation, axis=1)
    return np.asarray(np.quantile(largest, level) * deviation)
