"""Clarabel, in a file of its own: what runs by default imports no other solver."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from sdp_vs_penalty.solvers.conic import ConicProblem, Solution
from sdp_vs_penalty.solvers.solver import ACCURACY, Solver


class Clarabel(Solver):
    """Clarabel (Goulart, Chen 2024), called directly on our conic data: the default."""

    name = "clarabel"
    requires = "package", "clarabel"
    default_options = {
        **dict.fromkeys(("tol_gap_abs", "tol_gap_rel", "tol_feas"), ACCURACY),
        "max_threads": 1,
    }
    tuned_options = {
        "direct_solve_method": "faer",
        # A pivot whose sign rounding has turned would be replaced by 2e-7, far above
        # the accuracy that links of unequal size need: over 540 random arms that made
        # one certified gap in twenty loose.
        "dynamic_regularization_enable": False,
        "static_regularization_constant": 1e-10,
    }
    status_meaning = {
        "Solved": "optimal",
        "PrimalInfeasible": "infeasible",
        "DualInfeasible": "unbounded",
        **dict.fromkeys(
            ("AlmostSolved", "AlmostPrimalInfeasible", "AlmostDualInfeasible"),
            "inaccurate",
        ),
    }

    def run(self, problem: ConicProblem, options: Mapping[str, Any]) -> Solution:
        """Solve a conic problem by the package Clarabel.

        The problem is: minimise x^T P x / 2 + q^T x so that b - A x lies in a product
        of cones. ``options`` are Clarabel's settings by name. Returns the variables x
        (m,), the multipliers z (rows,) and Clarabel's status.
        """
        import clarabel

        # By default (set_infinity, presolve_enable) Clarabel takes an entry of b beyond
        # 1e20 for infinite: it drops the row, or panics.
        if np.max(np.abs(problem.b), initial=0.0) >= 1e20:
            return Solution.none(problem, "data beyond 1e20")
        settings = clarabel.DefaultSettings()
        settings.verbose = False
        for key, value in options.items():
            setattr(settings, key, value)
        make_cone_of_kind = {
            "zero": clarabel.ZeroConeT,
            "nonnegative": clarabel.NonnegativeConeT,
            "soc": clarabel.SecondOrderConeT,
            "psd": clarabel.PSDTriangleConeT,
            "exp": lambda size: clarabel.ExponentialConeT(),
        }
        cones = [make_cone_of_kind[cone.kind](cone.size) for cone in problem.cones]
        solver = clarabel.DefaultSolver(
            problem.P, problem.q, problem.A, problem.b, cones, settings
        )
        result = solver.solve()
        x = np.array(result.x)
        z = np.array(result.z)
        return self.make_solution(x, z, str(result.status), result.iterations)
