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
        derivatives by x; beyond the ends the first and the last piece go on.

        On a piece of width h, with s = (x - start) / h from 0 to 1, the spline is
        value + h s (slope + s (a + s b)); a and b follow from value and slope at the
        piece's end.
        """
        at = np.asarray(at, float)
        piece = np.searchsorted(self.x, at, "right") - 1
        piece = np.clip(piece, 0, len(self.x) - 2)
        start = self.x[piece]
        h = (self.x[piece + 1] - start)[..., None]
        s = (at - start)[..., None] / h
        slope = self.slopes[piece]
        mean_slope = (self.values[piece + 1] - self.values[piece]) / h
        b = slope + self.slopes[piece + 1] - 2.0 * mean_slope
        a = mean_slope - slope - b
        if order == 1:
            return slope + s * (2.0 * a + 3.0 * s * b)
        return self.values[piece] + h * s * (slope + s * (a + s * b))


def _slopes_at_knots(x: Array, y: Array) -> Array:
    """Return the derivatives (N, d) at knots x (N,) of the spline through y (N, d).

    Second derivatives are continuous at inner knots, third ones at the second knot and
    the last but one: a tridiagonal system.
    """
    n_knots = len(x)
    if n_knots < 4:  # one polynomial
        powers = np.vander(x - x[0], n_knots)
        exponents = np.arange(n_knots - 1, 0, -1)[:, None]
        return powers[:, 1:] @ (exponents * np.linalg.solve(powers, y)[:-1])
    width = np.diff(x)
    two_widths = width[:-1] + width[1:]
    mean_slope = np.diff(y, axis=0) / width[:, None]
    above = [0.0, two_widths[0], *width[:-1]]
    diagonal = [width[1], *(2.0 * two_widths), width[-2]]
    below = [*width[1:], two_widths[-1], 0.0]
    inner = 3.0 * (
        width[1:, None] * mean_slope[:-1] + width[:-1, None] * mean_slope[1:]
    )

    def at_end(first: float, second: float, near: Array, far: Array) -> Array:
        """Return the right side (d,) of an end, from the widths of the two pieces there
        and their mean slopes."""
        both = first + second
        return ((first + 2.0 * both) * second * near + first**2 * far) / both

    begin = at_end(width[0], width[1], mean_slope[0], mean_slope[1])
    end = at_end(width[-1], width[-2], mean_slope[-1], mean_slope[-2])
    right_side = np.vstack([begin, inner, end])
    bands = np.array([above, diagonal, below])
    return scipy.linalg.solve_banded((1, 1), bands, right_side)
