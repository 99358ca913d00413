"""How large a finding is, and how well that is known: with the constants of all shapes, the gains of the
torque channels and a model that is held fixed in doubt.

Coefficients are least squares on white rows beside the model and all other findings. Their covariance is
the sandwich A^-1 S A^-1 with a column for each shape constant
(:mod:`~sdp_vs_penalty.estimation.shape_constants`) and S over the clusters of rows that make it largest,
and at least that of independent rows.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sdp_vs_penalty.diagnosis.score import Fit, Term
from sdp_vs_penalty.diagnosis.search import Search
from sdp_vs_penalty.diagnosis.whitening import WhiteData, cluster_sums, model_columns
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.estimation.shape_constants import ShapeSensitivity, free_constants, prior_deviation
from sdp_vs_penalty.robot.arrays import Array


@dataclass(frozen=True)
class Size:
    """beta (k,) with covariance (k, k) of an effect's parameters; constants : standard deviation of each
    free shape constant, in its own scale (of its logarithm, or of the value)."""

    beta: Array
    covariance: Array
    constants: dict[str, float]


def size_of_term(search: Search, term: Term, errors: Array) -> Size:
    """errors (n, M, e) : a factor of the covariance of white rows' torque, from
    :func:`torque_errors`."""
    data, k = search.data, term.form.k
    others = [t for t in search.terms if t != term]
    fit = search.score.fit(others, search.fit)
    if term.form.own:
        fit = fit.without_own(term.form) or fit
    apart, known = search.score.apart(fit, term.form, term.columns)
    columns = [apart]
    own = free_constants(term.form.effect)
    for t in [term, *others]:
        if free_constants(t.form.effect):
            moved = data.columns(ShapeSensitivity(t.form.effect, t.beta))
            if moved:
                columns.append(fit.beside(fit.scaled(moved)))
    T = np.concatenate(columns, axis=2)
    prior = np.concatenate([known**-2.0, np.ones(T.shape[2] - k)])
    A = np.tensordot(T, T, axes=((0, 1), (0, 1))) + np.diag(prior)
    inverse = np.linalg.pinv(A, rcond=1e-12, hermitian=True)
    beta = term.beta
    left = fit.residual - T[:, :, :k] @ beta
    inside = _factor(search, fit, T, left)
    through = inverse @ np.hstack([inside, _torque(T, fit, errors)])
    covariance = through @ through.T
    least = inverse @ (A - np.diag(prior)) @ inverse
    variances = np.diagonal(covariance)
    grown = np.maximum(variances, np.diagonal(least)) / np.maximum(variances, 1e-300)
    covariance = covariance * np.sqrt(grown[:, None] * grown)
    deviations = np.sqrt(np.maximum(np.diagonal(covariance), 0.0))[k : k + len(own)]
    constants = {
        name: float(d * prior_deviation(term.form.effect, name))
        for name, d in zip(own, deviations, strict=False)
    }
    return Size(beta, covariance[:k, :k], constants)


def _factor(search: Search, fit: Fit, T: Array, left: Array) -> Array:
    """(K, C) a factor of S, of the clusters that make it largest."""
    sums = cluster_sums(search.data.clusters, np.sum(T * left[:, :, None], axis=0))
    # As many degrees of freedom as there are clusters, less those that the fit has taken.
    every = (u.T * np.sqrt(len(u) / max(len(u) - T.shape[2], 1.0)) for u in sums)
    return max(every, key=lambda u: float(np.sum(u**2)))


def _torque(T: Array, fit: Fit, errors: Array) -> Array:
    """(K, e) what errors of the torque (n, M, e) do to the normal equations."""
    if not errors.shape[2]:
        return np.zeros((T.shape[2], 0))
    weighted = fit.beside({j: e for j, e in enumerate(errors / fit.level[:, None, None])})
    return np.tensordot(T, weighted, axes=((0, 1), (0, 1)))


def torque_errors(data: WhiteData, estimate: Estimate, gain_errors: Array) -> Array:
    """(n, M, e) white rows of the torque that is in doubt before anything is searched.

    gain_errors (n, e) : a factor of the covariance of the channels' gains. A model that is held fixed
    brings its parameters' spread along, and what the same gains have made of them.
    """
    known, rows = estimate.uncertainty, data.rows
    n, M = rows.n, len(rows.t)
    if not data.frozen and not gain_errors.any():
        return np.zeros((n, M, 0))
    columns = model_columns(rows, estimate)
    parts = []
    for j in range(n):
        gains = -columns[j] @ known.gains
        gains[:, j] += rows.torque[:, j]
        part = gains @ gain_errors
        if data.frozen:
            part = np.hstack([part, -columns[j] @ known.spread])
        parts.append(data.white(part, j))
    return np.stack(parts)
