"""SDPA (Fujisawa, Fukuda, Kojima, Nakata, Yamashita) through sdpa-python."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from sdp_vs_penalty.solvers.conic import ConicProblem, Solution
from sdp_vs_penalty.solvers.rewrite import KINDS, sizes
from sdp_vs_penalty.solvers.solver import ACCURACY, Solver

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


class Sdpa(Solver):
    name = "sdpa"
    extra = "solvers"
    requires = "package", "sdpap"
    cones = frozenset({"nonnegative", "psd"})
    order, full_matrices = KINDS, True
    told = {"epsilonStar": ACCURACY, "epsilonDash": ACCURACY, "maxIteration": 200}

    def run(self, problem: ConicProblem, told: Mapping[str, Any]) -> Solution:
        import sdpap

        dims = sizes(problem.cones)
        # minimise c^T x subject to (-A) x - (-b) in J, x free
        free = sdpap.SymCone(f=len(problem.q))
        cones = sdpap.SymCone(l=dims["l"], s=tuple(dims["s"]))
        settings = {**told, "print": "no", "numThreads": 1}
        x, y, info, _, more = sdpap.solve(-problem.A, -problem.b, problem.q, free, cones, settings)
        x, z = (np.asarray(v.todense()).ravel() for v in (x, y))
        status = str(info.get("phasevalue"))
        return Solution(x, z, CLAIMS.get(status, "failed"), status, int(more.get("iteration", 0)))
