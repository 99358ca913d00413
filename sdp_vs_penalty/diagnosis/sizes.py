"""Sizes of findings, with covariances.

A size is estimated by least squares on white rows, beside the model and all other
findings. Its covariance is the sandwich A^-1 S A^-1: A has a column for each shape
constant too (:mod:`~sdp_vs_penalty.estimation.sensitivity`), and S sums over the
clusters of rows, or the parts of the log, that make it largest. Variances are at least
those of independent rows. Errors of the torque channels' gains, and of a model held
fixed, are included.

More rows do not tell the size better than the law is right. As in the search
(:mod:`~sdp_vs_penalty.diagnosis.nuisances`), errors of a law are expected to make 4 % of
what it explains, and each of them its share eps. So the shape constants may be wrong by
what loses the share eps of the drop dD of the deviance, and the size follows them. To
second order its standard deviation is

    sqrt(eps dD (C - C_s)),

with the variances C of the size beside free constants and C_s beside exact ones, of
independent rows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from sdp_vs_penalty.diagnosis.constants import PARTS, SIGNIFICANT, UNCERTAIN
from sdp_vs_penalty.diagnosis.linear_fit import ScoredEffect, WhiteFit
from sdp_vs_penalty.diagnosis.nuisances import share_of_one_misfit
from sdp_vs_penalty.diagnosis.search import Search
from sdp_vs_penalty.diagnosis.white_rows import (
    ConstantErrors,
    WhiteData,
    model_columns,
    spread_columns,
)
from sdp_vs_penalty.effects.effect import Effect
from sdp_vs_penalty.estimation.constants import NORMAL_95
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.estimation.sensitivity import ShapeSensitivity, free_constants
from sdp_vs_penalty.regression.evidence import cluster_sums, student_95
from sdp_vs_penalty.robot.arrays import Array, Indices
from sdp_vs_penalty.signals.segments import SegmentedRuns


@dataclass(frozen=True)
class TorqueMade:
    """Root mean square of the torque that a finding makes in the searched rows."""

    #: Number of the joint where the torque is largest, from 0.
    joint: int
    #: RMS of the torque [N m or N].
    rms: float
    #: Standard deviation of the RMS [N m or N].
    std: float


@dataclass(frozen=True)
class Size:
    """Parameters of an effect with their covariance."""

    #: (k,) parameters in SI units.
    beta: Array
    #: (k, k) covariance of the parameters, with the errors of shape constants (such as
    #: a Stribeck velocity).
    covariance: Array
    #: (k, k) covariance of the parameters if these constants were exact.
    covariance_given_constants: Array
    #: (k, k) covariance without the torque in doubt as well, from the scatter over the
    #: log alone.
    covariance_of_rows: Array
    #: (k, k) covariance that the tolerated error of the law adds.
    covariance_of_law: Array
    #: How much torque the parameters make.
    torque: TorqueMade

    def std_of_law(self, effect: Effect) -> float:
        """Return the standard deviation of the effect's size by the tolerated error of
        its law, in the size's SI unit.

        At most half the size (SIGNIFICANT): that the effect is there is judged by its
        evidence, and another value of a shape constant does not take it away.
        """
        size, std = size_of(effect, self.beta, self.covariance_of_law)
        return min(std, SIGNIFICANT * abs(size))


def is_uncertain(size: float, std: float) -> bool:
    """Return whether a size's relative standard deviation is 20 % (UNCERTAIN) or more.

    A size of zero counts as uncertain, and so does one whose std is not a number.
    """
    return not std < UNCERTAIN * abs(size)


def is_insignificant(size: float, std: float) -> bool:
    """Return whether a size is at most two standard deviations from zero.

    That is std / |size| >= 0.5 (SIGNIFICANT), or a std that is not a number.
    """
    return not std < SIGNIFICANT * abs(size)


def sizes_with_intervals(
    search: Search,
    torque_in_doubt: Array,
    errors_of_constants: Sequence[ConstantErrors],
) -> list[Size]:
    """Compute the parameters of all findings of a search, with their covariances.

    Parameters
    ----------
    search
        The findings beside the model.
    torque_in_doubt
        (n, M, e) white torque that known errors, of gains and of a fixed model, cause
        (:func:`torque_errors`).
    errors_of_constants
        White derivatives of torque by shape constants, by effect
        (:meth:`WhiteData.constant_error_columns`).

    Returns
    -------
    list of Size
        One for each finding, in the same order.
    """
    fit = search.score.fit(search.terms, search.fit)
    return [
        size_with_interval(search, t, fit, torque_in_doubt, errors_of_constants)
        for t in search.terms
    ]


def size_with_interval(
    search: Search,
    term: ScoredEffect,
    fit_of_all: WhiteFit,
    torque_in_doubt: Array,
    errors_of_constants: Sequence[ConstantErrors],
) -> Size:
    """Compute the covariance of one finding's parameters, with all others in the fit.

    covariance = A^-1 S A^-1 (sandwich), with A = T'T + prior for the columns T of the
    finding and of errors of shape constants, less what the fit with all other findings
    explains of them. S sums the products of scores T'r over clusters of rows, and adds
    the torque in doubt. Variances are at least those of independent rows.

    Parameters
    ----------
    search
        The findings beside the model.
    fit_of_all
        A fit with all findings; its columns are used again.
    torque_in_doubt
        (n, M, e) white torque that known errors, of gains and of a fixed model, cause
        (:func:`torque_errors`).
    errors_of_constants
        White derivatives of torque by shape constants, by effect.
    """
    k = term.form.n_coefficients
    others = [t for t in search.terms if t != term]
    fit = search.score.fit(others, fit_of_all)
    trial = search.score.trial_beside(fit, fit, term.form, term.columns)
    # (n, M, K): the effect's k columns first, then those of errors of shape constants,
    # which are scaled so that their prior standard deviation is 1.
    columns, is_own = [trial.columns_left], [True] * k
    for derivatives, white in errors_of_constants:
        if not term.joints.isdisjoint(white):
            columns.append(fit.residual_of(fit.scaled(white)))
            is_own += [derivatives.effect.text == term.text] * len(derivatives.keys)
    T = np.concatenate(columns, axis=2)
    n_constants = T.shape[2] - k
    prior = np.diag(np.concatenate([trial.prior_std**-2.0, np.ones(n_constants)]))
    joints_and_rows = ((0, 1), (0, 1))
    gram = np.tensordot(T, T, axes=joints_and_rows)
    A = gram + prior
    inverse = _inverse(A)
    residual = fit.residual - T[:, :, :k] @ term.beta
    # Factors F of the sandwich's middle S = F F', side by side.
    factors = [largest_sums(search.data, T, residual)]
    if torque_in_doubt.shape[2]:
        by_joint = dict(enumerate(torque_in_doubt))
        doubt = fit.residual_of(fit.scaled(by_joint))
        factors.append(np.tensordot(T, doubt, axes=joints_and_rows))
    covariance = _sandwich(inverse, factors, gram)
    # Without the columns of the constants, as if these were exact.
    inverse_given_constants = _inverse(A[:k, :k])
    given_constants = partial(_sandwich, inverse_given_constants, gram=gram[:k, :k])
    of_effect = [factor[:k] for factor in factors]
    own = np.flatnonzero(is_own)
    by_constants = _inverse(A[np.ix_(own, own)])[:k, :k] - inverse_given_constants
    tolerated = share_of_one_misfit(term.form.effect) * max(term.drop, 0.0)
    return Size(
        beta=term.beta,
        covariance=covariance[:k, :k],
        covariance_given_constants=given_constants(of_effect),
        covariance_of_rows=given_constants(of_effect[:1]),
        covariance_of_law=tolerated * by_constants,
        torque=torque_made(
            search.data.rows,
            term.form.effect,
            term.beta,
            covariance[np.ix_(own, own)],
            joints_with_offset(search.data),
        ),
    )


def joints_with_offset(data: WhiteData) -> frozenset[int]:
    """Return the joints (from 0) whose constant torque the model's own offset takes in;
    none of a model that is held fixed."""
    effects = () if data.frozen else data.estimate.model.effects
    offsets = [set(e.joints) for e in effects if e.simulator_field == "offset"]
    return frozenset[int]().union(*offsets)


def beside_offsets(columns: Array, effect: Effect, offsets: frozenset[int]) -> Array:
    """Return an effect's columns (n, M, k) without what the model's offsets take in.

    That is the mean over all rows, of an effect with a constant part: a drift that
    settles in minutes is nearly a line in a run of seconds, and its amplitude is no
    measure of its torque.
    """
    if not effect.has_constant_part or not offsets:
        return columns
    out = columns.copy()
    for joint in offsets:
        out[joint] -= out[joint].mean(axis=0)
    return out


def torque_made(
    rows: SegmentedRuns,
    effect: Effect,
    beta: Array,
    covariance: Array,
    offsets: frozenset[int] = frozenset(),
) -> TorqueMade:
    """Compute how much torque a finding makes, and how well that is known.

    With the torque tau = Y(s) beta in M rows, T = sqrt(sum tau^2 / M). To first order
    its variance is g'C g, with the gradient g = (tau'Y / (M T), tau'D / (M T)), the
    derivatives D of the torque by the shape constants s, and the covariance C of beta
    and s. The share eps of the squares that is the law's own tolerated error adds
    eps T^2. A size such as that of a power law is far less certain than its torque: it
    is the torque at 1 rad/s, and follows the exponent.

    Parameters
    ----------
    beta
        (k,) its parameters, in SI units.
    covariance
        (k + c, k + c) their covariance with the errors of its c free shape constants,
        which are in units of their prior deviations.
    offsets
        Joints (from 0) whose constant torque the model takes in: it does not count.

    Returns
    -------
    TorqueMade
        On the joint where it is largest.
    """
    Y = beside_offsets(spread_columns(rows, effect), effect, offsets)
    torque = Y @ beta  # (n joints, M rows)
    mean_squares = np.mean(torque**2, axis=1)
    joint = int(np.argmax(mean_squares))
    rms = float(np.sqrt(mean_squares[joint]))
    if rms == 0.0:
        return TorqueMade(joint, rms, 0.0)
    columns = Y[joint]
    if free_constants(effect):
        by_constants = spread_columns(rows, ShapeSensitivity(effect, beta))
        beside = beside_offsets(by_constants, effect, offsets)
        columns = np.hstack([columns, beside[joint]])
    gradient = torque[joint] @ columns / (len(columns) * rms)
    variance = float(gradient @ covariance @ gradient)
    of_law = share_of_one_misfit(effect) * rms**2
    return TorqueMade(joint, rms, float(np.sqrt(max(variance, 0.0) + of_law)))


def _inverse(A: Array) -> Array:
    """Return the inverse of a symmetric matrix, where it has one."""
    return np.asarray(np.linalg.pinv(A, rcond=1e-12, hermitian=True), float)


def _sandwich(inverse: Array, factors: Sequence[Array], gram: Array) -> Array:
    """Return the covariance A^-1 F F' A^-1 (K, K); variances are at least those of
    independent rows.

    inverse (K, K) : A^-1; factors : columns of F (K, ...), side by side; gram (K, K) :
    T'T, which is F F' for independent rows.
    """
    factor = inverse @ np.hstack(factors)
    return _at_least(factor @ factor.T, inverse @ gram @ inverse)


def largest_sums(data: WhiteData, T: Array, residual: Array) -> Array:
    """Return a factor F (K, clusters) of the sandwich covariance's middle S = F F'
    (:func:`largest_sums_of_scores`), from columns T (n joints, rows, K) and the
    residual (n, rows)."""
    scores = np.sum(T * residual[:, :, None], axis=0)
    return largest_sums_of_scores(data.clusters, scores)


def largest_sums_of_scores(clusters: Sequence[Indices], scores: Array) -> Array:
    """Return a factor F (K, clusters) of the sandwich covariance's middle S = F F'.

    A column of F is the score summed over a cluster of rows that err together. Rows are
    clustered by time and by phase. Factors are scaled by sqrt(C / (C - K)) for C
    clusters and K parameters. Clusters are also joined to PARTS (8), because a model
    that lacks something errs alike over longer times than a cluster lasts: that is a
    jackknife over parts of the log, to first order. Of all ways the one with the
    largest trace of S is taken.

    Parameters
    ----------
    clusters
        For each way the label (rows,) of each row's cluster, from 0.
    scores
        (rows, K) products of the columns with the residual.
    """
    n_parameters = scores.shape[1]
    factors = []
    for sums in cluster_sums(clusters, scores):
        n_clusters = len(sums)
        degrees = max(n_clusters - n_parameters, 1.0)
        factors.append(sums.T * np.sqrt(n_clusters / degrees))
        if n_clusters >= 2 * PARTS:
            factors.append(_sums_of_parts(sums).T)
    return max(factors, key=lambda factor: float(np.sum(factor**2)))


def _sums_of_parts(sums: Array) -> Array:
    """Add sums (C, K) of consecutive clusters to those of PARTS parts, (PARTS, K).

    They are scaled by sqrt(PARTS / (PARTS - 1)), and by the 95 % quantile of Student's
    distribution with PARTS - 1 degrees of freedom over that of the normal one: a
    variance from few parts is uncertain itself.
    """
    first_clusters = np.linspace(0, len(sums), PARTS, endpoint=False).astype(np.intp)
    of_parts = np.add.reduceat(sums, first_clusters, axis=0)
    degrees = PARTS / (PARTS - 1)
    return of_parts * np.sqrt(degrees) * student_95(PARTS) / NORMAL_95


def _at_least(covariance: Array, smallest: Array) -> Array:
    """Raise the variances of a covariance (K, K) to those of another one, ``smallest``.

    Variances that are larger stay, and so do all correlations.
    """
    variances = np.diagonal(covariance)
    larger = np.maximum(variances, np.diagonal(smallest))
    growth = larger / np.maximum(variances, 1e-300)
    return covariance * np.sqrt(growth[:, None] * growth)


def torque_errors(data: WhiteData, estimate: Estimate) -> Array:
    """Return white torque (n joints, M rows, e) that known errors may have caused.

    These are errors that no search of the rows can remove: of the torque channels'
    gains, with the change that these make in the model's parameters, and, if the model
    is held fixed, of its parameters. Column i is the torque of an error of one standard
    deviation in direction i.

    Parameters
    ----------
    estimate
        The model with its uncertainty.
    """
    uncertainty = estimate.uncertainty
    rows = data.rows
    if not data.frozen and not uncertainty.gain_errors.any():
        return np.zeros((rows.n, len(rows.t), 0))
    columns = model_columns(rows, estimate)
    by_joint = []
    for j in range(rows.n):
        # (M, n) change of this joint's error for a unit error of each channel's gain.
        by_gain = -columns[j] @ uncertainty.gain_response
        by_gain[:, j] += rows.torque[:, j]
        errors = by_gain @ uncertainty.gain_errors
        if data.frozen:
            by_parameters = -columns[j] @ uncertainty.spread
            errors = np.hstack([errors, by_parameters])
        by_joint.append(data.white(errors, j))
    return np.stack(by_joint)


def size_of(effect: Effect, beta: Array, covariance: Array) -> tuple[float, float]:
    """Return one number for the size of an effect with parameters of covariance (k, k),
    and its standard deviation.

    The effect declares which of its parameters are its size (the slice ``sized_by``).
    If there are several, such as the amplitudes of sine and cosine, the size is their
    norm; of elements side by side (``sizes_add_up``), it is their sum.

    Parameters
    ----------
    beta
        (k,) its parameters, in SI units.

    Returns
    -------
    float
        The size in the parameter's SI unit, with its sign if it is one parameter.
    float
        Its standard deviation sqrt(u'C u), where u is the gradient of the size: ones
        for a sum, and to first order the unit vector along the parameters for a norm.
    """
    parameters = beta[effect.sized_by]
    their_covariance = covariance[effect.sized_by, effect.sized_by]
    if len(parameters) == 1 or effect.sizes_add_up:
        variance = max(float(their_covariance.sum()), 0.0)
        return float(parameters.sum()), variance**0.5
    size = float(np.linalg.norm(parameters))
    if size == 0.0:
        return 0.0, float(np.sqrt(np.trace(their_covariance)))
    direction = parameters / size  # the gradient of the norm
    variance = max(float(direction @ their_covariance @ direction), 0.0)
    return size, variance**0.5
