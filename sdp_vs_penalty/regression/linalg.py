"""Partial regression: what columns show, and what least squares in them leave of
others.

And non-linear least squares within bounds, where the residual comes with its Jacobian.
"""

from collections.abc import Callable

import numpy as np
import scipy
from numpy.typing import NDArray

from sdp_vs_penalty.robot.arrays import Array

#: Singular values below this share of the largest, at columns of unit norm, are
#: rounding [-].
UNSEEN = 1e-9


def column_space(A: Array) -> tuple[Array, Array]:
    """What the columns of a matrix show: A V = U, with U'U = 1.

    Columns are brought to unit norm first; of smaller norm than 1e-10 of the largest
    they show nothing.

    Parameters
    ----------
    A : (r, p) array
        Columns.

    Returns
    -------
    (r, k) array
        U, what the directions make.
    (p, k) array
        V, directions of theta.
    """
    unit, nonzero, norms = _unit_columns(A)
    u, s, vt = np.linalg.svd(unit, full_matrices=False)
    good = s > UNSEEN * s.max(initial=0.0)
    directions = vt[good] / s[good, None]
    V = np.zeros((A.shape[1], len(directions)))
    V[nonzero] = directions.T / norms[:, None]
    return u[:, good], V


def _unit_columns(A: Array) -> tuple[Array, NDArray[np.intp], Array]:
    """The columns of A (r, p) that are not zero beside the largest, at unit norm; which
    they are; their norms."""
    norms = np.linalg.norm(A, axis=0)
    nonzero = np.flatnonzero(norms > 1e-10 * norms.max(initial=0.0))
    return A[:, nonzero] / norms[nonzero], nonzero, norms[nonzero]


def min_norm_lstsq(
    A: Array,
    b: Array,
    near: Array | float = 0.0,
) -> Array:
    """The theta nearest to ``near`` that minimises |A theta - b|: moved in the
    directions that A shows, columns at unit norm.

    Parameters
    ----------
    A : (r, p) array
        Columns.
    b : (r,) array
        What they should make.
    near : (p,) array or float
        Where to stay.

    Returns
    -------
    (p,) array
        theta.
    """
    unit, nonzero, norms = _unit_columns(A)
    theta = np.broadcast_to(np.asarray(near, float), A.shape[1]).copy()
    if len(nonzero):
        # A complete orthogonal factorisation: a third of the time of singular values.
        move, *_ = scipy.linalg.lstsq(
            unit,
            b - A @ theta,
            cond=UNSEEN,
            lapack_driver="gelsy",
        )
        theta[nonzero] += move / norms
    return theta


def deviations(A: Array) -> Array:
    """Standard deviations of least squares in columns whose rows have noise one.

    Parameters
    ----------
    A : (r, p) array
        Columns.

    Returns
    -------
    (p,) array
        Infinite where the columns do not determine a parameter.
    """
    U, V = column_space(A)
    known = np.einsum("kr,rk->k", V, U.T @ A) > 1.0 - 1e-6
    return np.where(
        known,
        np.linalg.norm(V, axis=1),
        np.inf,
    )


def span(A: Array) -> Array:
    """An orthonormal basis of what columns make, in a third of the time of
    :func:`column_space`.

    Parameters
    ----------
    A : (r, p) array
        Columns.

    Returns
    -------
    (r, k) array
        U, with U'U = 1.
    """
    unit, nonzero, _ = _unit_columns(A)
    if not len(nonzero):
        return np.zeros((len(A), 0))
    q, r, _ = scipy.linalg.qr(
        unit,
        mode="economic",
        pivoting=True,
        check_finite=False,
    )
    size = np.abs(np.diagonal(r))
    rank = int(np.sum(size > UNSEEN * size[0]))
    return np.asarray(q[:, :rank])


def partialled(A: Array, others: Array) -> Array:
    """What least squares in columns leave of other columns.

    Parameters
    ----------
    A : (r, p) array
        Columns.
    others : (r, ...) array
        The other ones.

    Returns
    -------
    (r, ...) array
        Orthogonal to A's.
    """
    U = span(A)
    return np.asarray(others - U @ (U.T @ others))


class InTurn:
    """Residual and Jacobian as SciPy asks for them, one after the other at the same x,
    of ``at``, which computes them together; once for each x."""

    def __init__(self, at: Callable[[Array], tuple[Array, Array]]) -> None:
        self._at = at
        self._last_x = np.full(1, np.nan)
        self._answer = (np.zeros(0), np.zeros(0))

    def residual(self, x: Array) -> Array:
        """Residuals at a point.

        Parameters
        ----------
        x : (p,) array
            The point.

        Returns
        -------
        (m,) array
            r.
        """
        return self._both(x)[0]

    def jacobian(self, x: Array) -> Array:
        """Derivatives of the residuals at a point.

        Parameters
        ----------
        x : (p,) array
            The point.

        Returns
        -------
        (m, p) array
            J.
        """
        return self._both(x)[1]

    def _both(self, x: Array) -> tuple[Array, Array]:
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
    """The least |r(x)|^2 with low <= x <= high (trust region reflective: Branch,
    Coleman, Li, SIAM J. Scientific Computing 1999).

    Parameters
    ----------
    at : callable
        r (m,) and its Jacobian (m, p) of x (p,), which it computes together.
    start : (p,) array
        Where to begin.
    ends : ((p,) array, (p,) array)
        low and high.
    xtol : float
        As ``scipy.optimize.least_squares`` takes it.
    ftol : float
        The same.
    steps : int
        At most.

    Returns
    -------
    (p,) array
        x.
    (m,) array
        r at x.
    (m, p) array
        The Jacobian at x.
    """

    both = InTurn(at)
    # SciPy's reflected step, which it discards, and its step along a gradient of 0.
    with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
        solution = scipy.optimize.least_squares(
            both.residual,
            np.clip(start, *ends),
            both.jacobian,
            bounds=ends,
            xtol=xtol,
            ftol=ftol,
            gtol=None,
            max_nfev=steps,
        )
    return solution.x, solution.fun, solution.jac
