"""CVXOPT's conelp (Andersen, Dahl, Vandenberghe) with its LDL factorisation."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.solvers.conic import ConicProblem, Solution
from sdp_vs_penalty.solvers.rewrite import full_matrices, linear_objective, reject, reorder, sizes

NAME = "cvxopt"
EXTRA = "solvers"
REQUIRES = ("package", "cvxopt")
CONES = frozenset({"zero", "nonnegative", "soc", "psd"})

_CLAIMS = {
    "optimal": "optimal",
    "primal infeasible": "infeasible",
    "dual infeasible": "unbounded",
    "unknown": "failed",
}


def options(accuracy: float) -> dict[str, Any]:
    """What the solver is told, in its own words, for a relative gap and feasibility."""
    return {"abstol": accuracy, "reltol": accuracy, "feastol": accuracy, "maxiters": 200}


def solve(problem: ConicProblem, accuracy: float = 1e-7) -> Solution:
    """Solve to the accuracy asked for (absolute and relative gap, feasibility)."""
    import cvxopt
    from cvxopt import solvers

    reject(problem, {"exp"})
    ordered = linear_objective(problem).then(reorder)
    p, dims = ordered.problem, sizes(ordered.problem.cones)
    full, equal = full_matrices(p), dims["z"]
    made, coo = full.problem, full.problem.A.tocoo()
    rows, columns = coo.row.astype(int), coo.col.astype(int)
    A, b = cvxopt.spmatrix(coo.data, rows, columns, coo.shape), cvxopt.matrix(made.b)
    parts = A[equal:, :], b[equal:], {k: dims[k] for k in "lqs"}, A[:equal, :], b[:equal]
    told = {**options(accuracy), "show_progress": False}
    try:
        result = solvers.conelp(cvxopt.matrix(made.q), *parts, kktsolver="ldl", options=told)
    except (ValueError, ArithmeticError) as error:
        return Solution.none(problem, str(error))
    status = result["status"]
    x = _array(result["x"], len(made.q))
    z = np.concatenate([_array(result["y"], equal), _array(result["z"], len(made.b) - equal)])
    seen = (p, *full.back(x, z))
    x, z = ordered.back(*seen[1:])
    return Solution(x, z, _CLAIMS[status], status, int(result["iterations"]), seen)


def _array(values: Any, size: int) -> NDArray[np.float64]:
    return np.full(size, np.nan) if values is None else np.array(values, float).ravel()
