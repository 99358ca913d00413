"""Clarabel as CVXPY calls it: our conic form, CVXPY's reductions."""

from __future__ import annotations

from sdp_vs_penalty.solvers import through_cvxpy
from sdp_vs_penalty.solvers.clarabel import options
from sdp_vs_penalty.solvers.conic import ConicProblem, Solution

NAME = "cvxpy-clarabel"
EXTRA = None  # part of the core installation
REQUIRES = ("package", "clarabel")
CONES = frozenset({"quadratic", "zero", "nonnegative", "soc", "psd", "exp"})
SAME_AS = "clarabel"  # in the shootout
warm_up = through_cvxpy.warm_up


def solve(problem: ConicProblem, accuracy: float = 1e-9) -> Solution:
    """Solve to the accuracy asked for, in the solver's own sense."""
    return through_cvxpy.solve(problem, "CLARABEL", options(accuracy))
