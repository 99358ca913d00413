"""What users do without an SDP solver of their own: CVXPY, the penalty, log-Cholesky variables."""

from __future__ import annotations

import importlib
import importlib.util
import time
import warnings
from dataclasses import replace
from importlib import metadata
from typing import Any

import numpy as np
from scipy import sparse

from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimators.estimator import Fit
from sdp_vs_penalty.estimators.penalty import fit_penalty
from sdp_vs_penalty.shootout import log_cholesky_ipopt
from sdp_vs_penalty.shootout.contestant import (
    DEFAULT_ACCURACY,
    Contestant,
    certified_gap,
    no_answer,
    with_proof,
)
from sdp_vs_penalty.shootout.instance import Instance
from sdp_vs_penalty.shootout.judge import Answer, dimacs_error
from sdp_vs_penalty.solvers import scs, through_cvxpy
from sdp_vs_penalty.solvers.conic import Cone, ConicProblem
from sdp_vs_penalty.solvers.through_cvxpy import CLAIMS
from sdp_vs_penalty.version import __version__

#: What CVXPY asks of its default solver for such problems, SCS.
CVXPY_ACCURACY = 1e-5

#: Seeds that the penalty's loop tries before it takes its tightest answer.
_PENALTY_SEEDS = 4


def rivals() -> list[Contestant]:
    """All of them, absent ones included."""
    return [
        _cvxpy(None),
        _cvxpy("CLARABEL"),
        _penalty(),
        _certified_penalty(),
        _log_cholesky_ipopt(),
    ]


def _cvxpy(solver: str | None) -> Contestant:
    """The problem as its formulas read; prob.solve() alone, or with the solver that a user names."""

    def solve(instance: Instance, accuracy: float) -> Answer:
        import cvxpy as cp

        start = time.perf_counter()
        data = instance.data if instance.raw is None else instance.raw
        theta = cp.Variable(data.R.shape[1])
        constraints = []
        for c in instance.constraints.convex:
            d = len(c.constant)
            flat = c.coefficients.reshape(len(c.indices), -1).T @ theta[c.indices] + c.constant.ravel()
            if c.cone == "psd":
                matrix = cp.reshape(flat, (d, d), order="C")
                constraints.append(0.5 * (matrix + matrix.T) >> 0)
            elif c.cone == "soc":
                constraints.append(cp.SOC(flat[0], flat[1:]))
            else:
                constraints.append(flat >= 0)
        objective = cp.sum_squares(data.R @ theta - data.rho)
        entropy = instance.objective.entropy
        if entropy is not None:
            for link, p0 in zip(entropy.links, entropy.nominal, strict=True):
                flat = link.coefficients.reshape(10, 16).T @ theta[link.indices]
                matrix = cp.reshape(flat, (4, 4), order="C")
                matrix = 0.5 * (matrix + matrix.T)
                trace = cp.trace(np.linalg.inv(p0) @ matrix)
                objective = objective + entropy.weight * (trace - cp.log_det(matrix))
        problem = cp.Problem(cp.Minimize(objective), constraints)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                dimacs = _solved(problem, solver)
        except cp.error.SolverError as error:
            return no_answer(instance, str(error), time.perf_counter() - start)
        total = time.perf_counter() - start
        stats = problem.solver_stats
        inside = float(stats.solve_time or 0.0)
        value = np.full(data.R.shape[1], np.nan) if theta.value is None else np.asarray(theta.value)
        status = f"{problem.status} ({stats.solver_name})"
        claims = CLAIMS.get(problem.status, "failed")
        steps = int(stats.num_iters or 0)

        return Answer(value, claims, status, steps, total - inside, inside, dimacs=dimacs)

    how = "prob.solve(), no options" if solver is None else f"prob.solve(solver={solver!r})"
    return Contestant(
        "cvxpy" if solver is None else f"cvxpy {solver.lower()}",
        f"CVXPY as a user meets it: the formulas, {how}",
        solve,
        lambda _: None,
        lambda: metadata.version("cvxpy"),
        None,
        False,
        CVXPY_ACCURACY if solver is None else DEFAULT_ACCURACY,
        through_cvxpy.warm_up,
    )


def _solved(problem: Any, solver: str | None) -> float:
    """problem.solve() in its own steps, for the DIMACS error of what CVXPY's solver saw."""
    data, chain, inverse = problem.get_problem_data(solver, solver_opts={})
    raw = chain.solve_via_data(problem, data, solver_opts={})
    problem.unpack_results(raw, chain, inverse)
    dims, columns = data["dims"], len(data["c"])
    cones = [Cone("zero", dims.zero), Cone("nonnegative", dims.nonneg)]
    cones += [Cone("soc", d) for d in dims.soc] + [Cone("psd", d) for d in dims.psd]
    cones += [Cone("exp", 3)] * dims.exp
    quadratic = data.get("P")
    P = sparse.csc_matrix((columns, columns) if quadratic is None else sparse.triu(quadratic))
    A, b = sparse.csr_matrix(data["A"]), np.asarray(data["b"], float)
    if problem.solver_stats.solver_name == "SCS":
        x, z, rows = raw["x"], raw["y"], scs.upper_triangles(tuple(cones))
        A, b, z = A[rows], b[rows], np.asarray(z)[rows]
    else:
        x, z = raw.x, raw.z
    seen = ConicProblem(P, np.asarray(data["c"], float), sparse.csc_matrix(A), b, tuple(cones))
    return dimacs_error(seen, np.asarray(x, float), np.asarray(z, float))


def _no_entropy(instance: Instance) -> str | None:
    return None if instance.objective.entropy is None else "no entropic regulariser"


def _penalty() -> Contestant:
    def solve(instance: Instance, accuracy: float) -> Answer:
        start = time.perf_counter()
        try:
            fit = fit_penalty(instance.task, instance.data, instance.task.constraints, 3, accuracy)
        except InputError as error:
            return no_answer(instance, error, time.perf_counter() - start)
        seconds = time.perf_counter() - start
        runs = fit.details["runs"]
        best = min(runs, key=lambda run: run["objective"])
        claims = "optimal" if best["residual"] <= accuracy else "inaccurate"
        status, steps = f"residual {best['residual']:.1e}", int(best["iterations"])
        return Answer(
            fit.theta, claims, status, steps, 0.0, seconds, fit.multipliers, attempts=len(runs)
        )

    words = "the exact penalty, multi-start (no SDP solver)"
    return Contestant("penalty", words, solve, _no_entropy, lambda: __version__)


def _certified_penalty() -> Contestant:
    """The penalty with the rights of solvers in the loop: certified, started again while loose."""

    def fits(instance: Instance) -> list[Fit]:
        found: list[Fit] = []
        for seed in range(_PENALTY_SEEDS):
            task = replace(instance.task, seed=seed)
            # The first start is the interior point each time: later attempts need a random one too.
            starts = 1 if seed == 0 else 2
            found.append(fit_penalty(task, instance.data, task.constraints, starts, 1e-10))
            if certified_gap(instance, found[-1]) <= DEFAULT_ACCURACY:
                break
        runs = [run for fit in found for run in fit.details["runs"]]
        return [replace(fit, details={"runs": runs}) for fit in found]

    def words(fit: Fit) -> tuple[list[str], int]:
        runs = fit.details["runs"]
        return [f"residual {r['residual']:.1e}" for r in runs], sum(int(r["iterations"]) for r in runs)

    return Contestant(
        "penalty certified",
        "the exact penalty inside our loop: certified, started again where the gap is loose",
        lambda instance, accuracy: with_proof(instance, accuracy, fits, words),
        _no_entropy,
        lambda: __version__,
        tunable=False,
    )


def _log_cholesky_ipopt() -> Contestant:
    package = log_cholesky_ipopt.PACKAGE
    here = importlib.util.find_spec(package) is not None
    return Contestant(
        "log-cholesky ipopt",
        "log-Cholesky variables and IPOPT with exact derivatives (no SDP solver)",
        log_cholesky_ipopt.solve,
        lambda _: None,
        lambda: metadata.version(package),
        None if here else f"the package {package} is not installed (source: the extra [ipopt])",
        warm_up=lambda: _import(package),
    )


def _import(package: str) -> None:
    importlib.import_module(package)
