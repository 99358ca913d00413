"""QICS (He, Saunderson, Fawzi 2024), an interior-point method for nonsymmetric cones."""

from typing import Any

import numpy as np
from scipy import sparse

from sdp_vs_penalty.solvers.conic import Cone, ConicProblem, Solution
from sdp_vs_penalty.solvers.rewrite import full_matrices, linear_objective, reorder, sizes

NAME = "qics"
EXTRA = "solvers"
REQUIRES = ("package", "qics")
CONES = frozenset({"zero", "nonnegative", "soc", "psd", "exp"})

_CLAIMS = {
    "optimal": "optimal",
    "near_optimal": "inaccurate",
    "pinfeas": "infeasible",
    "near_pinfeas": "infeasible",
    "dinfeas": "unbounded",
    "near_dinfeas": "unbounded",
}


def options(accuracy: float) -> dict[str, Any]:
    """What the solver is told, in its own words, for a relative gap and feasibility.

    Iterative refinement and third-order adjustments are on by default, as its documentation recommends.
    """
    return {"tol_gap": accuracy, "tol_feas": accuracy, "max_iter": 200}


def solve(problem: ConicProblem, accuracy: float = 1e-10) -> Solution:
    """Solve to the accuracy asked for (gap and feasibility)."""
    import qics

    ordered = linear_objective(problem).then(reorder)
    p = ordered.problem
    full, equal = full_matrices(p), sizes(p.cones)["z"]
    made, cones = full.problem, []
    # y exp(x / y) <= z exactly if -x >= y log(y / z): the first of each three rows with another sign.
    exponential = len(made.b) - 3 * sizes(p.cones)["ep"]
    signs = np.ones(len(made.b))
    signs[exponential::3] = -1.0
    for cone in p.cones:
        if cone.kind == "nonnegative":
            cones.append(qics.cones.NonNegOrthant(cone.size))
        elif cone.kind == "soc":
            cones.append(qics.cones.SecondOrder(cone.size - 1))
        elif cone.kind == "psd":
            cones.append(qics.cones.PosSemidefinite(cone.size))
        elif cone.kind == "exp":
            cones.append(qics.cones.ClassRelEntr(1))
    A, b = sparse.csr_matrix(sparse.diags(signs) @ made.A), (signs * made.b)[:, None]
    parts = {"A": A[:equal], "b": b[:equal], "G": A[equal:], "h": b[equal:]}
    model = qics.Model(made.q[:, None], **parts, cones=cones)
    info = qics.Solver(model, verbose=0, **options(accuracy)).solve()
    x = np.asarray(info["x_opt"]).ravel()
    duals = info["y_opt"], getattr(info["z_opt"], "vec", info["z_opt"])  # as versions of QICS have it
    z = signs * np.concatenate([np.asarray(dual, float).ravel() for dual in duals])
    seen = (p, *full.back(x, z))
    x, z = ordered.back(*seen[1:])
    status = f"{info['sol_status']} ({info['exit_status']})"
    claims = _CLAIMS.get(info["sol_status"], "failed")
    return Solution(x, z, claims, status, int(info["num_iter"]), seen)


def warm_up() -> None:
    """QICS compiles its code for each cone on first use: a tiny problem that has them all."""
    rows = np.eye(2)
    square = np.array([[1.0, 0.0], [0.0, 0.0], [0.0, 1.0]])
    cones = (Cone("nonnegative", 2), Cone("soc", 3), Cone("psd", 2), Cone("exp", 3))
    A = sparse.csc_matrix(-np.vstack([rows, [[0, 0], [1, 0], [0, 1]], square, [[1, 0], [0, 0], [0, 1]]]))
    b = np.array([0.0, 0.0, 9.0, 0.0, 0.0, 1.0, 0.0, 1.0, 0.0, 1.0, 9.0])
    empty = sparse.csc_matrix((2, 2))
    solve(ConicProblem(empty, np.ones(2), A, b, cones), 1e-4)
