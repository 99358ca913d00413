"""Evidence of an effect or of a fault: what both the diagnosis and the check judge by.

A candidate lowers the squared residual. How much that is worth follows from

- the deviance of the residual, each joint with a variance of its own (:func:`deviance`);
- the number of rows that err independently: by the residual's autocorrelation
  (:func:`independent_rows`), or by clusters of rows (:func:`rows_worth_one`);
- what parameters and choices cost (:func:`price`);
- the scatter of estimates without one part of the log each (:func:`jackknifed`,
  :func:`student_95`, :func:`standard_errors_above_zero`).

How many candidates compete is the caller's matter.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import scipy
from numpy.typing import ArrayLike

from sdp_vs_penalty.robot.arrays import Array, Indices, nonzero_or_one


def deviance(
    squares: Array, degrees: ArrayLike, smallest_variance: float = 0.0
) -> Array:
    """Return the deviance D = -2 log L [-] of Gaussian residuals, each joint with a
    variance of its own.

    It is D = sum_j N_j log V_j + S_j / V_j, with V_j = max(S_j / N_j,
    smallest_variance), up to a constant.

    Parameters
    ----------
    squares : (..., n) array
        S_j, squared residual of each joint, summed over the rows.
    degrees : (n,) array or float
        N_j, number of independent rows of each joint.
    smallest_variance : float
        Lowest variance of a joint, in the residual's unit squared.
    """
    variance = np.maximum(squares / np.asarray(degrees), smallest_variance)
    by_joint = degrees * np.log(variance) + squares / variance
    return np.sum(by_joint, axis=-1)


def log_odds(squares_before: Array, squares_after: Array, degrees: ArrayLike) -> float:
    """Return by how much a fall of the residual raises the log-likelihood.

    Without a smallest variance it is sum_j N_j / 2 log(S_j before / S_j after): half
    the drop of the deviance.

    Parameters
    ----------
    squares_before, squares_after : (n,) array
        S_j, positive: squared residuals, or shares of the squared torque.
    degrees : (n,) array or float
        N_j, number of independent rows of each joint.

    Returns
    -------
    float
        Natural logarithm; negative for a rise.
    """
    drop = deviance(squares_before, degrees) - deviance(squares_after, degrees)
    return 0.5 * float(drop)


def independent_rows(residual: Array) -> float:
    """Return the number of independent samples, M at most, in M correlated rows of a
    residual (n, M).

    It is M / (1 + 2 sum_k rho_k), rho_k the autocorrelation of the residual at lag k,
    summed up to the first lag at which it is not positive (Geyer 1992); the median over
    the joints.
    """
    n_rows = residual.shape[1]
    centred = residual - residual.mean(axis=1, keepdims=True)
    # Autocorrelation by FFT; zeros behind the rows keep it from wrapping round.
    power = np.abs(np.fft.rfft(centred, 2 * n_rows)) ** 2
    rho = np.fft.irfft(power)[:, :n_rows]
    rho = rho / nonzero_or_one(rho[:, :1])
    is_before_first_zero = np.cumprod(rho > 0.0, axis=1)
    # Lag 0, of correlation 1, is in the sum once too often.
    rows_per_sample = 2.0 * np.sum(rho * is_before_first_zero, axis=1) - 1.0
    return n_rows / max(float(np.median(rows_per_sample)), 1.0)


def cluster_sums(clusters: Sequence[Indices], scores: Array) -> Iterator[Array]:
    """Yield the sums of scores (number of clusters, k) over clusters of rows, for each
    way to cluster them.

    The M rows have scores (M, k), and for each way the labels (M,) of their clusters,
    from 0.
    """
    for labels in clusters:
        yield np.stack([np.bincount(labels, column) for column in scores.T], axis=1)


def rows_worth_one(
    clusters: Sequence[Indices], scores: Array, inverse: Array, freedom: float
) -> float:
    """Return v, the number of correlated rows that carry the evidence of one
    independent row.

    v = tr(A^-1 S) / freedom, at least 1, with the effective number of coefficients
    (``freedom``). S = sum of u u' over clusters of rows, with u the scores summed
    within a cluster: the middle of the sandwich covariance (Liang, Zeger, Biometrika
    1986). Of several ways to cluster rows the largest v counts.

    Parameters
    ----------
    clusters
        For each way the label (M,) of each row's cluster, from 0.
    scores
        (M, K) products of the candidate's columns with the residual, row by row.
    inverse
        (K, K) A^-1, the inverse information matrix.
    """
    # tr(A^-1 sum u u') = sum of u' A^-1 u over the clusters' sums u.
    traces = [float(np.sum((u @ inverse) * u)) for u in cluster_sums(clusters, scores)]
    return max(1.0, *(trace / freedom for trace in traces))


def price(freedom: float | Array, n_rows: float, worth: float, n_choices: float) -> Any:
    """Return what a candidate's evidence J = dD / v - price costs: (k + s) log(N / v)
    + 2 log P, the extended BIC (Chen, Chen, Biometrika 2008).

    Parameters
    ----------
    freedom
        k + s, effective numbers of coefficients and of shape constants.
    n_rows, worth
        N rows, of which v carry the evidence of one; N / v is three at least, so that
        a parameter costs more than one.
    n_choices
        P, among how many candidates this one was chosen.
    """
    return freedom * np.log(max(n_rows / worth, 3.0)) + 2.0 * np.log(n_choices)


def jackknifed(estimates: Array) -> tuple[Array, Array]:
    """Return means and jackknife standard deviations, sqrt((parts - 1) var), of
    estimates (parts, ...) without one part each."""
    n_parts = len(estimates)
    # Numbers that the rows do not determine may be as large as floats can be.
    with np.errstate(over="ignore", invalid="ignore"):
        spread = np.sqrt((n_parts - 1) * np.var(estimates, axis=0))
        return np.mean(estimates, axis=0), spread


def relative_error(errors: ArrayLike, torques: ArrayLike) -> Array:
    """Return 100 |error| / |torque| [%] from sums of their squares."""
    return 100.0 * np.sqrt(np.divide(errors, torques))


def relative_errors_without(errors: Array, torques: Array) -> Array:
    """Return the relative error (parts,) [%] of all parts but each, for the jackknife,
    from the parts' sums of squared errors and torques (parts,)."""
    return relative_error(errors.sum() - errors, torques.sum() - torques)


def student_95(n_parts: float) -> float:
    """Return half the width of a 95 % interval, in standard deviations that are known
    from n_parts parts only, as :func:`jackknifed` ones are.

    It is the 97.5 % quantile of Student's distribution with n_parts - 1 degrees
    of freedom: 2.36 of 8 parts, 1.96 of infinitely many.
    """
    return float(scipy.special.stdtrit(n_parts - 1, 0.975))


def standard_errors_above_zero(values: Array) -> float:
    """Return the mean of values over its standard error.

    Parameters
    ----------
    values : (parts,) or (logs, parts) array
        Values of the parts of a log, or of several logs, whose means may differ: the
        scatter is taken about each log's mean.

    Returns
    -------
    float
        Number of standard errors by which the mean lies above zero; negative below.
    """
    variance = np.mean(np.var(values, axis=-1))
    error = float(np.sqrt(variance / values.size))
    return float(np.mean(values)) / max(error, 1e-300)
