"""Cubic splines through samples: those of scipy.interpolate, whose import takes 3 % of
an identification."""

import numpy as np
import scipy
from numpy.typing import ArrayLike

from sdp_vs_penalty.robot.arrays import Array


class CubicSpline:
    """The cubic spline through samples ``values`` (N, d) at ascending knots ``x`` (N,),
    at least two, whose first two and last two pieces are one cubic each."""

    def __init__(self, x: ArrayLike, values: ArrayLike) -> None:
        """Compute the ``slopes`` (N, d) at the knots."""
        self.x: Array = np.asarray(x, float)
        self.values: Array = np.asarray(values, float)
        self.slopes = _slopes_at_knots(self.x, self.values)

    def __call__(self, at: ArrayLike, order: int = 0) -> Array:
        """Return the values (..., d) at places (...), or with ``order`` 1 the
        derivatives by x; beyond the ends the first and the last piece go on."""
        at = np.asarray(at, float)
        piece = np.searchsorted(self.x, at, "right") - 1
        piece = np.clip(piece, 0, len(self.x) - 2)
        start = self.x[piece]
        width = (self.x[piece + 1] - start)[..., None]
        s = (at - start)[..., None] / width
        before = self.slopes[piece]
        rise = (self.values[piece + 1] - self.values[piece]) / width
        cube = before + self.slopes[piece + 1] - 2.0 * rise
        square = rise - before - cube
        if order == 1:
            return before + s * (2.0 * square + 3.0 * s * cube)
        return self.values[piece] + width * s * (before + s * (square + s * cube))


def _slopes_at_knots(x: Array, y: Array) -> Array:
    """Return the derivatives (N, d) at knots x (N,) of values y (N, d)."""
    n_knots = len(x)
    if n_knots < 4:  # one polynomial
        powers = np.vander(x - x[0], n_knots)
        exponents = np.arange(n_knots - 1, 0, -1)[:, None]
        return powers[:, 1:] @ (exponents * np.linalg.solve(powers, y)[:-1])
    width = np.diff(x)
    double = width[:-1] + width[1:]
    rise = np.diff(y, axis=0) / width[:, None]
    # Of the equations the diagonals above, on and below the main one: second derivatives
    # are continuous at inner knots, third ones at the second knot and the last but one.
    above = [0.0, double[0], *width[:-1]]
    main = [width[1], *(2.0 * double), width[-2]]
    below = [*width[1:], double[-1], 0.0]
    of_both_sides = width[1:, None] * rise[:-1] + width[:-1, None] * rise[1:]

    def at_end(first: float, second: float, near: Array, far: Array) -> Array:
        both = first + second
        return ((first + 2.0 * both) * second * near + first**2 * far) / both

    begin = at_end(width[0], width[1], rise[0], rise[1])
    end = at_end(width[-1], width[-2], rise[-1], rise[-2])
    right_side = np.vstack([begin, 3.0 * of_both_sides, end])
    return scipy.linalg.solve_banded((1, 1), np.array([above, main, below]), right_side)
