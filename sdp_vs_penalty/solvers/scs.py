"""SCS (O'Donoghue, Chu, Parikh, Boyd 2016), a first-order splitting method, called directly."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from sdp_vs_penalty.solvers.conic import ConicProblem, Solution
from sdp_vs_penalty.solvers.rewrite import KINDS, sizes
from sdp_vs_penalty.solvers.solver import ACCURACY, Solver

#: The first word of its status; what follows says that it is inaccurate.
_CLAIMS = {"solved": "optimal", "infeasible": "infeasible", "unbounded": "unbounded"}


class Scs(Solver):
    name = "scs"
    extra = "solvers"
    requires = "package", "scs"
    order = KINDS
    finest = 1e-7
    # The rest are its defaults, which its documentation recommends (adaptive scale, normalisation,
    # Anderson acceleration over 10 steps).
    told = {"eps_abs": ACCURACY, "eps_rel": ACCURACY, "max_iters": 100_000}

    def run(self, problem: ConicProblem, told: Mapping[str, Any]) -> Solution:
        import scs

        rows, start = [np.zeros(0, np.intp)], 0
        for cone in problem.cones:
            i, j = np.triu_indices(cone.size)  # entry (j, i), j >= i: column i of the lower triangle
            rows.append(start + (j * (j + 1) // 2 + i if cone.kind == "psd" else np.arange(cone.rows)))
            start += cone.rows
        lower = np.concatenate(rows)
        A = problem.A.tocsr()[lower].tocsc()
        data = {"P": problem.P, "A": A, "b": problem.b[lower], "c": problem.q}
        result = scs.SCS(data, sizes(problem.cones), verbose=False, **told).solve()
        z, info = np.empty(len(lower)), result["info"]
        z[lower] = result["y"]
        word, _, more = info["status"].partition(" ")
        claims = "inaccurate" if word == "solved" and more else _CLAIMS.get(word, "failed")
        return Solution(np.array(result["x"]), z, claims, info["status"], int(info["iter"]))
