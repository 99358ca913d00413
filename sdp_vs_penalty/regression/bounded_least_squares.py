"""Non-linear least squares within bounds, where the residual comes with its Jacobian."""

from collections.abc import Callable

import numpy as np

from sdp_vs_penalty.robot.arrays import Array


def in_turn(
    at: Callable[[Array], tuple[Array, Array]],
) -> tuple[Callable[[Array], Array], Callable[[Array], Array]]:
    """Residual and Jacobian as SciPy asks for them, one after the other at the same x, of ``at``, which
    computes them together; once for each x."""
    asked, answer = np.full(1, np.nan), (np.zeros(0), np.zeros(0))

    def both(x: Array) -> tuple[Array, Array]:
        nonlocal asked, answer
        if not np.array_equal(x, asked):
            asked, answer = x.copy(), at(x)
        return answer

    return lambda x: both(x)[0], lambda x: both(x)[1]


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

    residual, jacobian = in_turn(at)
    # SciPy's reflected step, which it discards, and its step along a gradient of 0.
    with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
        found = optimize.least_squares(
            residual, np.clip(start, *ends), jacobian, bounds=ends, xtol=xtol, ftol=ftol,
            gtol=None, max_nfev=steps,
        )  # fmt: skip
    return found.x, found.fun, found.jac
