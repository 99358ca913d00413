"""Small non-linear least squares within bounds, without scipy.optimize: importing it takes longer than a
whole identification."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from sdp_vs_penalty.robot.arrays import Array

#: Damping at the start and at the end of hope, relative to the diagonal of J'J (Marquardt 1963) [-].
_FIRST, _LAST = 1e-3, 1e8


def least_squares(
    at: Callable[[Array], tuple[Array, Array]],
    start: Array,
    ends: tuple[Array, Array],
    xtol: float,
    ftol: float,
    steps: int,
) -> tuple[Array, Array, Array]:
    """x (p,), residual r (m,) and Jacobian J (m, p) at the least |r(x)|^2 with low <= x <= high.

    at : r and J of x; ends : low and high (p,). Levenberg-Marquardt (Nielsen's damping, IMM-REP-1999-05)
    in the variables that no bound holds against the descent; ends where a step is shorter than xtol of
    x, gains less than ftol of the square, or after so many evaluations.
    """
    low, high = ends
    x = np.clip(start, low, high)
    r, J = at(x)
    damping, grows, square = _FIRST, 2.0, float(r @ r)
    for _ in range(steps):
        slope, curvature = J.T @ r, J.T @ J
        free = ~(((x <= low) & (slope > 0.0)) | ((x >= high) & (slope < 0.0)))
        free &= np.diagonal(curvature) > 0.0
        if not free.any():
            break
        some = np.ix_(free, free)
        H = curvature[some] + damping * np.diag(np.diagonal(curvature)[free])
        step = np.zeros(len(x))
        step[free] = -np.linalg.lstsq(H, slope[free], rcond=1e-14)[0]
        there = np.clip(x + step, low, high)
        step = there - x
        foreseen = -float(2.0 * step @ slope + step @ curvature @ step)
        if np.linalg.norm(step) <= xtol * (xtol + np.linalg.norm(x)):
            break
        other, slopes = at(there)
        gained = square - float(other @ other)
        if gained > 0.0:
            done = gained <= ftol * square
            x, r, J, square = there, other, slopes, square - gained
            damping *= max(1.0 / 3.0, 1.0 - (2.0 * gained / max(foreseen, 1e-300) - 1.0) ** 3)
            grows = 2.0
            if done:
                break
        else:
            damping, grows = damping * grows, 2.0 * grows
            if damping > _LAST or foreseen <= ftol * square:
                break
    return x, r, J
