"""Classical least squares (CLS): no constraint, the lowest loss of all."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from sdp_vs_penalty.estimators.estimator import (
    Array,
    Estimator,
    Fit,
    Task,
    with_joint_prior,
)
from sdp_vs_penalty.regression.evidence import relative_error
from sdp_vs_penalty.regression.linalg import column_space, deviations


@dataclass(frozen=True)
class Ols(Estimator):
    """pi_hat = argmin |W pi - tau|^2 (Gautier, Khalil; Gaz et al. 2019, eq. 13).

    Determines base parameters only; theta is the minimiser nearest to the nominal
    robot, and in general not physically consistent.
    """

    name = "ols"
    table_place: ClassVar[int | None] = 1
    undetermined_by = "prior"
    description = "least squares: links may be impossible (the paper's CLS)"

    #: Weight of the pull of joint parameters to zero, as of ``lmi-sdp``; 0: none.
    joint_prior: float = 0.0

    def fit(self, task: Task) -> Fit:
        """Return the least-squares theta nearest to the nominal one; no constraint is
        imposed.
        """
        task = with_joint_prior(task, self.joint_prior)
        return Fit(task.ols, task.problem)


def condition_number(task: Task) -> float:
    """Return the condition number of the base parameters' regressor W = R B^+.

    Parameters
    ----------
    task : Task
        Compressed data R, and B, the map to the base parameters.

    Returns
    -------
    float
        Ratio of the extreme singular values; infinite if a direction is not excited.
    """
    regressor = task.data.R @ np.linalg.pinv(task.base.rows)
    if column_space(regressor)[0].shape[1] < regressor.shape[1]:
        return np.inf
    singular = np.linalg.svd(regressor, compute_uv=False)
    return float(singular[0] / singular[-1])


def standard_deviations(task: Task, oversampling: float) -> tuple[Array, Array]:
    """Return the least-squares base parameters pi_hat (b,) [SI] and their standard
    deviations (b,), infinite where not excited.

    Parameters
    ----------
    oversampling : float
        Filtered rows per independent sample.

    Notes
    -----
    C = sigma^2 (W^T W)^-1 with sigma^2 = loss / (N - b) (Gaz et al. 2019, eq. 14), N
    the number of independent rows: rows / oversampling, while W^T W counts all rows.
    The residual is taken as white within the filters' band; where a model error
    dominates it, the true error is larger.
    """
    w = task.data.R @ np.linalg.pinv(task.base.rows)
    rank = column_space(w)[0].shape[1]
    degrees = max(task.data.rows / oversampling - rank, 1.0)
    residual = np.sqrt(task.data.loss(task.ols) / degrees)
    return task.base.rows @ task.ols, residual * deviations(w)


@dataclass(frozen=True)
class ReverseEngineering(Estimator):
    """pi_RE = argmin |W pi - (g, M)|^2 over configurations (Gaz et al. 2019, sec. III).

    W stacks, for each configuration, the n rows of g(q) and the n (n + 1) / 2
    upper-triangle entries of M(q), newton metres beside kg m^2 as in the paper. The
    condition number of W in the base parameters and the relative error in percent come
    with the estimate.
    """

    name = "reverse-engineering"
    description = (
        "least squares on gravity torques and inertia matrices of a black box (an .npz"
        " file)"
    )
    needs_black_box = True

    def fit(self, task: Task) -> Fit:
        """Fit a black box's answers; return condition number and relative error [%] in
        the details.
        """
        error = relative_error(task.data.loss(task.ols), task.data.tau_squared)
        details = {
            "condition_number": condition_number(task),
            "relative_error_percent": float(error),
        }
        return Fit(task.ols, task.problem, details=details)
