"""Clarabel (Goulart, Chen 2024), called directly on our conic data: the default."""

from typing import Any

import numpy as np

from sdp_vs_penalty.solvers.conic import ConicProblem, Solution

NAME = "clarabel"
EXTRA = None  # part of the core installation
REQUIRES = ("package", "clarabel")
CONES = frozenset({"quadratic", "zero", "nonnegative", "soc", "psd", "exp"})

#: Numbers that it takes for infinite: rows with such a right side are dropped, or make it panic.
_INFINITE = 1e20
_CLAIMS = {
    "Solved": "optimal",
    "AlmostSolved": "inaccurate",
    "PrimalInfeasible": "infeasible",
    "AlmostPrimalInfeasible": "infeasible",
    "DualInfeasible": "unbounded",
    "AlmostDualInfeasible": "unbounded",
}


def options(accuracy: float) -> dict[str, Any]:
    """What the solver is told, in its own words, for a relative gap and feasibility."""
    return {"tol_gap_abs": accuracy, "tol_gap_rel": accuracy, "tol_feas": accuracy}


def solve(problem: ConicProblem, accuracy: float = 1e-10) -> Solution:
    """Solve to the accuracy asked for (relative gap and feasibility)."""
    import clarabel

    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.max_threads = 1
    # Supernodal: as fast as the default on an arm, twice as fast on sixty links.
    settings.direct_solve_method = "faer"
    # A pivot whose sign rounding has turned would be replaced by 2e-7, far above the accuracy that
    # links of unequal size need: over 540 random arms that made one certified gap in twenty loose.
    settings.dynamic_regularization_enable = False
    settings.static_regularization_constant = 1e-10
    for key, value in options(accuracy).items():
        setattr(settings, key, value)
    kinds = {
        "zero": clarabel.ZeroConeT,
        "nonnegative": clarabel.NonnegativeConeT,
        "soc": clarabel.SecondOrderConeT,
        "psd": clarabel.PSDTriangleConeT,
    }
    cones = [
        clarabel.ExponentialConeT() if c.kind == "exp" else kinds[c.kind](c.size) for c in problem.cones
    ]
    if np.max(np.abs(problem.b), initial=0.0) >= _INFINITE:
        return Solution.none(problem, "data beyond 1e20")
    solver = clarabel.DefaultSolver(problem.P, problem.q, problem.A, problem.b, cones, settings)
    result = solver.solve()
    status, x, z = str(result.status), np.array(result.x), np.array(result.z)
    return Solution(x, z, _CLAIMS.get(status, "failed"), status, int(result.iterations))
