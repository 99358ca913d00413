"""Sizes of findings, with intervals.

They are least squares on white rows beside the model, all other findings and what is
tolerated of a mounting. Their covariance is the sandwich A^-1 S A^-1 with a column for
each shape constant (:mod:`~sdp_vs_penalty.estimation.sensitivity`) and S over the
clusters of rows that make it largest, at least that of independent rows. The gains of
the torque channels and a model that is held fixed are in doubt.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sdp_vs_penalty.diagnosis.linear_fit import ScoredEffect, WhiteFit
from sdp_vs_penalty.diagnosis.search import Search
from sdp_vs_penalty.diagnosis.white_rows import (
    ConstantErrors,
    WhiteData,
    cluster_sums,
    model_columns,
)
from sdp_vs_penalty.effects.effect import Effect
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.robot.arrays import Array


@dataclass(frozen=True)
class Size:
    """beta (k,) and covariance (k, k) of an effect's parameters, and the covariance where
    its shape constants are exact."""

    beta: Array
    covariance: Array
    covariance_given_constants: Array


def sizes_with_intervals(
    search: Search,
    torque_in_doubt: Array,
    errors_of_constants: Sequence[ConstantErrors],
) -> list[Size]:
    """Of all terms; torque_in_doubt (n, M, e) : of :func:`torque_errors`;
    errors_of_constants : of :meth:`WhiteData.constant_error_columns`."""
    tolerances = search.nuisances.mounting_tolerances.values()
    fit = search.score.fit([*search.terms, *tolerances], search.fit)
    return [
        size_with_interval(search, t, fit, torque_in_doubt, errors_of_constants)
        for t in search.terms
    ]


def size_with_interval(
    search: Search,
    term: ScoredEffect,
    fit_with_tolerances: WhiteFit,
    torque_in_doubt: Array,
    errors_of_constants: Sequence[ConstantErrors],
) -> Size:
    """The size of a term beside all others, with its covariance.

    fit_with_tolerances : of all terms and all that is tolerated; the others as in
    :func:`sizes_with_intervals`.
    """
    k = term.form.n_coefficients
    others = [t for t in search.terms if t != term]
    tolerated = search.nuisances.mounting_tolerances_beside(term, others)
    fit = search.score.fit([*others, *tolerated], fit_with_tolerances)
    columns, known = search.score.partial_out(
        fit,
        term.form,
        term.columns,
    )
    of_constants = [
        fit.residual_of(fit.scaled(z))
        for _, z in errors_of_constants
        if not term.joints.isdisjoint(z)
    ]
    T = np.concatenate([columns, *of_constants], axis=2)
    prior = np.diag(np.concatenate([known**-2.0, np.ones(T.shape[2] - k)]))
    A = np.tensordot(T, T, axes=((0, 1), (0, 1))) + prior
    inverse = np.linalg.pinv(A, rcond=1e-12, hermitian=True)
    left = fit.residual - T[:, :, :k] @ term.beta
    middle = [_largest_sums(search.data, T, left)]
    if torque_in_doubt.shape[2]:
        doubt = fit.residual_of(fit.scaled(dict(enumerate(torque_in_doubt))))
        middle.append(
            np.tensordot(
                T,
                doubt,
                axes=((0, 1), (0, 1)),
            )
        )
    through = inverse @ np.hstack(middle)
    covariance = _at_least(through @ through.T, inverse @ (A - prior) @ inverse)
    precision = np.linalg.pinv(covariance, hermitian=True)[:k, :k]
    return Size(
        beta=term.beta,
        covariance=covariance[:k, :k],
        covariance_given_constants=np.linalg.pinv(precision, hermitian=True),
    )


def _largest_sums(data: WhiteData, T: Array, left: Array) -> Array:
    """(K, clusters) a factor of the sandwich's middle, of the clusters that make most
    of it.

    They have as many degrees of freedom as there are clusters, less those that the fit
    has taken.
    """
    scores = np.sum(T * left[:, :, None], axis=0)[: len(data.clusters[0])]
    scaled = [
        u.T * np.sqrt(len(u) / max(len(u) - T.shape[2], 1.0))
        for u in cluster_sums(data.clusters, scores)
    ]
    return max(scaled, key=lambda u: float(np.sum(u**2)))


def _at_least(covariance: Array, smallest: Array) -> Array:
    """(K, K) a covariance with variances of at least those of another one."""
    variances = np.diagonal(covariance)
    larger = np.maximum(variances, np.diagonal(smallest))
    grown = larger / np.maximum(variances, 1e-300)
    return np.asarray(covariance * np.sqrt(grown[:, None] * grown))


def torque_errors(data: WhiteData, estimate: Estimate, gain_errors: Array) -> Array:
    """(n, M, e) white rows of the torque that is in doubt before anything is searched.

    gain_errors (n, e) : a factor of the covariance of the channels' gains. A model that
    is held fixed brings its parameters' spread along, and what the same gains have made
    of them.
    """
    known = estimate.uncertainty
    rows = data.rows
    n = rows.n
    M = len(rows.t)
    if not data.frozen and not gain_errors.any():
        return np.zeros((n, M, 0))
    columns = model_columns(rows, estimate)
    parts = []
    for j in range(n):
        gains = -columns[j] @ known.gain_response
        gains[:, j] += rows.torque[:, j]
        part = gains @ gain_errors
        if data.frozen:
            part = np.hstack(
                [
                    part,
                    -columns[j] @ known.spread,
                ]
            )
        parts.append(data.white(part, j))
    return np.stack(parts)


def size_of(
    effect: Effect,
    beta: Array,
    covariance: Array,
) -> tuple[float, float]:
    """One number for the size of an effect, and its standard deviation.

    The parameter that the effect is sized by, with its sign; the norm where it is
    several.
    """
    b = beta[effect.sized_by]
    c = covariance[effect.sized_by, effect.sized_by]
    if len(b) == 1:
        return float(b[0]), float(max(c[0, 0], 0.0) ** 0.5)
    size = float(np.linalg.norm(b))
    if size == 0.0:
        return 0.0, float(np.sqrt(np.trace(c)))
    direction = b / size
    return size, float(max(float(direction @ c @ direction), 0.0) ** 0.5)
