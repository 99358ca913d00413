"""SDPA (Fujisawa, Fukuda, Kojima, Nakata, Yamashita) through sdpa-python."""

from typing import Any

import numpy as np

from sdp_vs_penalty.solvers.conic import ConicProblem, Solution
from sdp_vs_penalty.solvers.rewrite import full_matrices, linear_matrix_inequalities, reorder, sizes

NAME = "sdpa"
EXTRA = "solvers"
REQUIRES = ("package", "sdpap")
CONES = frozenset({"nonnegative", "psd"})

#: sdpa-python's own reading of the phase, in which our problem is the dual.
CLAIMS = {
    "pdOPT": "optimal",
    "pdFEAS": "inaccurate",
    "pFEAS": "inaccurate",
    "dFEAS": "inaccurate",
    "pINF_dFEAS": "infeasible",
    "pFEAS_dINF": "unbounded",
    "pUNBD": "unbounded",
    "dUNBD": "infeasible",
}


def options(accuracy: float) -> dict[str, Any]:
    """What the solver is told, in its own words, for a relative gap and feasibility."""
    return {"epsilonStar": accuracy, "epsilonDash": accuracy, "maxIteration": 200}


def solve(problem: ConicProblem, accuracy: float = 1e-10) -> Solution:
    """Solve to the accuracy asked for (gap and feasibility)."""
    import sdpap

    lmi = linear_matrix_inequalities(problem).then(reorder)
    full, dims = full_matrices(lmi.problem), sizes(lmi.problem.cones)
    p = full.problem
    # minimise c^T x subject to (-A) x - (-b) in J, x free
    free = sdpap.SymCone(f=len(p.q))
    cones = sdpap.SymCone(l=dims["l"], s=tuple(dims["s"]))
    settings = {**options(accuracy), "print": "no", "numThreads": 1}
    x, y, info, _, more = sdpap.solve(-p.A, -p.b, p.q, free, cones, settings)
    dense_x, dense_z = (np.asarray(v.todense()).ravel() for v in (x, y))
    x, z = lmi.back(*full.back(dense_x, dense_z))
    status = str(info.get("phasevalue"))
    claims = CLAIMS.get(status, "failed")
    return Solution(x, z, claims, status, int(more.get("iteration", 0)))
