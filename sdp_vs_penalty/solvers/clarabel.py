"""Clarabel (Goulart, Chen 2024), called directly on our conic data: the default."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.solvers.conic import ConicProblem, Solution

Array = NDArray[np.float64]

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


def options(accuracy: float) -> dict[str, Any]:
    """What the solver is told, in its own words, for a relative gap and feasibility."""
    return {"tol_gap_abs": accuracy, "tol_gap_rel": accuracy, "tol_feas": accuracy}


def solve(problem: ConicProblem, accuracy: float = 1e-9) -> Solution:
    """Solve to the accuracy asked for (relative gap and feasibility)."""
    import clarabel

    settings, cones = _settings(accuracy), _cones(problem)
    start = time.perf_counter()
    solver = clarabel.DefaultSolver(problem.P, problem.q, problem.A, problem.b, cones, settings)
    ready = time.perf_counter()
    result = solver.solve()
    return _solution(result, ready - start, time.perf_counter() - ready)


def _settings(accuracy: float) -> Any:
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
    return settings


def _cones(problem: ConicProblem) -> list[Any]:
    import clarabel

    kinds = {
        "zero": clarabel.ZeroConeT,
        "nonnegative": clarabel.NonnegativeConeT,
        "soc": clarabel.SecondOrderConeT,
        "psd": clarabel.PSDTriangleConeT,
    }
    return [
        clarabel.ExponentialConeT() if c.kind == "exp" else kinds[c.kind](c.size) for c in problem.cones
    ]


def _solution(result: Any, setup: float, seconds: float) -> Solution:
    status = str(result.status)
    claims = _CLAIMS.get(status, "failed")
    x, z = np.array(result.x), np.array(result.z)
    return Solution(x, z, claims, status, int(result.iterations), setup, seconds)


class Updated:
    """One problem solved again and again with new values in A and b at the same places.

    Clarabel keeps its ordering and symbolic factorisation between solves (its data update), which
    needs presolve off and every place of A that will ever be non-zero to be stored from the start.
    """

    def __init__(self, problem: ConicProblem, accuracy: float) -> None:
        import clarabel

        settings = _settings(accuracy)
        settings.presolve_enable = False
        settings.chordal_decomposition_enable = False
        settings.input_sparse_dropzeros = False
        self._values = problem.A.data.copy()
        self._b = problem.b.copy()
        start = time.perf_counter()
        self._solver = clarabel.DefaultSolver(
            problem.P, problem.q, problem.A, problem.b, _cones(problem), settings
        )
        self._setup = time.perf_counter() - start

    def solve(self, where: NDArray[np.intp], values: Array, b: Array) -> Solution:
        """Solve with A.data[where] = values and the first rows of b replaced."""
        start = time.perf_counter()
        self._values[where] = values
        self._b[: len(b)] = b
        self._solver.update(A=self._values, b=self._b)
        ready = time.perf_counter()
        result = self._solver.solve()
        return _solution(result, ready - start, time.perf_counter() - ready)
