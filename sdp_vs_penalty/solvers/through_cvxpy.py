"""Our conic form stated in CVXPY and handed to one of its solvers: MOSEK, COPT."""

import os
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import scipy

from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.solvers.conic import Cone, ConicProblem, Solution
from sdp_vs_penalty.solvers.rewrite import quadratic_factor
from sdp_vs_penalty.solvers.solver import ACCURACY, Solver, flat

CLAIMS = {
    word + ending: "inaccurate" if ending else word
    for word in ("optimal", "infeasible", "unbounded")
    for ending in ("", "_inaccurate")
}


def solve_tiny(solver: str | None) -> None:
    """Compile every kind of cone in CVXPY and solve a tiny problem, so that the next
    solution's time holds no import, library or compiled code of the first.

    Parameters
    ----------
    solver : str or None
        CVXPY's name of the solver; None for CVXPY's own choice.
    """
    import cvxpy as cp

    x = cp.Variable(2)
    square = cp.reshape(cp.hstack([x, x]), (2, 2), order="F")
    cones = [square + square.T >> 0, cp.SOC(x[0] + 9.0, x)]
    objective = cp.sum_squares(x) - cp.log_det(np.eye(2) + square + square.T)
    with warnings.catch_warnings(action="ignore"):
        cp.Problem(cp.Minimize(objective), cones).solve(solver=solver)


class ThroughCvxpy(Solver):
    """A solver of CVXPY's, called there by our name in capitals; group : the argument
    that holds its options, "" where each is an argument; licences : files of which it
    needs one, or port@server; none where it is free."""

    extra = "its vendor, with a licence"
    full_matrices = True
    group: ClassVar[str] = ""
    licences: ClassVar[tuple[str, ...]] = ()
    status_meaning = CLAIMS

    @property
    def absent(self) -> str:
        """Why the solver cannot be used here (package or licence missing), "" if it
        can.
        """
        licence_files = (
            Path(os.path.expandvars(path)).expanduser() for path in self.licences
        )
        # A licence server is written as port@server.
        has_licence = any("@" in path.name or path.is_file() for path in licence_files)
        if super().absent:
            return super().absent
        return (
            ""
            if has_licence or not self.licences
            else f"no licence in {', '.join(self.licences)}"
        )

    def run(self, problem: ConicProblem, options: Mapping[str, Any]) -> Solution:
        """State a conic problem in CVXPY and solve it there by this class's solver.

        The problem is: minimise x^T P x / 2 + q^T x so that b - A x lies in a product
        of cones. ``options`` are the solver's. Returns the variables x (m,), the
        multipliers z (rows,) and CVXPY's status.
        """
        import cvxpy as cp

        x = cp.Variable(len(problem.q))
        A = scipy.sparse.csr_matrix(problem.A)
        objective = problem.q @ x
        if problem.P.nnz:
            objective = objective + 0.5 * cp.sum_squares(quadratic_factor(problem) @ x)
        constraints = []  # one a cone: its rows of b - A x lie in it
        first_row = 0
        for cone in problem.cones:
            rows = slice(first_row, first_row + _n_rows(cone))
            first_row = rows.stop
            constraints.append(_membership(cone, problem.b[rows] - A[rows] @ x))
        model = cp.Problem(cp.Minimize(objective), constraints)
        # CVXPY takes some solvers' options as one dictionary, others' one by one.
        keywords = {self.group: options} if self.group else options
        try:
            with warnings.catch_warnings(action="ignore"):
                model.solve(solver=self.name.upper(), **keywords)
        except cp.error.SolverError as error:
            return Solution.none(problem, str(error))
        z = np.concatenate(
            [_dual(c, m) for c, m in zip(problem.cones, constraints, strict=True)]
        )
        iterations = model.solver_stats.num_iters or 0
        return self.make_solution(
            flat(x.value, len(problem.q)), z, model.status, iterations
        )


def _n_rows(cone: Cone) -> int:
    """Return the number of rows of a cone whose matrices have all d^2 entries."""
    return cone.size**2 if cone.kind == "psd" else cone.rows


def _membership(cone: Cone, slack: Any) -> Any:
    """Return the CVXPY constraint that ``slack`` (rows,) lies in the cone.

    Rows of a psd cone are all entries of a matrix, column by column; those of a
    second-order cone its bound first; those of an exponential cone (x, y, z) with
    y exp(x / y) <= z.
    """
    import cvxpy as cp

    if cone.kind == "psd":
        matrix = cp.reshape(slack, (cone.size, cone.size), order="F")
        # CVXPY's ">> 0": positive semidefinite.
        return 0.5 * (matrix + matrix.T) >> 0
    if cone.kind == "soc":
        return cp.SOC(slack[0], slack[1:])
    if cone.kind == "exp":
        return cp.ExpCone(slack[0], slack[1], slack[2])
    return slack == 0 if cone.kind == "zero" else slack >= 0


def _dual(cone: Cone, constraint: Any) -> Array:
    """Return the multiplier (rows,) of a solved CVXPY constraint, NaN if it has none.

    The order is that of the cone's rows. CVXPY gives second-order and exponential cones
    a list of arrays, other cones one array; a matrix is made symmetric.
    """
    value = constraint.dual_value
    if value is None or (isinstance(value, list) and value[0] is None):
        return np.full(_n_rows(cone), np.nan)
    if cone.kind == "psd":
        return np.ravel(0.5 * (value + value.T))
    parts = value if isinstance(value, list) else [value]  # a list for soc and exp
    return np.concatenate([np.ravel(part) for part in parts])


class Mosek(ThroughCvxpy):
    """MOSEK, commercial, where its package and a licence are found; called through
    CVXPY."""

    name = "mosek"
    requires = "package", "mosek"
    group = "mosek_params"
    default_options = {
        f"MSK_DPAR_INTPNT_CO_TOL_{what}": ACCURACY
        for what in ("REL_GAP", "PFEAS", "DFEAS")
    }
    licences = "$MOSEKLM_LICENSE_FILE", "~/mosek/mosek.lic"


class Copt(ThroughCvxpy):
    """COPT, commercial, where its package and a licence are found; called through
    CVXPY."""

    name = "copt"
    requires = "package", "coptpy"
    default_options = dict.fromkeys(("RelGap", "FeasTol", "DualTol"), ACCURACY)
    licences = tuple(
        f"{home}/license.dat" for home in ("$COPT_LICENSE_DIR", "$COPT_HOME", "~/copt")
    )
