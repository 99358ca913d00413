"""What each solver is told for an accuracy asked of it: all of it, in one place.

accuracy : relative gap and feasibility, in the solver's own sense of both.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

#: Iterations after which an interior-point method is stopped.
_STEPS = 200

_OPTIONS: dict[str, Callable[[float], dict[str, Any]]] = {
    "clarabel": lambda eps: {"tol_gap_abs": eps, "tol_gap_rel": eps, "tol_feas": eps},
    "cvxpy-clarabel": lambda eps: {"tol_gap_abs": eps, "tol_gap_rel": eps, "tol_feas": eps},
    "scs": lambda eps: {"eps_abs": eps, "eps_rel": eps, "max_iters": 100_000},
    "cvxpy-scs": lambda eps: {"eps_abs": eps, "eps_rel": eps, "max_iters": 100_000},
    "cvxopt": lambda eps: {"abstol": eps, "reltol": eps, "feastol": eps, "maxiters": _STEPS},
    "sdpa": lambda eps: {"epsilonStar": eps, "epsilonDash": eps, "maxIteration": _STEPS},
    "sdpa-program": lambda eps: {"epsilonStar": eps, "epsilonDash": eps, "maxIteration": _STEPS},
    "qics": lambda eps: {"tol_gap": eps, "tol_feas": eps, "max_iter": _STEPS},
    "csdp": lambda eps: {"axtol": eps, "atytol": eps, "objtol": eps, "maxiter": _STEPS},
    "dsdp": lambda eps: {"gaptol": eps, "maxit": 5 * _STEPS},
    "copt": lambda eps: {"RelGap": eps, "FeasTol": eps, "DualTol": eps},
    "mosek": lambda eps: {
        "MSK_DPAR_INTPNT_CO_TOL_REL_GAP": eps,
        "MSK_DPAR_INTPNT_CO_TOL_PFEAS": eps,
        "MSK_DPAR_INTPNT_CO_TOL_DFEAS": eps,
    },
}


def options(solver: str, accuracy: float) -> dict[str, Any]:
    """The options of a solver for an accuracy, under the solver's own names."""
    return _OPTIONS[solver](accuracy)
