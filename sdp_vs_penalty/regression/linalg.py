"""Partial regression: what columns show, and what least squares in them leave of
others.

And non-linear least squares within bounds, where the residual comes with its Jacobian.
"""

from collections.abc import Callable

import numpy as np
import scipy

from sdp_vs_penalty.robot.arrays import Array, Indices

#: Singular values below this share of the largest, at columns of unit norm, are
#: rounding [-].
UNSEEN = 1e-9


def column_space(A: Array) -> tuple[Array, Array]:
    """Return the column space U of a matrix and directions V with A V = U, U'U = 1.

    Columns are brought to unit norm first; columns below 1e-10 of the largest norm, and
    singular values below UNSEEN of the largest, are rounding.

    Parameters
    ----------
    A : (r, p) array
        Columns of a least-squares problem.

    Returns
    -------
    (r, k) array
        U, an orthonormal basis of the columns' span.
    (p, k) array
        V, the visible directions of theta (those that the data determine).
    """
    unit, nonzero, norms = _unit_columns(A)
    u, s, vt = np.linalg.svd(unit, full_matrices=False)
    is_visible = s > UNSEEN * s.max(initial=0.0)
    directions = vt[is_visible] / s[is_visible, None]
    V = np.zeros((A.shape[1], len(directions)))
    V[nonzero] = directions.T / norms[:, None]
    return u[:, is_visible], V


def _unit_columns(A: Array) -> tuple[Array, Indices, Array]:
    """Return the nonzero columns of A (r, p) at unit norm, their indices, and their
    norms.
    """
    norms = np.linalg.norm(A, axis=0)
    nonzero = np.flatnonzero(norms > 1e-10 * norms.max(initial=0.0))
    return A[:, nonzero] / norms[nonzero], nonzero, norms[nonzero]


def min_norm_lstsq(A: Array, b: Array, near: Array | float = 0.0) -> Array:
    """Return the least-squares theta (p,) of |A theta - b|, with A (r, p) and b (r,),
    that is nearest to ``near``.

    Theta moves from ``near`` only in directions that A determines. Distance is measured
    with columns at unit norm.
    """
    unit, nonzero, norms = _unit_columns(A)
    theta = np.broadcast_to(np.asarray(near, float), A.shape[1]).copy()
    if len(nonzero):
        # A complete orthogonal factorisation: a third of the time of singular values.
        move, *_ = scipy.linalg.lstsq(
            unit, b - A @ theta, cond=UNSEEN, lapack_driver="gelsy"
        )
        theta[nonzero] += move / norms
    return theta


def deviations(A: Array) -> Array:
    """Return standard deviations (p,) of least squares in rows A (r, p) with noise of
    variance one; infinite where the columns do not determine a parameter."""
    U, V = column_space(A)
    # Diagonal of V U^T A, the projection onto the visible directions: 1 where the
    # parameter itself is visible.
    projection = np.einsum("kr,rk->k", V, U.T @ A)
    is_determined = projection > 1.0 - 1e-6
    return np.where(is_determined, np.linalg.norm(V, axis=1), np.inf)


def span(A: Array) -> Array:
    """Return an orthonormal basis U (r, k) of the span of the columns of A (r, p), by a
    pivoted QR: in two thirds of the time of :func:`column_space`."""
    unit, nonzero, _ = _unit_columns(A)
    if not len(nonzero):
        return np.zeros((len(A), 0))
    Q, R, _ = scipy.linalg.qr(unit, mode="economic", pivoting=True, check_finite=False)
    size = np.abs(np.diagonal(R))
    return np.ascontiguousarray(Q[:, size > UNSEEN * size[0]])


def partialled(A: Array, others: Array) -> Array:
    """Return what least squares in the columns of A (r, p) leaves of other columns (r,
    ...): residuals (r, ...), orthogonal to the columns of A."""
    U = span(A)
    return others - U @ (U.T @ others)


class InTurn:
    """Residual and Jacobian as SciPy asks for them, one after the other at the same x,
    of ``at``, which computes them together; once for each x."""

    def __init__(self, at: Callable[[Array], tuple[Array, Array]]) -> None:
        """Keep the function ``at`` that returns residual (m,) and Jacobian (m, p) of x
        (p,) together."""
        self._at = at
        self._last_x = np.full(1, np.nan)
        self._answer = (np.zeros(0), np.zeros(0))

    def residual(self, x: Array) -> Array:
        """Return the residual vector r(x) (m,) of the least-squares problem at x (p,)."""
        return self._residual_and_jacobian(x)[0]

    def jacobian(self, x: Array) -> Array:
        """Return the Jacobian dr/dx (m, p) of the residual vector at x (p,)."""
        return self._residual_and_jacobian(x)[1]

    def _residual_and_jacobian(self, x: Array) -> tuple[Array, Array]:
        """Return residual and Jacobian at x; those of the last x are kept.

        SciPy asks for the two one after the other at the same x.
        """
        if not np.array_equal(x, self._last_x):
            self._last_x = x.copy()
            self._answer = self._at(x)
        return self._answer


def least_squares(
    at: Callable[[Array], tuple[Array, Array]],
    start: Array,
    ends: tuple[Array, Array],
    xtol: float,
    ftol: float,
    steps: int,
) -> tuple[Array, Array, Array]:
    """Minimise |r(x)|^2 between lower and upper bounds (``ends``), in at most ``steps``
    evaluations; return x (p,), r (m,) and the Jacobian (m, p) there.

    The method is trust-region reflective (Branch, Coleman, Li, SIAM J. Scientific
    Computing 1999, in SciPy).

    Parameters
    ----------
    at : callable
        Returns r (m,) and its Jacobian (m, p) of x (p,), computed together.
    start : (p,) array
        Start; clipped to the bounds.
    xtol : float
        Relative change of x that ends the search, as in
        ``scipy.optimize.least_squares``.
    ftol : float
        Relative change of |r|^2 that ends the search.
    """

    function = InTurn(at)
    # SciPy's reflected step, which it discards, and its step along a gradient of 0.
    with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
        solution = scipy.optimize.least_squares(
            function.residual,
            np.clip(start, *ends),
            function.jacobian,
            bounds=ends,
            xtol=xtol,
            ftol=ftol,
            gtol=None,
            max_nfev=steps,
        )
    return solution.x, solution.fun, solution.jac
