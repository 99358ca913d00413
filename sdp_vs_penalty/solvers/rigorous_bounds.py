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
from sdp_vs_penalty.solvers.objective import Entropy, Objective

#: Extended precision where the machine has it, plain doubles elsewhere; the error
#: bounds follow.
Long = np.longdouble
Extended = Any  # an array or a number of Long


def _gamma(operations: int) -> Extended:
    """gamma_k, four times: the rounding of the bound itself, and of a few operations
    more, is in it."""
    return 4 * (operations + 16) * Long(np.finfo(Long).eps)


#: What underflow can lose in one operation, where numbers have the exponents of
#: doubles.
_TINY = Long(np.finfo(float).tiny)


def in_cones(entries: StackedCones, multipliers: Array) -> tuple[Extended, Array]:
    """Multipliers that lie in their (self-dual) cones, near those given.

    Parameters
    ----------
    entries : StackedCones
        The cones.
    multipliers : (e,)
        Near them.

    Returns
    -------
    tuple
        (e,) the multipliers, and their sums' absolute values. A matrix is V
        V^T, formed with rounding; the others are exact.
    """
    size = np.maximum(multipliers, 0.0)
    exact = np.asarray(size, Long)
    parts = [entries.split(x) for x in (multipliers, exact, size)]
    groups_with_values = zip(entries.groups, *parts, strict=True)
    for group, raw, values, its_size in groups_with_values:
        if group.cone == "psd" and raw.any():
            values[:], its_size[:] = _square(
                factor(0.5 * (raw + np.swapaxes(raw, 1, 2)))
            )
        elif group.cone == "soc":
            values[:] = raw
            norm = (
                np.sqrt(np.sum(values[:, 1:] ** 2, axis=1))
                * (1 + _gamma(values.shape[1]))
                + _TINY
            )
            values[:, 0] = np.maximum(values[:, 0], norm)
            its_size[:] = np.abs(values)
    return exact, size


def _square(v: Array) -> tuple[Extended, Array]:
    """V V^T (g, d, d) and |V| |V|^T, whose own rounding gamma holds as well."""
    exact = np.asarray(v, Long)
    size = np.abs(v)
    return exact @ _transposed(exact), size @ _transposed(size)


def _transposed(matrices: Any) -> Any:
    """(g, d, d) each matrix transposed."""
    return np.swapaxes(matrices, 1, 2)


def _diagonals(matrices: Array) -> Array:
    """(g, d) of each matrix."""
    return np.diagonal(
        matrices,
        axis1=1,
        axis2=2,
    )


def factor(matrices: Array) -> Array:
    """V with V V^T near symmetric matrices, or near their projections where one is
    indefinite.

    Parameters
    ----------
    matrices : (g, d, d)
        Symmetric.

    Returns
    -------
    (g, d, d)
        Seen with a diagonal of size one: what is near does not depend on units.
    """
    out = np.zeros_like(matrices)
    used = matrices.any(axis=(1, 2))
    try:
        # Near entry by entry, in any system of units.
        out[used] = np.linalg.cholesky(matrices[used])
    except np.linalg.LinAlgError:
        size = np.sqrt(np.abs(_diagonals(matrices)))
        size = nonzero_or_one(size)[:, :, None]
        eigenvalues, vectors = np.linalg.eigh(matrices / size / _transposed(size))
        roots = np.sqrt(np.maximum(eigenvalues, 0.0))
        out = size * vectors * roots[:, None]
    return out


def _against(
    entries: StackedCones,
    dual: Extended,
    sizes: Array,
    p: int,
) -> tuple[Extended, Extended]:
    """(2, p) slope and (2,) constant of <S, F(theta)> over all constraints, and of
    absolute values; dual, sizes (e,)."""
    slope = np.zeros((2, p), Long)
    terms = entries.value * dual[entries.row]
    np.add.at(slope[0], entries.column, terms)
    sizes_of_terms = np.abs(entries.value) * sizes[entries.row]
    slope[1] = np.bincount(entries.column, sizes_of_terms, p)
    constant = entries.constant @ dual
    size = np.abs(entries.constant) @ sizes
    return slope, np.array([constant, size], Long)


def _entropy_tangent(
    entropy: Entropy,
    slopes: Array,
    p: int,
) -> tuple[Extended, Extended]:
    """The same of -log det P >= log det S + 4 - <S, P> for each link, with S = V V^T
    exactly."""
    symmetric = 0.5 * (slopes + _transposed(slopes))
    v = np.asarray(np.linalg.cholesky(symmetric), float)
    logs = np.log(np.asarray(_diagonals(v), Long))
    inverse, log_det = entropy.nominal_terms
    exact, size = _square(v)
    dual = (inverse - exact).ravel()
    sizes = (np.abs(inverse) + size).ravel()
    slope, constant = _against(
        entropy.entries,
        dual,
        sizes,
        p,
    )
    # A logarithm is right to a few units of its last place, or of one.
    more = 2 * logs.sum() + log_det.sum()
    size_of_more = 16 * np.sum(np.abs(logs) + 1) + np.abs(log_det).sum()
    weight = Long(entropy.weight)
    constant = constant + np.array([more, size_of_more], Long)
    return weight * slope, weight * constant


@dataclass(frozen=True)
class DualEvidence:
    """What a lower bound follows from, whoever adds it up: the numbers may be off, the
    bound holds.

    multipliers (e,) : of the constraints' entries, near their cones; y (r,) : near the
    residual at the optimum; entropy_slopes (links, 4, 4) : positive definite S, -log
    det P >= log det S + 4 - tr(S P); push : from a leftover slope (p,) times its limit
    to the shift of y (r,) that removes it, by default none.
    """

    multipliers: Array
    y: Array
    entropy_slopes: Array = field(default_factory=lambda: np.zeros((0, 4, 4)))
    push: Callable[[Array], Array] = lambda leftover: np.zeros(())


def lower_bound(
    objective: Objective,
    constraints: StackedCones,
    evidence: DualEvidence,
    bound: Array,
) -> float:
    """A number that is certainly at most the least objective over the constraints and
    |theta_k| <= bound_k.

    f(theta) >= residual_norm^2 + 2 y^T (R theta - rho) - y^T y - sum <S_i, F_i(theta)>
    for every y and all S_i in their cones; what is left of the slope, e, costs |e|^T
    bound. y is shifted, in extended precision from the second time on, until that no
    longer matters.

    Parameters
    ----------
    objective : Objective
        A sum of squares with a linear and an entropic term.
    constraints : StackedCones
        What theta has to satisfy.
    evidence : DualEvidence
        Multipliers near their cones, and y near the residual.
    bound : (p,)
        The largest plausible |theta_k|.

    Returns
    -------
    float
        -inf where slopes of the entropy are not definite.
    """
    data = objective.least_squares
    signs = np.array([-1, 1])
    dual, dual_sizes = in_cones(constraints, evidence.multipliers)
    slope, constant = _against(
        constraints,
        dual,
        dual_sizes,
        len(bound),
    )
    slope = signs[:, None] * slope
    constant = signs * constant
    linear = np.array(
        [
            objective.linear,
            np.abs(objective.linear),
        ]
    )
    slope += linear.reshape(2, -1)
    operations = len(evidence.y) + len(constraints.constant)
    if objective.entropy is not None:
        operations += len(objective.entropy.entries.constant)
        try:
            tangent = _entropy_tangent(
                objective.entropy,
                evidence.entropy_slopes,
                len(bound),
            )
        except np.linalg.LinAlgError:
            return -np.inf
        slope = slope + tangent[0]
        constant = constant + tangent[1]
    push = evidence.push
    left_near = np.asarray(slope[0], float) + 2.0 * (evidence.y @ data.R)
    near = evidence.y - push(bound * left_near)
    R = np.asarray(data.R, Long)
    rho = np.asarray(data.rho, Long)
    limit = np.asarray(bound, Long)
    y = np.asarray(near, Long)
    floor = Long(data.residual_norm) ** 2
    left = slope[0] + 2 * (y @ R)
    for _ in range(CORRECTIONS):
        leftover = np.asarray(limit * left, float)
        loss = float(y @ y + floor)
        if np.abs(leftover).sum() <= 1e-3 * TIGHT * loss:
            break
        y = y - push(leftover)
        left = slope[0] + 2 * (y @ R)
    gamma = _gamma(operations)
    # Whose own rounding gamma holds.
    sizes = 2 * (np.abs(data.R).T @ np.abs(np.asarray(y, float)))
    left_at_most = np.abs(left) + gamma * (slope[1] + sizes) + _TINY
    cost = left_at_most @ limit
    size = constant[1] + floor + 2 * np.abs(y) @ np.abs(rho) + y @ y + cost
    exact_bound = constant[0] + floor - 2 * (y @ rho) - y @ y - cost
    lowest = exact_bound - gamma * size - _TINY
    double = float(lowest)  # the largest that is not above it
    return double if double <= lowest else float(np.nextafter(double, -np.inf))


#: Gap relative to the loss that is promised: an answer within it is kept at once, a
#: bound within half of it is not made tighter, and a leftover slope that costs a
#: thousandth of it is left.
TIGHT = 1e-8
#: Corrections of y at most.
CORRECTIONS = 3


def proves_infeasible(
    constraints: ConstraintSet,
    multipliers: Array,
    bound: Array,
) -> bool:
    """Whether multipliers prove that no |theta_k| <= bound_k satisfies all
    constraints.

    It is the lower bound of the objective zero: positive exactly if the set is empty.

    Parameters
    ----------
    constraints : ConstraintSet
        What theta has to satisfy.
    multipliers : (e,)
        Of the constraints' entries.
    bound : (p,)
        The largest plausible |theta_k|.

    Returns
    -------
    bool
        By Farkas: 0 <= sum <S_i, F_i(theta)> <= sum <S_i, F_i0> + |e|^T bound <
        0 cannot be.
    """
    evidence = DualEvidence(multipliers, np.zeros(0))
    nothing = Objective.without_data(len(bound))
    lowest = lower_bound(
        nothing,
        constraints.entries,
        evidence,
        bound,
    )
    return lowest > 0.0


def certainly_feasible(constraints: Sequence[Constraint], theta: Array) -> bool:
    """Whether theta satisfies all constraints, decided in rational arithmetic.

    Parameters
    ----------
    constraints : sequence of Constraint
        What theta has to satisfy.
    theta : (p,)
        Parameters of the model.

    Returns
    -------
    bool
        No rounding is in it.
    """
    cones = StackedCones.from_groups(group_cones(constraints))
    margin, size = cones.margins(theta)
    is_well_inside = margin > _WELL_INSIDE * size
    used = {int(k) for constraint in constraints for k in constraint.indices}
    exact = {k: Fraction(float(theta[k])) for k in used}
    close = [
        c for c, is_well in zip(constraints, is_well_inside, strict=True) if not is_well
    ]
    return all(verify_proof.inside(c.cone, _exact_value(c, exact)) for c in close)


def violations(constraints: ConstraintSet, theta: Array) -> dict[str, float]:
    """The worst violation of each family.

    Parameters
    ----------
    constraints : ConstraintSet
        What theta has to satisfy.
    theta : (p,)
        Parameters of the model.

    Returns
    -------
    dict
        By the family's name; zero where only rounding in the evaluation sees
        one.
    """
    out = constraints.worst(theta)
    for family in [family for family, violation in out.items() if violation > 0.0]:
        convex = [c for c in constraints.convex if c.family == family]
        if convex and certainly_feasible(convex, theta):
            out[family] = 0.0
    return out


#: A margin above this share of the constraint's terms is no matter of rounding, of
#: either kind.
_WELL_INSIDE = np.sqrt(np.finfo(float).eps)


def _exact_value(
    constraint: Constraint, theta: Mapping[int, Fraction]
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
    places = product(range(d), range(d))
    return [(out[i * d + j] + out[j * d + i]) / 2 for i, j in places]
