"""Penalty-based retrieval at its strongest: an exact penalty, from several seeded starts.

It receives the SDP's convex constraints as the same arrays, and the barycentric bounds that are not
convex as they are. For constraints F_i(x) in cones K_i (self-dual), weight w and shifts S_i,

    L(x; S, w) = f(x) + 1 / (2 w) sum_i (|Pi_K(S_i - w F_i(x))|^2 - |S_i|^2)

is smooth; S <- Pi_K(S - w F(x)) after each minimisation makes the minimiser feasible at a finite w, and
S tends to the multipliers, from which the certificate bounds the optimum (Powell 1969, Hestenes 1969,
Rockafellar 1974: the augmented Lagrangian). The weight grows tenfold while the violation does not fall
to a quarter. Each minimisation is a damped semismooth Newton method (Zhao, Sun, Toh, SIAM J. Optim.
2010): the curvatures of loss and penalty differ by ten orders of magnitude.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import scipy.linalg

from sdp_vs_penalty.estimators.barycentric import BarycentricPart, barycentric_box
from sdp_vs_penalty.estimators.estimator import Estimator, Fit, Task, with_joint_prior
from sdp_vs_penalty.estimators.lmi_sdp import LmiSdpThickness
from sdp_vs_penalty.estimators.sdp_fit import interior_point
from sdp_vs_penalty.regression.regression import LeastSquares
from sdp_vs_penalty.robot.arrays import Array, or_one
from sdp_vs_penalty.robot.constraint import (
    Alike,
    Constraint,
    ConstraintSet,
    project,
    projection_curvature,
)
from sdp_vs_penalty.solvers.certificate import repair
from sdp_vs_penalty.solvers.objective import Objective

#: The first weight, in units of (scaled loss) / (scaled distance)^2, and the largest.
_FIRST_WEIGHT, _LARGEST_WEIGHT = 0.1, 1e10
#: Stages, and Newton steps of each, at most. One that is cut short lets the weight grow too
#: early: with 60, runs on columns that torque hardly tells apart (rotors, links) ended .8 % too high.
_STEPS = 300


@dataclass(frozen=True)
class AffinePart:
    """F(x) = constant + matrix x, a group of equal cones in scaled variables."""

    cone: str
    shape: tuple[int, ...]
    constant: Array  # (rows,)
    matrix: Array  # (rows, p)
    scale: Array  # (g, ...): F here is scale * F of the stack, entry by entry

    @classmethod
    def of(cls, stack: Alike, theta_scale: Array, reference: Array) -> AffinePart:
        """Scaled so that every cone has about unit size at the reference: the set stays the same."""
        at = stack.values(reference)
        matrix = np.zeros((len(stack.matrix), len(theta_scale)))
        matrix[:, : stack.matrix.shape[1]] = stack.matrix
        matrix *= theta_scale
        if stack.cone == "psd":
            root = 1.0 / np.sqrt(or_one(np.abs(np.diagonal(at, axis1=1, axis2=2))))
            scale = root[:, :, None] * root[:, None, :]
        else:
            size = np.abs(matrix).max(axis=1) + np.abs(stack.constant.ravel())
            scale = 1.0 / or_one(size).reshape(at.shape)
            if stack.cone == "soc":
                scale = np.broadcast_to(scale.min(axis=1, keepdims=True), scale.shape)
        flat = scale.ravel()
        return cls(stack.cone, at.shape, stack.constant.ravel() * flat, matrix * flat[:, None], scale)

    def values(self, x: Array) -> Array:
        """F(x), (g, ...)."""
        return (self.constant + self.matrix @ x).reshape(self.shape)

    def jacobian(self, x: Array) -> Array:
        """dF/dx, (rows, p), rows in the order of F.ravel()."""
        return self.matrix

    def second(self, multiplier: Array) -> float:
        """Hessian of <multiplier, F(x)>, (p, p); 0.0 where F is affine."""
        return 0.0


#: Constraints of one kind: F(x) (g, ...) in a cone, with first and second derivatives.
Part = AffinePart | BarycentricPart


@dataclass(frozen=True)
class ShiftedPenalty:
    """L(x; S, w) with f(x) = |R x - rho|^2 + residual_norm^2, all scaled.

    ``shifts`` has one array a part.
    """

    R: Array
    rho: Array
    constant: float
    parts: tuple[Part, ...]

    def shifted(self, x: Array, shifts: Sequence[Array], weight: float) -> list[Array]:
        """Pi_K(S - w F(x)): the next shifts."""
        pairs = zip(self.parts, shifts, strict=True)
        return [project(part.cone, shift - weight * part.values(x)) for part, shift in pairs]

    def value_and_gradient(
        self, x: Array, shifts: Sequence[Array], weight: float
    ) -> tuple[float, Array]:
        """L and its gradient 2 R^T (R x - rho) - sum_i J_i^T Pi_K(S_i - w F_i)."""
        residual = self.R @ x - self.rho
        value = float(residual @ residual) + self.constant
        gradient = 2.0 * (residual @ self.R)
        new = self.shifted(x, shifts, weight)
        for part, shift, z in zip(self.parts, shifts, new, strict=True):
            value += (float(np.vdot(z, z)) - float(np.vdot(shift, shift))) / (2.0 * weight)
            gradient -= z.ravel() @ part.jacobian(x)
        return value, gradient

    def largest_curvature(self, x: Array, weight: float) -> Array:
        """(p, p) the Hessian if every constraint were active: an upper bound of it where F is affine."""
        rows = [np.sqrt(2.0) * self.R, *(np.sqrt(weight) * part.jacobian(x) for part in self.parts)]
        out = np.sum([J.T @ J for J in rows], axis=0)
        out[np.diag_indices_from(out)] += 1e-12 * or_one(out.max(initial=0.0))
        return np.asarray(out)

    def hessian(self, x: Array, shifts: Sequence[Array], weight: float) -> Array:
        """An element of L's generalised Hessian (p, p)."""
        out = 2.0 * self.R.T @ self.R
        for part, shift in zip(self.parts, shifts, strict=True):
            moved = shift - weight * part.values(x)
            jacobian = part.jacobian(x).reshape(len(moved), -1, len(x))
            out += weight * projection_curvature(part.cone, moved, jacobian)
            out -= part.second(project(part.cone, moved))
        return out


def minimise(
    penalty: ShiftedPenalty, x: Array, tolerance: float
) -> tuple[Array, list[Array], dict[str, float]]:
    """Continue weight and shifts from x until violation and complementarity are below tolerance, in the
    scaled units of the parts: x (p,), the shifts (multipliers) there, and what was spent."""
    shifts, weight = [np.zeros_like(part.values(x)) for part in penalty.parts], _FIRST_WEIGHT
    residual, accuracy = np.inf, 1e-2
    evaluations = iterations = 0
    for _ in range(_STEPS):
        x, more, steps = newton(penalty, x, shifts, weight, accuracy)
        evaluations, iterations = evaluations + more, iterations + steps
        moved = penalty.shifted(x, shifts, weight)
        changes = (np.abs(a - b).max(initial=0.0) for a, b in zip(moved, shifts, strict=True))
        previous, residual = residual, float(max(changes, default=0.0)) / weight
        shifts = moved
        if residual <= tolerance and accuracy <= 1e-6:
            break
        if residual > 0.25 * previous and weight < _LARGEST_WEIGHT:
            weight *= 10.0
        accuracy = max(0.1 * accuracy, 1e-8)
    spent = {"residual": residual, "weight": weight, "evaluations": evaluations}
    return x, shifts, {**spent, "iterations": iterations}


def newton(
    penalty: ShiftedPenalty, x: Array, shifts: Sequence[Array], weight: float, accuracy: float
) -> tuple[Array, int, int]:
    """Minimise L(.; S, w) from x by Newton steps, damped (Levenberg, Marquardt) in the metric of the
    largest curvature, so that no choice of variables matters; returns x, evaluations and steps.

    Stops at a gradient below ``accuracy`` (scaled units) or where rounding hides any descent.
    """
    value, gradient = penalty.value_and_gradient(x, shifts, weight)
    evaluations, damping, metric = 1, 0.0, penalty.largest_curvature(x, weight)
    for step in range(_STEPS):
        if np.abs(gradient).max(initial=0.0) <= accuracy:
            return x, evaluations, step
        hessian = penalty.hessian(x, shifts, weight)
        while True:
            direction, damping = _descent(hessian, gradient, metric, damping)
            slope = float(gradient @ direction)
            if -slope <= 1e-15 * abs(value) or damping > 1e3:
                return x, evaluations, step
            new_value, new_gradient = penalty.value_and_gradient(x + direction, shifts, weight)
            evaluations += 1
            if new_value <= value + 1e-4 * slope:
                break
            damping = max(10.0 * damping, 1e-10)
        x, value, gradient, damping = x + direction, new_value, new_gradient, 0.1 * damping
    return x, evaluations, _STEPS


def _descent(hessian: Array, gradient: Array, metric: Array, damping: float) -> tuple[Array, float]:
    """-(H + t metric)^-1 g and t: the first of damping times 1, 100, ... that is definite."""
    damping = max(damping, 1e-14)
    while True:
        try:
            factor = scipy.linalg.cho_factor(hessian + damping * metric, check_finite=False)
            return -scipy.linalg.cho_solve(factor, gradient, check_finite=False), damping
        except np.linalg.LinAlgError:
            damping *= 100.0


@dataclass(frozen=True)
class Penalty(Estimator):
    """minimise loss(theta) + shifted penalty of F(theta), weights continued until it is exact.

    body : whether each link's mass must lie inside of its body, as for ``lmi-sdp``.
    thickness : smallest radius of gyration of a link [m]; 0 for none.
    starts : runs; the first from the problem's nominal robot, the others from seeded random points
        of the barycentric box, moved towards it until the convex constraints hold. Where the data
        leave directions open a run may stop above the optimum, and its certified gap says so.
    tolerance : of violation and complementarity, relative to the size of each constraint's values.
    joint_prior : as ``lmi-sdp`` has it.
    """

    name = "penalty"
    table_place: ClassVar[int | None] = 2
    description = "one-step torque loss with an exact penalty, multi-start (the strongest)"

    body: bool = True
    thickness: float = LmiSdpThickness.thickness
    starts: int = 5
    tolerance: float = 1e-9
    joint_prior: float = 0.0

    def demands(self, task: Task) -> ConstraintSet:
        """The same arrays as the SDP's."""
        demands = task.constraints.plus(task.minimum_thickness(self.thickness))
        return demands.plus(task.bodies) if self.body else demands

    def fit(self, task: Task) -> Fit:
        task = with_joint_prior(task, self.joint_prior)
        return fit_penalty(task, task.data, self.demands(task), self.starts, self.tolerance)


@dataclass(frozen=True)
class PenaltyTwoStep(Penalty):
    """minimise |pi(theta) - pi_hat|^2, the retrieval of Gaz et al. (RA-L 2019, eq. 29).

    Friction and other joint parameters are coefficients of their own: they stay as estimated where
    their sign bounds allow it.
    """

    name = "penalty-two-step"
    table_place: ClassVar[int | None] = None
    description = "exact penalty on the distance to the OLS base parameters, multi-start"

    def fit(self, task: Task) -> Fit:
        return fit_penalty(task, task.base_distance, self.demands(task), self.starts, self.tolerance)


def fit_penalty(
    task: Task, data: LeastSquares, constraints: ConstraintSet, starts: int, tolerance: float
) -> Fit:
    """The best of several runs, each made feasible; raises InputError where nothing is feasible."""
    interior = interior_point(task, constraints)
    scaled = ScaledProblem.of(task, data, constraints, interior)
    box, rng = barycentric_box(task), np.random.default_rng(task.seed)
    runs: list[dict[str, Any]] = []
    best: tuple[float, Array, list[Array]] | None = None
    for run in range(max(starts, 1)):
        random = box.theta(rng.uniform(box.lower, box.upper)) if run else interior
        start = repair(constraints, random, interior) if run else interior
        x, shifts, spent = minimise(scaled.penalty, start / scaled.theta_scale, tolerance)
        theta = feasible(constraints, scaled.theta_scale * x, interior)
        objective, violation = data.loss(theta), max(constraints.worst(theta).values(), default=0.0)
        found = {"loss": task.data.loss(theta), "objective": objective, "violation": violation}
        runs.append({**found, **spent})
        # A run that could not be made feasible counts behind every one that could.
        rank = objective if violation <= 1e-9 else np.inf
        # One that is lower by less than it violates is no better: its multipliers may be worse.
        if best is None or rank < best[0] * (1.0 - 1e-7):
            best = (rank, theta, shifts)
        least = min(r["objective"] for r in runs)
        task.progress(f"run {run + 1} of {starts}: best {least:.6g}, violation {violation:.1e}")
    assert best is not None
    _, theta, shifts = best
    multipliers, details = scaled.multipliers(constraints, shifts), {"runs": runs}
    return Fit(theta, Objective(data), constraints, multipliers, interior=interior, details=details)


def feasible(constraints: ConstraintSet, theta: Array, interior: Array) -> Array:
    """The nearest point towards the interior that satisfies all constraints, convex or not.

    Where a bound that is not convex holds nowhere on the way, the convex repair alone.
    """
    repaired = repair(constraints, theta, interior)
    for step in (0.0, *np.logspace(-14, 0, 57)):
        point = repaired + step * (interior - repaired)
        if all(bound.margin(point) >= 0.0 for bound in constraints.nonconvex):
            return point
    return repaired


@dataclass(frozen=True)
class ScaledProblem:
    """The shifted penalty in variables and cones of about unit size, and the way back."""

    penalty: ShiftedPenalty
    theta_scale: Array
    loss_scale: float
    received: ConstraintSet  # convex, without what others imply

    @classmethod
    def of(
        cls, task: Task, data: LeastSquares, constraints: ConstraintSet, interior: Array
    ) -> ScaledProblem:
        """In units of what each parameter can be, of the cones at the interior point and of the loss."""
        norms, size = data.column_norms, np.sqrt(data.tau_squared)
        own = np.where((norms > 0.0) & (size > 0.0), size / or_one(norms), np.inf)
        theta_scale = np.minimum(own, task.bound)
        # The loss in units of its unconstrained minimum, so that weights mean the same everywhere.
        loss_scale = max(data.loss(task.ols), 1e-6 * data.tau_squared) or 1.0
        received = ConstraintSet(constraints.essential)
        parts: list[Part] = [AffinePart.of(s, theta_scale, interior) for s in received.groups]
        if constraints.nonconvex:
            parts.append(BarycentricPart.of(constraints.nonconvex, theta_scale, interior))
        root = np.sqrt(loss_scale)
        scaled = data.R * theta_scale / root, data.rho / root, data.residual_norm**2 / loss_scale
        penalty = ShiftedPenalty(*scaled, tuple(parts))
        return cls(penalty, theta_scale, loss_scale, received)

    def multipliers(self, constraints: ConstraintSet, shifts: Sequence[Array]) -> list[Array]:
        """The shifts as dual variables of the convex constraints, in units of loss per F."""
        found: dict[Constraint, Array] = {}
        groups = self.received.groups  # the first of the parts, in this order
        for group, part, shift in zip(groups, self.penalty.parts, shifts, strict=False):
            assert isinstance(part, AffinePart)
            for place, scale, multiplier in zip(group.places, part.scale, shift, strict=True):
                found[self.received.convex[place]] = self.loss_scale * scale * multiplier
        return [found.get(c, np.zeros_like(c.constant)) for c in constraints.convex]
