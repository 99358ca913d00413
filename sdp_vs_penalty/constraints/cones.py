"""Self-dual cones: margin and depth of a point, its projection, the curvature of the projection."""

from __future__ import annotations

import numpy as np

from sdp_vs_penalty.robot.arrays import Array


def cone_margin(cone: str, values: Array) -> Array:
    """Smallest eigenvalue (psd), s - |u| (soc) or smallest entry (nonnegative), of one or a batch.

    >>> float(cone_margin("soc", np.array([6.0, 3.0, 4.0])))
    1.0
    """
    if cone == "psd":
        return smallest_eigenvalue(values)
    if cone == "soc":
        return np.asarray(values[..., 0] - np.linalg.norm(values[..., 1:], axis=-1))
    return np.asarray(values.min(axis=-1))


def cone_depths(cone: str, values: Array, terms: Array) -> Array:
    """(g,) margins of equal cones (g, ...) relative to the terms that were summed: free of units.

    terms (g, ...) : |F_0| + sum |theta_i F_i|, entry by entry. A matrix F is seen as D F D with
    D = diag(terms)^-1/2, so that rounding in F is of size eps whatever cancelled on the way: a depth
    above :func:`safe_depth` is a positive margin in any order of summation.
    """
    if cone == "psd":
        size = np.sqrt(np.diagonal(terms, axis1=1, axis2=2))
        size = np.where(size > 0.0, size, 1.0)
        return np.asarray(np.linalg.eigvalsh(values / (size[:, :, None] * size[:, None, :]))[:, 0])
    if cone == "soc":
        size = terms.sum(axis=1)
        margin = values[:, 0] - np.linalg.norm(values[:, 1:], axis=1)
        return np.asarray(margin / np.where(size > 0.0, size, 1.0))
    return np.asarray((values / np.where(terms > 0.0, terms, 1.0)).min(axis=1))


def safe_depth(size: int) -> float:
    """The depth that rounding cannot turn into a violation, for cones of this order."""
    return 32.0 * size * float(np.finfo(float).eps)


def smallest_eigenvalue(values: Array) -> Array:
    """The smallest eigenvalue of symmetric matrices (..., d, d), its sign right in any system of units.

    A matrix of a link holds its mass in one corner and, in kilometres, moments of 1e-9 in the others:
    rounding relative to the corner would decide on them. The sign is therefore taken from T F T with
    diagonals of size one (Sylvester), T of powers of two, which round nothing.
    """
    raw = np.linalg.eigvalsh(values)[..., 0]
    diagonal = np.abs(np.diagonal(values, axis1=-2, axis2=-1))
    t = 2.0 ** -np.round(0.5 * np.log2(np.where(diagonal > 0.0, diagonal, 1.0)))
    sign = np.linalg.eigvalsh(values * t[..., :, None] * t[..., None, :])[..., 0]
    # Ostrowski: the eigenvalue is that of T F T times a factor between the extremes of T^-2.
    least = sign * np.min(t**-2, axis=-1)
    return np.asarray(np.where(sign >= 0.0, np.maximum(raw, 0.0), np.minimum(raw, least)))


def project(cone: str, value: Array) -> Array:
    """The nearest point of the cone (all three are their own duals); one value or a batch (g, ...)."""
    if cone == "psd":
        symmetric = 0.5 * (value + np.swapaxes(value, -1, -2))
        eigenvalues, vectors = np.linalg.eigh(symmetric)
        positive = np.maximum(eigenvalues, 0.0)
        return (vectors * positive[..., None, :]) @ np.swapaxes(vectors, -1, -2)
    if cone == "soc":
        s, norm = value[..., :1], np.linalg.norm(value[..., 1:], axis=-1, keepdims=True)
        with np.errstate(divide="ignore", invalid="ignore"):
            ray = np.concatenate([np.ones_like(s), value[..., 1:] / norm], axis=-1)
        boundary = 0.5 * (s + norm) * ray
        return np.where(norm <= s, value, np.where(norm <= -s, 0.0, boundary))
    return np.maximum(value, 0.0)


def projection_curvature(cone: str, values: Array, directions: Array) -> Array:
    """sum_g A_g^T dPi(M_g) A_g, (p, p): dPi an element of the generalised derivative of the projection.

    values M (g, ...) and directions A (g, entries, p). Positive semidefinite; it is the Hessian of
    1/2 sum |Pi(M + A x)|^2 wherever that has one. For matrices dPi(M)[H] = U (Omega o U^T H U) U^T
    with the divided differences Omega of max(., 0) (Malick, Sendov, Set-Valued Analysis 2006).
    """
    group, _, width = directions.shape
    if cone == "psd":
        d = values.shape[-1]
        eigenvalues, u = np.linalg.eigh(values)
        positive = np.maximum(eigenvalues, 0.0)
        gap = eigenvalues[:, :, None] - eigenvalues[:, None, :]
        close = np.abs(gap) <= 1e-14 * np.abs(eigenvalues).max(axis=1)[:, None, None]
        rise = positive[:, :, None] - positive[:, None, :]
        step = (eigenvalues > 0.0)[:, :, None] * np.ones(d)
        omega = np.where(close, step, rise / np.where(close, 1.0, gap))
        h = directions.reshape(group, d, d, width).transpose(0, 3, 1, 2)
        rotated = np.swapaxes(u, 1, 2)[:, None] @ h @ u[:, None]
        half = (np.sqrt(omega)[:, None] * rotated).transpose(0, 2, 3, 1).reshape(-1, width)
    elif cone == "soc":
        s, norm = values[:, 0], np.linalg.norm(values[:, 1:], axis=1)
        on_axis = norm <= 1e-14 * np.abs(s)
        ray = values[:, 1:] / np.where(on_axis, 1.0, norm)[:, None]
        # In the frame (axis, ray, across the ray) the derivative has eigenvalues 1 and 0 along
        # (1, +-ray) / sqrt(2), and (1 + s / |u|) / 2, at most 1 and at least 0, across.
        along = np.clip(np.where(on_axis, np.sign(s), s + norm), 0.0, None) > 0.0
        against = s - norm > 0.0
        with np.errstate(divide="ignore", invalid="ignore"):
            across = np.where(on_axis, s > 0.0, np.clip(0.5 * (1.0 + s / norm), 0.0, 1.0))
        a_axis = directions[:, 0]
        a_ray = np.einsum("gi,gip->gp", ray, directions[:, 1:])
        a_rest = directions[:, 1:] - ray[:, :, None] * a_ray[:, None]
        half = np.concatenate(
            [
                along[:, None] * (a_axis + a_ray) / np.sqrt(2.0),
                against[:, None] * (a_axis - a_ray) / np.sqrt(2.0),
                (np.sqrt(across)[:, None, None] * a_rest).reshape(-1, width),
            ]
        )
    else:
        half = directions.reshape(-1, width)[values.ravel() > 0.0]
    return half.T @ half
