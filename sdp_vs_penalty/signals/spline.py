"""Cubic splines without scipy.interpolate, whose import takes longer than a whole fit."""

from __future__ import annotations

from bisect import bisect

import numpy as np

from sdp_vs_penalty.robot.arrays import Array


class CubicSpline:
    """Through values y (N, ...) at increasing x (N,), twice differentiable; the outermost two pieces of
    either end are one cubic (not-a-knot; de Boor, A Practical Guide to Splines, IV), and go on outside.
    """

    def __init__(self, x: Array, y: Array) -> None:
        self.x, self.y = np.asarray(x, float), np.asarray(y, float)
        width = np.diff(self.x).reshape(-1, *(1,) * (self.y.ndim - 1))
        rise = np.diff(self.y, axis=0) / width
        s = _slopes(np.diff(self.x), rise)
        bend = (s[:-1] + s[1:] - 2.0 * rise) / width
        self._cubic, self._square = bend / width, (rise - s[:-1]) / width - bend
        self._slope, self._knots = s, self.x.tolist()

    def __call__(self, at: Array | float) -> Array:
        """(M, ...) values at M places, or at a single one."""
        at = np.asarray(at, float)
        k = np.clip(np.searchsorted(self.x, at, "right") - 1, 0, len(self.x) - 2)
        z = np.reshape(at - self.x[k], at.shape + (1,) * (self.y.ndim - 1))
        return np.asarray(
            self.y[k] + z * (self._slope[k] + z * (self._square[k] + z * self._cubic[k])), float
        )

    def with_slope(self, at: float) -> tuple[Array, Array]:
        """(...) the value at one place, and the derivative there."""
        k = min(max(bisect(self._knots, at) - 1, 0), len(self._knots) - 2)
        z, a, b, c = at - self._knots[k], self._cubic[k], self._square[k], self._slope[k]
        return self.y[k] + z * (c + z * (b + z * a)), c + z * (2.0 * b + 3.0 * z * a)


def _slopes(h: Array, rise: Array) -> Array:
    """(N, ...) derivatives at the knots, from the pieces' widths h (N - 1,) and slopes."""
    from scipy.linalg import solve_banded

    if len(h) == 1:
        return np.concatenate([rise, rise])
    flat = rise.reshape(len(h), -1)
    w = h[:, None]
    if len(h) == 2:  # one parabola
        middle = (w[1] * flat[0] + w[0] * flat[1]) / (w[0] + w[1])
        out = np.stack([2.0 * flat[0] - middle, middle, 2.0 * flat[1] - middle])
        return out.reshape(3, *rise.shape[1:])
    first, last = h[0] + h[1], h[-1] + h[-2]
    bands = np.zeros((3, len(h) + 1))
    bands[1, 1:-1], bands[0, 2:], bands[2, :-2] = 2.0 * (h[:-1] + h[1:]), h[:-1], h[1:]
    bands[1, 0], bands[0, 1], bands[1, -1], bands[2, -2] = h[1], first, h[-2], last
    right = np.empty((len(h) + 1, flat.shape[1]))
    right[1:-1] = 3.0 * (w[1:] * flat[:-1] + w[:-1] * flat[1:])
    right[0] = ((h[0] + 2.0 * first) * h[1] * flat[0] + h[0] ** 2 * flat[1]) / first
    right[-1] = (h[-1] ** 2 * flat[-2] + (2.0 * last + h[-1]) * h[-2] * flat[-1]) / last
    return np.asarray(solve_banded((1, 1), bands, right)).reshape(-1, *rise.shape[1:])
