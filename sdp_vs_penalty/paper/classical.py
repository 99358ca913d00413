"""Estimators of the literature that the study of methods compares, beside those of
``estimators``.

ridge          |R theta - rho|^2 + lambda |theta / s|^2, s_k = 1 / |R_k|, lambda by generalised
               cross-validation (Golub, Heath, Wahba, Technometrics 1979)
total          total least squares in base parameters: the smallest right singular vector of
               [W D, rho], columns scaled by D (Van Huffel, Vandewalle, 1991)
geodesic       |R theta - rho|^2 + (w / 2) sum_i |log(L_i^-1 P_i L_i^-T)|^2, P_i0 = L_i L_i^T: the
               prior of ``lmi-sdp-entropic`` by the affine-invariant distance of pseudo-inertias
               (Lee, Wensing, Park, IEEE T-RO 2020)

All get a Task, and so the same rows and joint weights.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import scipy

from sdp_vs_penalty.estimators.estimator import (
    Estimator,
    Fit,
    Task,
    sample_variance,
    with_joint_prior,
)
from sdp_vs_penalty.estimators.lmi_sdp import LmiSdp
from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.robot.arrays import Array, nonzero_or_one


@dataclass(frozen=True)
class Ridge(Estimator):
    """Least squares that shrinks every parameter, by a weight that the data choose."""

    name = "ridge"
    description = "ridge regression, weight by generalised cross-validation"
    table_place: ClassVar[int | None] = None

    #: Weights that are tried, in units of the largest squared singular value.
    weights: tuple[float, ...] = tuple(10.0 ** np.arange(-12.0, 0.1, 0.5))

    def fit(self, task: Task) -> Fit:
        """Shrink each direction by s^2 / (s^2 + lambda), with the best lambda."""
        data = task.data
        scale = 1.0 / nonzero_or_one(data.column_norms)
        U, s, Vt = np.linalg.svd(data.R * scale, full_matrices=False)
        determined = U.T @ data.rho
        outside = data.residual_norm**2 + data.rho @ data.rho - determined @ determined

        def score(weight: float) -> float:
            kept = s**2 / (s**2 + weight)
            residual = outside + np.sum(((1.0 - kept) * determined) ** 2)
            return float(residual / (data.rows - kept.sum()) ** 2)

        best = min((w * s[0] ** 2 for w in self.weights), key=score)
        theta = scale * (Vt.T @ (s / (s**2 + best) * determined))
        return Fit(theta, task.problem)


@dataclass(frozen=True)
class TotalLeastSquares(Estimator):
    """Least squares with errors in the columns as well as in the torque."""

    name = "total-least-squares"
    description = "total least squares in base parameters"
    table_place: ClassVar[int | None] = None

    def fit(self, task: Task) -> Fit:
        """Take the smallest right singular vector of columns and torque."""
        data = task.data
        to_theta = np.linalg.pinv(task.base.rows)
        columns = data.R @ to_theta
        scale = 1.0 / nonzero_or_one(np.linalg.norm(columns, axis=0))
        stacked = np.column_stack([columns * scale, data.rho])
        # What no column shows stands below the triangle.
        last = np.append(np.zeros(len(scale)), data.residual_norm)
        *_, v = np.linalg.svd(np.vstack([stacked, last]))[2]
        theta = to_theta @ (-scale * v[:-1] / v[-1])
        return Fit(theta, task.problem)


@dataclass(frozen=True)
class Geodesic(Estimator):
    """Least squares with a geodesic pull of each pseudo-inertia to the nominal robot's.

    Consistent by its coordinates, P = L exp(S) L^T; bounds are not imposed, and the
    optimum is local (Levenberg-Marquardt from the nominal robot).
    """

    name = "geodesic"
    description = "torque loss with the geodesic distance of pseudo-inertias"
    table_place: ClassVar[int | None] = None

    #: Weight of the pull, as that of `lmi-sdp`.
    entropy: float = LmiSdp.entropy
    #: Weight of the pull of friction and offsets to zero, likewise.
    joint_prior: float = LmiSdp.joint_prior
    #: Steps at most.
    steps: int = 200

    def fit(self, task: Task) -> Fit:
        """Minimise over x: the entries of S (symmetric, one a link), then the joints' own
        parameters."""
        data = with_joint_prior(task, self.joint_prior).data
        roots = np.linalg.cholesky(inertia.pseudo_inertia(task.prior_links))
        others = np.setdiff1d(np.arange(len(task.bound)), task.links)
        pull = np.sqrt(0.5 * self.entropy * sample_variance(task))
        n = len(task.links)
        weights = pull * np.tile(_SIZES, n)

        def point(x: Array) -> tuple[Array, Array]:
            """Return theta (p,) and its derivatives (p, 10 n + k) by x."""
            theta = np.zeros(len(task.bound))
            slope = np.zeros((len(task.bound), len(x)))
            for k, link in enumerate(task.links):
                columns_of_link = slice(10 * k, 10 * k + 10)
                theta[link], slope[link, columns_of_link] = _link(
                    roots[k], x[columns_of_link]
                )
            theta[others] = x[10 * n :]
            slope[others, 10 * n + np.arange(len(others))] = 1.0
            return theta, slope

        def residual(x: Array) -> Array:
            pulled = weights * x[: 10 * n]
            return np.concatenate([data.R @ point(x)[0] - data.rho, pulled])

        def jacobian(x: Array) -> Array:
            below = np.zeros((10 * n, len(x)))
            np.fill_diagonal(below, weights)
            return np.vstack([data.R @ point(x)[1], below])

        start = np.append(np.zeros(10 * n), task.nominal[others])
        solution = scipy.optimize.least_squares(
            residual,
            start,
            jacobian,
            method="lm",
            max_nfev=self.steps,
            xtol=1e-12,
            ftol=1e-12,
        )
        return Fit(point(solution.x)[0], task.problem)


#: Places of a symmetric 4x4 matrix's ten entries, and how much each counts in its norm.
_ROWS, _COLUMNS = np.triu_indices(4)
_SIZES = np.where(_ROWS == _COLUMNS, 1.0, np.sqrt(2.0))
#: Of each place the symmetric matrix with ones there.
_UNITS = np.zeros((10, 4, 4))
_UNITS[np.arange(10), _ROWS, _COLUMNS] = 1.0
_UNITS[np.arange(10), _COLUMNS, _ROWS] = 1.0


def _link(root: Array, s: Array) -> tuple[Array, Array]:
    """Return a link (10,) with P = L exp(S) L^T, and its derivatives (10, 10) by S's entries.

    The derivative of exp at S = V diag(e) V^T in the direction E is V (G * (V^T E V)) V^T
    with G_ij = (exp e_i - exp e_j) / (e_i - e_j).
    """
    S = np.zeros((4, 4))
    S[_ROWS, _COLUMNS] = S[_COLUMNS, _ROWS] = s
    e, V = np.linalg.eigh(S)
    grown = np.exp(e)
    apart = e[:, None] - e[None, :]
    close = np.abs(apart) < 1e-9
    divided = (grown[:, None] - grown[None, :]) / np.where(close, 1.0, apart)
    G = np.where(close, 0.5 * (grown[:, None] + grown[None, :]), divided)
    left = root @ V
    P = (left * grown) @ left.T
    inner = G * (V.T @ _UNITS @ V)
    changes = left @ inner @ left.T
    return inertia.from_pseudo_inertia(P), inertia.from_pseudo_inertia(changes).T
