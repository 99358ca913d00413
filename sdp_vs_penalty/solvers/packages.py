"""Conic solvers that are Python packages and take NumPy's arrays: CVXOPT, QICS, SCS and
SDPA."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import scipy

from sdp_vs_penalty.solvers.conic import Cone, ConicProblem, Solution
from sdp_vs_penalty.solvers.rewrite import KINDS, sizes
from sdp_vs_penalty.solvers.solver import (
    ACCURACY,
    EVERYTHING,
    SDPA_CLAIMS,
    Solver,
    flat,
)


class Cvxopt(Solver):
    """CVXOPT's conelp (Andersen, Dahl, Vandenberghe) with its LDL factorisation."""

    name = "cvxopt"
    extra = "solvers"
    requires = "package", "cvxopt"
    cones = frozenset({"zero", "nonnegative", "soc", "psd"})
    order = KINDS
    full_matrices = True
    finest = 1e-7
    default_options = {
        **dict.fromkeys(("abstol", "reltol", "feastol"), ACCURACY),
        "maxiters": 200,
    }
    status_meaning = {
        "optimal": "optimal",
        "primal infeasible": "infeasible",
        "dual infeasible": "unbounded",
    }

    def run(
        self,
        problem: ConicProblem,
        settings: Mapping[str, Any],
    ) -> Solution:
        """Solve the problem by CVXOPT's conelp and return x (m,) and multipliers z
        (rows,).
        """
        import cvxopt
        from cvxopt import solvers

        dims = sizes(problem.cones)
        coo = problem.A.tocoo()
        equal = dims["z"]
        rows = coo.row.astype(int)
        columns = coo.col.astype(int)
        A = cvxopt.spmatrix(
            coo.data,
            rows,
            columns,
            coo.shape,
        )
        b = cvxopt.matrix(problem.b)
        cones = {k: dims[k] for k in "lqs"}
        options = {**settings, "show_progress": False}
        try:
            result = solvers.conelp(
                cvxopt.matrix(problem.q),
                A[equal:, :],
                b[equal:],
                cones,
                A[:equal, :],
                b[:equal],
                kktsolver="ldl",
                options=options,
            )
        except (ValueError, ArithmeticError) as error:
            return Solution.none(problem, str(error))
        z = (
            flat(result["y"], equal),
            flat(result["z"], len(problem.b) - equal),
        )
        x = flat(result["x"], len(problem.q))
        return self.make_solution(
            x,
            np.concatenate(z),
            result["status"],
            result["iterations"],
        )


class Qics(Solver):
    """QICS (He, Saunderson, Fawzi 2024), an interior-point method for nonsymmetric
    cones."""

    name = "qics"
    extra = "solvers"
    requires = "package", "qics"
    cones = EVERYTHING - {"quadratic"}
    order = KINDS
    full_matrices = True
    # Iterative refinement and third-order adjustments are on by default, as its manual
    # recommends.
    default_options = {
        "tol_gap": ACCURACY,
        "tol_feas": ACCURACY,
        "max_iter": 200,
    }
    status_meaning = (
        {"optimal": "optimal", "near_optimal": "inaccurate"}
        | dict.fromkeys(("pinfeas", "near_pinfeas"), "infeasible")
        | dict.fromkeys(("dinfeas", "near_dinfeas"), "unbounded")
    )

    def run(
        self,
        problem: ConicProblem,
        options: Mapping[str, Any],
    ) -> Solution:
        """Solve the problem by QICS and return x (m,) and multipliers z (rows,)."""
        import qics

        answer = {
            "nonnegative": qics.cones.NonNegOrthant,
            "soc": lambda size: qics.cones.SecondOrder(size - 1),
            "psd": qics.cones.PosSemidefinite,
            "exp": lambda size: qics.cones.ClassRelEntr(1),
        }
        cones = [
            answer[cone.kind](cone.size)
            for cone in problem.cones
            if cone.kind != "zero"
        ]
        dims = sizes(problem.cones)
        rows = len(problem.b)
        # y exp(x / y) <= z exactly if -x >= y log(y / z): of three rows the first with
        # another sign.
        signs = np.ones(rows)
        equal = dims["z"]
        signs[rows - 3 * dims["ep"] :: 3] = -1.0
        A = scipy.sparse.csr_matrix(scipy.sparse.diags(signs) @ problem.A)
        b = (signs * problem.b)[:, None]
        parts = {
            "A": A[:equal],
            "b": b[:equal],
            "G": A[equal:],
            "h": b[equal:],
        }
        model = qics.Model(
            problem.q[:, None],
            **parts,
            cones=cones,
        )
        info = qics.Solver(
            model,
            verbose=0,
            **options,
        ).solve()
        duals = (
            info["y_opt"],
            getattr(info["z_opt"], "vec", info["z_opt"]),
        )  # as versions have it
        flat_duals = [np.asarray(dual, float).ravel() for dual in duals]
        z = signs * np.concatenate(flat_duals)
        x = np.asarray(info["x_opt"]).ravel()
        more = f"({info['exit_status']})"
        return self.make_solution(
            x,
            z,
            info["sol_status"],
            info["num_iter"],
            more,
        )

    def warm_up(self) -> None:
        """Solve a tiny problem with all cones: QICS compiles its code for each on first
        use.
        """
        rows = np.eye(2)
        square = np.array(
            [
                [1.0, 0.0],
                [0.0, 0.0],
                [0.0, 1.0],
            ]
        )
        cones = (Cone("nonnegative", 2), Cone("soc", 3), Cone("psd", 2), Cone("exp", 3))
        below = [[0, 0], [1, 0], [0, 1]], square, [[1, 0], [0, 0], [0, 1]]
        A = scipy.sparse.csc_matrix(-np.vstack([rows, *below]))
        b = np.array([0.0, 0.0, 9.0, 0.0, 0.0, 1.0, 0.0, 1.0, 0.0, 1.0, 9.0])
        empty = scipy.sparse.csc_matrix((2, 2))
        self.solve(
            ConicProblem(
                empty,
                q=np.ones(2),
                A=A,
                b=b,
                cones=cones,
            ),
            1e-4,
        )


class Scs(Solver):
    """SCS (O'Donoghue, Chu, Parikh, Boyd 2016), a first-order splitting method, called
    directly."""

    name = "scs"
    extra = "solvers"
    requires = "package", "scs"
    order = KINDS
    finest = 1e-7
    # The rest are its defaults, which its documentation recommends (adaptive scale,
    # normalisation, Anderson acceleration over 10 steps).
    default_options = {
        "eps_abs": ACCURACY,
        "eps_rel": ACCURACY,
        "max_iters": 100_000,
    }
    status_meaning = {
        "solved": "optimal",
        "infeasible": "infeasible",
        "unbounded": "unbounded",
    }

    def run(
        self,
        problem: ConicProblem,
        options: Mapping[str, Any],
    ) -> Solution:
        """Solve the problem by SCS and return x (m,) and multipliers z (rows,).

        SCS takes the lower triangle of matrices column by column, we the upper one.
        """
        import scs

        rows = [np.zeros(0, np.intp)]
        start = 0
        for cone in problem.cones:
            places = np.arange(cone.rows)
            if cone.kind == "psd":
                # Entry (j, i), j >= i, column by column of the lower triangle, is in
                # svec's column j, which begins at j (j + 1) / 2.
                i, j = np.triu_indices(cone.size)
                places = j * (j + 1) // 2 + i
            rows.append(start + places)
            start += cone.rows
        lower = np.concatenate(rows)
        A = problem.A.tocsr()[lower].tocsc()
        data = {
            "P": problem.P,
            "A": A,
            "b": problem.b[lower],
            "c": problem.q,
        }
        result = scs.SCS(
            data,
            sizes(problem.cones),
            verbose=False,
            **options,
        ).solve()
        z = np.empty(len(lower))
        info = result["info"]
        z[lower] = result["y"]
        # The first word of its status; what follows says that it is inaccurate.
        word, _, more = info["status"].partition(" ")
        solution = self.make_solution(
            np.array(result["x"]),
            z,
            word,
            info["iter"],
            more,
        )
        return (
            replace(solution, claims="inaccurate")
            if word == "solved" and more
            else solution
        )


class Sdpa(Solver):
    """SDPA (Fujisawa, Fukuda, Kojima, Nakata, Yamashita) through sdpa-python."""

    name = "sdpa"
    extra = "solvers"
    requires = "package", "sdpap"
    cones = frozenset({"nonnegative", "psd"})
    order = KINDS
    full_matrices = True
    default_options = {
        "epsilonStar": ACCURACY,
        "epsilonDash": ACCURACY,
        "maxIteration": 200,
    }
    status_meaning = SDPA_CLAIMS

    def run(
        self,
        problem: ConicProblem,
        options: Mapping[str, Any],
    ) -> Solution:
        """Solve the problem by SDPA and return x (m,) and multipliers z (rows,)."""
        import sdpap

        dims = sizes(problem.cones)
        # minimise c^T x subject to (-A) x - (-b) in J, x free
        free = sdpap.SymCone(f=len(problem.q))
        cones = sdpap.SymCone(
            l=dims["l"],
            s=tuple(dims["s"]),
        )
        settings = {
            **options,
            "print": "no",
            "numThreads": 1,
        }
        x, y, info, _, more = sdpap.solve(
            -problem.A,
            -problem.b,
            problem.q,
            free,
            cones,
            settings,
        )
        x = np.asarray(x.todense()).ravel()
        z = np.asarray(y.todense()).ravel()
        return self.make_solution(
            x,
            z,
            str(info.get("phasevalue")),
            more.get("iteration", 0),
        )
