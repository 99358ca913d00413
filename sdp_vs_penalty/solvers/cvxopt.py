"""CVXOPT's conelp (Andersen, Dahl, Vandenberghe) with its LDL factorisation."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.solvers.conic import ConicProblem, Solution
from sdp_vs_penalty.solvers.rewrite import KINDS, sizes
from sdp_vs_penalty.solvers.solver import ACCURACY, Solver

_CLAIMS = {"optimal": "optimal", "primal infeasible": "infeasible", "dual infeasible": "unbounded"}


class Cvxopt(Solver):
    name = "cvxopt"
    extra = "solvers"
    requires = "package", "cvxopt"
    cones = frozenset({"zero", "nonnegative", "soc", "psd"})
    order, full_matrices = KINDS, True
    finest = 1e-7
    told = {**dict.fromkeys(("abstol", "reltol", "feastol"), ACCURACY), "maxiters": 200}

    def run(self, problem: ConicProblem, told: Mapping[str, Any]) -> Solution:
        import cvxopt
        from cvxopt import solvers

        dims, coo = sizes(problem.cones), problem.A.tocoo()
        equal, rows, columns = dims["z"], coo.row.astype(int), coo.col.astype(int)
        A, b = cvxopt.spmatrix(coo.data, rows, columns, coo.shape), cvxopt.matrix(problem.b)
        parts = A[equal:, :], b[equal:], {k: dims[k] for k in "lqs"}, A[:equal, :], b[:equal]
        options = {**told, "show_progress": False}
        try:
            result = solvers.conelp(cvxopt.matrix(problem.q), *parts, kktsolver="ldl", options=options)
        except (ValueError, ArithmeticError) as error:
            return Solution.none(problem, str(error))
        status, x = result["status"], _array(result["x"], len(problem.q))
        z = _array(result["y"], equal), _array(result["z"], len(problem.b) - equal)
        claims = _CLAIMS.get(status, "failed")
        return Solution(x, np.concatenate(z), claims, status, int(result["iterations"]))


def _array(values: Any, size: int) -> Array:
    return np.full(size, np.nan) if values is None else np.array(values, float).ravel()
