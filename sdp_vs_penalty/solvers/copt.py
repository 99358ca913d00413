"""COPT, commercial, where its package and a licence are found; called through CVXPY."""

import os
from pathlib import Path
from typing import Any

from sdp_vs_penalty.solvers import through_cvxpy
from sdp_vs_penalty.solvers.conic import ConicProblem, Solution

NAME = "copt"
EXTRA = "its vendor, with a licence"
REQUIRES = ("package", "coptpy")
CONES = frozenset({"quadratic", "zero", "nonnegative", "soc", "psd", "exp"})
warm_up = through_cvxpy.warm_up


def licence() -> str | None:
    """What is missing of the licence, or None."""
    folders = [
        os.environ.get("COPT_LICENSE_DIR"),
        os.environ.get("COPT_HOME"),
        str(Path.home() / "copt"),
    ]
    if any(folder and (Path(folder) / "license.dat").is_file() for folder in folders):
        return None
    return "no license.dat in COPT_LICENSE_DIR, COPT_HOME or ~/copt"


def options(accuracy: float) -> dict[str, Any]:
    """What the solver is told, in its own words, for a relative gap and feasibility."""
    return {"RelGap": accuracy, "FeasTol": accuracy, "DualTol": accuracy}


def solve(problem: ConicProblem, accuracy: float = 1e-10) -> Solution:
    """Solve to the accuracy asked for (relative gap and feasibility)."""
    return through_cvxpy.solve(problem, "COPT", options(accuracy))
