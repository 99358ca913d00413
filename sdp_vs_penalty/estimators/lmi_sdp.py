"""The convex estimator: least squares subject to linear matrix inequalities, in one step.

    minimise |R theta - rho|^2 + floor^2   subject to   P_i(theta) >= 0, bounds, signs

(Sousa, Cortesao, IJRR 2014, with the 4x4 pseudo-inertia of Wensing et al. 2018, which contains the
triangle inequalities). Plain, its optimum makes rods of most links: torque data hardly see
thickness, and the least loss sits on the boundary. Two convex remedies: a minimum thickness, and an
entropic pull towards a nominal robot that comes from the problem, never from published estimates.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from sdp_vs_penalty import inertia
from sdp_vs_penalty.constraints import Constraint, ConstraintSet
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimators.estimator import Array, Estimator, Fit, Task
from sdp_vs_penalty.solvers import solver
from sdp_vs_penalty.solvers.conic import Entropy, Objective, largest_margin, least_squares_sdp

DEFAULT_THICKNESS = 0.02  # m: costs about 1 % of the Panda's loss


@dataclass(frozen=True)
class LmiSdp(Estimator):
    """thickness : smallest radius of gyration of a link in any direction [m]; 0 for none.

    entropy : weight of the Bregman divergence from the nominal robot, in units of the variance of
        one independent torque sample (1: the nominal counts like one such sample a link); 0: none.
    solver : one of solvers/; accuracy : what it is asked for.
    """

    name = "lmi-sdp"
    description = "one-step torque SDP with minimum thickness (the default)"

    thickness: float = DEFAULT_THICKNESS
    entropy: float = 0.0
    solver: str = "clarabel"
    accuracy: float = 1e-10

    def fit(self, task: Task) -> Fit:
        constraints = task.constraints.plus(task.minimum_thickness(self.thickness))
        objective = Objective(task.data, self._entropy(task))
        return solve_sdp(task, objective, constraints, self.solver, self.accuracy)

    def _entropy(self, task: Task) -> Entropy | None:
        if self.entropy <= 0.0 or not len(task.links):
            return None
        links = tuple(c for c in task.constraints.convex if c.family == "pseudo-inertia")
        variance = task.data.loss(task.ols) / max(task.data.rows, 1)
        nominal = inertia.pseudo_inertia(task.nominal[task.links])
        return Entropy(self.entropy * variance, links, nominal)


@dataclass(frozen=True)
class LmiSdpPlain(LmiSdp):
    name = "lmi-sdp-plain"
    description = "one-step torque SDP without minimum thickness: links degenerate to rods"
    thickness: float = 0.0


@dataclass(frozen=True)
class LmiSdpEntropic(LmiSdp):
    name = "lmi-sdp-entropic"
    description = "one-step torque SDP with an entropic pull towards the problem's nominal robot"
    thickness: float = 0.0
    entropy: float = 1.0


@dataclass(frozen=True)
class LmiSdpTwoStep(Estimator):
    """Sousa and Cortesao's chain (IJRR 2014), each step a feasible set and a distance:

    beta'   nearest feasible base parameters to the OLS estimate, Euclidean in the symbols;
    beta*   the torque SDP with pseudo-inertias only;
    beta*e  the torque SDP with centre-of-mass and mass bounds as well;
    delta   standard parameters with base parameters beta*e (their eq. 49).
    """

    name = "lmi-sdp-two-step"
    description = "Sousa and Cortesao's chain: beta', beta*, beta*e, delta"

    solver: str = "clarabel"
    accuracy: float = 1e-10

    #: What beta' and beta* are subject to.
    _physics: ClassVar[tuple[str, ...]] = ("pseudo-inertia", "sign")

    def fit(self, task: Task) -> Fit:
        # Families that only bound the feasible set stay: without them it is open to infinity.
        physics = task.constraints.with_families(
            lambda family: family in (*self._physics, "range", "trace", "bounding ellipsoid", "mass")
        )
        nearest = solve_sdp(task, Objective(task.base_distance), physics, self.solver, self.accuracy)
        torque = Objective(task.data)
        best = solve_sdp(task, torque, physics, self.solver, self.accuracy)
        bounded = solve_sdp(task, torque, task.constraints, self.solver, self.accuracy)
        chain = {
            name: (task.base @ fit.theta).tolist()
            for name, fit in (("beta_prime", nearest), ("beta_star", best), ("beta_star_e", bounded))
        }
        details = {**bounded.details, **chain, "loss_beta_prime": task.data.loss(nearest.theta)}
        return Fit(
            bounded.theta, torque, bounded.constraints, bounded.multipliers, bounded.interior, details
        )


def solve_sdp(
    task: Task, objective: Objective, constraints: ConstraintSet, solver_name: str, accuracy: float
) -> Fit:
    """Solve one SDP and put the answer inside the constraints; InputError where there is no inside."""
    interior = interior_point(task, constraints, solver_name)
    problem = least_squares_sdp(objective, constraints.convex, interior, task.bound)
    solution = solver(solver_name).solve(problem.conic, accuracy)
    if solution.claims in ("infeasible", "unbounded", "failed"):
        raise InputError(
            f"solver {solver_name} gave up on a problem that has an interior point "
            f"({solution.status}): choose another solver, or check the units of the measurements."
        )
    details = {
        "solver": solver_name,
        "status": solution.status,
        "iterations": solution.iterations,
        "interior": interior.tolist(),
    }
    theta = problem.theta(solution)
    return Fit(theta, objective, constraints, problem.multipliers(solution), interior, details)


def interior_point(task: Task, constraints: ConstraintSet, solver_name: str = "clarabel") -> Array:
    """A theta strictly inside all convex constraints: the nominal one, or that of largest margin.

    Raises InputError naming the families that exclude each other where there is none.
    """
    nominal = task.nominal.copy()
    others = np.setdiff1d(np.arange(len(nominal)), task.model.rigid_indices)
    for k in others:
        lower = task.model.parameters[k].lower
        nominal[k] = 0.0 if np.isinf(lower) else lower + 1e-2
    if constraints.margin(nominal) > 0.0:
        return nominal
    problem = largest_margin(constraints.convex, nominal, task.bound)
    solution = solver(solver_name).solve(problem.conic, 1e-8)
    theta = problem.theta(solution)
    if constraints.margin(theta) > 0.0:
        return theta
    families = conflicting(constraints.convex, problem.multipliers(solution))
    raise InputError(
        "The constraints admit no parameters: "
        + " and ".join(families)
        + " exclude each other (from the infeasibility certificate): relax one of them."
    )


def conflicting(constraints: Sequence[Constraint], multipliers: Sequence[Array]) -> list[str]:
    """The families whose multipliers carry the proof that nothing satisfies all, largest first."""
    weight: dict[str, float] = {}
    for constraint, multiplier in zip(constraints, multipliers, strict=True):
        size = float(np.linalg.norm(multiplier))
        label = f"{constraint.family} ({constraint.name})"
        weight[label] = max(weight.get(label, 0.0), size)
    largest = max(weight.values(), default=0.0)
    names = sorted(weight, key=lambda k: -weight[k])
    return [name for name in names if weight[name] > 1e-3 * largest][:4]
