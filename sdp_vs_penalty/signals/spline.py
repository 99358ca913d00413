"""Cubic splines, of which SciPy's have the same coefficients: importing those takes longer than to
identify a robot."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import solve_banded

from sdp_vs_penalty.robot.arrays import Array


class CubicSpline:
    """Through y (K, ...) at ascending x (K,), K > 3, with a third derivative that does not jump at the
    second and the last but one (de Boor 1978, ch. IV); beyond the ends its outer polynomials go on."""

    def __init__(self, x: ArrayLike, y: ArrayLike) -> None:
        self.x, self.y = np.asarray(x, float), np.asarray(y, float)
        h, flat = np.diff(self.x), self.y.reshape(len(self.x), -1)
        slope, ends = np.diff(flat, axis=0) / h[:, None], (h[0] + h[1], h[-2] + h[-1])
        band, right = np.zeros((3, len(h) + 1)), np.empty_like(flat)
        band[0, 2:], band[1, 1:-1], band[2, :-2] = h[:-1], 2.0 * (h[:-1] + h[1:]), h[1:]
        band[1, 0], band[0, 1], band[2, -2], band[1, -1] = h[1], ends[0], ends[1], h[-2]
        right[1:-1] = 3.0 * (h[1:, None] * slope[:-1] + h[:-1, None] * slope[1:])
        right[0] = (h[0] + 2.0 * ends[0]) * h[1] * slope[0] + h[0] ** 2 * slope[1]
        right[-1] = h[-1] ** 2 * slope[-2] + (2.0 * ends[1] + h[-1]) * h[-2] * slope[-1]
        right[[0, -1]] /= np.array(ends)[:, None]
        s = solve_banded((1, 1), band, right, overwrite_ab=True, overwrite_b=True, check_finite=False)
        bend = (s[:-1] + s[1:] - 2.0 * slope) / h[:, None]
        #: (4, K - 1, ...) coefficients of each piece in powers 3, 2, 1, 0 of the distance from its knot.
        self.powers = np.stack(
            [bend / h[:, None], (slope - s[:-1]) / h[:, None] - bend, s[:-1], flat[:-1]]
        )

    def __call__(self, at: ArrayLike) -> Array:
        """Values (..., ...) at ``at`` (...)."""
        at = np.asarray(at, float)
        k = np.clip(np.searchsorted(self.x, at, "right") - 1, 0, len(self.x) - 2)
        u, (a, b, c, y) = (at - self.x[k])[..., None], self.powers[:, k]
        return np.asarray((((a * u + b) * u + c) * u + y).reshape(at.shape + self.y.shape[1:]))
