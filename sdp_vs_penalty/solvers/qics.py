"""QICS (He, Saunderson, Fawzi 2024), an interior-point method for nonsymmetric cones."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy import sparse

from sdp_vs_penalty.solvers.conic import Cone, ConicProblem, Solution
from sdp_vs_penalty.solvers.rewrite import KINDS, sizes
from sdp_vs_penalty.solvers.solver import ACCURACY, EVERYTHING, Solver

_CLAIMS = {
    "optimal": "optimal",
    "near_optimal": "inaccurate",
    "pinfeas": "infeasible",
    "near_pinfeas": "infeasible",
    "dinfeas": "unbounded",
    "near_dinfeas": "unbounded",
}


class Qics(Solver):
    name = "qics"
    extra = "solvers"
    requires = "package", "qics"
    cones = EVERYTHING - {"quadratic"}
    order, full_matrices = KINDS, True
    # Iterative refinement and third-order adjustments are on by default, as its manual recommends.
    told = {"tol_gap": ACCURACY, "tol_feas": ACCURACY, "max_iter": 200}

    def run(self, problem: ConicProblem, told: Mapping[str, Any]) -> Solution:
        import qics

        made = {
            "nonnegative": qics.cones.NonNegOrthant,
            "soc": lambda size: qics.cones.SecondOrder(size - 1),
            "psd": qics.cones.PosSemidefinite,
            "exp": lambda size: qics.cones.ClassRelEntr(1),
        }
        cones = [made[cone.kind](cone.size) for cone in problem.cones if cone.kind != "zero"]
        dims, rows = sizes(problem.cones), len(problem.b)
        # y exp(x / y) <= z exactly if -x >= y log(y / z): of three rows the first with another sign.
        signs, equal = np.ones(rows), dims["z"]
        signs[rows - 3 * dims["ep"] :: 3] = -1.0
        A, b = sparse.csr_matrix(sparse.diags(signs) @ problem.A), (signs * problem.b)[:, None]
        parts = {"A": A[:equal], "b": b[:equal], "G": A[equal:], "h": b[equal:]}
        model = qics.Model(problem.q[:, None], **parts, cones=cones)
        info = qics.Solver(model, verbose=0, **told).solve()
        duals = (
            info["y_opt"],
            getattr(info["z_opt"], "vec", info["z_opt"]),
        )  # as versions of QICS have it
        z = signs * np.concatenate([np.asarray(dual, float).ravel() for dual in duals])
        status = f"{info['sol_status']} ({info['exit_status']})"
        claims = _CLAIMS.get(info["sol_status"], "failed")
        return Solution(np.asarray(info["x_opt"]).ravel(), z, claims, status, int(info["num_iter"]))

    def warm_up(self) -> None:
        """It compiles its code for each cone on first use: a tiny problem that has them all."""
        rows = np.eye(2)
        square = np.array([[1.0, 0.0], [0.0, 0.0], [0.0, 1.0]])
        cones = (Cone("nonnegative", 2), Cone("soc", 3), Cone("psd", 2), Cone("exp", 3))
        below = [[0, 0], [1, 0], [0, 1]], square, [[1, 0], [0, 0], [0, 1]]
        A = sparse.csc_matrix(-np.vstack([rows, *below]))
        b = np.array([0.0, 0.0, 9.0, 0.0, 0.0, 1.0, 0.0, 1.0, 0.0, 1.0, 9.0])
        empty = sparse.csc_matrix((2, 2))
        self.solve(ConicProblem(empty, np.ones(2), A, b, cones), 1e-4)
