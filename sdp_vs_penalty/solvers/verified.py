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

from collections.abc import Callable, Mapping, Sequence
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
from sdp_vs_penalty.solvers import verify_proof
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
    slope = slope + Enclosure.exact(objective.linear)
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


def certainly_feasible(
    constraints: Sequence[Constraint], theta: Array, as_written: bool = False
) -> bool:
    """Whether theta satisfies all constraints, decided in rational arithmetic; as_written : also the
    shortest decimal text of each number, which is what a file holds."""
    margin, size = margins(constraints, theta)
    numbers = [{int(k): Fraction(float(theta[k])) for c in constraints for k in c.indices}]
    if as_written:
        numbers.append({k: Fraction(repr(float(theta[k]))) for k in numbers[0]})
    return all(
        verify_proof.inside(c.cone, _exact_value(c, exact))
        for c, well in zip(constraints, margin > _WELL_INSIDE * size, strict=True)
        if not well
        for exact in numbers
    )


def violations(constraints: ConstraintSet, theta: Array) -> dict[str, float]:
    """Worst violation of each family; one that only rounding in its evaluation sees is none."""
    out = constraints.worst(theta)
    for family in [family for family, violation in out.items() if violation > 0.0]:
        convex = [c for c in constraints.convex if c.family == family]
        if convex and certainly_feasible(convex, theta):
            out[family] = 0.0
    return out


#: A margin above this share of the constraint's terms is no matter of rounding, of either kind.
_WELL_INSIDE = 1e-9


def feasible_point(
    constraints: Sequence[Constraint], theta: Array, interior: Array, as_written: bool = False
) -> Array | None:
    """The first point on the way from theta to an interior point that is certainly feasible; theta
    itself, nearly always: on a boundary rounding may put its last digit outside."""
    for step in (0.0, *10.0 ** (0.5 * np.arange(-32, 1))):
        point = theta + step * (interior - theta) if step else theta
        if certainly_feasible(constraints, point, as_written):
            return point
    return None


def upper_bound(objective: Objective, theta: Array) -> float:
    """A number that is certainly >= objective(theta)."""
    data = objective.least_squares
    residual = product(data.R, theta) - Enclosure.exact(data.rho)
    worst = residual.magnitude()
    value = product(worst, worst) + product([Long(data.residual_norm)], [Long(data.residual_norm)])
    value = value + product(np.broadcast_to(objective.linear, theta.shape), theta)
    if objective.entropy is not None:
        value = value + _entropy_value(objective.entropy, theta)
    return -_down(-value.upper)


def _entropy_value(entropy: Entropy, theta: Array) -> Enclosure:
    exact = [Fraction(float(x)) for x in theta]
    value = Enclosure.exact(0.0)
    for link, inverse, logdet0 in zip(entropy.links, *entropy.nominal_terms, strict=True):
        matrix = _exact_value(link, exact)
        determinant = verify_proof.determinant(matrix)
        if not determinant:
            return Enclosure.exact(np.inf)
        log_det = Long(float(verify_proof.log_below(determinant)))
        trace = verify_proof.dot([Fraction(x) for x in inverse.ravel().tolist()], matrix)
        trace_long = Long(float(trace))
        part = Enclosure(trace_long, 2.0**-52 * abs(trace_long)) - Enclosure(
            log_det, Long(2.0**-50) * (abs(log_det) + 1)
        )
        value = value + (part + Enclosure.exact(float(logdet0) - 4.0)).times(entropy.weight)
    return value


def _exact_value(
    constraint: Constraint, theta: Mapping[int, Fraction] | Sequence[Fraction]
) -> list[Fraction]:
    """F(theta) in rational numbers, entry by entry; a matrix's symmetric part."""
    out = [Fraction(float(x)) for x in constraint.constant.ravel()]
    for k, coefficient in zip(constraint.indices, constraint.coefficients, strict=True):
        flat = coefficient.ravel()
        for entry in np.flatnonzero(flat):
            out[entry] += theta[int(k)] * Fraction(float(flat[entry]))
    if constraint.cone != "psd":
        return out
    d = len(constraint.constant)
    return [(out[i * d + j] + out[j * d + i]) / 2 for i in range(d) for j in range(d)]


def _down(x: Any) -> float:
    """The largest double that is not above x."""
    double = float(x)
    return double if Long(double) <= x else float(np.nextafter(double, -np.inf))
