"""Non-linear least squares within bounds, where the residual comes with its Jacobian."""

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

    at : r and J of x, which it computes together; ends : low and high (p,); xtol, ftol, steps : as
    ``scipy.optimize.least_squares`` takes them (trust region reflective: Branch, Coleman, Li, SIAM J.
    Scientific Computing 1999).
    """
    from scipy import optimize

    asked = np.full(len(start), np.nan)
    answer = asked, asked

    def both(x: Array) -> tuple[Array, Array]:
        nonlocal asked, answer
        if not np.array_equal(x, asked):
            asked, answer = x.copy(), at(x)
        return answer

    # SciPy's reflected step, which it discards, and its step along a gradient of 0.
    with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
        found = optimize.least_squares(
            lambda x: both(x)[0], np.clip(start, *ends), lambda x: both(x)[1],
            bounds=ends, xtol=xtol, ftol=ftol, gtol=None, max_nfev=steps,
        )  # fmt: skip
    return found.x, found.fun, found.jac
