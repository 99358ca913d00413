"""What users do without choosing an SDP solver: the formulas in CVXPY, or an exact penalty."""

import warnings
from typing import Any

import numpy as np

from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimators.penalty import fit_penalty
from sdp_vs_penalty.shootout.instance import Instance
from sdp_vs_penalty.shootout.judge import Answer, no_answer
from sdp_vs_penalty.solvers.through_cvxpy import CLAIMS

#: What CVXPY asks of its default solver for such problems, SCS.
CVXPY_ACCURACY = 1e-5
#: Starts of the penalty.
_STARTS = 3


def solve_cvxpy(instance: Instance, accuracy: float, solver: str | None) -> Answer:
    """The problem as its formulas read; prob.solve() alone, or with the solver that a user names."""
    import cvxpy as cp

    data, entropy = instance.data, instance.objective.entropy
    theta = cp.Variable(data.R.shape[1])

    def matrix(c: Any) -> Any:
        flat = c.coefficients.reshape(len(c.indices), -1).T @ theta[c.indices] + c.constant.ravel()
        square = cp.reshape(flat, c.constant.shape, order="C")
        return 0.5 * (square + square.T)

    constraints = []
    for c in instance.constraints.convex:
        if c.cone == "psd":
            constraints.append(matrix(c) >> 0)
            continue
        flat = c.coefficients.T @ theta[c.indices] + c.constant
        constraints.append(cp.SOC(flat[0], flat[1:]) if c.cone == "soc" else flat >= 0)
    objective = cp.sum_squares(data.R @ theta - data.rho)
    if entropy is not None:
        for link, p0 in zip(entropy.links, entropy.nominal, strict=True):
            trace = cp.trace(np.linalg.inv(p0) @ matrix(link))
            objective = objective + entropy.weight * (trace - cp.log_det(matrix(link)))
    problem = cp.Problem(cp.Minimize(objective), constraints)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            problem.solve(solver=solver)
    except cp.error.SolverError as error:
        return no_answer(instance, str(error))
    value = np.full(data.R.shape[1], np.nan) if theta.value is None else np.asarray(theta.value)
    status, stats = f"{problem.status} ({problem.solver_stats.solver_name})", problem.solver_stats
    return Answer(value, CLAIMS.get(problem.status, "failed"), status, int(stats.num_iters or 0))


def penalty_options(accuracy: float) -> dict[str, Any]:
    """What the penalty is told: its estimator's fields."""
    return {"starts": _STARTS, "tolerance": accuracy}


def solve_penalty(instance: Instance, accuracy: float) -> Answer:
    """The estimator ``penalty`` on the instance's constraints; its shifts are its multipliers."""
    try:
        fit = fit_penalty(instance.task, instance.data, instance.constraints, _STARTS, accuracy)
    except InputError as error:
        return no_answer(instance, error)
    runs = fit.details["runs"]
    best = min(runs, key=lambda run: run["objective"])
    claims = "optimal" if best["residual"] <= accuracy else "inaccurate"
    status, steps = f"residual {best['residual']:.1e}", int(best["stages"])
    return Answer(fit.theta, claims, status, steps, fit.multipliers, attempts=len(runs))
