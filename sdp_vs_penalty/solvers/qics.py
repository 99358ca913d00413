"""QICS (He, Saunderson, Fawzi 2024), an interior-point method for nonsymmetric cones."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from scipy import sparse

from sdp_vs_penalty.solvers.conic import Cone, ConicProblem, Solution
from sdp_vs_penalty.solvers.rewrite import full_matrices, linear_objective, reorder

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

    start = time.perf_counter()
    kinds = ("zero", "nonnegative", "soc", "psd", "exp")
    ordered = linear_objective(problem).then(lambda p: reorder(p, kinds))
    p = ordered.problem
    full, _ = full_matrices(p)
    made = full.problem
    equal = sum(c.size for c in p.cones if c.kind == "zero")
    signs = np.ones(len(made.b))
    cones = []
    at = equal
    for cone in p.cones:
        if cone.kind == "nonnegative":
            cones.append(qics.cones.NonNegOrthant(cone.size))
        elif cone.kind == "soc":
            cones.append(qics.cones.SecondOrder(cone.size - 1))
        elif cone.kind == "psd":
            cones.append(qics.cones.PosSemidefinite(cone.size))
        elif cone.kind == "exp":
            # y exp(x / y) <= z exactly if -x >= y log(y / z)
            cones.append(qics.cones.ClassRelEntr(1))
            signs[at] = -1.0
        at += 0 if cone.kind == "zero" else cone.size**2 if cone.kind == "psd" else cone.size
    matrix = sparse.diags(signs) @ made.A.tocsr()
    right = signs * made.b
    model = qics.Model(
        made.q[:, None],
        A=matrix[:equal],
        b=right[:equal, None],
        G=sparse.csr_matrix(matrix[equal:]),
        h=right[equal:, None],
        cones=cones,
    )
    solver = qics.Solver(model, verbose=0, **options(accuracy))
    ready = time.perf_counter()
    info = solver.solve()
    end = time.perf_counter()
    x = np.asarray(info["x_opt"]).ravel()
    z = signs * np.concatenate([np.asarray(info["y_opt"]).ravel(), _stacked(info["z_opt"])])
    seen = (p, *full.back(x, z))
    x, z = ordered.back(*seen[1:])
    status = f"{info['sol_status']} ({info['exit_status']})"
    claims = _CLAIMS.get(info["sol_status"], "failed")
    return Solution(x, z, claims, status, int(info["num_iter"]), ready - start, end - ready, seen)


def _stacked(point: object) -> np.ndarray:
    """All cones' entries in one vector, whatever container this version of QICS returns."""
    vector = getattr(point, "vec", point)
    return np.asarray(vector, float).ravel()


def warm_up() -> None:
    """QICS compiles its code for each cone on first use: a tiny problem that has them all."""
    rows = np.eye(2)
    square = np.array([[1.0, 0.0], [0.0, 0.0], [0.0, 1.0]])
    cones = (Cone("nonnegative", 2), Cone("soc", 3), Cone("psd", 2), Cone("exp", 3))
    A = sparse.csc_matrix(-np.vstack([rows, [[0, 0], [1, 0], [0, 1]], square, [[1, 0], [0, 0], [0, 1]]]))
    b = np.array([0.0, 0.0, 9.0, 0.0, 0.0, 1.0, 0.0, 1.0, 0.0, 1.0, 9.0])
    empty = sparse.csc_matrix((2, 2))
    solve(ConicProblem(empty, np.ones(2), A, b, cones), 1e-4)
