"""Base parameters by scikit-learn: a pivoted QR chooses columns, a regression fits them.

Nothing demands that the parameters belong to bodies that can exist.
"""

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

Array = NDArray[np.float64]
#: Columns whose pivot is smaller than this, relative to the largest, depend on others.
TOLERANCE = 1e-6


def solve(y: Array, tau: Array) -> Array:
    """Return theta (13 n,) of rows y (M, n, 13 n) and torques tau (M, n).

    Parameters that are not in the base are zero.
    """
    from sklearn.linear_model import LinearRegression

    rows = y.reshape(-1, y.shape[2])
    triangle, order = linalg.qr(rows, mode="r", pivoting=True)
    pivots = np.abs(np.diag(triangle))
    base = order[: int(np.sum(pivots > TOLERANCE * pivots[0]))]
    fit = LinearRegression(fit_intercept=False).fit(rows[:, base], tau.ravel())
    theta = np.zeros(y.shape[2])
    theta[base] = fit.coef_
    return theta
