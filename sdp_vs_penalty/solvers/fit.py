"""Our own judgement of an estimate, independent of whoever computed it.

Primal side: the worst violation of every constraint family, those included that the
method never received. Dual side: for a convex objective f and any multipliers S_i in
the (self-dual) cones,

    f(theta) >= l0 + l^T theta                               (a tangent of f)
             >= l0 - sum <S_i, F_i0> + e^T theta             (theta feasible, <S_i, F_i(theta)> >= 0)
             >= l0 - sum <S_i, F_i0> - |e|^T B,              e = l - sum F_i^*(S_i), |theta_k| <= B_k

so that any multipliers, projected onto their cones, give a lower bound on the optimum;
good ones give a tight one. Nothing a solver says about itself enters.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
import scipy

from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.constraint import ConeGroup, ConstraintSet, project
from sdp_vs_penalty.solvers.convex_problem import ConvexProblem, Entropy
from sdp_vs_penalty.solvers.identification import unit_diagonal_factors
from sdp_vs_penalty.solvers.primal_dual import Iterate, minimise
from sdp_vs_penalty.solvers.rigorous_bounds import TIGHT, DualEvidence, lower_bound
from sdp_vs_penalty.solvers.small_cones import SmallCones


@dataclass(frozen=True)
class Fit:
    """A method's answer; for convex problems also what the certificate needs to bound
    the optimum."""

    #: (p,) parameters.
    theta: Array
    #: What was minimised, over which theta.
    problem: ConvexProblem
    #: (e,) multipliers of the constraints' entries, near their cones.
    multipliers: Array | None = None
    #: (links, 4, 4) the dual's own S for P(theta)^-1, where a solver gives it.
    entropy_slopes: Array | None = None
    #: (p,) a point strictly inside the convex constraints.
    interior: Array | None = None
    #: What else the method reports, plain JSON.
    details: dict[str, Any] = field(default_factory=dict)
    #: An iterate from which to start for similar data.
    central: Iterate | None = None

    @cached_property
    def upper(self) -> float:
        """Objective at theta, an upper bound of the optimum."""
        return self.problem.value(self.theta)

    @cached_property
    def lower(self) -> float:
        """Rigorous lower bound of the optimal objective, valid for any multipliers.

        The quick bound uses the solver's multipliers as they are. If the gap of theta
        to it exceeds half of TIGHT (the gap that counts as certified), a second bound
        with polished multipliers is computed, and the larger one returned.
        """
        problem = self.problem
        lower = lower_bound(problem, dual_evidence(self, polished=False))
        if problem.least_squares.gap(self.upper, lower, self.theta) <= 0.5 * TIGHT:
            return lower
        return max(lower, lower_bound(problem, dual_evidence(self)))

    @cached_property
    def gap(self) -> float:
        """Objective at theta minus the lower bound of the optimum, relative to the
        loss.
        """
        return self.problem.least_squares.gap(self.upper, self.lower, self.theta)


def with_best_dual(fit: Fit, others: Sequence[Fit]) -> Fit:
    """Return a fit with those multipliers that prove most of it: its own or those of
    other answers to the same problem, since a bound holds whoever found it."""
    candidates = [fit]
    for other in others:
        if other is not fit:
            dual = other.multipliers, other.entropy_slopes
            candidates.append(replace(fit, multipliers=dual[0], entropy_slopes=dual[1]))
    return max(candidates, key=lambda candidate: candidate.lower)


def fit_by_small_cones(
    problem: ConvexProblem,
    cones: SmallCones,
    starts: Sequence[Array | Iterate],
    interior: Array,
    accuracy: float,
) -> Fit | None:
    """Solve a problem by our own interior-point method, from the first start that lies
    inside of its cones; None if there is none.

    Parameters
    ----------
    interior : (p,)
        A point strictly inside the constraints, towards which theta is repaired.
    accuracy : float
        Largest cost of gap and dual residual, as a share of the loss.
    """
    solved = minimise(cones, problem.least_squares, starts, accuracy)
    if solved is None:
        return None
    multipliers, slopes = cones.multipliers(solved.multipliers)
    status = f"relative gap {solved.error:.1e} ({solved.iterations})"
    return Fit(
        repair(problem.constraints, solved.theta, interior),
        problem,
        multipliers,
        slopes,
        interior,
        details={"solver": "primal-dual", "solver_said": [status]},
        central=solved.central,
    )


def dual_evidence(fit: Fit, polished: bool = True) -> DualEvidence:
    """Collect what a lower bound of the objective |R theta - rho|^2 + ... follows from.

    Parameters
    ----------
    polished : bool
        Improve the multipliers until little of the dual slope is left (the gradient of
        the Lagrangian by theta, zero for exact multipliers).

    Returns
    -------
    DualEvidence
        Multipliers, residual y = R theta - rho (r,), matrices of the prior's gradient
        (links, 4, 4), and the map from a dual slope (p,) to a shift of y (r,).
    """
    assert fit.multipliers is not None
    problem = fit.problem
    theta = fit.theta
    bound = problem.bound
    data = problem.least_squares
    slopes = fit.entropy_slopes
    if problem.entropy is not None and (polished or slopes is None):
        slopes = _definite_slopes(problem.entropy, slopes, theta)
    # Cholesky factor of R^T R in units of the bounds; a ridge keeps it definite.
    gram = bound[:, None] * data.curvature * bound
    without_data = float(not gram.any())  # 1: any ridge will do
    ridge = _RIDGE * np.trace(gram) + without_data
    gram[np.diag_indices_from(gram)] += ridge
    # LAPACK itself: SciPy's wrappers take as long again.
    cholesky, failed = scipy.linalg.lapack.dpotrf(gram, lower=1, clean=0)
    if failed:
        raise np.linalg.LinAlgError

    def push(slope: Array) -> Array:
        """Return the shift of y (r,) that removes a dual slope (p,), which is scaled by
        bound.
        """
        step, _ = scipy.linalg.lapack.dpotrs(cholesky, slope, lower=1)
        return data.R @ (bound * step)

    evidence = DualEvidence(
        multipliers=fit.multipliers,
        y=data.R @ theta - data.rho,
        entropy_slopes=np.zeros((0, 4, 4)) if slopes is None else slopes,
        push=push,
    )
    if not polished:
        return evidence
    return _polished(evidence, problem)


def _definite_slopes(prior: Entropy, slopes: Array | None, theta: Array) -> Array:
    """Return the matrices (links, 4, 4) of the prior's gradient; P(theta)^-1 stands in for
    those that are missing or not positive definite."""
    if slopes is None:
        slopes = np.zeros_like(prior.nominal)
    is_definite = np.linalg.eigvalsh(slopes)[:, 0] > 0.0
    if is_definite.all():
        return slopes
    links = np.array([link.value(theta) for link in prior.links])
    return np.where(is_definite[:, None, None], slopes, np.linalg.inv(links))


def _polished(evidence: DualEvidence, problem: ConvexProblem) -> DualEvidence:
    """Return evidence whose multipliers leave less of the dual slope.

    The dual slope (p,) is the gradient of the Lagrangian by theta; what is left of it
    lowers the bound. A round has three steps:
    1. project the multipliers onto their cones;
    2. shift y (the dual variable of the residual), which removes the slope in all
       directions that the data determine;
    3. put the remaining slope into the multiplier of each link's last 4x4 constraint,
       which can hold any slope of that link's ten parameters.
    Rounds go on as long as one improves the lower bound by _WORTHWHILE of what the
    remaining slope costs.
    """
    data = problem.least_squares
    entries = problem.constraints.entries
    bound = problem.bound
    objective_slope = _objective_slope(evidence, problem)
    slope_per_y = 2.0 * data.R.T
    push = _slope_remover(data.R * bound)
    # Scale each matrix F to T F T with a unit diagonal: else the projection would
    # depend on units.
    terms = zip(entries.groups, entries.split(entries.at(bound)[1]), strict=True)
    scales = [
        unit_diagonal_factors(x) if g.cone == "psd" else np.ones_like(g.constant)
        for g, x in terms
    ]
    duals = entries.split(evidence.multipliers)
    best_multipliers = evidence.multipliers
    # Without a matrix that holds a link's slope, a second round would be the first again.
    holds_links = any(_is_of_link(g) for g in entries.groups)
    best = -np.inf  # the largest lower bound so far, up to a constant
    for _ in range(_DUAL_ROUNDS):
        # 1. Project the multipliers onto their cones.
        duals = [
            scale * project(group.cone, dual / scale)
            for group, dual, scale in zip(entries.groups, duals, scales, strict=True)
        ]
        multipliers = np.concatenate([np.zeros(0), *(x.ravel() for x in duals)])
        # 2. Remove by y what the data determine; twice, for rounding.
        slope = objective_slope - entries.adjoint(multipliers, len(bound))
        y = evidence.y
        for _ in range(2):
            y = y - push(bound * (slope + slope_per_y @ y))
        leftover = slope + slope_per_y @ y
        cost = float(np.abs(leftover) @ bound)
        lower = (
            -float(entries.constant @ multipliers)
            - 2.0 * float(y @ data.rho)
            - float(y @ y)
            - cost
        )
        gain = lower - best
        if gain > 0.0:
            best = lower
            best_multipliers = multipliers
        if gain <= _WORTHWHILE * cost or not holds_links:
            break
        # 3. Put the slope that is left into the multipliers of the links' matrices.
        for k, (group, scale) in enumerate(zip(entries.groups, scales, strict=True)):
            if _is_of_link(group):
                per_slope = _multipliers_per_slope(group, scale)
                added = np.einsum("gk,gkab->gab", leftover[group.indices], per_slope)
                duals[k] = duals[k] + scale * added
    return replace(evidence, multipliers=best_multipliers, push=push)


def _objective_slope(evidence: DualEvidence, problem: ConvexProblem) -> Array | float:
    """Return the gradient (p,) of the objective without its squares: of its linear
    terms, and of the tangent of the entropic prior."""
    if problem.entropy is None:
        return problem.linear
    prior = problem.entropy
    pulls = prior.weight * (prior.nominal_terms[0] - evidence.entropy_slopes)
    return problem.linear + prior.entries.adjoint(pulls.ravel(), len(problem.bound))


def _slope_remover(scaled_R: Array) -> Callable[[Array], Array]:
    """Return the function from a dual slope (p,), scaled by the parameters' bounds as the
    columns of R are, to the shift of y (r,) that removes it in all directions that the
    data determine."""
    u, strength, vt = np.linalg.svd(scaled_R, full_matrices=False)
    is_active = strength > _CUT * strength.max(initial=0.0)

    def push(slope: Array) -> Array:
        in_directions = vt[is_active] @ slope
        return u[:, is_active] @ (in_directions / (2.0 * strength[is_active]))

    return push


def _is_of_link(group: ConeGroup) -> bool:
    """Return whether a group holds 4x4 matrices of a link's ten parameters."""
    return group.coefficients.shape[1:] == (10, 4, 4)


def _multipliers_per_slope(group: ConeGroup, scale: Array) -> Array:
    """Return (g, 10, 4, 4) matrices E_k that turn a slope of a link into a multiplier.

    A constraint on a link is F_0 + sum_i theta_i F_i >= 0 (4x4), scaled entry by entry
    as T F T by ``scale`` (g, 4, 4). A slope e (10,) of the link's parameters is removed
    by the multiplier E = sum_k e_k E_k, since <T F_i T, E> = e_i. Only the last
    constraint on each link gets one (its minimum thickness, which is active); the others
    are zero.
    """
    # Pseudo-inverse of the ten flat matrices T F_i T (10, 16) of each constraint.
    flat = (group.coefficients * scale[:, None]).reshape(-1, 10, 16)
    matrices = np.swapaxes(np.linalg.pinv(flat), 1, 2).reshape(-1, 10, 4, 4)
    # A link is known by the index of its first parameter; later constraints overwrite.
    last_of_link = {int(first): k for k, first in enumerate(group.indices[:, 0])}
    others = np.setdiff1d(np.arange(len(matrices)), list(last_of_link.values()))
    matrices[others] = 0.0
    return np.asarray(matrices)


#: Directions below this share of the data's energy, or of the strongest, are left alone
#: where a slope is pushed into y: by a Cholesky factor first, which is quick, by
#: singular values then.
_RIDGE = 1e-9
_CUT = 1e-8
#: Most rounds of pushing the leftover slope into the multipliers, and the share of what
#: it costs that a round has to gain.
_DUAL_ROUNDS = 50
_WORTHWHILE = 0.02


def repair(constraints: ConstraintSet, theta: Array, interior: Array) -> Array:
    """Return the first feasible point on the way from a nearly feasible theta (p,) to
    an interior point.

    Parameters
    ----------
    interior : (p,)
        A point inside all constraints.

    Returns
    -------
    (p,)
        theta itself if it is feasible. Feasible means by more than rounding
        (:func:`safe_depth`), so that the certificate, which forms F(theta) in another
        order, finds no violation; if the interior point is no deeper, it is returned.
    """

    def feasible(step: float) -> bool:
        """Return whether the point at a share ``step`` of the way is feasible beyond
        rounding.
        """
        return constraints.is_safely_inside(theta + step * (interior - theta))

    if feasible(0.0):
        return theta
    # Convex: feasible steps are an interval that ends at 1. A solver's violation needs
    # a tiny step, so that the decimal logarithm of the step is bisected.
    too_short = -14.0
    long_enough = 0.0
    while 10.0**long_enough - 10.0**too_short > max(1e-6 * 10.0**long_enough, 1e-14):
        middle = 0.5 * (too_short + long_enough)
        if feasible(10.0**middle):
            long_enough = middle
        else:
            too_short = middle
    return theta + 10.0**long_enough * (interior - theta)
