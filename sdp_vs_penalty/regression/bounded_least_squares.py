"""Non-linear least squares within bounds, where the residual comes with its Jacobian."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from sdp_vs_penalty.robot.arrays import Array

#: Levenberg's damping at first, and how much a step that fails multiplies it by, then twice that.
_DAMPING, _WORSE = 0.03, 4.0


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
    changes of x and of |r|^2 that end the search; steps : how often ``at`` is asked at most. The method
    of Levenberg and Marquardt in the coordinates that no bound holds, each step cut to the bounds, its
    damping by how well the last step was foreseen (Nielsen, IMM-REP-1999-05).
    """
    x, damping, worse = np.clip(start, *ends), _DAMPING, _WORSE
    r, J = at(x)
    for _ in range(steps - 1):
        down = -(r @ J)
        free = np.where(down > 0.0, x < ends[1], x > ends[0])
        size = damping**0.5 * np.linalg.norm(J, axis=0)[free]
        rows = np.vstack([J[:, free], np.diag(size)])
        new = x.copy()
        new[free] += np.linalg.lstsq(rows, np.append(-r, np.zeros(len(size))))[0]
        new = np.clip(new, *ends)
        tried, loss = at(new), float(r @ r)
        fall, hoped = (loss - float(y @ y) for y in (tried[0], r + J @ (new - x)))
        near = np.linalg.norm(new - x) <= xtol * (xtol + np.linalg.norm(x))
        if fall > 0.0:
            x, (r, J) = new, tried
            damping *= max(1.0 / 3.0, 1.0 - (2.0 * fall / max(hoped, fall) - 1.0) ** 3)
            worse = _WORSE
        else:
            damping, worse = damping * worse, 2.0 * worse
        if near or 0.0 <= fall <= ftol * loss:
            break
    return x, r, J
