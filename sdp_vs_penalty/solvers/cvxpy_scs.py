"""SCS as CVXPY calls it: our conic form, CVXPY's reductions."""

from __future__ import annotations

from sdp_vs_penalty.solvers import through_cvxpy
from sdp_vs_penalty.solvers.conic import ConicProblem, Solution
from sdp_vs_penalty.solvers.scs import options

NAME = "cvxpy-scs"
EXTRA = "solvers"
REQUIRES = ("package", "scs")
CONES = frozenset({"quadratic", "zero", "nonnegative", "soc", "psd", "exp"})
SAME_AS = "scs"  # in the shootout
warm_up = through_cvxpy.warm_up


def solve(problem: ConicProblem, accuracy: float = 1e-9) -> Solution:
    """Solve to the accuracy asked for, in the solver's own sense."""
    return through_cvxpy.solve(problem, "SCS", options(accuracy))
