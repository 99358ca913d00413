"""Penalty-based retrieval at its strongest: an exact penalty, from several seeded starts.

It receives the convex constraints of the SDP as the same arrays, and the barycentric bounds that
are not convex as they are. What it finds is feasible; its shifts are multipliers, from which the
certificate computes a lower bound on the optimum as it does for the SDP.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from sdp_vs_penalty.constraints.constraint import Constraint, ConstraintSet
from sdp_vs_penalty.estimators.barycentric import (
    BarycentricPart,
    OneSided,
    barycentric_box,
    implied_by_centre,
)
from sdp_vs_penalty.estimators.estimator import Array, Estimator, Fit, Task
from sdp_vs_penalty.estimators.lmi_sdp import DEFAULT_THICKNESS
from sdp_vs_penalty.estimators.sdp_fit import interior_point
from sdp_vs_penalty.estimators.shifted_penalty import (
    AffinePart,
    Minimum,
    Part,
    ShiftedPenalty,
    minimise,
    scaled_loss,
)
from sdp_vs_penalty.regression.regression import LeastSquares
from sdp_vs_penalty.solvers.certificate import repair
from sdp_vs_penalty.solvers.objective import Objective


@dataclass(frozen=True)
class Penalty(Estimator):
    """minimise loss(theta) + shifted penalty of F(theta), weights continued until it is exact.

    body : whether each link's mass must lie inside of its body, as for ``lmi-sdp``.
    thickness : smallest radius of gyration of a link [m]; 0 for none.
    starts : runs; the first from the problem's nominal robot, the others from seeded random points
        of the barycentric box, moved towards it until the convex constraints hold. With convex
        constraints only and motion that excites the arm, all end at the same loss; on a second or two
        of motion, where the data leave directions open, a run may stop some per cent above the optimum,
        and its certified gap says so.
    tolerance : of violation and complementarity, relative to the size of each constraint's values.
    """

    name = "penalty"
    table_place: ClassVar[int | None] = 2
    description = "one-step torque loss with an exact penalty, multi-start (the strongest)"

    body: bool = True
    thickness: float = DEFAULT_THICKNESS
    starts: int = 5
    tolerance: float = 1e-9

    def demands(self, task: Task) -> ConstraintSet:
        """The same arrays as the SDP's."""
        demands = task.constraints.plus(task.minimum_thickness(self.thickness))
        return demands.plus(task.bodies) if self.body else demands

    def fit(self, task: Task) -> Fit:
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
    best: tuple[float, Array, Minimum] | None = None
    for run in range(max(starts, 1)):
        start = interior if run == 0 else repair(constraints, box.theta(box.random(rng)), interior)
        minimum = minimise(scaled.penalty, start / scaled.theta_scale, tolerance)
        theta = feasible(constraints, scaled.theta_scale * minimum.x, interior)
        objective, violation = data.loss(theta), max(constraints.worst(theta).values(), default=0.0)
        runs.append(
            {
                "loss": task.data.loss(theta),
                "objective": objective,
                "violation": violation,
                "residual": minimum.residual,
                "weight": minimum.weight,
                "evaluations": minimum.evaluations,
                "iterations": minimum.iterations,
            }
        )
        # A run that could not be made feasible counts behind every one that could.
        rank = objective if violation <= 1e-9 else np.inf
        if best is None or rank < best[0]:
            best = (rank, theta, minimum)
        task.progress(
            f"run {run + 1} of {starts}: best {min(r['objective'] for r in runs):.6g}, "
            f"violation {violation:.1e}"
        )
    assert best is not None
    _, theta, minimum = best
    multipliers = scaled.multipliers(constraints, minimum)
    details = {"runs": runs, "interior": interior.tolist()}
    return Fit(
        theta,
        Objective(data),
        constraints,
        multipliers=multipliers,
        interior=interior,
        details=details,
    )


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
        norms, size = data.column_norms, np.sqrt(data.tau_squared)
        theta_scale = task.bound.copy()
        np.divide(size, norms, out=theta_scale, where=(norms > 0.0) & (size > 0.0))
        theta_scale = np.minimum(theta_scale, task.bound)
        # The loss in units of its unconstrained minimum, so that weights mean the same everywhere.
        loss_scale = max(data.loss(task.ols), 1e-6 * data.tau_squared) or 1.0
        bounds = OneSided.all_of(constraints.nonconvex, interior)
        box = barycentric_box(task)
        centre = {int(k[0]): np.column_stack([box.lower[k[1:4]], box.upper[k[1:4]]]) for k in task.links}
        received = ConstraintSet(_not_implied(constraints.convex)).plus(
            implied_by_centre(bounds, centre)
        )
        parts: list[Part] = [AffinePart.of(s, theta_scale, interior) for s in received.stacks]
        if bounds:
            parts.append(BarycentricPart.of(bounds, theta_scale, interior))
        reach = 2.0 * task.bound / theta_scale
        penalty = ShiftedPenalty(*scaled_loss(data, theta_scale, loss_scale), tuple(parts), reach)
        return cls(penalty, theta_scale, loss_scale, received)

    def multipliers(self, constraints: ConstraintSet, minimum: Minimum) -> list[Array]:
        """The shifts as dual variables of the convex constraints, in units of loss per F."""
        found: dict[Constraint, Array] = {}
        stacks = self.received.stacks  # the first of the parts, in this order
        for stack, part, shift in zip(stacks, self.penalty.parts, minimum.shifts, strict=False):
            assert isinstance(part, AffinePart)
            for member, scale, multiplier in zip(stack.members, part.scale, shift, strict=True):
                found[member] = self.loss_scale * scale * multiplier
        return [found.get(c, np.zeros_like(c.constant)) for c in constraints.convex]


def _not_implied(convex: tuple[Constraint, ...]) -> tuple[Constraint, ...]:
    """Without the pseudo-inertias of links that have a minimum thickness, which contains them."""
    thick = {tuple(c.indices) for c in convex if c.family == "minimum thickness"}
    return tuple(c for c in convex if c.family != "pseudo-inertia" or tuple(c.indices) not in thick)
