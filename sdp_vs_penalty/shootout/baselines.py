"""What users do without choosing an SDP solver: the formulas in CVXPY, or an exact penalty."""

from __future__ import annotations

import time
import warnings
from typing import Any

import numpy as np
from scipy import sparse

from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimators.penalty import fit_penalty
from sdp_vs_penalty.shootout.instance import Instance
from sdp_vs_penalty.shootout.judge import Answer, dimacs_error, no_answer
from sdp_vs_penalty.solvers import scs
from sdp_vs_penalty.solvers.conic import Cone, ConicProblem
from sdp_vs_penalty.solvers.through_cvxpy import CLAIMS

#: What CVXPY asks of its default solver for such problems, SCS.
CVXPY_ACCURACY = 1e-5
#: Starts of the penalty.
_STARTS = 3


def solve_cvxpy(instance: Instance, accuracy: float, solver: str | None) -> Answer:
    """The problem as its formulas read; prob.solve() alone, or with the solver that a user names."""
    import cvxpy as cp

    start = time.perf_counter()
    data = instance.data if instance.raw is None else instance.raw
    theta = cp.Variable(data.R.shape[1])
    constraints = []
    for c in instance.constraints.convex:
        flat = c.coefficients.reshape(len(c.indices), -1).T @ theta[c.indices] + c.constant.ravel()
        if c.cone == "psd":
            matrix = cp.reshape(flat, c.constant.shape, order="C")
            constraints.append(0.5 * (matrix + matrix.T) >> 0)
        elif c.cone == "soc":
            constraints.append(cp.SOC(flat[0], flat[1:]))
        else:
            constraints.append(flat >= 0)
    objective = cp.sum_squares(data.R @ theta - data.rho)
    entropy = instance.objective.entropy
    if entropy is not None:
        for link, p0 in zip(entropy.links, entropy.nominal, strict=True):
            flat = link.coefficients.reshape(10, 16).T @ theta[link.indices]
            matrix = cp.reshape(flat, (4, 4), order="C")
            matrix = 0.5 * (matrix + matrix.T)
            trace = cp.trace(np.linalg.inv(p0) @ matrix)
            objective = objective + entropy.weight * (trace - cp.log_det(matrix))
    problem = cp.Problem(cp.Minimize(objective), constraints)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            dimacs = _solved(problem, solver)
    except cp.error.SolverError as error:
        return no_answer(instance, str(error), time.perf_counter() - start)
    total, stats = time.perf_counter() - start, problem.solver_stats
    inside = float(stats.solve_time or 0.0)
    value = np.full(data.R.shape[1], np.nan) if theta.value is None else np.asarray(theta.value)
    status = f"{problem.status} ({stats.solver_name})"
    claims, steps = CLAIMS.get(problem.status, "failed"), int(stats.num_iters or 0)
    return Answer(value, claims, status, steps, total - inside, inside, dimacs=dimacs)


def _solved(problem: Any, solver: str | None) -> float:
    """problem.solve() in its own steps, for the DIMACS error of what CVXPY's solver saw."""
    data, chain, inverse = problem.get_problem_data(solver, solver_opts={})
    raw = chain.solve_via_data(problem, data, solver_opts={})
    problem.unpack_results(raw, chain, inverse)
    dims, columns = data["dims"], len(data["c"])
    cones = [Cone("zero", dims.zero), Cone("nonnegative", dims.nonneg)]
    cones += [Cone("soc", d) for d in dims.soc] + [Cone("psd", d) for d in dims.psd]
    cones += [Cone("exp", 3)] * dims.exp
    quadratic = data.get("P")
    P = sparse.csc_matrix((columns, columns) if quadratic is None else sparse.triu(quadratic))
    A, b = sparse.csr_matrix(data["A"]), np.asarray(data["b"], float)
    if problem.solver_stats.solver_name == "SCS":
        x, z, rows = raw["x"], raw["y"], scs.upper_triangles(tuple(cones))
        A, b, z = A[rows], b[rows], np.asarray(z)[rows]
    else:
        x, z = raw.x, raw.z
    seen = ConicProblem(P, np.asarray(data["c"], float), sparse.csc_matrix(A), b, tuple(cones))
    return dimacs_error(seen, np.asarray(x, float), np.asarray(z, float))


def penalty_options(accuracy: float) -> dict[str, Any]:
    """What the penalty is told: its estimator's fields."""
    return {"starts": _STARTS, "tolerance": accuracy}


def solve_penalty(instance: Instance, accuracy: float) -> Answer:
    """The estimator ``penalty`` on the instance's constraints; its shifts are its multipliers."""
    start = time.perf_counter()
    try:
        fit = fit_penalty(instance.task, instance.data, instance.constraints, _STARTS, accuracy)
    except InputError as error:
        return no_answer(instance, error, time.perf_counter() - start)
    seconds = time.perf_counter() - start
    runs = fit.details["runs"]
    best = min(runs, key=lambda run: run["objective"])
    claims = "optimal" if best["residual"] <= accuracy else "inaccurate"
    status, steps = f"residual {best['residual']:.1e}", int(best["iterations"])
    return Answer(fit.theta, claims, status, steps, 0.0, seconds, fit.multipliers, attempts=len(runs))
