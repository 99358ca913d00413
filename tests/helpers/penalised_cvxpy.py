"""The penalised problem's relaxation posed a second time, in CVXPY."""

import cvxpy as cp
import numpy as np


def cvxpy_optima(problem, weights):
    """Return the relaxation's optimum at each weight by CVXPY and Clarabel, as a check.

    The model is compiled once, with the weight as its parameter. theta is scaled by the
    torque that it makes, the loss by that of the feasible optimum.

    Parameters
    ----------
    problem : PenalisedProblem
        The problem, which is posed a second time.

    Returns
    -------
    dict
        Optimum by weight.
    """
    data = problem.data
    centre = problem.feasible.theta
    unit = max(problem.feasible.upper, 1e-12 * data.tau_squared)
    scale = _torque_scale(problem)
    x = cp.Variable(problem.p)
    y = cp.Variable(len(problem.prices), nonneg=True)
    # The slacks in units of (loss at the optimum) / xi, so that they cost one.
    slack_size = cp.Parameter(nonneg=True)
    price = cp.Parameter(nonneg=True)
    slack = slack_size * y
    theta = cp.hstack([centre + cp.multiply(scale, x), slack])
    demands = [_cvxpy(c, theta) for c in (*problem.hard, *problem.soft)]
    corner = np.diag([1.0, 1.0, 1.0, 0.0])
    for k, c in enumerate(problem.consistency):
        demands.append(_cvxpy_value(c, theta) + slack[k] * corner >> 0)
    root = np.sqrt(unit)
    at_centre = (data.R @ centre - data.rho) / root
    residual = (data.R * scale / root) @ x + at_centre
    cost = cp.sum_squares(residual) + price * (problem.prices @ y)
    program = cp.Problem(cp.Minimize(cost), demands)
    out = {}
    for xi in weights:
        slack_size.value = unit / xi if xi > 0.0 else 1.0
        price.value = 1.0 if xi > 0.0 else 0.0
        program.solve(solver="CLARABEL")
        if program.status in ("optimal", "optimal_inaccurate"):
            out[xi] = float(program.value) * unit + data.residual_norm**2
    return out


def _torque_scale(problem):
    """Return the size (p,) at which each parameter alone makes all the torque.

    It is at most the parameter's bound.
    """
    norms = problem.data.column_norms
    is_seen = norms > 0.0
    size = np.sqrt(problem.data.tau_squared) / np.where(is_seen, norms, np.inf)
    return np.where(is_seen, np.minimum(size, problem.bound), problem.bound)


def _cvxpy_value(c, theta):
    """Return the value F(theta) of a constraint as a CVXPY expression."""
    rows = c.coefficients.reshape(len(c.indices), -1).T
    value = rows @ theta[c.indices] + c.constant.ravel()
    if c.cone == "psd":
        return cp.reshape(value, c.constant.shape, order="C")
    return value


def _cvxpy(c, theta):
    """Return the CVXPY constraint that F(theta) lies in its second-order cone, or is
    >= 0.
    """
    value = _cvxpy_value(c, theta)
    if c.cone == "soc":
        return cp.norm(value[1:]) <= value[0]
    return value >= 0
