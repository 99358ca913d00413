"""Clarabel (Goulart, Chen 2024), called directly on our conic data: the default."""

from __future__ import annotations

import time

import numpy as np

from sdp_vs_penalty.solvers.conic import ConicProblem, Solution
from sdp_vs_penalty.solvers.options import options

NAME = "clarabel"
EXTRA = None  # part of the core installation
REQUIRES = ("package", "clarabel")
CONES = frozenset({"quadratic", "zero", "nonnegative", "soc", "psd", "exp"})

_CLAIMS = {
    "Solved": "optimal",
    "AlmostSolved": "inaccurate",
    "PrimalInfeasible": "infeasible",
    "AlmostPrimalInfeasible": "infeasible",
    "DualInfeasible": "unbounded",
    "AlmostDualInfeasible": "unbounded",
}


def solve(problem: ConicProblem, accuracy: float = 1e-9) -> Solution:
    """Solve to the accuracy asked for (relative gap and feasibility)."""
    import clarabel

    kinds = {
        "zero": clarabel.ZeroConeT,
        "nonnegative": clarabel.NonnegativeConeT,
        "soc": clarabel.SecondOrderConeT,
        "psd": clarabel.PSDTriangleConeT,
    }
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.max_threads = 1
    for key, value in options(NAME, accuracy).items():
        setattr(settings, key, value)
    cones = [
        clarabel.ExponentialConeT() if c.kind == "exp" else kinds[c.kind](c.size) for c in problem.cones
    ]
    start = time.perf_counter()
    solver = clarabel.DefaultSolver(problem.P, problem.q, problem.A, problem.b, cones, settings)
    ready = time.perf_counter()
    result = solver.solve()
    end = time.perf_counter()
    status = str(result.status)
    return Solution(
        np.array(result.x),
        np.array(result.z),
        _CLAIMS.get(status, "failed"),
        status,
        int(result.iterations),
        ready - start,
        end - ready,
    )
