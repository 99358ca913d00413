"""The torque SDP as one reads it: the definition that the fast path is held to.

    minimise    |R theta - rho|^2 + floor^2  [+ w sum_i D(P_i || P0_i)]
    subject to  P_i(theta) >= 0                               each link consistent
                Sigma_c >= m r^2 1                            no link thinner than r
                m <= m_i <= m,  lb m <= m c <= ub m           mass, centre of mass
                |(m c) across| <= (m c) along . slope + m radius
                J_aa <= ub_aa + m max(c_b^2 + c_c^2)          or tr Sigma <= m radius^2
                sum_k E[(u_k . (x - c))^2] / a_k^2 <= m       each link inside of its body
                m <= sum m_i <= m,  signs and ranges of everything else

Written from the problem's physical quantities, not from the constraint arrays, so that the two can be
wrong only if both are. Any solver that CVXPY knows can be used; it is always named, because CVXPY's
own choice depends on what is installed. Ten to a hundred times slower than the direct path.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cvxpy as cp
import numpy as np

from sdp_vs_penalty import Problem
from sdp_vs_penalty.effects.effect import PARAMETER_RANGE
from sdp_vs_penalty.estimators import Task
from sdp_vs_penalty.estimators.estimator import Array
from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.solvers import Objective


@dataclass(frozen=True)
class CvxpyModel:
    """program : the cvxpy.Problem, of f / unit; theta : its expression (p,) in SI units."""

    program: Any
    theta: Any
    unit: float

    def solve(self, solver: str, **settings: Any) -> tuple[Array, float]:
        """theta (p,) and the objective in (N m)^2 from the solver of that name ("CLARABEL", "SCS")."""
        self.program.solve(solver=solver, **settings)
        return np.asarray(self.theta.value, float), float(self.program.value) * self.unit


def cvxpy_model(
    problem: Problem, task: Task, objective: Objective, thickness: float = 0.0, body: bool = False
) -> CvxpyModel:
    """The SDP of a task of this problem: its objective, a minimum thickness [m] of every link, its body.

    theta = centre + scale x: only the numbers that the solver handles are scaled, each parameter by
    the torque that it makes (by its bound where it makes none), the loss by that of least squares.
    """
    data = objective.least_squares
    norms = data.column_norms
    scale = np.minimum(np.sqrt(data.tau_squared) / np.where(norms > 0.0, norms, np.inf), task.bound)
    scale = np.where(norms > 0.0, scale, task.bound)
    x = cp.Variable(len(scale))
    theta = task.ols + cp.multiply(scale, x)
    unit = max(data.loss(task.ols), 1e-12 * data.tau_squared)

    root = np.sqrt(unit)
    residual = data.R / root @ cp.multiply(scale, x) + (data.R @ task.ols - data.rho) / root
    value = cp.sum_squares(residual) + data.residual_norm**2 / unit
    constraints: list[Any] = []
    links = [Link.of(theta, indices) for indices in task.links]
    for number, link in enumerate(links):
        constraints += _link(problem, number, link, thickness)
        if body:
            constraints.append(_inside(problem, number, link))
    if links and (problem.total_mass[0] > 0.0 or np.isfinite(problem.total_mass[1])):
        total = cp.sum(cp.hstack([link.mass for link in links]))
        constraints += _between(total, *problem.total_mass)
    for k in np.setdiff1d(np.arange(len(scale)), task.model.rigid_indices):
        lower = max(task.model.parameters[k].lower, -PARAMETER_RANGE)
        constraints += _between(theta[k], lower, PARAMETER_RANGE)
    entropy = objective.entropy
    if entropy is not None:
        for link, p0 in zip(links, entropy.nominal, strict=True):
            # Congruence by the nominal's size: the same divergence in numbers of order one.
            t = np.diag(1.0 / np.sqrt(np.diagonal(p0)))
            pull = cp.trace(np.linalg.inv(t @ p0 @ t) @ (t @ link.pseudo_inertia @ t)) - cp.log_det(
                t @ link.pseudo_inertia @ t
            )
            constant = float(np.linalg.slogdet(t @ p0 @ t)[1]) - 4.0
            value = value + entropy.weight / unit * (pull + constant)
    return CvxpyModel(cp.Problem(cp.Minimize(value), constraints), theta, unit)


@dataclass(frozen=True)
class Link:
    """A link's inertial parameters as CVXPY expressions: mass, h = m c (3,), J (3, 3), all about the
    link frame."""

    mass: Any
    h: Any
    J: Any

    @classmethod
    def of(cls, theta: Any, indices: Sequence[int]) -> Link:
        m, mx, my, mz, xx, xy, yy, xz, yz, zz = (theta[int(k)] for k in indices)
        return cls(m, cp.hstack([mx, my, mz]), cp.bmat([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]))

    @property
    def sigma(self) -> Any:
        """The second moment of the mass about the frame (3, 3)."""
        return 0.5 * cp.trace(self.J) * np.eye(3) - self.J

    @property
    def pseudo_inertia(self) -> Any:
        return self.with_corner(self.sigma)

    def with_corner(self, corner: Any) -> Any:
        column = cp.reshape(self.h, (3, 1), order="F")
        mass = cp.reshape(self.mass, (1, 1), order="F")
        return cp.bmat([[corner, column], [column.T, mass]])


def _link(problem: Problem, number: int, link: Link, thickness: float) -> list[Any]:
    box = problem.box[number]
    largest, com, _ = (x[number] for x in problem.link_sizes)
    # A congruence under which the nominal link is the identity: a solver sees numbers of one size.
    t = np.linalg.inv(np.linalg.cholesky(inertia.pseudo_inertia(problem.nominal_links[number])))
    corner = link.sigma - link.mass * thickness**2 * np.eye(3)
    out = [t @ link.with_corner(corner) @ t.T >> 0]
    out += _between(link.mass, max(box[0, 0], 0.0), largest)
    for axis in range(3):
        lower, upper = box[1 + axis]
        if np.isfinite(lower):
            out.append(link.h[axis] >= lower * link.mass)
        if np.isfinite(upper):
            out.append(link.h[axis] <= upper * link.mass)
    for cone in problem.cones:
        if cone.link == number + 1:
            along = "xyz".index(cone.axis)
            across = [a for a in range(3) if a != along]
            radius = cone.radius * link.mass + cone.slope * link.h[along]
            out.append(cp.norm(cp.hstack([link.h[a] for a in across])) <= radius)
    if problem._boxed[number]:
        for axis, entry in enumerate((4, 6, 9)):
            others = sum(com[a] ** 2 for a in range(3) if a != axis)
            out.append(link.J[axis, axis] <= box[entry, 1] + link.mass * others)
    else:
        out.append(cp.trace(link.sigma) <= link.mass * problem.link_defaults[number, 1] ** 2)
    return out


def _inside(problem: Problem, number: int, link: Link) -> Any:
    """The mean square distance from the body's centre, in its half axes, is at most one."""
    body = problem.link_bodies[number]
    square = 0.0
    for axis, half in zip(body.axes.T, body.half_axes, strict=True):
        centre = float(axis @ body.centre)
        along = axis @ link.sigma @ axis - 2.0 * centre * (axis @ link.h) + centre**2 * link.mass
        square = square + along / half**2
    return square <= link.mass


def _between(x: Any, lower: float, upper: float) -> list[Any]:
    out = [x >= lower] if np.isfinite(lower) else []
    return out + ([x <= upper] if np.isfinite(upper) else [])
