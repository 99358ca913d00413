"""Who takes part: every conic solver of the library, our default path, and what users do without one."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from types import ModuleType

import numpy as np

from sdp_vs_penalty.errors import Infeasible, InputError, unknown
from sdp_vs_penalty.estimators.lmi_sdp import solve_sdp
from sdp_vs_penalty.estimators.penalty import fit_penalty
from sdp_vs_penalty.shootout import log_cholesky
from sdp_vs_penalty.shootout.instance import Instance
from sdp_vs_penalty.shootout.judge import Answer, conic_errors
from sdp_vs_penalty.solvers import absent, solver_modules, through_cvxpy, version, warm_up
from sdp_vs_penalty.solvers.certificate import lower_bound, repair
from sdp_vs_penalty.solvers.through_cvxpy import CLAIMS
from sdp_vs_penalty.version import __version__

#: What our default path promises.
DEFAULT_ACCURACY = 1e-8
#: What CVXPY asks of its default solver for such problems, SCS.
CVXPY_ACCURACY = 1e-5

Solve = Callable[[Instance, float], Answer]
#: Why an instance cannot be posed to a contestant, or None.
Applies = Callable[[Instance], str | None]


def _nothing() -> None:
    pass


@dataclass(frozen=True)
class Contestant:
    """absent : why it is not here, or None; tunable : whether an accuracy can be asked for."""

    name: str
    description: str
    solve: Solve
    applies: Applies
    version: Callable[[], str]
    absent: str | None = None
    tunable: bool = True
    promise: float = DEFAULT_ACCURACY  # what is promised where no accuracy can be asked for
    #: What a first call pays for once (imports, compilation); it must not start a thread, because a
    #: forked child would wait for it for ever.
    warm_up: Callable[[], None] = _nothing

    def settings(self, accuracy: float) -> str:
        """How a run is set up, in one word: the key in runs.csv."""
        return f"{accuracy:.0e}" if self.tunable else "default"


def contestants() -> dict[str, Contestant]:
    """All of them by name, absent ones included."""
    found = {name: _conic(name, module) for name, module in solver_modules().items()}
    loops = [_certified(name, module) for name, module in solver_modules().items()]
    for other in (*loops, _cvxpy_default(), _penalty(), _log_cholesky()):
        found[other.name] = other
    return dict(sorted(found.items()))


def chosen(names: list[str] | None) -> tuple[list[Contestant], list[Contestant]]:
    """The contestants of these names (default: all), those that are here and those that are absent.

    Raises InputError for a name that does not exist, and for one asked for by name that is absent.
    """
    everyone = contestants()
    if names is None:
        return [c for c in everyone.values() if not c.absent], [c for c in everyone.values() if c.absent]
    for name in names:
        if name not in everyone:
            raise unknown("solver", name, everyone)
        if why := everyone[name].absent:
            raise InputError(f"solver {name} cannot be used here", why)
    return [everyone[name] for name in names], []


def _conic(name: str, module: ModuleType) -> Contestant:
    def solve(instance: Instance, accuracy: float) -> Answer:
        sdp = instance.sdp
        solution = module.solve(sdp.conic, accuracy)
        multipliers = instance.all_multipliers(sdp.multipliers(solution))
        return Answer(
            sdp.theta(solution),
            solution.claims,
            solution.status,
            solution.iterations,
            solution.setup_seconds,
            solution.solve_seconds,
            multipliers,
            sdp.entropy_slopes(solution),
            *conic_errors(sdp.conic, solution),
        )

    def applies(instance: Instance) -> str | None:
        if "exp" not in module.CONES and instance.objective.entropy is not None:
            return "no cone for log det"
        return None

    lines = (module.__doc__ or "").strip().splitlines()
    return Contestant(
        name,
        lines[0],
        solve,
        applies,
        lambda: version(module),
        absent(module),
        warm_up=lambda: warm_up(module),
    )


def _certified(name: str, module: ModuleType) -> Contestant:
    """A solver inside our loop: certified, and solved again where the gap is loose; with Clarabel it is
    the default path, ``lmi-sdp``."""

    def solve(instance: Instance, accuracy: float) -> Answer:
        start = time.perf_counter()
        nothing = np.full(len(instance.task.bound), np.nan)
        try:
            fit = solve_sdp(instance.task, instance.objective, instance.constraints, name, 1e-10)
        except InputError as error:
            claims = "infeasible" if isinstance(error, Infeasible) and error.proof else "failed"
            return Answer(nothing, claims, str(error), 0, 0.0, time.perf_counter() - start)
        assert fit.multipliers is not None
        assert fit.interior is not None
        bound = instance.task.bound
        lower = lower_bound(
            fit.objective, fit.constraints, fit.multipliers, fit.theta, bound, fit.entropy_slopes
        )
        upper = fit.objective.value(repair(fit.constraints, fit.theta, fit.interior))
        seconds = time.perf_counter() - start
        scale = max(instance.data.loss(fit.theta), 1e-12 * instance.data.tau_squared, 1e-300)
        gap = (upper - lower) / scale
        claims = "optimal" if gap <= accuracy else "inaccurate"
        said = fit.details["solver_said"]
        return Answer(
            fit.theta,
            claims,
            f"certified gap {gap:.1e}; " + ", ".join(said),
            sum(int(word.rpartition("(")[2].rstrip(")")) for word in said),
            0.0,
            seconds,
            fit.multipliers,
            fit.entropy_slopes,
        )

    def applies(instance: Instance) -> str | None:
        if "exp" not in module.CONES and instance.objective.entropy is not None:
            return "no cone for log det"
        return None

    ours = name == "clarabel"
    return Contestant(
        "lmi-sdp" if ours else f"{name} certified",
        f"{name} inside our loop: scaled, certified, solved again where the gap is loose",
        solve,
        applies,
        (lambda: __version__) if ours else lambda: version(module),
        absent(module),
        tunable=False,
        warm_up=lambda: warm_up(module),
    )


def _cvxpy_default() -> Contestant:
    """The problem as its formulas read, prob.solve() without options."""

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
                problem.solve()
        except cp.error.SolverError as error:
            nothing = np.full(len(instance.task.bound), np.nan)
            return Answer(nothing, "failed", str(error), 0, 0.0, time.perf_counter() - start)
        total = time.perf_counter() - start
        stats = problem.solver_stats
        inside = float(stats.solve_time or 0.0)
        value = np.full(data.R.shape[1], np.nan) if theta.value is None else np.asarray(theta.value)
        status = f"{problem.status} ({stats.solver_name})"
        claims = CLAIMS.get(problem.status, "failed")
        return Answer(value, claims, status, int(stats.num_iters or 0), total - inside, inside)

    def package() -> str:
        import cvxpy

        return str(cvxpy.__version__)

    words = "CVXPY as a user meets it: the formulas, prob.solve(), no options"
    return Contestant(
        "cvxpy",
        words,
        solve,
        lambda _: None,
        package,
        None,
        False,
        CVXPY_ACCURACY,
        through_cvxpy.warm_up,
    )


def _penalty() -> Contestant:
    def solve(instance: Instance, accuracy: float) -> Answer:
        start = time.perf_counter()
        try:
            fit = fit_penalty(instance.task, instance.data, instance.task.constraints, 3, accuracy)
        except InputError as error:
            nothing = np.full(len(instance.task.bound), np.nan)
            claims = "infeasible" if isinstance(error, Infeasible) and error.proof else "failed"
            return Answer(nothing, claims, str(error), 0, 0.0, time.perf_counter() - start)
        seconds = time.perf_counter() - start
        best = min(fit.details["runs"], key=lambda run: run["objective"])
        claims = "optimal" if best["residual"] <= accuracy else "inaccurate"
        status = f"residual {best['residual']:.1e}"
        steps = int(best["iterations"])
        return Answer(fit.theta, claims, status, steps, 0.0, seconds, fit.multipliers)

    def applies(instance: Instance) -> str | None:
        return None if instance.objective.entropy is None else "no entropic regulariser"

    words = "the exact penalty, multi-start (no SDP solver)"
    return Contestant("penalty", words, solve, applies, lambda: __version__)


def _log_cholesky() -> Contestant:
    def version_of_scipy() -> str:
        import scipy

        return str(scipy.__version__)

    words = "log-Cholesky parametrisation and SLSQP (no SDP solver)"
    solve, applies = log_cholesky.solve, lambda _: None
    return Contestant("log-cholesky", words, solve, applies, version_of_scipy, None, False, 1e-6)
