"""CVXOPT's conelp (Andersen, Dahl, Vandenberghe) with its LDL factorisation."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.solvers.conic import ConicProblem, Solution
from sdp_vs_penalty.solvers.rewrite import full_matrices, linear_objective, reject, reorder

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
    start = time.perf_counter()
    kinds = ("zero", "nonnegative", "soc", "psd")
    ordered = linear_objective(problem).then(lambda p: reorder(p, kinds))
    p = ordered.problem
    full, dims = full_matrices(p)
    equal = sum(c.size for c in p.cones if c.kind == "zero")
    made = full.problem
    sparse_matrix = _to_cvxopt(made.A)
    right = cvxopt.matrix(made.b)
    ready = time.perf_counter()
    settings = {**options(accuracy), "show_progress": False}
    try:
        result = solvers.conelp(
            cvxopt.matrix(made.q),
            sparse_matrix[equal:, :],
            right[equal:],
            dims,
            sparse_matrix[:equal, :],
            right[:equal],
            kktsolver="ldl",
            options=settings,
        )
    except (ValueError, ArithmeticError, ZeroDivisionError) as error:
        end = time.perf_counter()
        nothing = np.full(len(problem.q), np.nan), np.full(len(problem.b), np.nan)
        return Solution(*nothing, "failed", str(error), 0, ready - start, end - ready)
    end = time.perf_counter()
    status = result["status"]
    x = _array(result["x"], len(made.q))
    z = np.concatenate([_array(result["y"], equal), _array(result["z"], len(made.b) - equal)])
    seen = (p, *full.back(x, z))
    x, z = ordered.back(*seen[1:])
    iterations = int(result["iterations"])
    return Solution(x, z, _CLAIMS[status], status, iterations, ready - start, end - ready, seen)


def _array(values: Any, size: int) -> NDArray[np.float64]:
    return np.full(size, np.nan) if values is None else np.array(values, float).ravel()


def _to_cvxopt(matrix: Any) -> Any:
    import cvxopt

    coo = matrix.tocoo()
    return cvxopt.spmatrix(coo.data, coo.row.astype(int), coo.col.astype(int), matrix.shape)
