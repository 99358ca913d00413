"""The torque SDP as one reads it: the definition that the fast path is held to.

    minimise    |R theta - rho|^2 + floor^2  [+ w sum_i D(P_i || P0_i)]
    subject to  P_i(theta) >= 0                               each link consistent
                Sigma_c >= m r^2 1                            no link thinner than r
                m <= m_i <= m,  lb m <= m c <= ub m           mass, centre of mass
                |(m c) across| <= (m c) along . slope + m radius
                J_aa <= ub_aa + m max(c_b^2 + c_c^2)          or tr Sigma <= m radius^2
                sum_k E[(u_k . (x - c))^2] / a_k^2 <= m       each link inside of its body
                m <= sum m_i <= m,  signs and ranges of everything else

Written from the problem's physical quantities, not from the constraint arrays, so that
the two can be wrong only if both are.
"""

import cvxpy as cp
import numpy as np

from sdp_vs_penalty.effects.effect import PARAMETER_RANGE
from sdp_vs_penalty.robot import inertia


def cvxpy_optimum(problem, task, objective, method):
    """theta (p,) and the objective in (N m)^2 from CVXPY and Clarabel, with
    the minimum thickness [m] that the method demands and, where it does,
    the bodies of the links.

    theta = centre + scale x: only the numbers that the solver handles are scaled, each
    parameter by the torque that it makes (by its bound where it makes none), the loss
    by that of least squares.
    """
    data = objective.least_squares
    norms = objective.least_squares.column_norms
    scale = np.minimum(
        np.sqrt(data.tau_squared) / np.where(norms > 0.0, norms, np.inf), task.bound
    )
    scale = np.where(norms > 0.0, scale, task.bound)
    x = cp.Variable(len(scale))
    theta = task.ols + cp.multiply(scale, x)
    unit = max(data.loss(task.ols), 1e-12 * data.tau_squared)
    root = np.sqrt(unit)
    residual = (
        data.R / root @ cp.multiply(scale, x) + (data.R @ task.ols - data.rho) / root
    )
    value = cp.sum_squares(residual) + data.residual_norm**2 / unit
    constraints = []
    links = [Link(theta[indices]) for indices in task.links]
    for number, link in enumerate(links):
        constraints += _link(problem, number, link, method.thickness, method.body)
    if links:
        constraints += _between(
            cp.sum(cp.hstack([link.mass for link in links])), *problem.total_mass
        )
    for k in np.setdiff1d(np.arange(len(scale)), task.model.rigid_indices):
        lower = max(task.model.parameters[k].lower, -PARAMETER_RANGE)
        constraints += _between(theta[k], lower, PARAMETER_RANGE)
    if (entropy := objective.entropy) is not None:
        for link, p0 in zip(links, entropy.nominal, strict=True):
            # Congruence by the nominal's size: the same divergence in numbers of order
            # one.
            t = np.diag(1.0 / np.sqrt(np.diagonal(p0)))
            own = t @ link.pseudo_inertia() @ t
            nominal = t @ p0 @ t
            pull = cp.trace(np.linalg.inv(nominal) @ own) - cp.log_det(own)
            value += (
                entropy.weight
                / unit
                * (pull + float(np.linalg.slogdet(nominal)[1]) - 4.0)
            )
    program = cp.Problem(cp.Minimize(value), constraints)
    program.solve(solver="CLARABEL")
    return np.asarray(theta.value, float), float(program.value) * unit


class Link:
    """A link's inertial parameters as CVXPY expressions, about the link frame: mass, h
    = m c (3,), J and sigma (3, 3), the second moment of the mass."""

    def __init__(self, theta):
        self.mass = theta[0]
        self.h = theta[1:4]
        xx, xy, yy, xz, yz, zz = (theta[k] for k in range(4, 10))
        self.J = cp.bmat([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        self.sigma = 0.5 * cp.trace(self.J) * np.eye(3) - self.J

    def pseudo_inertia(self, thickness=0.0):
        """Of a link whose gyration is less by a thickness in every direction (4, 4)."""
        column = cp.reshape(self.h, (3, 1), order="F")
        mass = cp.reshape(self.mass, (1, 1), order="F")
        return cp.bmat(
            [
                [self.sigma - self.mass * thickness**2 * np.eye(3), column],
                [column.T, mass],
            ]
        )


def _link(problem, number, link, thickness, bodily):
    box = problem.box[number]
    mass = link.mass
    largest, com, _ = (x[number] for x in problem.link_sizes)
    # A congruence under which the nominal link is the identity: a solver sees numbers
    # of one size.
    t = np.linalg.inv(
        np.linalg.cholesky(inertia.pseudo_inertia(problem.nominal_links[number]))
    )
    out = [t @ link.pseudo_inertia(thickness) @ t.T >> 0]
    out += _between(mass, max(box[0, 0], 0.0), largest)
    for axis, (lower, upper) in enumerate(box[1:4]):
        out += [link.h[axis] >= lower * mass] if np.isfinite(lower) else []
        out += [link.h[axis] <= upper * mass] if np.isfinite(upper) else []
    for cone in (cone for cone in problem.cones if cone.link == number + 1):
        along = "xyz".index(cone.axis)
        across = cp.hstack([link.h[a] for a in range(3) if a != along])
        out.append(cp.norm(across) <= cone.radius * mass + cone.slope * link.h[along])
    if problem._boxed[number]:
        for axis, entry in enumerate((4, 6, 9)):
            others = sum(com[a] ** 2 for a in range(3) if a != axis)
            out.append(link.J[axis, axis] <= box[entry, 1] + mass * others)
    else:
        out.append(cp.trace(link.sigma) <= mass * problem.link_defaults[number, 1] ** 2)
    # the mean square distance from the body's centre, in its half axes, is at most one
    if bodily:
        body = problem.link_bodies[number]
        square = 0.0
        for axis, half in zip(body.axes.T, body.half_axes, strict=True):
            centre = float(axis @ body.centre)
            along = (
                axis @ link.sigma @ axis
                - 2.0 * centre * (axis @ link.h)
                + centre**2 * mass
            )
            square = square + along / half**2
        out.append(square <= mass)
    return out


def _between(x, lower, upper):
    return ([x >= lower] if np.isfinite(lower) else []) + (
        [x <= upper] if np.isfinite(upper) else []
    )
