"""Non-linear least squares within bounds, where the residual comes with its Jacobian."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from sdp_vs_penalty.robot.arrays import Array


def least_squares(
    at: Callable[[Array], tuple[Array, Array]],
    start: Array,
    ends: tuple[Array, Array],
    xtol: float,
    ftol: float,
    steps: int,
) -> tuple[Array, Array, Array]:
    """x (p,), residual r (m,) and Jacobian J (m, p) at the least |r(x)|^2 with low <= x <= high.

    at : r and J of x, which it computes together; ends : low and high (p,); xtol, ftol : relative
    changes of x and of |r|^2 that end the search; steps : how often ``at`` is asked at most. Gauss and
    Newton's step in the coordinates that no bound holds, cut to the bounds, within a ball that grows and
    shrinks with how well the last step was foreseen (Levenberg and Marquardt; Conn, Gould, Toint,
    Trust-Region Methods 2000, ch. 6). It begins with radius 1: a factor of e in a logarithm.
    """
    x, radius = np.clip(start, *ends), 1.0
    r, J = at(x)
    for _ in range(steps - 1):
        down = -(r @ J)
        free = np.where(down > 0.0, x < ends[1], x > ends[0])
        _, s, vt = np.linalg.svd(J[:, free], full_matrices=False)
        pull = vt @ down[free]
        damping = np.linalg.norm(pull) / radius * 2.0 ** -np.arange(60.0) + np.finfo(float).tiny
        tried = pull / (s**2 + damping[:, None])  # longer and longer
        new = x.copy()
        new[free] += vt.T @ tried[np.linalg.norm(tried, axis=1) <= radius][-1]
        new = np.clip(new, *ends)
        there, loss = at(new), float(r @ r)
        fall, hoped = (loss - float(y @ y) for y in (there[0], r + J @ (new - x)))
        far = float(np.linalg.norm(new - x))
        near = far <= xtol * (xtol + np.linalg.norm(x))
        if not fall > 0.25 * hoped:
            radius = 0.25 * far
        elif fall > 0.75 * hoped:
            radius = max(radius, 2.0 * far)
        if fall > 0.0:
            x, (r, J) = new, there
        if near or 0.0 <= fall <= ftol * loss:
            break
    return x, r, J
