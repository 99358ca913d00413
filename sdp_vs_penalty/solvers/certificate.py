"""Our own judgement of an estimate, independent of whoever computed it.

Primal side: the worst violation of every constraint family, those included that the method never
received. Dual side: for a convex objective f and any multipliers S_i in the (self-dual) cones,

    f(theta) >= l0 + l^T theta                               (a tangent of f)
             >= l0 - sum <S_i, F_i0> + e^T theta             (theta feasible, <S_i, F_i(theta)> >= 0)
             >= l0 - sum <S_i, F_i0> - |e|^T B,              e = l - sum F_i^*(S_i), |theta_k| <= B_k

so that any multipliers, projected onto their cones, give a lower bound on the optimum; good ones
give a tight one. Nothing a solver says about itself enters.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
import scipy.linalg
from numpy.typing import NDArray
from scipy import sparse
from scipy.linalg import lapack

from sdp_vs_penalty.regression.regression import LeastSquares
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.constraint import (
    Alike,
    Constraint,
    ConstraintSet,
    Entries,
    alike,
    cone_depths,
    project,
    safe_depth,
)
from sdp_vs_penalty.solvers import verified
from sdp_vs_penalty.solvers.objective import Objective


@dataclass(frozen=True)
class Push:
    """From a slope (p,) times its limit to the shift of y (r,) that makes it, to least squares.

    The basic solution of limit 2 R^T shift = slope by a QR with pivoted columns, of so many of them as
    ``triangle`` has (Golub, Van Loan, 5.5.6): half the time of that of least norm, which the bound does
    not need, and nothing but products with vectors afterwards.
    """

    reflectors: tuple[Array, Array]
    triangle: Array
    pivots: NDArray[np.intp]

    @classmethod
    def candidates(cls, matrix: Array, cuts: Sequence[float]) -> list[Push]:
        """One for each rank that leaves out directions below a cut of the strongest."""
        if not matrix.size:
            return [cls((np.zeros((0, 0)), np.zeros(0)), np.zeros((0, 0)), np.arange(matrix.shape[1]))]
        raw, r, pivots = scipy.linalg.qr(matrix, mode="raw", pivoting=True, check_finite=False)
        diagonal = np.abs(np.diagonal(r))
        ranks = {int(np.sum(diagonal > cut * diagonal.max())) for cut in cuts}
        return [cls(raw, r[:k, :k], pivots) for k in sorted(ranks, reverse=True)]

    def __call__(self, slope: Array) -> Array:
        (reflectors, tau), rank, shift = self.reflectors, len(self.triangle), np.zeros(len(self.pivots))
        if rank:
            turned = lapack.dormqr("L", "T", reflectors[:, : len(tau)], tau, slope[:, None], len(slope))[
                0
            ]
            shift[self.pivots[:rank]] = scipy.linalg.solve_triangular(
                self.triangle, turned[:rank, 0], check_finite=False
            )
        return shift


@dataclass(frozen=True)
class DualEvidence:
    """What a lower bound follows from, whoever adds it up: the numbers may be off, the bound holds.

    constraints : balanced, T F T; multipliers : near their cones; scales : the diagonal of each T,
    powers of two (None for a cone that is no matrix); y : near the residual at the optimum; push :
    from a leftover slope times its limit to the shift of y that removes it.
    """

    constraints: tuple[Constraint, ...]
    multipliers: tuple[Array, ...]
    scales: tuple[Array | None, ...]
    y: Array
    entropy_slopes: tuple[Array, ...]
    push: Push


def lower_bound(
    objective: Objective,
    constraints: ConstraintSet,
    multipliers: Sequence[Array],
    theta: Array,
    bound: Array,
    entropy_slopes: Array | None = None,
) -> float:
    """A rigorous lower bound on min objective over the constraints, from any multipliers.

    Proved with outward rounding (:mod:`verified`) from the multipliers as they are; unless that bound is
    tight, also from what plain floating point makes of them (:func:`dual_evidence`).
    """
    if objective.entropy is None or entropy_slopes is not None:
        with suppress(np.linalg.LinAlgError):  # slopes that are not definite
            lower = _as_given(objective, constraints, multipliers, theta, bound, entropy_slopes)
            if objective.least_squares.gap(objective.value(theta), lower, theta) <= _TIGHT:
                return lower
    e = dual_evidence(objective, constraints, multipliers, theta, bound, entropy_slopes)
    entries = Entries.of(alike(e.constraints))
    slopes, proven = e.entropy_slopes, -np.inf
    with suppress(np.linalg.LinAlgError):  # slopes that rounding leaves indefinite prove nothing
        proven = verified.lower_bound(objective, entries, e.multipliers, e.y, bound, slopes, e.push)
    return proven


def _as_given(
    objective: Objective,
    constraints: ConstraintSet,
    multipliers: Sequence[Array],
    theta: Array,
    bound: Array,
    entropy_slopes: Array | None,
) -> float:
    """The bound from multipliers as they are; what rounding in theta leaves of the slope goes into y."""
    data = objective.least_squares
    y = data.R.astype(verified.Long) @ theta - data.rho
    columns = data.R * bound
    gram = 2.0 * (columns.T @ columns)
    gram[np.diag_indices_from(gram)] += _RIDGE * np.trace(gram) + 1e-300
    factor = scipy.linalg.cho_factor(gram, lower=True, overwrite_a=True, check_finite=False)

    def push(slope: Array) -> Array:
        return np.asarray(columns @ scipy.linalg.cho_solve(factor, slope, check_finite=False))

    slopes = () if entropy_slopes is None else tuple(entropy_slopes)
    return verified.lower_bound(objective, constraints.entries, multipliers, y, bound, slopes, push)


#: Directions whose share of the data is below this are left alone where a slope is pushed into y.
_RIDGE = 1e-9
#: Gap relative to the loss, half of what is promised, from which on a tighter bound is of no use.
_TIGHT = 5e-9


def dual_evidence(
    objective: Objective,
    constraints: ConstraintSet,
    multipliers: Sequence[Array],
    theta: Array,
    bound: Array,
    entropy_slopes: Array | None = None,
) -> DualEvidence:
    """Multipliers, polished so that little of the slope is left, and the tangent that they go with.

    theta : where the objective is linearised (the closer to the optimum, the tighter the bound);
    bound : (p,) |theta_k| <= bound_k for every feasible theta;
    entropy_slopes : (links, 4, 4) positive definite S with which -log det P >= log det S + 4 -
        tr(S P) is used; P(theta)^-1 by default, the dual's own S where a solver gives it.
    """
    groups = [
        _balanced(group, np.array([multipliers[k] for k in group.places]), bound)
        for group in alike(constraints.convex)
    ]
    dual = [project(group.cone, scaled) for group, scaled, _ in groups]
    balanced = list(constraints.convex)
    scales: list[Array | None] = [None] * len(balanced)
    for group, _, t in groups:
        for i, k in enumerate(group.places):
            own = {"constant": group.constant[i], "coefficients": group.coefficients[i]}
            balanced[k] = replace(balanced[k], **own)
            scales[k] = None if t is None else t[i]
    spread = _spread([group for group, _, _ in groups])
    order = np.concatenate([np.arange(0), *(group.places for group, _, _ in groups)])
    rows = Entries.of([group for group, _, _ in groups])
    adjoint = sparse.csr_matrix((rows.value, (rows.column, rows.row)), (len(bound), len(rows.constant)))
    tangents = _Tangent.candidates(objective, theta, bound, entropy_slopes)
    tangent = (
        max(tangents, key=lambda t: t.bound(rows.constant, adjoint, dual)[0])
        if len(tangents) > 1
        else tangents[0]
    )
    best, kept = -np.inf, list(dual)
    for _ in range(_DUAL_ROUNDS):
        value, leftover = tangent.bound(rows.constant, adjoint, dual)
        gained = value - best
        if gained > 0.0:
            best, kept = value, list(dual)
        if gained <= _WORTHWHILE * float(np.abs(leftover) @ bound):
            break
        # What is left of the slope goes into the multipliers of each link's 4x4 matrix, which can
        # hold any of it; projecting them back onto the cone leaves less.
        for k, (members, indices, inverse) in spread.items():
            correction = np.einsum("gk,gkab->gab", leftover[indices], inverse)
            dual[k] = dual[k].copy()
            dual[k][members] = project("psd", dual[k][members] + correction)
    places = np.argsort(order).tolist()
    flat = [multiplier for group in kept for multiplier in group]
    return DualEvidence(
        tuple(balanced),
        tuple(flat[k] for k in places),
        tuple(scales),
        tangent.y,
        tangent.entropy_slopes,
        tangent.push,
    )


def _balanced(group: Alike, multipliers: Array, bound: Array) -> tuple[Alike, Array, Array | None]:
    """T F T, T^-1 S T^-1 and the diagonal (g, d) of T: each F with a diagonal of size one.

    Otherwise what is near depends on units. T holds powers of two: no rounding changes the constraint.
    """
    if group.cone != "psd":
        return group, multipliers, None
    terms = np.abs(np.diagonal(group.coefficients, axis1=2, axis2=3))
    size = (bound[group.indices][:, None] @ terms)[:, 0]
    size += np.abs(np.diagonal(group.constant, axis1=1, axis2=2))
    t = 2.0 ** -np.round(0.5 * np.log2(np.where(size > 0.0, size, 1.0)))
    both = t[:, :, None] * t[:, None]
    constant, coefficients = group.constant * both, group.coefficients * both[:, None]
    return replace(group, constant=constant, coefficients=coefficients), multipliers / both, t


#: Most rounds of pushing the dual's residual into the multipliers; each gives a valid bound, and one
#: that gains less than this share of what the residual costs is the last.
_DUAL_ROUNDS, _WORTHWHILE = 50, 0.02


#: Directions of data below this share of the strongest are not used to take up what is left of the
#: slope: two columns that differ by a billionth would ask for a shift of y that costs more.
_CUTS = (1e-12, 1e-8)


@dataclass(frozen=True)
class _Tangent:
    """A lower bound of the objective that is affine in theta once y is chosen.

    f(theta) >= constant + slope^T theta + 2 y^T (R theta - rho) - y^T y for every y.
    """

    constant: float
    slope: Array
    data: LeastSquares
    y: Array
    limit: Array  # (p,) |theta_k| <= limit_k
    entropy_slopes: tuple[Array, ...]
    push: Push

    @classmethod
    def candidates(
        cls, objective: Objective, theta: Array, limit: Array, entropy_slopes: Array | None
    ) -> list[_Tangent]:
        """One for each of ``_CUTS`` that makes a difference."""
        data = objective.least_squares
        constant, slope = data.residual_norm**2, np.zeros(len(theta))
        used: list[Array] = []
        if objective.entropy is not None:
            entropy = objective.entropy
            inverse = np.linalg.inv(np.array([link.value(theta) for link in entropy.links]))
            s = inverse if entropy_slopes is None else np.asarray(entropy_slopes)
            definite = np.linalg.eigvalsh(s)[:, 0] > 0.0
            s = np.where(definite[:, None, None], s, inverse)
            used = list(s)
            # -log det P + tr(P0^-1 P) + log det P0 - 4 >= log det (S P0) + tr((P0^-1 - S) P)
            constant += entropy.weight * float(np.linalg.slogdet(s @ entropy.nominal)[1].sum())
            difference = entropy.weight * (np.linalg.inv(entropy.nominal) - s)
            for link, part in zip(entropy.links, difference, strict=True):
                slope[link.indices] += link.adjoint(part)
                constant += float(np.sum(part * link.constant))
        y = data.R @ theta - data.rho
        pushes = Push.candidates(limit[:, None] * (2.0 * data.R.T), _CUTS)
        return [cls(constant, slope, data, y, limit, tuple(used), push) for push in pushes]

    @cached_property
    def _pull(self) -> Array:
        return 2.0 * self.data.R.T

    def bound(
        self, constant: Array, adjoint: sparse.csr_matrix, dual: Sequence[Array]
    ) -> tuple[float, Array]:
        """The bound for multipliers inside their cones, and the slope (p,) that they leave over."""
        flat = np.concatenate([np.zeros(0), *(multiplier.ravel() for multiplier in dual)])
        slope = self.slope - adjoint @ flat
        lower = self.constant - float(constant @ flat)
        # Shift y so that what is left of the slope vanishes wherever the data determine theta.
        y = self.y - self.push(self.limit * (slope + self._pull @ self.y))
        leftover = slope + self._pull @ y
        lower += -2.0 * float(y @ self.data.rho) - float(y @ y)
        return lower - float(np.abs(leftover) @ self.limit), leftover


@lru_cache(maxsize=1024)
def inverse_map(coefficients: bytes) -> Array:
    """(10, 4, 4) from coefficients (10, 4, 4): the pseudo-inverse, which few kinds of demand share."""
    flat = np.frombuffer(coefficients).reshape(10, 16)
    return np.ascontiguousarray(np.linalg.pinv(flat).T, float).reshape(10, 4, 4)


def _spread(groups: Sequence[Alike]) -> dict[int, tuple[list[int], NDArray[np.intp], Array]]:
    """For one 4x4 constraint a link the map (10, 4, 4) from a slope e to E with <F_i, E> = e_i: by its
    group which members these are, their parameters, and the maps."""
    for k, group in enumerate(groups):
        if group.cone == "psd" and group.coefficients.shape[1:] == (10, 4, 4):
            # The last demand on a link (its minimum thickness) is the one that is active.
            members = sorted({int(first): i for i, first in enumerate(group.indices[:, 0])}.values())
            maps = [inverse_map(np.ascontiguousarray(group.coefficients[i]).tobytes()) for i in members]
            return {k: (members, group.indices[members], np.array(maps))}
    return {}


def repair(constraints: ConstraintSet, theta: Array, interior: Array) -> Array:
    """The first feasible point on the way from theta to an interior point; theta itself if feasible.

    Feasible by more than rounding (:func:`safe_depth`): the certificate, which forms F(theta) in
    another order, finds no violation. An interior point that is no deeper is what comes out.
    """
    ways = []
    for stack in constraints.groups:
        value, terms = stack.values(theta), stack.terms(theta)
        ahead, above = stack.values(interior) - value, stack.terms(interior) - terms
        ways.append((stack, value, ahead, terms, above))

    def feasible(step: float) -> bool:
        # The terms of a point between two others are at most those in between.
        return all(
            cone_depths(stack.cone, value + step * ahead, terms + step * above).min()
            >= safe_depth(stack.constant.shape[1])
            for stack, value, ahead, terms, above in ways
        )

    if feasible(0.0):
        return theta
    # Convex: feasible steps are an interval that ends at 1. Search its start by its exponent first,
    # because a solver's violation asks for a tiny step.
    high = 1e-14
    while not feasible(high):
        high *= 10.0
        if high > 1.0:
            high = 1.0
            break
    low = high / 10.0
    for _ in range(30):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if feasible(middle) else (middle, high)
    return theta + high * (interior - theta)
