"""One problem of the shootout: the mathematical problem, and the form in which solvers get it."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimators.estimator import Task
from sdp_vs_penalty.estimators.sdp_fit import essential, interior_point
from sdp_vs_penalty.regression.regression import LeastSquares
from sdp_vs_penalty.robot.arrays import Array, or_one
from sdp_vs_penalty.robot.constraint import Constraint, ConstraintSet
from sdp_vs_penalty.solvers import clarabel
from sdp_vs_penalty.solvers.certificate import lower_bound
from sdp_vs_penalty.solvers.identification import SdpProblem, least_squares_sdp
from sdp_vs_penalty.solvers.objective import Entropy, Objective
from sdp_vs_penalty.solvers.unscaled import gram_sdp, rows_sdp


@dataclass(frozen=True)
class Instance:
    """minimise objective(theta) over task.constraints.convex, |theta_k| <= task.bound.

    task : data, constraints and bounds in the instance's own units; what it calls nonconvex is empty.
    formulation : "residual" is ours, centred and scaled; "gram", "gram in float32" and "rows" are what
        users write. raw : the uncompressed rows that the formulation "rows" poses.
    """

    name: str
    task: Task
    objective: Objective
    formulation: str = "residual"
    raw: LeastSquares | None = None

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
    def near(self) -> Array:
        """A point well inside the constraints whose objective is near the optimum: a solver stopped
        early. Repair towards it costs what a violation is worth, not what a nominal robot is."""
        inside = self.task.nominal if self.interior is None else self.interior
        sent = list(self.constraints.convex)
        least = 1e-6 * self.data.tau_squared
        sdp = least_squares_sdp(self.objective, sent, inside, self.task.bound, inside, least_loss=least)
        theta = sdp.theta(clarabel.solve(sdp.conic, 1e-2))
        if not np.all(np.isfinite(theta)):
            return inside
        # Not onto the boundary, where repair would find no room.
        middle = theta + 1e-2 * (inside - theta)
        return middle if self.constraints.depth(middle) > 1e-9 else inside

    @cached_property
    def sent(self) -> list[Constraint]:
        """The constraints that solvers get: ours without redundant ones, users' all of them."""
        if self.formulation == "residual":
            return essential(self.constraints, self.objective)
        return list(self.constraints.convex)

    @cached_property
    def sdp(self) -> SdpProblem:
        """The problem as it is posed to conic solvers."""
        if self.formulation == "gram":
            return gram_sdp(self.data, self.sent)
        if self.formulation == "gram in float32":
            return gram_sdp(self.data, self.sent, np.float32)
        if self.formulation == "rows":
            return rows_sdp(self.data if self.raw is None else self.raw, self.sent)
        centre = self.task.nominal if self.interior is None else self.interior
        least = 1e-6 * self.data.tau_squared
        return least_squares_sdp(
            self.objective, self.sent, centre, self.task.bound, centre, least_loss=least
        )

    def lower_bound(self, theta: Array, multipliers: Sequence[Array], slopes: Array | None) -> float:
        """A rigorous bound below the optimum, from any multipliers of all constraints."""
        bound = self.task.bound
        return lower_bound(self.objective, self.constraints, multipliers, theta, bound, slopes)

    def all_multipliers(self, sent: Iterable[Array]) -> list[Array]:
        """Multipliers of all constraints, in order, from those of the ``sent`` ones."""
        out, found = [], zip(self.sent, sent, strict=True)
        wanted, multiplier = next(found, (None, None))
        for c in self.constraints.convex:
            if c is wanted:
                out.append(np.asarray(multiplier))
                wanted, multiplier = next(found, (None, None))
            else:
                out.append(np.zeros_like(c.constant))
        return out

    @cached_property
    def hash(self) -> str:
        """Sixteen hexadecimal digits over every number of the problem, the form it is posed in included.

        Numbers are rounded to six digits first: libraries of linear algebra differ in the last ones.
        """
        digest = hashlib.sha256(f"{self.formulation} {self.name}".encode())
        data = self.data
        # Rounding decides the signs of R's rows and, where R lacks rank, what of the residual stands in
        # the floor. Not so: the columns' sizes and angles to rho, and the least loss of any theta.
        norms = data.column_norms
        seen = or_one(norms)
        size = np.sqrt(data.tau_squared) or 1.0
        cosines = np.where(norms > 0.0, data.R.T @ data.rho / seen / size, 0.0)
        digest.update((np.round(cosines, 7) + 0.0).tobytes())
        arrays = [norms, np.array([data.tau_squared, data.loss(self.task.ols)]), self.task.bound]
        for c in self.constraints.convex:
            digest.update(f"{c.family} {c.name} {c.cone} {c.indices.tolist()}".encode())
            arrays += [c.constant, c.coefficients]
        if self.objective.entropy is not None:
            arrays.append(self.objective.entropy.nominal)
        for array in arrays:
            digest.update(_six_digits(np.asarray(array, float)).tobytes())
        return digest.hexdigest()[:16]


def _six_digits(array: Array) -> Array:
    """Each entry to six digits; what is only rounding beside the largest entry is zero."""
    size = np.abs(array)
    kept = size > 1e-12 * size.max(initial=0.0)
    decade = 10.0 ** np.floor(np.log10(np.where(kept, size, 1.0)))
    return np.where(kept, np.round(array / decade, 6) * decade, 0.0) + 0.0


def in_units(instance: Instance, mass: float, length: float) -> Instance:
    """The same problem with masses in ``mass`` kg and lengths in ``length`` m (seconds stay).

    Torques become tau / (mass length^2); parameters, bounds and constraint rows follow their units.
    """
    task = instance.task
    m, l = 1.0 / mass, 1.0 / length  # noqa: E741
    torque = m * l**2
    factor = np.full(len(task.bound), torque)
    for indices in task.links:
        factor[indices] = [m, *[m * l] * 3, *[m * l**2] * 6]
    data = instance.data
    changed = LeastSquares(
        torque * data.R / factor,
        torque * data.rho,
        torque * data.residual_norm,
        torque**2 * data.tau_squared,
        data.rows,
    )
    row_units = {"centre of mass": m * l, "centre of mass cone": m * l, "trace": m * l**2}
    row_units |= dict.fromkeys(("mass", "total mass", "bounding ellipsoid", "body"), m)

    def convert(c: Constraint) -> Constraint:
        local = factor[c.indices].reshape(-1, *[1] * c.constant.ndim)
        if c.cone == "psd":
            corner = np.sqrt(m) * np.array([l, l, l, 1.0])
            scale = np.outer(corner, corner)
        else:
            scale = np.full(c.constant.shape, row_units.get(c.family, torque))
        return replace(c, constant=c.constant * scale, coefficients=c.coefficients * scale / local)

    convex = tuple(convert(c) for c in task.constraints.convex)
    entropy = instance.objective.entropy
    if entropy is not None:
        corner = np.sqrt(m) * np.array([l, l, l, 1.0])
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
