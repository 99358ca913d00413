"""Bounds on an inertia about the centre of mass between two convex sets.

An upper bound on a moment about the centre of mass, and both bounds on a product of inertia, are not
convex in the standard parameters: with h = m c,

    I_aa = J_aa - (h_b^2 + h_c^2) / m <= ub,        lb <= I_ab = J_ab + h_a h_b / m <= ub.

While the centre of mass is in a cell l <= c <= u they have convex neighbours on both sides, linear in
(m, h, J) but for one second-order cone each:

    outer:  m c_b^2 <= (l + u) h_b - l u m              (secant), and McCormick's envelope of m c_a c_b
    inner:  m c_b^2 >= 2 c0 h_b - c0^2 m                (tangent at c0), and with it the difference
            m c_a c_b = ((h_a + h_b)^2 - (h_a - h_b)^2) / 4 m

(McCormick, Mathematical Programming 1976, for the envelope.)
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sdp_vs_penalty.constraints import constraint as build
from sdp_vs_penalty.constraints.constraint import BarycentricBound, Constraint
from sdp_vs_penalty.robot.arrays import Array

#: Rows and columns of the six entries of an inertia, in our order.
_ENTRIES = ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2))


def moment_axes(entry: int) -> tuple[int, ...]:
    """The axes whose first moments turn this entry of J into that of I."""
    i, j = _ENTRIES[entry]
    return tuple(a for a in range(3) if a != i) if i == j else (i, j)


def _row(entry: int, mass: float = 0.0, moments: dict[int, float] | None = None) -> Array:
    """Coefficients (10,) of J_entry + mass m + sum of moments[a] h_a."""
    row = np.zeros(10)
    row[4 + entry], row[0] = 1.0, mass
    for axis, value in (moments or {}).items():
        row[1 + axis] = value
    return row


def outer(bound: BarycentricBound, cell: Array) -> list[Constraint]:
    """Convex consequences of a bound while the centre of mass is in the cell (3, 2)."""
    a, b = moment_axes(bound.entry)
    (la, ua), (lb, ub) = cell[a], cell[b]
    i, j = _ENTRIES[bound.entry]
    if i == j:
        under = [_row(bound.entry, la * ua + lb * ub, {a: -la - ua, b: -lb - ub})]
        over: list[Array] = []
    else:
        under = [_row(bound.entry, -p * q, {a: q, b: p}) for p, q in ((la, lb), (ua, ub))]
        over = [_row(bound.entry, -p * q, {a: q, b: p}) for p, q in ((ua, lb), (la, ub))]
    out = []
    if np.isfinite(bound.upper):
        rows = np.array([-r for r in under]).T
        out.append(_linear(bound, rows, np.full(len(under), bound.upper)))
    if np.isfinite(bound.lower) and over:
        out.append(_linear(bound, np.array(over).T, np.full(len(over), -bound.lower)))
    return out + _exact(bound)


def inner(bound: BarycentricBound, c: Array) -> list[Constraint]:
    """Convex conditions that imply a bound, tight where the centre of mass is at c (3,)."""
    a, b = moment_axes(bound.entry)
    i, j = _ENTRIES[bound.entry]
    if i == j:
        row = _row(bound.entry, c[a] ** 2 + c[b] ** 2, {a: -2.0 * c[a], b: -2.0 * c[b]})
        upper = (
            [_linear(bound, -row[:, None], np.array([bound.upper]))] if np.isfinite(bound.upper) else []
        )
        return upper + _exact(bound)
    out = []
    for sign, limit in ((1.0, bound.upper), (-1.0, -bound.lower)):
        # sign J + (h_a + sign h_b)^2 / 4m - (h_a - sign h_b)^2 / 4m <= limit, the last term replaced
        # by its tangent: u^2 / 4m <= t with u = h_a + sign h_b and t affine.
        if not np.isfinite(limit):
            continue
        d = c[a] - sign * c[b]
        t = -sign * _row(bound.entry) + _shift(a, b, sign, d)
        u = np.zeros(10)
        u[1 + a], u[1 + b] = 1.0, sign
        out.append(_rotated(bound, [u], t, limit))
    return out


def _shift(a: int, b: int, sign: float, d: float) -> Array:
    """(2 d g - d^2 m) / 4: the tangent of g^2 / 4m with g = h_a - sign h_b, where g / m = d."""
    row = np.zeros(10)
    row[0], row[1 + a], row[1 + b] = -(d**2) / 4.0, d / 2.0, -sign * d / 2.0
    return row


def _exact(bound: BarycentricBound) -> list[Constraint]:
    """The lower bound of a moment is convex: (h_b^2 + h_c^2) / m <= J_aa - lb."""
    i, j = _ENTRIES[bound.entry]
    # Consistency already implies a moment >= 0.
    if i != j or not np.isfinite(bound.lower) or bound.lower <= 0.0:
        return []
    rows = []
    for axis in moment_axes(bound.entry):
        u = np.zeros(10)
        u[1 + axis] = 2.0
        rows.append(u)
    return [_rotated(bound, rows, _row(bound.entry), -bound.lower)]


def _rotated(bound: BarycentricBound, u: Sequence[Array], t: Array, constant: float) -> Constraint:
    """|u|^2 <= 4 m (t + constant) as |(u, m - t)| <= m + t, for rows u, t (10,) of theta."""
    mass = np.eye(10)[0]
    coefficients = np.column_stack([mass + t, *u, mass - t])
    offset = np.zeros(coefficients.shape[1])
    offset[0], offset[-1] = constant, -constant
    return build.second_order("barycentric piece", bound.name, bound.indices, coefficients, offset)


def _linear(bound: BarycentricBound, coefficients: Array, constant: Array) -> Constraint:
    return build.linear("barycentric piece", bound.name, bound.indices, coefficients, constant)
