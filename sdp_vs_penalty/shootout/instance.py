"""One problem of the shootout: the mathematical problem, and the form in which solvers get it."""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import sparse

from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimators.estimator import Task
from sdp_vs_penalty.estimators.sdp_fit import essential, interior_point
from sdp_vs_penalty.regression.regression import LeastSquares
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.constraint import Constraint, ConstraintSet
from sdp_vs_penalty.solvers.conic import svec
from sdp_vs_penalty.solvers.identification import RowBuilder, SdpProblem, least_squares_sdp
from sdp_vs_penalty.solvers.objective import Entropy, Objective


@dataclass(frozen=True)
class Instance:
    """minimise objective(theta) over task.constraints.convex, |theta_k| <= task.bound.

    task : data, constraints and bounds in the instance's own units; what it calls nonconvex is empty.
    formulation : "residual" is ours, centred and scaled; "gram", "gram in float32" and "rows" are what
        users write (:func:`unscaled_sdp`).
    """

    name: str
    task: Task
    objective: Objective
    formulation: str = "residual"

    @property
    def constraints(self) -> ConstraintSet:
        return self.task.constraints

    @property
    def data(self) -> LeastSquares:
        """The least-squares part of the objective."""
        return self.objective.least_squares

    @cached_property
    def interior(self) -> Array | None:
        """A strictly feasible theta, or None where the constraints exclude each other."""
        try:
            return interior_point(self.task, self.constraints)
        except InputError:
            return None

    @cached_property
    def sent(self) -> list[Constraint]:
        """The constraints that solvers get: ours without redundant ones, users' all of them."""
        if self.formulation == "residual":
            return essential(self.constraints, self.objective)
        return list(self.constraints.convex)

    @cached_property
    def sdp(self) -> SdpProblem:
        """The problem as it is posed to conic solvers."""
        if self.formulation != "residual":
            return unscaled_sdp(self.data, self.sent, self.formulation)
        centre = self.task.nominal if self.interior is None else self.interior
        least = 1e-6 * self.data.tau_squared
        return least_squares_sdp(
            self.objective, self.sent, centre, self.task.bound, centre, least_loss=least
        )

    @cached_property
    def hash(self) -> str:
        """Sixteen hexadecimal digits of the problem and the form it is posed in: of objective and
        constraints at three points, to the six digits that all libraries of linear algebra share."""
        data, bound, entropy = self.data, self.task.bound, self.objective.entropy
        numbers = [data.tau_squared, bound.sum()]
        numbers += [] if entropy is None else [entropy.weight, entropy.nominal.sum()]
        for x in np.random.default_rng(0).uniform(-1.0, 1.0, (3, len(bound))) * bound:
            numbers += [data.loss(x), *(c.value(x).sum() for c in self.constraints.convex)]
        families = [f"{c.family} {c.name} {c.cone}" for c in self.constraints.convex]
        told = [self.formulation, self.name, *families, *(f"{x:.6g}" for x in numbers)]
        return hashlib.sha256("\n".join(told).encode()).hexdigest()[:16]


def unscaled_sdp(data: LeastSquares, constraints: Sequence[Constraint], formulation: str) -> SdpProblem:
    """The problem as users write it, without a centre, without scales of parameters or cones:

    gram   minimise theta^T (R^T R) theta - 2 rho^T R theta, whose constant rho^T rho is left out;
           "gram in float32" sums R^T R and R^T rho in single precision
    rows   minimise |z|^2 subject to R theta - z = rho
    """
    (r, p), offset = data.R.shape, data.residual_norm**2
    if formulation == "rows":
        pieces = RowBuilder(p + r)
        pieces.rows("zero", sparse.hstack([sparse.csr_matrix(data.R), -sparse.identity(r)]), data.rho)
        P, q = sparse.diags(np.repeat([0.0, 2.0], [p, r])).tocsc(), np.zeros(p + r)
    else:
        single = formulation.endswith("float32")
        R, rho = (x.astype(np.float32 if single else float) for x in (data.R, data.rho))
        pieces, offset = RowBuilder(p), offset + float(data.rho @ data.rho)
        P = sparse.csc_matrix(np.triu(2.0 * (R.T @ R).astype(float)))
        q = -2.0 * (R.T @ rho).astype(float)
    placed = []
    for c in constraints:
        psd, d = c.cone == "psd", len(c.constant)
        constant, columns = (svec(x) if psd else x for x in (c.constant, c.coefficients))
        placed.append(pieces.place(c, np.eye(d) if psd else np.ones(d), constant, columns))
    return SdpProblem(pieces.problem(P, q), np.zeros(p), np.ones(p), 1.0, tuple(placed), offset)


def in_units(instance: Instance, mass: float, length: float) -> Instance:
    """The same problem with masses in ``mass`` kg and lengths in ``length`` m (seconds stay).

    Torques become tau / (mass length^2); parameters, bounds and constraint rows follow their units.
    """
    task, data, entropy = instance.task, instance.data, instance.objective.entropy
    m, l = 1.0 / mass, 1.0 / length  # noqa: E741
    torque, corner = m * l**2, np.sqrt(m) * np.array([l, l, l, 1.0])
    factor = np.full(len(task.bound), torque)
    factor[task.links] = [m, *[m * l] * 3, *[m * l**2] * 6]
    changed = replace(
        data,
        R=torque * data.R / factor,
        rho=torque * data.rho,
        residual_norm=torque * data.residual_norm,
        tau_squared=torque**2 * data.tau_squared,
    )
    row_units = {"centre of mass": m * l, "centre of mass cone": m * l, "trace": m * l**2}
    row_units |= dict.fromkeys(("mass", "total mass", "bounding ellipsoid", "body"), m)

    def convert(c: Constraint) -> Constraint:
        local = factor[c.indices].reshape(-1, *[1] * c.constant.ndim)
        scale = np.outer(corner, corner) if c.cone == "psd" else row_units.get(c.family, torque)
        return replace(c, constant=c.constant * scale, coefficients=c.coefficients * scale / local)

    convex = tuple(convert(c) for c in task.constraints.convex)
    if entropy is not None:
        links = tuple(c for c in convex if c.family == "pseudo-inertia")
        entropy = Entropy(entropy.weight * torque**2, links, entropy.nominal * np.outer(corner, corner))
    moved = replace(
        task,
        data=changed,
        constraints=ConstraintSet(convex),
        bound=task.bound * factor,
        nominal=task.nominal * factor,
    )
    return replace(instance, task=moved, objective=Objective(changed, entropy))
