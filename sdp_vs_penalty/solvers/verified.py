"""Bounds on the optimum that hold in floating point, whatever was rounded on the way.

In the manner of Jansson, Chaykin, Keil ("Rigorous error bounds for the optimal value in
semidefinite programming", SIAM J. Numer. Anal. 2007): any numbers a solver returns are turned into
a lower bound on the optimum over {theta feasible, |theta_k| <= B_k}, and into a point that is
feasible beyond doubt, hence an upper bound. R, rho, residual_norm and the constraint arrays are taken as
exact, as the doubles they are.

Lower side. A multiplier is used as V V^T, which is positive semidefinite whatever V's entries are,
so that no eigenvalue has to be trusted; sums are enclosed (enclosure.py). Upper side. F(theta) is
formed in rational arithmetic and factorised exactly: feasible is then a fact.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from fractions import Fraction
from typing import Any

import numpy as np

from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.constraint import (
    Constraint,
    ConstraintSet,
    Entries,
    alike,
    margins,
)
from sdp_vs_penalty.solvers.enclosure import (
    ROUNDOFF,
    Enclosure,
    Long,
    in_cone,
    product,
    scaled,
    scattered,
    total,
    up,
)
from sdp_vs_penalty.solvers.objective import Entropy, Objective


def _joined(parts: Sequence[Enclosure]) -> Enclosure:
    nothing = np.zeros(0, Long)
    return Enclosure(
        np.concatenate([nothing, *(part.value.ravel() for part in parts)]),
        np.concatenate([nothing, *(part.radius.ravel() for part in parts)]),
    )


def _against(
    entries: Entries, multipliers: Sequence[Enclosure], size: int
) -> tuple[Enclosure, Enclosure]:
    """<S, F(theta)> over all constraints as an affine function of theta (size,): constant and slope."""
    flat = _joined(multipliers)
    value = np.asarray(entries.value, Long)
    at = Enclosure(flat.value[entries.row], flat.radius[entries.row])
    slope = scattered(size, entries.column, scaled(value, at))
    return total(scaled(np.asarray(entries.constant, Long), flat)), slope


def _entropy_tangent(
    entropy: Entropy, slopes: Sequence[Array], size: int
) -> tuple[Enclosure, Enclosure]:
    """-log det P >= log det S + 4 - <S, P> for each link, with S = V V^T exactly: constant and slope."""
    raw = np.asarray(slopes)
    factor = np.linalg.cholesky(0.5 * (raw + np.swapaxes(raw, 1, 2)))
    logs = np.log(np.asarray(np.diagonal(factor, axis1=1, axis2=2), Long))
    log_det = Enclosure(2 * logs, up(16 * ROUNDOFF * (np.abs(logs) + 1)))
    inverse, logdet0 = entropy.nominal_terms
    difference = Enclosure.exact(inverse) - product(factor, np.swapaxes(factor, 1, 2))
    own = [
        Enclosure(difference.value[group.places], difference.radius[group.places])
        for group in entropy.entries.groups
    ]
    constant, slope = _against(entropy.entries, own, size)
    constant = constant + total(log_det) + total(Enclosure.exact(logdet0))
    return constant.times(entropy.weight), slope.times(entropy.weight)


def lower_bound(
    objective: Objective,
    constraints: Entries,
    multipliers: Sequence[Array],
    y: Array,
    bound: Array,
    entropy_slopes: Sequence[Array] = (),
    correct: Callable[[Array], Array] | None = None,
) -> float:
    """A number that is certainly <= min objective over the constraints and |theta_k| <= bound_k.

    f(theta) >= residual_norm^2 + 2 y^T (R theta - rho) - y^T y - sum <S_i, F_i(theta)> for every y and
    all S_i in their cones; what is left of the slope, e, costs |e|^T bound. y (r,) near the residual at
    the optimum, multipliers near the dual optimum; correct : from a leftover slope (p,) times bound to
    the shift (r,) of y that removes it, added in extended precision until it no longer matters.
    """
    data = objective.least_squares
    dual = [
        in_cone(group.cone, values)
        for group, values in zip(constraints.groups, constraints.stacked(multipliers), strict=True)
    ]
    taken, slope = _against(constraints, dual, len(bound))
    constant, slope = Enclosure.exact(0.0) - taken, Enclosure(-slope.value, slope.radius)
    if objective.entropy is not None:
        tangent = _entropy_tangent(objective.entropy, entropy_slopes, len(bound))
        constant, slope = constant + tangent[0], slope + tangent[1]
    pull = 2 * np.asarray(data.R, Long).T
    shifted = np.asarray(y, Long)
    for _ in range(0 if correct is None else _CORRECTIONS):
        assert correct is not None
        leftover = np.asarray(bound * (slope.value + pull @ shifted), float)
        if np.abs(leftover).sum() <= _MATTERS * float(shifted @ shifted + data.residual_norm**2):
            break
        shifted = shifted - correct(leftover)
    left = slope + product(pull, shifted)
    constant = constant + product([Long(data.residual_norm)], [Long(data.residual_norm)])
    constant = constant - product(2 * shifted, np.asarray(data.rho, Long))
    constant = constant - product(shifted, shifted)
    reach = product(left.magnitude(), np.asarray(bound, Long))
    return _down((constant - Enclosure(reach.upper, Long(0))).lower)


#: Corrections of y at most, and what a leftover slope may cost of the loss without another one.
_CORRECTIONS, _MATTERS = 3, 1e-12


def proves_infeasible(
    constraints: Sequence[Constraint], multipliers: Sequence[Array], bound: Array
) -> bool:
    """Whether the multipliers prove that no |theta_k| <= bound_k satisfies all constraints.

    0 <= sum <S_i, F_i(theta)> <= sum <S_i, F_i0> + |e|^T bound < 0 cannot be (Farkas). It is the
    lower bound of the objective zero: positive exactly if the set is empty.
    """
    from sdp_vs_penalty.regression.regression import LeastSquares

    p = len(bound)
    nothing = Objective(LeastSquares(np.zeros((0, p)), np.zeros(0), 0.0, 0.0, 0))
    return lower_bound(nothing, Entries.of(alike(constraints)), multipliers, np.zeros(0), bound) > 0.0


def certainly_feasible(constraints: Sequence[Constraint], theta: Array) -> bool:
    """Whether theta satisfies all constraints, decided in rational arithmetic."""
    return _certainly_inside(constraints, theta, Fraction)


def feasible_as_written(constraints: Sequence[Constraint], theta: Array) -> bool:
    """The same, and of the shortest decimal text of each number too, which is what a file holds."""
    return _certainly_inside(constraints, theta, Fraction, _as_written)


def violations(constraints: ConstraintSet, theta: Array) -> dict[str, float]:
    """Worst violation of each family; one that only rounding in its evaluation sees is none."""
    out = constraints.worst(theta)
    for family in [family for family, violation in out.items() if violation > 0.0]:
        convex = [c for c in constraints.convex if c.family == family]
        if convex and certainly_feasible(convex, theta):
            out[family] = 0.0
    return out


def _as_written(x: float) -> Fraction:
    return Fraction(repr(x))


#: A margin above this share of the constraint's terms is no matter of rounding, of either kind.
_WELL_INSIDE = 1e-9


def _certainly_inside(
    constraints: Sequence[Constraint], theta: Array, *read: Callable[[float], Fraction]
) -> bool:
    """As each of ``read`` takes the numbers."""
    margin, size = margins(constraints, theta)
    return all(
        _inside(c.cone, _exact_value(c, {int(k): exact(float(theta[k])) for k in c.indices}))
        for c, well in zip(constraints, margin > _WELL_INSIDE * size, strict=True)
        if not well
        for exact in read
    )


def feasible_point(constraints: Sequence[Constraint], theta: Array, interior: Array) -> Array | None:
    """The first point on the way from theta to an interior point that is certainly feasible."""
    for point in way_inside(theta, interior):
        if certainly_feasible(constraints, point):
            return point
    return None


def repaired_as_written(constraints: Sequence[Constraint], theta: Array, interior: Array) -> Array:
    """The first point on the way to an interior one that is feasible as it will be written.

    theta itself, nearly always: where it sits on a boundary, rounding may put its last digit outside.
    """
    for point in way_inside(theta, interior):
        if feasible_as_written(constraints, point):
            return point
    return theta


def way_inside(theta: Array, interior: Array) -> Iterator[Array]:
    """theta, then points ever farther on the way to an interior one: steps of 1e-16 to 1."""
    yield theta
    for k in range(-32, 1):
        yield theta + 10.0 ** (0.5 * k) * (interior - theta)


def upper_bound(objective: Objective, theta: Array) -> float:
    """A number that is certainly >= objective(theta)."""
    data = objective.least_squares
    residual = product(data.R, theta) - Enclosure.exact(data.rho)
    worst = residual.magnitude()
    value = product(worst, worst) + product([Long(data.residual_norm)], [Long(data.residual_norm)])
    if objective.entropy is not None:
        value = value + _entropy_value(objective.entropy, theta)
    return -_down(-value.upper)


def _entropy_value(entropy: Entropy, theta: Array) -> Enclosure:
    exact = [Fraction(float(x)) for x in theta]
    value = Enclosure.exact(0.0)
    for link, inverse, logdet0 in zip(entropy.links, *entropy.nominal_terms, strict=True):
        matrix = _exact_value(link, exact)
        determinant = math.prod(_pivots(matrix), start=Fraction(1))
        if determinant <= 0:
            return Enclosure.exact(np.inf)
        log_det = Long(_log(determinant))
        trace = sum(
            (Fraction(float(inverse[a, b])) * matrix[a][b] for a in range(4) for b in range(4)),
            Fraction(0),
        )
        trace_long = Long(float(trace))
        part = Enclosure(trace_long, 2.0**-52 * abs(trace_long)) - Enclosure(
            log_det, Long(2.0**-50) * (abs(log_det) + 1)
        )
        value = value + (part + Enclosure.exact(float(logdet0) - 4.0)).times(entropy.weight)
    return value


def _log(x: Fraction) -> float:
    """log of a positive rational of any size."""
    shift = x.numerator.bit_length() - x.denominator.bit_length()
    return math.log(float(x / Fraction(2) ** shift)) + shift * math.log(2.0)


def _exact_value(constraint: Constraint, theta: Mapping[int, Fraction] | Sequence[Fraction]) -> Any:
    """F(theta) in rational numbers: nested lists of the shape of the constraint's arrays."""
    out = [Fraction(float(x)) for x in constraint.constant.ravel()]
    for k, coefficient in zip(constraint.indices, constraint.coefficients, strict=True):
        flat = coefficient.ravel()
        for entry in np.flatnonzero(flat):
            out[entry] += theta[int(k)] * Fraction(float(flat[entry]))
    if constraint.constant.ndim == 1:
        return out
    d = len(constraint.constant)
    return [out[i * d : (i + 1) * d] for i in range(d)]


def _inside(cone: str, value: Any) -> bool:
    if cone == "psd":
        return all(pivot >= 0 for pivot in _pivots(value))
    if cone == "soc":
        return value[0] >= 0 and value[0] ** 2 >= sum(u**2 for u in value[1:])
    return all(x >= 0 for x in value)


def _pivots(matrix: Sequence[Sequence[Fraction]]) -> list[Fraction]:
    """The D of L D L^T: all >= 0 exactly if the symmetric matrix is positive semidefinite.

    A zero pivot whose column is not zero makes the matrix indefinite: it is returned as -1.
    """
    order = range(len(matrix))
    rows = [[(matrix[i][j] + matrix[j][i]) / 2 for j in order] for i in order]
    pivots: list[Fraction] = []
    for k in range(len(rows)):
        pivot = rows[k][k]
        below = range(k + 1, len(rows))
        if pivot <= 0:
            if pivot < 0 or any(rows[i][k] != 0 for i in below):
                return [*pivots, Fraction(-1)]
            pivots.append(Fraction(0))
            continue
        for i in below:
            ratio = rows[i][k] / pivot
            for j in below:
                rows[i][j] -= ratio * rows[k][j]
        pivots.append(pivot)
    return pivots


def _down(x: Any) -> float:
    """The largest double that is not above x."""
    double = float(x)
    return double if Long(double) <= x else float(np.nextafter(double, -np.inf))
