"""Partial regression: what columns show, and what least squares in them leave of others."""

import numpy as np

from sdp_vs_penalty.robot.arrays import Array

#: Singular values below this share of the largest, at columns of unit norm, are rounding [-].
UNSEEN = 1e-9


def visible(A: Array) -> tuple[Array, Array]:
    """Directions V (p, k) of theta that the columns A (r, p) show, and what they make, A V = U (r, k),
    with U'U = 1.

    Columns are brought to unit norm first; of smaller norm than 1e-10 of the largest they show nothing.
    """
    norms = np.linalg.norm(A, axis=0)
    seen = np.flatnonzero(norms > 1e-10 * norms.max(initial=0.0))
    if not len(seen):
        return np.zeros((len(A), 0)), np.zeros((A.shape[1], 0))
    u, s, vt = np.linalg.svd(A[:, seen] / norms[seen], full_matrices=False)
    good = s > UNSEEN * s[0]
    V = np.zeros((A.shape[1], int(good.sum())))
    V[seen] = (vt[good] / s[good, None]).T / norms[seen, None]
    return u[:, good], V


def smallest(A: Array, b: Array) -> Array:
    """The smallest theta (p,) that minimises |A theta - b|, in the directions that A (r, p) shows."""
    U, V = visible(A)
    return np.asarray(V @ (U.T @ b))


def deviations(A: Array) -> Array:
    """(p,) standard deviations of least squares in columns A (r, p) whose rows have noise one; infinite
    where they do not determine a parameter."""
    U, V = visible(A)
    known = np.einsum("kr,rk->k", V, U.T @ A) > 1.0 - 1e-6
    return np.where(known, np.linalg.norm(V, axis=1), np.inf)


def partialled(A: Array, others: Array) -> Array:
    """(r, ...) what least squares in the columns A (r, p) leave of other columns (r, ...)."""
    U, _ = visible(A)
    return np.asarray(others - U @ (U.T @ others))
