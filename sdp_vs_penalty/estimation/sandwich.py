"""The error of least squares from time blocks: a sandwich that few blocks and slow noise do not fool.

In coordinates z of the visible directions, theta = V z with V' (R' W^2 R) V = 1, c' theta errs by
w' sum_b g_b, w = V' c, with the block scores g_b = V' R_b' W^2 (rho_b - R_b theta_hat). Its variance is
estimated by

    v = sum_ab K_ab (w' g_a) (w' g_b),     K_ab = max(0, 1 - |t_a - t_b| / window) within a run

(Newey, West, Econometrica 1987). theta_hat takes part of the error with it: were the error white with
variance s^2, then E v = s^2 tr(K G) with G_ab = [a = b] w' A_a w - w' A_a A_b w, A_b the blocks' grams.
v is divided by tr(K G), and counts for tr(K G)^2 / tr(K G K G) degrees of freedom (Bell, McCaffrey,
Survey Methodology 2002), so that quantiles are Student's. The window is a multiple of the correlation
time by which the scores exceed white noise. What all directions say together counts for three degrees of
freedom more, which keeps short runs finite (a moderated t: Smyth 2004).
"""

from collections.abc import Sequence
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.special import stdtrit

from sdp_vs_penalty.estimation.constants import LEVEL, POOLED, WINDOW
from sdp_vs_penalty.regression.partial import span, visible
from sdp_vs_penalty.regression.regression import LeastSquares, Regression
from sdp_vs_penalty.robot.arrays import Array


class Sandwich:
    """The sandwich of weighted least squares on compressed data.

    prior_scale : (p,) standard deviations of parameters that are known beforehand to be zero, infinite
    for all others; taken_white : the blocks are not asked.

    directions V (p, r); grams (B, r, r) and scores (B, r) of the blocks in these coordinates; kernel
    (B, B): how far blocks' errors are one error; white: variance of white rows, and pooled: that all
    directions say together; prior (r, r): part of the information that is no data's; norms (p,): of the
    columns; solution (p,): the smallest least-squares theta.
    """

    def __init__(
        self, regression: Regression, weights: Array, prior_scale: Array, taken_white: bool = False
    ) -> None:
        self.regression, self.weights, self.taken_white = regression, weights, taken_white
        data = regression.least_squares(weights)
        self.white = white_variance(data, regression.oversampling)
        # Where the torque is fitted to rounding, a prior weighs that much and no less.
        strength = max(self.white, 1e-24 * data.tau_squared / max(data.rows, 1))
        whole = data.with_prior(prior_scale, strength) if np.any(np.isfinite(prior_scale)) else data
        self.directions = V = visible(whole.R)[1]
        z = V.T @ (whole.R.T @ whole.rho)
        B, r = len(regression.blocks), V.shape[1]
        self.grams, self.scores = np.zeros((B, r, r)), np.zeros((B, r))
        for joint, indices, blocks, rows in regression.by_joint():
            seen = rows[..., :-1] @ (weights[joint] * V[indices])
            left = weights[joint] * rows[..., -1] - seen @ z
            self.grams[blocks] += seen.swapaxes(1, 2) @ seen
            self.scores[blocks] += (left[:, None] @ seen)[:, 0]
        excess = float(np.sum(np.trace(self.grams, axis1=1, axis2=2)) - np.sum(self.grams**2))
        inflation = 1.0
        if excess > 1e-6 * r and self.white > 0.0:
            inflation = float(np.sum(self.scores**2)) / excess / self.white
        self.pooled, self.kernel = inflation * self.white, _kernel(regression, inflation)
        self.prior = V.T * (strength / prior_scale**2) @ V
        self.norms, self.solution = whole.column_norms, V @ z

    def sees(self, contrasts: Array) -> NDArray[np.bool_]:
        """Which linear functions (k, p) of theta the data determine."""
        norms, dark = self.norms, self.norms <= 0.0
        scaled = contrasts / np.where(dark, 1.0, norms)
        total = np.sum(scaled**2, axis=1)
        hidden = np.any(np.abs(contrasts[:, dark]) > 0.0, axis=1)
        inside = np.sum((scaled @ self._basis) ** 2, axis=1)
        # A linear function of theta belongs to the visible ones up to this much of its square.
        return np.asarray((inside > (1.0 - 1e-6) * total) & ~hidden & (total > 0.0))

    @cached_property
    def _basis(self) -> Array:
        """(p, r) of the visible directions at unit norm."""
        return np.asarray(np.linalg.qr(self.directions * self.norms[:, None])[0])

    def half_widths(self, contrasts: Array) -> Array:
        """(k,) half-widths of intervals of linear functions (k, p) of theta, or of its first parameters
        alone; NaN for unseen ones."""
        contrasts = np.pad(contrasts, ((0, 0), (0, len(self.norms) - contrasts.shape[1])))
        half, seen = np.full(len(contrasts), np.nan), np.flatnonzero(self.sees(contrasts))
        # Numbers of the products of blocks that are held at once.
        for few in np.array_split(seen, 1 + seen.size * self.directions.shape[1] ** 2 // (1 << 20)):
            w = contrasts[few] @ self.directions
            variance, freedom = self._variances(w)
            known = self.white * np.sum((w @ self.prior) * w, axis=1)
            t, normal = stdtrit(freedom, 0.5 + 0.5 * LEVEL), stdtrit(np.inf, 0.5 + 0.5 * LEVEL)
            half[few] = np.sqrt(t**2 * variance + normal**2 * known)
        return half

    def _variances(self, w: Array) -> tuple[Array, Array]:
        """Of each w' z, w (c, r): variance from the data (c,), and degrees of freedom (c,)."""
        if self.taken_white:
            prior = np.sum((w @ self.prior) * w, axis=1)
            return self.white * (np.sum(w * w, axis=1) - prior), np.full(len(w), np.inf)
        K, (B, r) = self.kernel, self.scores.shape
        AB, h = np.moveaxis(self.grams @ w.T, 2, 0), w @ self.scores.T  # (c, B, r), (c, B)
        own = np.maximum(np.einsum("cbr,cr->cb", AB, w), 0.0)
        KAB = np.moveaxis((K @ np.moveaxis(AB, 1, 0).reshape(B, -1)).reshape(B, len(w), r), 1, 0)
        # tr (K G)^2 of G's second part, by the smaller of (A B)'K A B and K A B (A B)'.
        M = np.swapaxes(AB, 1, 2) @ KAB if r < B else KAB @ np.swapaxes(AB, 1, 2)
        information = own.sum(axis=1)
        expected = information - np.trace(M, axis1=1, axis2=2)
        square = np.sum(own * (K.power(2) @ own.T).T, axis=1)
        square += np.sum(M * M.swapaxes(1, 2), axis=(1, 2))
        square -= 2.0 * np.sum(own * np.sum(KAB**2, axis=2), axis=1)
        found = np.maximum(np.sum(h * (K @ h.T).T, axis=1), 0.0)
        told = (expected > 1e-6 * information) & (square > 0.0)
        safe = np.where(told, expected, 1.0)
        freedom = np.where(told, safe**2 / np.where(told, square, 1.0), 0.0)
        moderated = (POOLED * self.pooled + freedom * found / safe) / (POOLED + freedom)
        return moderated * information, freedom + POOLED

    @cached_property
    def factor(self) -> Array:
        """(p, r) F with the covariance of everything visible F F'.

        The blocks' own products are few: they are shrunk to the pooled variance, by as much as there
        are more directions than independent windows.
        """
        B, r = self.scores.shape
        flat = self.grams.reshape(B, -1)
        lost = float(np.sum((self.kernel @ flat) * flat))
        data = r - float(np.trace(self.prior))
        windows = B**2 / max(float(self.kernel.sum()), 1.0)
        meat = self.pooled * np.eye(r)
        if data - lost > 1e-6 * data:
            products = self.scores.T @ (self.kernel @ self.scores) * (data / (data - lost))
            share = r / (r + windows)
            meat = share * meat + (1.0 - share) * products
        values, vectors = np.linalg.eigh(meat)
        return np.asarray(self.directions @ (vectors * np.sqrt(np.maximum(values, 0.0))))

    def response(self, torques: Sequence[Array]) -> Array:
        """(p, e) change of the estimate where the torque changes by ``torques``: (rows of its factor's
        triangle, e) for each factor of the regression."""
        moved = np.zeros((self.directions.shape[1], torques[0].shape[1] if torques else 0))
        for f, torque in zip(self.regression.factors, torques, strict=True):
            weighted = self.weights[f.joint] ** 2 * f.triangle[:, :-1] @ self.directions[f.indices]
            moved += weighted.T @ torque
        return np.asarray(self.directions @ moved)

    def gain_response(self, theta: Array) -> Array:
        """(p, n) change of the estimate theta for a unit relative error of each channel's gain."""
        moved = np.zeros((self.directions.shape[1], self.regression.joints))
        theta = np.pad(theta, (0, len(self.norms) - len(theta)))
        for f in self.regression.per_joint:
            rows, weight = f.triangle[:, :-1], self.weights[f.joint] ** 2
            moved[:, f.joint] = weight * (rows @ theta[f.indices]) @ (rows @ self.directions[f.indices])
        return np.asarray(self.directions @ moved)


def stretched(factor: Array, std: Array) -> Array:
    """Rows of a factor (p, r) as long as the deviations (p,); where they are NaN, longer by the median
    ratio."""
    length = np.linalg.norm(factor, axis=1)
    known = np.isfinite(std) & (length > 0.0)
    ratio = np.where(known, std, 1.0) / np.where(known, length, 1.0)
    typical = float(np.median(ratio[known])) if known.any() else 1.0
    return np.asarray(factor * np.where(known, ratio, typical)[:, None])


def white_variance(data: LeastSquares, oversampling: float) -> float:
    """Variance of the residual of least squares, were it white: of one independent row."""
    U = span(data.R)
    left = data.rho - U @ (U.T @ data.rho)
    degrees = max(data.rows - oversampling * U.shape[1], 1.0)
    return (float(left @ left) + data.residual_norm**2) / degrees * oversampling


def _kernel(regression: Regression, inflation: float) -> sparse.csr_array:
    """(B, B) the triangular window over the blocks of each run, at most half a run long."""
    runs, starts, stops = np.array(regression.blocks, float).reshape(-1, 3).T
    rows = max(int(regression.joint_rows().max(initial=0)), 1)
    # Scores of noise with the correlation time T have 2 T / interval times the variance of white rows.
    interval = float(np.sum(stops - starts)) * regression.oversampling / rows
    window = WINDOW * 0.5 * max(inflation, 1.0) * interval
    parts = []
    for run in np.unique(runs):
        start, stop = starts[runs == run], stops[runs == run]
        middle = 0.5 * (start + stop)
        length = min(window, 0.5 * float(stop.max() - start.min()))
        apart = np.abs(np.subtract.outer(middle, middle))
        parts.append(np.maximum(1.0 - apart / length, 0.0) if length > 0.0 else np.eye(len(middle)))
    return sparse.csr_array(sparse.block_diag(parts)) if parts else sparse.csr_array((0, 0))
