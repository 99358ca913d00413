"""Our conic form stated in CVXPY and handed to one of its solvers."""

import warnings
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from sdp_vs_penalty.solvers.conic import Cone, ConicProblem, Solution, svec
from sdp_vs_penalty.solvers.rewrite import full_matrices, quadratic_factor

CLAIMS = {
    "optimal": "optimal",
    "optimal_inaccurate": "inaccurate",
    "infeasible": "infeasible",
    "infeasible_inaccurate": "infeasible",
    "unbounded": "unbounded",
    "unbounded_inaccurate": "unbounded",
}


def warm_up() -> None:
    """Import CVXPY and let it build every kind of cone once; starts no thread and runs no solver."""
    import cvxpy as cp

    x = cp.Variable(2)
    square = cp.reshape(cp.hstack([x, x]), (2, 2), order="F")
    cones = [square + square.T >> 0, cp.SOC(x[0], x[1:])]
    cp.Problem(cp.Minimize(cp.sum_squares(x)), cones).get_problem_data("CLARABEL")


def solve(problem: ConicProblem, solver: str, settings: dict[str, Any]) -> Solution:
    """Build the CVXPY problem, solve it by CVXPY's solver of that name, read x and z back."""
    import cvxpy as cp

    x = cp.Variable(len(problem.q))
    objective = problem.q @ x
    if problem.P.nnz:
        objective = objective + 0.5 * cp.sum_squares(quadratic_factor(problem) @ x)
    full = full_matrices(problem).problem
    constraints = []
    at = 0
    for cone in problem.cones:
        rows = slice(at, at + (cone.size**2 if cone.kind == "psd" else cone.rows))
        at = rows.stop
        slack = full.b[rows] - sparse.csr_matrix(full.A)[rows] @ x
        constraints.append(_membership(cone, slack))
    model = cp.Problem(cp.Minimize(objective), constraints)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            model.solve(solver=solver, **settings)
    except cp.error.SolverError as error:
        return Solution.none(problem, str(error))
    missing = np.full(len(problem.q), np.nan)
    values = missing if x.value is None else np.asarray(x.value, float)
    z = np.concatenate([_dual(c, m) for c, m in zip(problem.cones, constraints, strict=True)])
    claims, steps = CLAIMS.get(model.status, "failed"), int(model.solver_stats.num_iters or 0)
    return Solution(values, z, claims, model.status, steps)


def _membership(cone: Cone, slack: Any) -> Any:
    import cvxpy as cp

    if cone.kind == "zero":
        return slack == 0
    if cone.kind == "nonnegative":
        return slack >= 0
    if cone.kind == "soc":
        return cp.SOC(slack[0], slack[1:])
    if cone.kind == "psd":
        matrix = cp.reshape(slack, (cone.size, cone.size), order="F")
        return 0.5 * (matrix + matrix.T) >> 0
    return cp.ExpCone(slack[0], slack[1], slack[2])


def _dual(cone: Cone, constraint: Any) -> NDArray[np.float64]:
    value = constraint.dual_value
    if value is None or (isinstance(value, list) and value[0] is None):
        return np.full(cone.rows, np.nan)
    if cone.kind == "psd":
        return svec(np.asarray(0.5 * (value + value.T), float))
    if isinstance(value, list):
        return np.concatenate([np.ravel(np.asarray(v, float)) for v in value])
    return np.ravel(np.asarray(value, float))
