"""SCS (O'Donoghue, Chu, Parikh, Boyd 2016), a first-order splitting method, called directly."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.solvers.conic import Cone, ConicProblem, Solution
from sdp_vs_penalty.solvers.rewrite import reorder

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

    start = time.perf_counter()
    ordered = reorder(problem, ("zero", "nonnegative", "soc", "psd", "exp"))
    p = ordered.problem
    lower = _placed(p.cones, _from_upper)
    count = {kind: [c.size for c in p.cones if c.kind == kind] for kind in CONES}
    data = {"P": p.P, "A": p.A.tocsr()[lower].tocsc(), "b": p.b[lower], "c": p.q}
    cone = {
        "z": sum(count["zero"]),
        "l": sum(count["nonnegative"]),
        "q": count["soc"],
        "s": count["psd"],
        "ep": len(count["exp"]),
    }
    solver = scs.SCS(data, cone, verbose=False, **options(accuracy))
    ready = time.perf_counter()
    result = solver.solve()
    end = time.perf_counter()
    z = np.empty(len(lower))
    z[lower] = result["y"]
    x, z = ordered.back(np.array(result["x"]), z)
    info = result["info"]
    word, _, more = info["status"].partition(" ")
    claims = "inaccurate" if word == "solved" and more else _CLAIMS.get(word, "failed")
    return Solution(x, z, claims, info["status"], int(info["iter"]), ready - start, end - ready)


def upper_triangles(cones: Sequence[Cone]) -> NDArray[np.intp]:
    """SCS's rows in our order: a matrix's upper triangle column by column."""
    return _placed(cones, lambda d: np.argsort(_from_upper(d)))


def _from_upper(d: int) -> NDArray[np.intp]:
    """Of SCS's entries, a matrix's lower triangle column by column, our numbers."""
    i, j = np.triu_indices(d)  # entry (j, i), j >= i: column i of the lower triangle
    return np.asarray(j * (j + 1) // 2 + i)


def _placed(cones: Sequence[Cone], order: Callable[[int], NDArray[np.intp]]) -> NDArray[np.intp]:
    rows, start = [np.zeros(0, np.intp)], 0
    for cone in cones:
        rows.append(start + (order(cone.size) if cone.kind == "psd" else np.arange(cone.rows)))
        start += cone.rows
    return np.concatenate(rows)
