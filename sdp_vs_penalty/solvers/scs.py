"""SCS (O'Donoghue, Chu, Parikh, Boyd 2016), a first-order splitting method, called directly."""

from typing import Any

import numpy as np

from sdp_vs_penalty.solvers.conic import ConicProblem, Solution
from sdp_vs_penalty.solvers.rewrite import reorder, sizes

NAME = "scs"
EXTRA = "solvers"
REQUIRES = ("package", "scs")
CONES = frozenset({"quadratic", "zero", "nonnegative", "soc", "psd", "exp"})

#: The first word of its status; what follows says that it is inaccurate.
_CLAIMS = {"solved": "optimal", "infeasible": "infeasible", "unbounded": "unbounded"}


def options(accuracy: float) -> dict[str, Any]:
    """What the solver is told, in its own words, for a relative gap and feasibility.

    The rest are its defaults, which its documentation recommends (adaptive scale, normalisation,
    Anderson acceleration over 10 steps).
    """
    return {"eps_abs": accuracy, "eps_rel": accuracy, "max_iters": 100_000}


def solve(problem: ConicProblem, accuracy: float = 1e-7) -> Solution:
    """Solve to the accuracy asked for (absolute and relative residuals)."""
    import scs

    ordered = reorder(problem)
    p, rows, start = ordered.problem, [np.zeros(0, np.intp)], 0
    for cone in p.cones:
        i, j = np.triu_indices(cone.size)  # entry (j, i), j >= i: column i of the lower triangle
        rows.append(start + (j * (j + 1) // 2 + i if cone.kind == "psd" else np.arange(cone.rows)))
        start += cone.rows
    lower = np.concatenate(rows)
    data = {"P": p.P, "A": p.A.tocsr()[lower].tocsc(), "b": p.b[lower], "c": p.q}
    result = scs.SCS(data, sizes(p.cones), verbose=False, **options(accuracy)).solve()
    z = np.empty(len(lower))
    z[lower] = result["y"]
    x, z = ordered.back(np.array(result["x"]), z)
    info = result["info"]
    word, _, more = info["status"].partition(" ")
    claims = "inaccurate" if word == "solved" and more else _CLAIMS.get(word, "failed")
    return Solution(x, z, claims, info["status"], int(info["iter"]))
