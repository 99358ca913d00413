"""Bounds on the optimum that hold in floating point, whatever was rounded on the way.

In the manner of Jansson, Chaykin, Keil ("Rigorous error bounds for the optimal value in
semidefinite programming", SIAM J. Numer. Anal. 2007): any numbers a solver returns are
turned into a lower bound on the optimum over {theta feasible, |theta_k| <= B_k};
whether a point is feasible is decided beyond doubt. R, rho, residual_norm and the
constraint arrays are taken as exact, as the doubles they are.

Lower side. A multiplier is used as V V^T, which is positive semidefinite whatever V's
entries are, so that no eigenvalue has to be trusted. Sums are formed in extended
precision beside the same sums of absolute values: where no number passes through more
than k operations, those times gamma_k bound the error, in any order of summation
(Higham, Accuracy and Stability, 2002, sec. 3.1). Upper side. F(theta) is formed in
rational arithmetic and factorised exactly: feasible is then a fact.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from itertools import product
from typing import Any

import numpy as np

from sdp_vs_penalty.robot.arrays import Array, nonzero_or_one
from sdp_vs_penalty.robot.constraint import (
    Constraint,
    ConstraintSet,
    StackedCones,
    group_cones,
)
from sdp_vs_penalty.solvers import verify_proof
from sdp_vs_penalty.solvers.convex_problem import ConvexProblem, Entropy

#: Extended precision where the machine has it, plain doubles elsewhere; the error
#: bounds follow.
Long = np.longdouble
Extended = Any  # an array or a number of Long


def _gamma(operations: int) -> Extended:
    """Return a bound of the relative rounding error of a number of operations.

    It is gamma_k = k eps, times four: this covers the rounding of the bound itself and
    of a few further operations.
    """
    return 4 * (operations + 16) * Long(np.finfo(Long).eps)


#: What underflow can lose in one operation, where numbers have the exponents of
#: doubles.
_TINY = Long(np.finfo(float).tiny)


def in_cones(entries: StackedCones, multipliers: Array) -> tuple[Extended, Array]:
    """Return multipliers that certainly lie in their (self-dual) cones, near the given
    ones.

    Parameters
    ----------
    multipliers : (e,)
        Multipliers, possibly outside of the cones.

    Returns
    -------
    (e,) array of Long
        Multipliers in the cones. Matrices are V V^T, formed with rounding; others are
        exact.
    (e,) array
        Sums of absolute values in each entry, for bounds of the rounding.
    """
    # Of nonnegative rows this is all; other groups are overwritten below.
    absolute_sums = np.maximum(multipliers, 0.0)
    inside = np.asarray(absolute_sums, Long)
    # Views of each group, written to in place.
    parts = [entries.split(x) for x in (multipliers, inside, absolute_sums)]
    groups_with_views = zip(entries.groups, *parts, strict=True)
    for group, outside, inside_view, sums_view in groups_with_views:
        if group.cone == "psd" and outside.any():
            symmetric = 0.5 * (outside + np.swapaxes(outside, 1, 2))
            inside_view[:], sums_view[:] = _square(factor(symmetric))
        elif group.cone == "soc":
            # Raise the axis to the norm of the other entries, rounding included.
            inside_view[:] = outside
            norm = np.sqrt(np.sum(inside_view[:, 1:] ** 2, axis=1))
            norm_with_rounding = norm * (1 + _gamma(inside_view.shape[1])) + _TINY
            inside_view[:, 0] = np.maximum(inside_view[:, 0], norm_with_rounding)
            sums_view[:] = np.abs(inside_view)
    return inside, absolute_sums


def _square(v: Array) -> tuple[Extended, Array]:
    """Return V V^T and |V| |V|^T of V (g, d, d); the latter bounds the rounding of the
    former.
    """
    exact = np.asarray(v, Long)
    size = np.abs(v)
    return exact @ _transposed(exact), size @ _transposed(size)


def _transposed(matrices: Any) -> Any:
    """Return each matrix of (g, d, d) transposed."""
    return np.swapaxes(matrices, 1, 2)


def _diagonals(matrices: Array) -> Array:
    """Return (g, d) the diagonal of each matrix."""
    return np.diagonal(matrices, axis1=1, axis2=2)


def factor(matrices: Array) -> Array:
    """Return V with V V^T near symmetric matrices, or near their psd projections.

    Parameters
    ----------
    matrices : (g, d, d)
        Symmetric matrices. If one is not positive definite, all are projected onto the
        psd cone, with diagonals scaled to one so that the result does not depend on
        units.

    Returns
    -------
    (g, d, d)
        V; zero for zero matrices.
    """
    factors = np.zeros_like(matrices)
    is_nonzero = matrices.any(axis=(1, 2))
    try:
        # Near entry by entry, in any system of units.
        factors[is_nonzero] = np.linalg.cholesky(matrices[is_nonzero])
    except np.linalg.LinAlgError:
        size = np.sqrt(np.abs(_diagonals(matrices)))
        size = nonzero_or_one(size)[:, :, None]
        eigenvalues, vectors = np.linalg.eigh(matrices / size / _transposed(size))
        roots = np.sqrt(np.maximum(eigenvalues, 0.0))
        factors = size * vectors * roots[:, None]
    return factors


def _constraint_sum(
    entries: StackedCones, multipliers: Extended, absolute_sums: Array, p: int
) -> tuple[Extended, Extended]:
    """Return sum <S_i, F_i(theta)> over all constraints, affine in theta, as slope
    (2, p) and constant (2,).

    Entry 0 of both is the value, entry 1 the sum of absolute values, which bounds the
    rounding.

    Parameters
    ----------
    multipliers, absolute_sums : (e,) arrays
        Entries of the multipliers S_i, and the sums of absolute values in each.
    p : int
        Number of parameters theta.
    """
    # The entries' F = constant + sparse matrix (row, column, value) theta.
    slope = np.zeros((2, p), Long)
    terms = entries.value * multipliers[entries.row]
    np.add.at(slope[0], entries.column, terms)
    absolute_terms = np.abs(entries.value) * absolute_sums[entries.row]
    slope[1] = np.bincount(entries.column, absolute_terms, p)
    constant = entries.constant @ multipliers
    absolute_constant = np.abs(entries.constant) @ absolute_sums
    return slope, np.array([constant, absolute_constant], Long)


def _entropy_tangent(
    entropy: Entropy, slopes: Array, p: int
) -> tuple[Extended, Extended]:
    """Return an affine lower bound of the entropic prior, as slope (2, p) and constant
    (2,).

    The prior is w sum (tr(P0^-1 P) - log det P + log det P0 - 4) over the links'
    pseudo-inertias P. Its bound uses -log det P >= log det S + 4 - tr(S P), for
    S = V V^T exactly, near ``slopes`` (links, 4, 4). Entry 0 of slope and constant is
    the value, entry 1 the sum of absolute values, which bounds the rounding. Raises
    LinAlgError unless all slopes are positive definite.
    """
    symmetric = 0.5 * (slopes + _transposed(slopes))
    v = np.asarray(np.linalg.cholesky(symmetric), float)
    logs = np.log(np.asarray(_diagonals(v), Long))
    inverse, log_det = entropy.nominal_terms
    exact, size = _square(v)
    dual = (inverse - exact).ravel()
    sizes = (np.abs(inverse) + size).ravel()
    slope, constant = _constraint_sum(entropy.entries, dual, sizes, p)
    # A logarithm is accurate to a few units in its last place, or in that of one.
    log_terms = 2 * logs.sum() + log_det.sum()
    size_of_logs = 16 * np.sum(np.abs(logs) + 1) + np.abs(log_det).sum()
    weight = Long(entropy.weight)
    constant = constant + np.array([log_terms, size_of_logs], Long)
    return weight * slope, weight * constant


@dataclass(frozen=True)
class DualEvidence:
    """What a lower bound follows from, whoever adds it up: the numbers may be off, the
    bound holds."""

    #: (e,) multipliers of the constraints' entries, near their cones.
    multipliers: Array
    #: (r,) a vector near the residual at the optimum.
    y: Array
    #: (links, 4, 4) positive definite S, with -log det P >= log det S + 4 - tr(S P).
    entropy_slopes: Array = field(default_factory=lambda: np.zeros((0, 4, 4)))
    #: Function of a leftover slope (p,) times its limit: the shift of y (r,) that
    #: removes it; by default none.
    push: Callable[[Array], Array] = lambda leftover: np.zeros(())


def _affine_minorant(
    problem: ConvexProblem, evidence: DualEvidence
) -> tuple[Extended, Extended]:
    """Return slope (2, p) and constant (2,) of linear term - sum <S_i, F_i(theta)> + the
    tangent of the prior, affine in theta.

    Entry 0 is the value, entry 1 the sum of absolute values, which bounds its rounding.
    Raises LinAlgError if the slopes of the prior are not positive definite.
    """
    constraints = problem.constraints.entries
    p = len(problem.bound)
    signs = np.array([-1, 1])
    dual, dual_sizes = in_cones(constraints, evidence.multipliers)
    slope, constant = _constraint_sum(constraints, dual, dual_sizes, p)
    slope = signs[:, None] * slope
    constant = signs * constant
    linear = np.array([problem.linear, np.abs(problem.linear)])
    slope += linear.reshape(2, -1)
    if problem.entropy is None:
        return slope, constant
    tangent = _entropy_tangent(problem.entropy, evidence.entropy_slopes, p)
    return slope + tangent[0], constant + tangent[1]


def lower_bound(problem: ConvexProblem, evidence: DualEvidence) -> float:
    """Return a number that is certainly at most the smallest objective.

    The minimum is over the constraints and |theta_k| <= bound_k. For every y and all
    S_i in their cones f(theta) >= residual_norm^2 + 2 y^T (R theta - rho) - y^T y - sum
    <S_i, F_i(theta)>; a slope e of this in theta costs |e|^T bound. y is corrected, in
    extended precision, until that cost no longer matters. Rounding is bounded and
    subtracted.

    Parameters
    ----------
    evidence : DualEvidence
        Multipliers near their cones, and y near the residual.

    Returns
    -------
    float
        -inf if the slopes of the prior are not positive definite.
    """
    try:
        slope, constant = _affine_minorant(problem, evidence)
    except np.linalg.LinAlgError:
        return -np.inf
    y, leftover = _corrected_y(problem, evidence, slope[0])
    data = problem.least_squares
    rho = np.asarray(data.rho, Long)
    limit = np.asarray(problem.bound, Long)
    floor = Long(data.residual_norm) ** 2
    # Sums of absolute values times gamma bound the rounding of the sums.
    operations = len(evidence.y) + len(problem.constraints.entries.constant)
    if problem.entropy is not None:
        operations += len(problem.entropy.entries.constant)
    gamma = _gamma(operations)
    absolute_slope = 2 * (np.abs(data.R).T @ np.abs(np.asarray(y, float)))
    largest_leftover = np.abs(leftover) + gamma * (slope[1] + absolute_slope) + _TINY
    cost = largest_leftover @ limit
    absolute_sum = constant[1] + floor + 2 * np.abs(y) @ np.abs(rho) + y @ y + cost
    computed = constant[0] + floor - 2 * (y @ rho) - y @ y - cost
    lowest = computed - gamma * absolute_sum - _TINY
    double = float(lowest)  # rounded down, in case the conversion rounded up
    return double if double <= lowest else float(np.nextafter(double, -np.inf))


def _corrected_y(
    problem: ConvexProblem, evidence: DualEvidence, slope: Extended
) -> tuple[Extended, Extended]:
    """Return y (r,) shifted until the leftover slope (p,) = ``slope`` + 2 R^T y costs
    little, and this leftover, both in extended precision.

    y is corrected first in doubles, then in extended precision.
    """
    data = problem.least_squares
    bound = problem.bound
    push = evidence.push
    first_slope = np.asarray(slope, float) + 2.0 * (evidence.y @ data.R)
    first_y = evidence.y - push(bound * first_slope)
    R = np.asarray(data.R, Long)
    limit = np.asarray(bound, Long)
    floor = Long(data.residual_norm) ** 2
    y = np.asarray(first_y, Long)
    leftover = slope + 2 * (y @ R)
    for _ in range(CORRECTIONS):
        scaled_leftover = np.asarray(limit * leftover, float)
        loss = float(y @ y + floor)
        if np.abs(scaled_leftover).sum() <= 1e-3 * TIGHT * loss:
            break
        y = y - push(scaled_leftover)
        leftover = slope + 2 * (y @ R)
    return y, leftover


#: Gap relative to the loss that is promised: an answer within it is kept at once, a
#: bound within half of it is not made tighter, and a leftover slope that costs a
#: thousandth of it is left.
TIGHT = 1e-8
#: Corrections of y at most.
CORRECTIONS = 3


def proves_infeasible(nothing: ConvexProblem, multipliers: Array) -> bool:
    """Return whether multipliers prove that no |theta_k| <= bound_k satisfies all
    constraints of a problem without data.

    They do if the lower bound of the objective zero is positive (Farkas): no theta can
    have 0 <= sum <S_i, F_i(theta)> <= sum <S_i, F_i0> + |e|^T bound < 0.

    Parameters
    ----------
    multipliers : (e,)
        Multipliers of the constraints' entries.

    Returns
    -------
    bool
        True if infeasibility is proved.
    """
    return lower_bound(nothing, DualEvidence(multipliers, np.zeros(0))) > 0.0


def certainly_feasible(constraints: Sequence[Constraint], theta: Array) -> bool:
    """Return whether theta (p,) satisfies all constraints, decided in rational
    arithmetic.

    Constraints whose margin is far above rounding are decided in doubles.
    """
    cones = StackedCones.from_groups(group_cones(constraints))
    margin, size = cones.margins(theta)
    is_well_inside = margin > _WELL_INSIDE * size
    used_parameters = {int(k) for constraint in constraints for k in constraint.indices}
    exact = {k: Fraction(float(theta[k])) for k in used_parameters}
    near_boundary = [
        c for c, is_well in zip(constraints, is_well_inside, strict=True) if not is_well
    ]
    return all(
        verify_proof.inside(c.cone, _exact_value(c, exact)) for c in near_boundary
    )


def violations(constraints: ConstraintSet, theta: Array) -> dict[str, float]:
    """Return the largest violation of each family of constraints.

    Returns
    -------
    dict
        By the family's name, in its unit; zero if the violation is rounding of the
        evaluation.
    """
    largest = constraints.worst(theta)
    for family in [family for family, violation in largest.items() if violation > 0.0]:
        convex = [c for c in constraints.convex if c.family == family]
        if convex and certainly_feasible(convex, theta):
            largest[family] = 0.0
    return largest


#: A margin above this share of the constraint's terms is no matter of rounding, of
#: either kind.
_WELL_INSIDE = np.sqrt(np.finfo(float).eps)


def _exact_value(
    constraint: Constraint, theta: Mapping[int, Fraction]
) -> list[Fraction]:
    """Return the entries of F(theta) = F_0 + sum_k theta_k F_k as Fractions.

    ``theta`` maps indices of parameters to values. A matrix is made symmetric.
    """
    entries = [Fraction(float(x)) for x in constraint.constant.ravel()]
    for k, coefficient in zip(constraint.indices, constraint.coefficients, strict=True):
        flat = coefficient.ravel()
        for place in np.flatnonzero(flat):
            entries[place] += theta[int(k)] * Fraction(float(flat[place]))
    if constraint.cone != "psd":
        return entries
    d = len(constraint.constant)
    places = product(range(d), range(d))
    return [(entries[i * d + j] + entries[j * d + i]) / 2 for i, j in places]
