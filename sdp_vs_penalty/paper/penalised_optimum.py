"""The certified global optimum of the published penalised objective (Gaz et al., RA-L
2019, eq. 29).

For a weight xi the paper's retrieval minimises

    f(theta) + xi [ sum_i (lambda_max(I_i) - tr(I_i) / 2)+ + v_M(theta) + v_c(theta) ]

over links inside bounds on masses, centres of mass and signs: f the torque loss (one
step) or |pi(theta) - pi_hat|^2 (two steps), I_i a link's inertia about its centre of
mass, v_M what the total mass violates [kg], v_c what centres of mass violate of their
cones [m]. With the pseudo-inertia P(theta) = [[Sigma, m c], [(m c)^T, m]] and
D = diag(1, 1, 1, 0), the Schur complement of P + s D at m > 0 gives

    P + s D >= 0   <=>   (tr(I) / 2) 1 - I + s 1 >= 0   <=>   s >= lambda_max(I) - tr(I) / 2,

so that the triangle penalty is the least slack s >= 0 of a linear matrix inequality:

    minimise  f(theta) + xi (sum_i s_i + sum_k e_k + sum_j d_j / m_j)
    subject to  P_i(theta) + s_i D >= 0,  s_i >= 0,                i = 1..n
                total mass in [M - e, M + e],  e >= 0,
                (m_j c_j, m_j) in its cone, widened by d_j >= 0,   m_j <= its upper bound,
                masses, centres of mass and signs inside their bounds.

Everything is convex but d_j / m_j, for which d_j / (upper bound of m_j) is taken: a lower
bound, which is exact where no cone is violated (the Panda has none). The box on
barycentric inertias is left out; :mod:`penalised_box` brings it in.

Since P(theta) + s D = P(theta + 2 s j), j the three moments of inertia, the matrices are
posed in theta' = theta + 2 s j: they are the SDP's own P(theta') >= 0, and the slack
stands in the loss instead.

A multiplier Z_i of P_i >= 0 in the problem without slack says from which weight on the
penalty is exact: xi >= <Z_i, D> for each link, and xi at least the multipliers of the
total mass (Han, Mangasarian, Math. Programming 1979).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any, ClassVar

import numpy as np

from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimators.estimator import Task
from sdp_vs_penalty.estimators.lmi_sdp import interior_point
from sdp_vs_penalty.estimators.penalty_paper import PenalisedLoss, TriangleInequality
from sdp_vs_penalty.paper.memo import load_or_compute, source_version
from sdp_vs_penalty.regression.regression import LeastSquares
from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.constraint import Constraint, ConstraintSet, linear
from sdp_vs_penalty.solvers.convex_problem import ConvexProblem
from sdp_vs_penalty.solvers.fit import Fit, fit_by_small_cones
from sdp_vs_penalty.solvers.small_cones import SmallCones


@dataclass(frozen=True)
class PenalisedOptimum:
    """The relaxation's answer at one weight."""

    #: A demand is violated above this [kg m^2, kg, m].
    tolerance: ClassVar[float] = 1e-6

    #: (p,) standard parameters.
    theta: Array
    #: Weight xi of the penalty.
    weight: float
    #: The published objective at theta.
    value: float
    #: Certified bound of the relaxation, below every value.
    lower: float
    #: Loss f at theta.
    loss: float
    #: (n,) violation of each link's triangle inequality [kg m^2].
    triangle: Array
    #: Largest violation of all kinds [kg m^2, kg, m].
    worst: float
    #: What the gap is relative to: the objective; for an exact fit a trace of the data.
    scale: float
    #: Number of relaxations solved for it.
    n_cells: int = 1

    @property
    def gap(self) -> float:
        """Distance of the published objective from its certified bound, (value -
        lower) / scale.
        """
        return max(self.value - self.lower, 0.0) / self.scale

    @property
    def is_violated(self) -> bool:
        """Whether any external demand is violated by more than the tolerance."""
        return self.worst > self.tolerance

    @property
    def n_links_violated(self) -> int:
        """Number of links whose triangle inequality is violated by more than the
        tolerance.
        """
        return int(np.sum(self.triangle > self.tolerance))


class PenalisedProblem:
    """The published problem of a task for every weight.

    - ``data``: the loss f.
    - ``two_step``: whether f is the distance to the base parameters.

    Slacks stand behind theta: one a link, then one an entry of each soft demand.
    """

    #: What the penalty takes the place of; "trace" is a consequence of the box.
    soft_families = ("pseudo-inertia", "total mass", "centre of mass cone")
    #: The bound on moments about the frame is this many times what the box implies,
    #: where the box is left out.
    moment_margin = 10.0
    #: Of a link's ten parameters those of its moments of inertia.
    moments = (4, 6, 9)
    #: Up to this gap an optimum at a smaller weight is one at a larger weight as well.
    held_gap = 1e-6
    #: Where the slacks start, as a share of what they may be.
    slack_start = 0.1

    def __init__(
        self, task: Task, two_step: bool, target: LeastSquares | None = None
    ) -> None:
        """Sort the task's constraints into hard ones, and demands that the penalty
        replaces.

        Parameters
        ----------
        two_step : bool
            Whether the loss is the distance from the base parameters (two steps)
            instead of the torque error (one step).
        target : LeastSquares, optional
            Base parameters of two steps and their target; default: least squares'.
        """
        self.task = task
        self.two_step = two_step
        # Rows of the loss |R theta - rho|^2.
        self.data = task.data
        if two_step:
            self.data = target or _links_distance(task)
        self.p, self.n = len(task.bound), len(task.links)
        free = task.model.rigid_indices if two_step else np.arange(self.p)
        self.published = PenalisedLoss(task, self.data, free)
        # Hard constraints stay; demands are what the penalty pays for when violated.
        convex = task.constraints.convex
        self.hard = [
            c for c in convex if c.family not in (*self.soft_families, "trace")
        ]
        # Without these the set would be unbounded where the data do not see a moment.
        self.hard += [
            linear("moments", f"link {k}", indices, -np.eye(3), self.bound[indices])
            for k, indices in enumerate(task.links[:, list(self.moments)], start=1)
        ]
        self.demands = [c for c in convex if c.family in self.soft_families[1:]]
        # A point strictly inside all of them, from which solvers start.
        self.interior = interior_point(
            task, ConstraintSet((*self.hard, *self.consistency, *self.demands))
        )

    @cached_property
    def consistency(self) -> tuple[Constraint, ...]:
        """The constraint P_i(theta) >= 0 of each link, P_i its pseudo-inertia."""
        return self.task.pseudo_inertias

    @cached_property
    def bound(self) -> Array:
        """(p,) bounds |theta_k| <= bound.

        Those of second moments are moment_margin times as wide as the box on inertias
        implies, because this relaxation leaves that box out.
        """
        bound = self.task.bound.copy()
        bound[self.task.links[:, 4:]] *= self.moment_margin
        return bound

    @cached_property
    def links_slack(self) -> Array:
        """(p, n) derivative of theta' by each link's slack.

        A link may violate its triangle inequality by a slack s [kg m^2]: the
        relaxation's theta' = theta + 2 s j is consistent, where j has ones at the
        link's three moments of inertia.
        """
        change = np.zeros((self.p, self.n))
        for k, link in enumerate(self.task.links):
            change[link[list(self.moments)], k] = 2.0
        return change

    @cached_property
    def soft(self) -> tuple[Constraint, ...]:
        """The demands on total mass and centres of mass, each softened by slack
        variables.

        Variables are theta' (p), the links' slacks (n), then these slacks: one for each
        row, or one for a second-order cone.
        """
        softened = list[Constraint]()
        first = self.p + self.n
        for c in self.demands:
            size = len(c.constant)
            # A second-order cone gets one slack, which widens its first entry.
            n_slacks = 1 if c.cone == "soc" else size
            slacks = np.arange(first, first + n_slacks)
            first += n_slacks
            coefficients = np.concatenate([c.coefficients, np.eye(size)[:n_slacks]])
            indices = np.concatenate([c.indices, slacks])
            softened.append(replace(c, indices=indices, coefficients=coefficients))
        return tuple(softened)

    @cached_property
    def prices(self) -> Array:
        """(s,) cost of a unit of each slack, in units of the weight xi.

        A slack of a centre-of-mass cone [kg m] is divided by the largest mass, to be in
        metres as in the paper.
        """
        prices = [np.ones(self.n)]
        for c in self.demands:
            if c.cone == "soc":
                largest_mass = self.task.bound[c.indices[0]]
                prices.append(np.array([1.0 / largest_mass]))
            else:
                prices.append(np.ones(len(c.constant)))
        return np.concatenate(prices)

    def value(self, theta: Array, weight: float) -> float:
        """Return the published objective, f(theta) + xi times the violations.

        Returns
        -------
        float
            Without the box on barycentric inertias.
        """
        return self.data.loss(theta) + weight * self.published.penalty(self._p(theta))

    def violations(self, theta: Array) -> dict[str, float]:
        """Return the worst violation of each kind of demand that the penalty stands
        for.

        Returns
        -------
        dict of str to float
            By family [kg m^2, kg, m].
        """
        return self.published.violations(self._p(theta))

    def triangle(self, theta: Array) -> Array:
        """Return (n,) the violation of each link's triangle inequality, (lambda_max(I)
        - tr(I) / 2)+ [kg m^2].

        I is the inertia about the centre of mass.
        """
        demand = TriangleInequality(self.task.links, self.p)
        return np.maximum(-demand.margins(self._p(theta)), 0.0)

    def _p(self, theta: Array) -> Array:
        """Return theta (p,) with each link in barycentric parameters, as the paper's
        loss takes it.

        Those are mass, centre of mass, and inertia about it.
        """
        barycentric = theta.copy()
        links = theta[self.task.links]
        barycentric[self.task.links] = inertia.barycentric_from_standard(links)
        return barycentric

    def solve(self, weight: float) -> PenalisedOptimum:
        """Solve the relaxation of the penalised problem at one weight.

        Its variables are theta' = theta + 2 s j (j has ones at a link's moments of
        inertia) and slacks that cost xi each; it is convex.

        Returns
        -------
        PenalisedOptimum
            With its certified lower bound.
        """
        # A start with slacks inside their limits.
        limit = self.slack_limits(weight)
        slack = self.slack_start * np.minimum(limit, 1.0)
        start = np.append(self.interior + self.links_slack @ slack[: self.n], slack)
        bound = np.append(self.bound + self.links_slack @ limit[: self.n], limit)
        constraints = (*self.hard, *self.consistency, *self.soft, *self.between(limit))
        # Slacks cost xi times their prices; theta' costs nothing by itself.
        cost = np.append(np.zeros(self.p), weight * self.prices)
        demands = ConstraintSet(constraints)
        problem = ConvexProblem(self.in_slacks, demands, bound, linear=cost)
        solved = solve_once(problem, start)
        if solved is None:
            raise _not_inside()
        return self.optimum(self.theta(solved.theta), weight, max(solved.lower, 0.0))

    def solve_all(
        self,
        weights: Iterable[float],
        solve: Callable[[float], PenalisedOptimum] | None = None,
    ) -> list[PenalisedOptimum]:
        """Solve the relaxation, or what ``solve`` solves, at increasing weights.

        The objective increases with the weight. So the bound of a smaller weight still
        holds, and an optimum without violations stays the optimum; it is not computed
        again. The optimum at a smaller weight is a point at a larger one as well.
        """
        solve = solve or self.solve
        optima = list[PenalisedOptimum]()
        for weight in weights:
            if not optima:
                optima.append(solve(weight))
                continue
            before = optima[-1]
            held = replace(self.optimum(before.theta, weight, before.lower), n_cells=0)
            if held.gap > self.held_gap:
                solved = solve(weight)
                lower = max(solved.lower, before.lower)
                best = min(held, solved, key=lambda optimum: optimum.value)
                held = replace(best, lower=lower, n_cells=solved.n_cells)
            optima.append(held)
        return optima

    @cached_property
    def in_slacks(self) -> LeastSquares:
        """The loss |R theta - rho|^2 as a function of the relaxation's variables:
        theta' = theta + 2 s j (p), each link's slack s (n), and the slacks of the other
        demands, on which the loss does not depend."""
        of_demands = np.zeros((len(self.data.R), len(self.prices) - self.n))
        R = np.hstack([self.data.R, -self.data.R @ self.links_slack, of_demands])
        return replace(self.data, R=R)

    def theta(self, x: Array) -> Array:
        """Return the standard parameters theta (p,) that belong to the relaxation's
        variables x (p + s,): theta' = theta + 2 s j, then the slacks."""
        return x[: self.p] - self.links_slack @ x[self.p : self.p + self.n]

    def between(self, limit: Array) -> list[Constraint]:
        """Return the constraints 0 <= slack <= limit (s,)."""
        # Two rows for a slack s: 0 + s >= 0 and limit - s >= 0.
        return [
            linear("slack", f"{k}", [k], [[1.0, -1.0]], [0.0, largest])
            for k, largest in enumerate(limit, start=self.p)
        ]

    def slack_limits(self, weight: float) -> Array:
        """Return upper limits (s,) of the slacks [kg m^2, kg, m], which every optimum
        obeys.

        A slack above its limit would cost more than the interior point's objective, or
        would undo all that the bounds allow.
        """
        largest = np.full(len(self.prices), float(self.bound.max()))
        if weight == 0.0:
            return largest
        limit = self.value(self.interior, weight) / (weight * self.prices)
        return np.minimum(limit, largest)

    def optimum(self, theta: Array, weight: float, lower: float) -> PenalisedOptimum:
        """Return a point with its objective, loss and violations at a weight.

        Parameters
        ----------
        lower : float
            Certified lower bound of the objective.
        """
        value = self.value(theta, weight)
        return PenalisedOptimum(
            theta,
            weight,
            value=value,
            lower=lower,
            loss=self.data.loss(theta),
            triangle=self.triangle(theta),
            worst=max(self.violations(theta).values()),
            scale=max(value, self.data.loss_scale(theta)),
        )

    @cached_property
    def feasible(self) -> Fit:
        """The certified optimum of the loss subject to the demands themselves, without
        a penalty: the limit of infinite weight xi."""
        constraints = ConstraintSet((*self.hard, *self.consistency, *self.demands))
        problem = ConvexProblem(self.data, constraints, self.bound)
        return solve_certified(problem, self.interior)

    @property
    def exact_weight_by_theory(self) -> float:
        """The weight from which on the penalty is exact: the largest multiplier of a
        demand.

        Han, Mangasarian, Math. Programming 1979. For a link's matrix this is <Z, D>,
        the trace of the first three rows of its multiplier Z.
        """
        fit = self.feasible
        largest = 0.0
        assert fit.multipliers is not None
        constraints = fit.problem.constraints
        multipliers = constraints.entries.each(fit.multipliers)
        for c, multiplier in zip(constraints.convex, multipliers, strict=True):
            if c.cone == "psd":
                largest = max(largest, float(np.trace(multiplier[:3, :3])))
            elif c.family == "total mass":
                largest = max(largest, float(multiplier.max()))
            elif c.family == "centre of mass cone":
                price = self.task.bound[c.indices[0]]
                largest = max(largest, float(multiplier[0]) * price)
        return largest


def _links_distance(task: Task) -> LeastSquares:
    """Return |pi(theta) - pi_hat|^2 over the base parameters that depend on links.

    Friction stays as it was estimated in the first step.
    """
    distance = task.base_distance
    links = task.model.rigid_indices
    rows = np.any(task.base.rows[:, links] != 0.0, axis=1)
    target = distance.rho[rows]
    squares = float(target @ target)
    return LeastSquares(
        distance.R[rows],
        rho=target,
        residual_norm=0.0,
        tau_squared=squares,
        rows=len(target),
    )


def solve_certified(problem: ConvexProblem, start: Array) -> Fit:
    """Solve a convex problem without an entropic prior, with a certificate.

    The solver is our own interior-point method. Its dual multipliers prove a lower
    bound of the minimum.

    Returns
    -------
    Fit
        With dual multipliers, from which its lower bound is computed.

    Raises
    ------
    InputError
        If the start is not strictly feasible.
    """
    cones = SmallCones(None, problem.constraints, len(start))
    cones.linear = np.broadcast_to(problem.linear, start.shape)
    fit = fit_by_small_cones(problem, cones, [start], start, 1e-10)
    if fit is None:
        raise _not_inside()
    return fit


def _not_inside() -> InputError:
    """Return the error for an interior point that violates its constraints."""
    return InputError(
        "the penalised problem's interior point is not inside of its constraints",
        "check the bounds of the problem",
    )


@dataclass(frozen=True)
class CertifiedPoint:
    """Where a convex problem's solver ends: theta, and a certified bound from below."""

    theta: Array
    lower: float


def solve_once(problem: ConvexProblem, start: Array) -> CertifiedPoint | None:
    """Return the result of :func:`solve_certified`, read from the disk if it is there.

    Returns
    -------
    CertifiedPoint or None
        None if the start is not strictly feasible.
    """
    plain = load_or_compute(
        "penalised",
        (source_version(), problem, start),
        partial(_solved, problem, start),
    )
    return plain and CertifiedPoint(np.array(plain["theta"]), plain["lower"])


def _solved(problem: ConvexProblem, start: Array) -> dict[str, Any] | None:
    """Solve, and return theta and the certified bound as JSON; None if that fails."""
    try:
        fit = solve_certified(problem, start)
    except InputError:
        return None
    return {"theta": fit.theta, "lower": fit.lower}
