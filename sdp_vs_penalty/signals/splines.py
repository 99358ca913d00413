"""Cubic splines through samples.

scipy.interpolate makes the same splines; to import it takes as long as a tenth of an
identification.
"""

from __future__ import annotations

import numpy as np
import scipy
from numpy.typing import ArrayLike

from sdp_vs_penalty.robot.arrays import Array, Indices


class CubicSpline:
    """The cubic spline through samples with continuous second derivatives, whose first
    two and last two pieces are one cubic each (not-a-knot).

    x (N,) : knots; c (4, N - 1, d) : coefficients of each piece, of the cube first, in
    powers of the distance from the piece's first knot.
    """

    def __init__(self, x: ArrayLike, values: ArrayLike) -> None:
        """Interpolate samples (N, d) at ascending knots x (N,), at least two."""
        self.x: Array = np.asarray(x, float)
        y: Array = np.asarray(values, float)
        width = np.diff(self.x)[:, None]
        if not np.all(width > 0.0):
            raise ValueError("the knots of a spline have to ascend")
        rise = np.diff(y, axis=0) / width
        slope = _slopes_at_knots(width, rise)
        bend = (slope[:-1] + slope[1:] - 2.0 * rise) / width
        self.c: Array = np.stack(
            [bend / width, (rise - slope[:-1]) / width - bend, slope[:-1], y[:-1]]
        )

    def __call__(self, at: ArrayLike, order: int = 0) -> Array:
        """Evaluate the spline or its first derivative.

        Parameters
        ----------
        at : (M,) array
            Where; beyond the ends the first and the last piece go on.
        order : int
            0 for values, 1 for the derivative by x.

        Returns
        -------
        (M, d) array
            Values, or values per unit of x.
        """
        at = np.asarray(at, float)
        piece = self._piece(at)
        cube, square, slope, value = (c[piece] for c in self.c)
        h = (at - self.x[piece])[:, None]
        if order == 1:
            return (3.0 * cube * h + 2.0 * square) * h + slope
        return ((cube * h + square) * h + slope) * h + value

    def _piece(self, at: Array) -> Indices:
        """Return the number (M,) of the piece for each of ``at`` (M,)."""
        behind = np.searchsorted(self.x, at, "right")
        return np.clip(behind - 1, 0, len(self.x) - 2)


def _slopes_at_knots(width: Array, rise: Array) -> Array:
    """Return the derivatives (N, d) at the knots.

    width (N - 1, 1) : of the pieces; rise (N - 1, d) : mean derivative of each piece.
    Two knots have a straight line, three a parabola.
    """
    if len(rise) == 1:
        return np.concatenate([rise, rise])
    first, second = width[0], width[1]
    if len(rise) == 2:
        bend = (rise[1] - rise[0]) / (first + second)
        return np.stack(
            [rise[0] - first * bend, rise[0] + first * bend, rise[1] + second * bend]
        )
    last, before = width[-1], width[-2]
    n_knots = len(rise) + 1
    right_side = np.empty((n_knots, rise.shape[1]))
    # Diagonals of the equations: above, on and below the main one.
    bands = np.zeros((3, n_knots))
    # Second derivatives are continuous at the inner knots.
    bands[0, 2:] = width[:-1, 0]
    bands[1, 1:-1] = 2.0 * (width[:-1, 0] + width[1:, 0])
    bands[2, :-2] = width[1:, 0]
    right_side[1:-1] = 3.0 * (width[1:] * rise[:-1] + width[:-1] * rise[1:])
    # Third derivatives are continuous at the second knot and at the last but one.
    bands[1, 0] = second[0]
    bands[0, 1] = first[0] + second[0]
    right_side[0] = (
        (first + 2.0 * (first + second)) * second * rise[0] + first**2 * rise[1]
    ) / (first + second)
    bands[1, -1] = before[0]
    bands[2, -2] = before[0] + last[0]
    right_side[-1] = (
        last**2 * rise[-2] + (2.0 * (before + last) + last) * before * rise[-1]
    ) / (before + last)
    return scipy.linalg.solve_banded((1, 1), bands, right_side)
