"""Partial regression: what columns show, and what least squares in them leave of
others.

And non-linear least squares within bounds, where the residual comes with its Jacobian.
"""

from collections.abc import Callable

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from sdp_vs_penalty.robot.arrays import Array

#: Singular values below this share of the largest, at columns of unit norm, are
#: rounding [-].
UNSEEN = 1e-9


def column_space(A: Array) -> tuple[Array, Array]:
    """Directions V (p, k) of theta that the columns A (r, p) show, and what they make,
    A V = U (r, k), with U'U = 1.

    Columns are brought to unit norm first; of smaller norm than 1e-10 of the largest
    they show nothing.
    """
    unit, nonzero, norms = _unit_columns(A)
    u, s, vt = np.linalg.svd(unit, full_matrices=False)
    good = s > UNSEEN * s.max(initial=0.0)
    V = np.zeros((A.shape[1], int(good.sum())))
    V[nonzero] = (vt[good] / s[good, None]).T / norms[:, None]
    return u[:, good], V


def _unit_columns(A: Array) -> tuple[Array, NDArray[np.intp], Array]:
    """The columns of A (r, p) that are not zero beside the largest, at unit norm; which
    they are; their norms."""
    norms = np.linalg.norm(A, axis=0)
    nonzero = np.flatnonzero(norms > 1e-10 * norms.max(initial=0.0))
    return A[:, nonzero] / norms[nonzero], nonzero, norms[nonzero]


def min_norm_lstsq(A: Array, b: Array, near: Array | float = 0.0) -> Array:
    """The theta (p,) nearest to ``near`` that minimises |A theta - b|: moved in the
    directions that A (r, p) shows, columns at unit norm."""
    U, V = column_space(A)
    start = np.broadcast_to(near, A.shape[1])
    return np.asarray(start + V @ (U.T @ (b - A @ start)))


def deviations(A: Array) -> Array:
    """(p,) standard deviations of least squares in columns A (r, p) whose rows have
    noise one; infinite where they do not determine a parameter."""
    U, V = column_space(A)
    known = np.einsum("kr,rk->k", V, U.T @ A) > 1.0 - 1e-6
    return np.where(known, np.linalg.norm(V, axis=1), np.inf)


def span(A: Array) -> Array:
    """U (r, k) with U'U = 1 of what the columns A (r, p) make, in a third of the time of
    :func:`column_space`."""
    unit, nonzero, _ = _unit_columns(A)
    if not len(nonzero):
        return np.zeros((len(A), 0))
    q, r, _ = scipy.linalg.qr(unit, mode="economic", pivoting=True, check_finite=False)
    size = np.abs(np.diagonal(r))
    rank = int(np.sum(size > UNSEEN * size[0]))
    return np.asarray(q[:, :rank])


def partialled(A: Array, others: Array) -> Array:
    """(r, ...) what least squares in the columns A (r, p) leave of other columns (r,
    ...)."""
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
        """r (m,) at x (p,)."""
        return self._both(x)[0]

    def jacobian(self, x: Array) -> Array:
        """J (m, p) at x (p,)."""
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
    """x (p,), residual r (m,) and Jacobian J (m, p) at the least |r(x)|^2 with low <= x
    <= high.

    at : r and J of x, which it computes together; ends : low and high (p,); xtol, ftol,
    steps : as ``scipy.optimize.least_squares`` takes them (trust region reflective:
    Branch, Coleman, Li, SIAM J. Scientific Computing 1999).
    """
    from scipy import optimize

    both = InTurn(at)
    # SciPy's reflected step, which it discards, and its step along a gradient of 0.
    with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
        solution = optimize.least_squares(
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
