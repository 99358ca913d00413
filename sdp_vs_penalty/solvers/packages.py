"""Conic solvers that are Python packages and take NumPy's arrays: CVXOPT, QICS, SCS and
SDPA."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import scipy

from sdp_vs_penalty.solvers.conic import ConicProblem, Solution
from sdp_vs_penalty.solvers.rewrite import KINDS, sizes
from sdp_vs_penalty.solvers.solver import (
    ACCURACY,
    EVERYTHING,
    SDPA_CLAIMS,
    Solver,
    flat,
)


class Cvxopt(Solver):
    """CVXOPT's conelp (Andersen, Dahl, Vandenberghe)."""

    name = "cvxopt"
    extra = "solvers"
    requires = "package", "cvxopt"
    cones = frozenset({"zero", "nonnegative", "soc", "psd"})
    order = KINDS
    full_matrices = True
    default_options = dict.fromkeys(("abstol", "reltol", "feastol"), ACCURACY)
    tuned_options = {"kktsolver": "ldl"}
    status_meaning = {
        "optimal": "optimal",
        "primal infeasible": "infeasible",
        "dual infeasible": "unbounded",
    }

    def run(self, problem: ConicProblem, settings: Mapping[str, Any]) -> Solution:
        """Solve a conic problem by CVXOPT's conelp.

        The problem is: minimise q^T x so that b - A x lies in a product of cones
        (equalities first). ``settings`` are CVXOPT's options. Returns the variables x
        (m,), the multipliers z (rows,) and CVXOPT's status.
        """
        import cvxopt
        from cvxopt import solvers

        dims = sizes(problem.cones)  # SCS's names: z zero, l nonnegative, q, s
        coo = problem.A.tocoo()
        n_equal = dims["z"]  # rows of equalities; they come first
        rows = coo.row.astype(int)
        columns = coo.col.astype(int)
        A = cvxopt.spmatrix(coo.data, rows, columns, coo.shape)
        b = cvxopt.matrix(problem.b)
        cones = {k: dims[k] for k in "lqs"}
        options = {**settings, "show_progress": False}
        factorisation = options.pop("kktsolver", None)
        try:
            result = solvers.conelp(
                cvxopt.matrix(problem.q),
                A[n_equal:, :],
                b[n_equal:],
                cones,
                A[:n_equal, :],
                b[:n_equal],
                kktsolver=factorisation,
                options=options,
            )
        except (ValueError, ArithmeticError) as error:
            return Solution.none(problem, str(error))
        equality_multipliers = flat(result["y"], n_equal)
        cone_multipliers = flat(result["z"], len(problem.b) - n_equal)
        z = np.concatenate([equality_multipliers, cone_multipliers])
        x = flat(result["x"], len(problem.q))
        return self.make_solution(x, z, result["status"], result["iterations"])


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
    default_options = {"tol_gap": ACCURACY, "tol_feas": ACCURACY}
    status_meaning = {
        "optimal": "optimal",
        "pinfeas": "infeasible",
        "dinfeas": "unbounded",
    } | dict.fromkeys(("near_optimal", "near_pinfeas", "near_dinfeas"), "inaccurate")

    def run(self, problem: ConicProblem, options: Mapping[str, Any]) -> Solution:
        """Solve a conic problem by the package QICS.

        The problem is: minimise q^T x so that b - A x lies in a product of cones
        (equalities first, exponential cones last). ``options`` are QICS's. Returns the
        variables x (m,), the multipliers z (rows,) and QICS's status.
        """
        import qics

        make_cone_of_kind = {
            "nonnegative": qics.cones.NonNegOrthant,
            # QICS does not count a second-order cone's bound.
            "soc": lambda size: qics.cones.SecondOrder(size - 1),
            "psd": qics.cones.PosSemidefinite,
            # An exponential cone is a relative entropy of one number.
            "exp": lambda size: qics.cones.ClassRelEntr(1),
        }
        cones = [
            make_cone_of_kind[cone.kind](cone.size)
            for cone in problem.cones
            if cone.kind != "zero"
        ]
        # y exp(x / y) <= z holds if and only if -x >= y log(y / z). So the first of an
        # exponential cone's three rows changes its sign; these cones come last.
        dims = sizes(problem.cones)
        n_rows = len(problem.b)
        n_exponential_rows = 3 * dims["ep"]
        signs = np.ones(n_rows)
        signs[n_rows - n_exponential_rows :: 3] = -1.0
        A = scipy.sparse.csr_matrix(scipy.sparse.diags(signs) @ problem.A)
        b = (signs * problem.b)[:, None]
        # Equalities come first: A x = b; then the cones: h - G x in K.
        n_equal = dims["z"]
        model = qics.Model(
            problem.q[:, None],
            A=A[:n_equal],
            b=b[:n_equal],
            G=A[n_equal:],
            h=b[n_equal:],
            cones=cones,
        )
        info = qics.Solver(model, verbose=0, **options).solve()
        # Some versions of QICS wrap the cones' multipliers; ``vec`` is the array.
        cone_multipliers = getattr(info["z_opt"], "vec", info["z_opt"])
        duals = [info["y_opt"], cone_multipliers]
        flat_duals = [np.asarray(dual, float).ravel() for dual in duals]
        z = signs * np.concatenate(flat_duals)
        x = np.asarray(info["x_opt"]).ravel()
        exit_status = f"({info['exit_status']})"
        return self.make_solution(
            x, z, info["sol_status"], info["num_iter"], exit_status
        )


class Scs(Solver):
    """SCS 3 (O'Donoghue, SIAM J. Optim. 2021), a first-order splitting method, called
    directly with the linear solver that it chooses (LinearSolver.AUTO)."""

    name = "scs"
    extra = "solvers"
    requires = "package", "scs"
    order = KINDS
    default_options = {"eps_abs": ACCURACY, "eps_rel": ACCURACY}
    status_meaning = {
        "solved": "optimal",
        "infeasible": "infeasible",
        "unbounded": "unbounded",
    }

    def run(self, problem: ConicProblem, options: Mapping[str, Any]) -> Solution:
        """Solve a conic problem by the package SCS.

        The problem is: minimise x^T P x / 2 + q^T x so that b - A x lies in a product
        of cones. Of a symmetric matrix SCS takes the lower triangle column by column,
        and we the upper one, so the rows of A and b are reordered. ``options`` are
        SCS's. Returns the variables x (m,), the multipliers z (rows,) in our order, and
        SCS's status.
        """
        import scs

        # Row k of SCS's problem is our row scs_order[k].
        orders_of_cones = [np.zeros(0, np.intp)]
        start = 0
        for cone in problem.cones:
            rows_of_cone = np.arange(cone.rows)
            if cone.kind == "psd":
                # SCS's next entry is (j, i), j >= i, of the lower triangle, column by
                # column. By symmetry it is our (i, j): column j of the upper triangle
                # begins at j (j + 1) / 2.
                i, j = np.triu_indices(cone.size)
                rows_of_cone = j * (j + 1) // 2 + i
            orders_of_cones.append(start + rows_of_cone)
            start += cone.rows
        scs_order = np.concatenate(orders_of_cones)
        A = problem.A.tocsr()[scs_order].tocsc()
        data = {"P": problem.P, "A": A, "b": problem.b[scs_order], "c": problem.q}
        result = scs.SCS(data, sizes(problem.cones), verbose=False, **options).solve()
        z = np.empty(len(scs_order))
        info = result["info"]
        z[scs_order] = result["y"]  # back to our order
        # "solved", or "solved (inaccurate - ...)": the first word is the status; so of
        # "infeasible" and "unbounded".
        word, _, remark = info["status"].partition(" ")
        words = f"{remark} {info.get('lin_sys_solver', '')}".strip()
        solution = self.make_solution(
            np.array(result["x"]), z, word, info["iter"], words
        )
        return replace(solution, claims="inaccurate") if remark else solution


class Sdpa(Solver):
    """SDPA (Fujisawa, Fukuda, Kojima, Nakata, Yamashita) as the wheel of sdpa-python, whose
    version it has, holds it."""

    name = "sdpa"
    extra = "solvers"
    requires = "package", "sdpap"
    distribution = "sdpa-python"
    cones = frozenset({"nonnegative", "psd"})
    order = KINDS
    full_matrices = True
    default_options = {
        "epsilonStar": ACCURACY,
        "epsilonDash": ACCURACY,
        "numThreads": 1,
    }
    status_meaning = SDPA_CLAIMS

    def run(self, problem: ConicProblem, options: Mapping[str, Any]) -> Solution:
        """Solve a conic problem by SDPA (the package sdpap).

        The problem is: minimise q^T x so that b - A x lies in a product of cones
        (nonnegative rows first, then matrices). ``options`` are SDPA's. Returns the
        variables x (m,), the multipliers z (rows,) and SDPA's status.
        """
        import sdpap

        dims = sizes(problem.cones)
        # SDPA's form: minimise c^T x subject to A' x - b' in the cones and x free.
        # Ours, b - A x in the cones, is that with A' = -A and b' = -b.
        free_variables = sdpap.SymCone(f=len(problem.q))
        cones = sdpap.SymCone(l=dims["l"], s=tuple(dims["s"]))
        settings = {**options, "print": "no"}
        x, z, info, _, statistics = sdpap.solve(
            -problem.A, -problem.b, problem.q, free_variables, cones, settings
        )
        return self.make_solution(
            np.asarray(x.todense()).ravel(),
            np.asarray(z.todense()).ravel(),
            str(info.get("phasevalue")),
            statistics.get("iteration", 0),
        )
