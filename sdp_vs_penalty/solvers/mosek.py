"""MOSEK, commercial, where its package and a licence are found; called through CVXPY."""

import os
from pathlib import Path
from typing import Any

from sdp_vs_penalty.solvers import through_cvxpy
from sdp_vs_penalty.solvers.conic import ConicProblem, Solution

NAME = "mosek"
EXTRA = "its vendor, with a licence"
REQUIRES = ("package", "mosek")
CONES = frozenset({"quadratic", "zero", "nonnegative", "soc", "psd", "exp"})
warm_up = through_cvxpy.warm_up


def licence() -> str | None:
    """What is missing of the licence, or None."""
    named = os.environ.get("MOSEKLM_LICENSE_FILE")
    if named and ("@" in named or Path(named).exists()):  # a file, or port@server
        return None
    if (Path.home() / "mosek" / "mosek.lic").is_file():
        return None
    return "no licence in MOSEKLM_LICENSE_FILE or ~/mosek/mosek.lic"


def options(accuracy: float) -> dict[str, Any]:
    """What the solver is told, in its own words, for a relative gap and feasibility."""
    return {
        "MSK_DPAR_INTPNT_CO_TOL_REL_GAP": accuracy,
        "MSK_DPAR_INTPNT_CO_TOL_PFEAS": accuracy,
        "MSK_DPAR_INTPNT_CO_TOL_DFEAS": accuracy,
    }


def solve(problem: ConicProblem, accuracy: float = 1e-10) -> Solution:
    """Solve to the accuracy asked for (relative gap and feasibility)."""
    return through_cvxpy.solve(problem, "MOSEK", {"mosek_params": options(accuracy)})
