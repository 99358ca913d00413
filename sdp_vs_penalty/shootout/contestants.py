"""Who takes part: our default method, every conic solver of the library, what users do
without one."""

import warnings
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from importlib import metadata
from typing import Any

import numpy as np

from sdp_vs_penalty.errors import InputError, require_known
from sdp_vs_penalty.estimators.lmi_sdp import ATTEMPTS, LmiSdp, PosedSdp
from sdp_vs_penalty.estimators.penalty import Penalty, fit_penalty
from sdp_vs_penalty.shootout import augmented_lagrangian
from sdp_vs_penalty.shootout.instances import Instance
from sdp_vs_penalty.shootout.judge import Answer, no_answer
from sdp_vs_penalty.solvers import solver_types
from sdp_vs_penalty.solvers.clarabel import Clarabel
from sdp_vs_penalty.solvers.solver import Solver
from sdp_vs_penalty.solvers.through_cvxpy import CLAIMS, solve_tiny
from sdp_vs_penalty.version import __version__


def solve_cvxpy(instance: Instance, accuracy: float, solver: str | None) -> Answer:
    """Solve an instance by CVXPY as a user would write it: formulas, and default
    options.

    Minimised is |R theta - rho|^2, plus weight * sum of (trace(P0^-1 P) - log det P)
    over the links' pseudo-inertias P and nominal ones P0, if the instance has an
    entropy.

    Parameters
    ----------
    accuracy : float
        Ignored: nothing is passed to prob.solve() but the solver.
    solver : str or None
        CVXPY's name of the solver; None for CVXPY's own choice.

    Returns
    -------
    Answer
        Without dual multipliers; theta is NaN if the solver returned none.
    """
    import cvxpy as cp

    data = instance.data
    entropy = instance.entropy
    theta = cp.Variable(data.R.shape[1])

    def matrix(c: Any) -> Any:
        """Return the symmetric matrix F(theta) of a constraint."""
        coefficients = c.coefficients.reshape(len(c.indices), -1)
        flat = coefficients.T @ theta[c.indices] + c.constant.ravel()
        square = cp.reshape(flat, c.constant.shape, order="C")
        return 0.5 * (square + square.T)

    constraints = []
    for c in instance.constraints.convex:
        if c.cone == "psd":
            constraints.append(matrix(c) >> 0)
            continue
        flat = c.coefficients.T @ theta[c.indices] + c.constant
        if c.cone == "soc":
            constraints.append(cp.SOC(flat[0], flat[1:]))
        else:
            constraints.append(flat >= 0)
    objective = cp.sum_squares(data.R @ theta - data.rho)
    if entropy is not None:  # a distance from the nominal links
        for link, nominal in zip(entropy.links, entropy.nominal, strict=True):
            trace = cp.trace(np.linalg.inv(nominal) @ matrix(link))
            divergence = trace - cp.log_det(matrix(link))
            objective = objective + entropy.weight * divergence
    problem = cp.Problem(cp.Minimize(objective), constraints)
    try:
        with warnings.catch_warnings(action="ignore"):
            problem.solve(solver=solver)
    except cp.error.SolverError as error:
        return no_answer(instance, str(error))
    value = np.full(data.R.shape[1], np.nan)
    if theta.value is not None:
        value = np.asarray(theta.value)
    status = f"{problem.status} ({problem.solver_stats.solver_name})"
    return Answer(value, CLAIMS.get(problem.status, "failed"), status)


def solve_penalty(instance: Instance, accuracy: float) -> Answer:
    """Solve an instance by the exact penalty method from several starts.

    Parameters
    ----------
    accuracy : float
        Relative accuracy that is asked for.

    Returns
    -------
    Answer
        The penalty's shifts serve as dual multipliers.
    """
    try:
        fit = fit_penalty(instance.task, instance.problem, Penalty.starts, accuracy)
    except InputError as error:
        return no_answer(instance, error)
    runs = fit.details["runs"]
    best = min(runs, key=lambda run: run["objective"])
    claims = "optimal" if best["residual"] <= accuracy else "inaccurate"
    status = f"residual {best['residual']:.1e}"
    return Answer(fit.theta, claims, status, fit.multipliers, attempts=len(runs))


def solve_by_default(instance: Instance, accuracy: float) -> Answer:
    """Solve an instance by our default method's certified fit.

    It scales the problem, calls a solver, and proves a gap from its multipliers. It
    claims an optimum only if the proved gap is at most ``accuracy``; its attempts are the
    solver's calls.
    """
    try:
        fit = PosedSdp(instance.task, instance.problem, None).fit(LmiSdp.accuracy)
        proved_gap = fit.gap
    except InputError as error:
        return no_answer(instance, error)
    solver_words: list[str] = fit.details["solver_said"]  # one text for each call
    words = f"{fit.details['solver']}: proved gap {proved_gap:.1e}; "
    return Answer(
        theta=fit.theta,
        claims="optimal" if proved_gap <= accuracy else "inaccurate",
        status=words + ", ".join(solver_words),
        multipliers=fit.multipliers,
        entropy_slopes=fit.entropy_slopes,
        attempts=len(solver_words),
    )


#: What the clock of a contestant holds.
SOLVER_CALL = "rewriting, the solver's call; form and interior point are there before"
PROGRAM_RUN = (
    "rewriting, the program's start, its reading and solving; form and interior point are"
    " there before"
)
ALL_OF_IT = "posing, solving, proving"
POSED_AND_SOLVED = "posing, solving"
MODELLING_TOO = "CVXPY's modelling and the solver's call"


@dataclass(frozen=True)
class Contestant:
    """Who takes part, with all that is printed about it."""

    #: Name by which the shootout knows it.
    name: str
    #: What it is, in a line.
    description: str
    #: Solves an instance, asked for an accuracy.
    solve: Callable[[Instance, float], Answer]
    #: What is passed at an accuracy, by the names of its documentation.
    options: Callable[[float], dict[str, Any]]
    #: Returns its version.
    version: Callable[[], str] = lambda: __version__
    #: Why it is not here, "" if it is.
    absent: str = ""
    #: The accuracy that it promises, if it cannot be asked for one.
    promise: float | None = None
    #: Whether it claims an optimum only after it has proved the gap of its answer.
    certifies: bool = False
    #: Whether it gets the conic form that is handed out; the others pose R and rho.
    takes_conic_form: bool = False
    #: Whether log det can be posed to it.
    entropy: bool = True
    #: What its processor time holds.
    clock: str = ALL_OF_IT
    #: Does once what only a first call costs. It must start no thread: a forked child
    #: would wait for that thread for ever.
    warm_up: Callable[[], None] = lambda: None

    def asked(self, accuracies: Iterable[float]) -> list[float]:
        """Return the accuracies at which this contestant runs, from loose to tight."""
        if self.promise is not None:
            return [self.promise]
        return sorted(set(accuracies), reverse=True)

    def settings(self, accuracy: float) -> str:
        """Return everything that is passed at an accuracy, in words; part of a run's key."""
        return _in_words(self.options(accuracy))

    def refuses(self, instance: Instance) -> str | None:
        """Return why an instance cannot be posed to this contestant, None if it can."""
        if instance.formulation != "residual" and not self.takes_conic_form:
            return "we pose it R and rho, which this form does not hand out"
        if instance.entropy is not None and not self.entropy:
            return "no cone for log det"
        return None


def _in_words(options: Mapping[str, Any]) -> str:
    """Return options with their values in words."""
    return ", ".join(
        f"{name} {value:g}" if isinstance(value, float) else f"{name} {value}"
        for name, value in options.items()
    )


def _versions(*packages: str) -> str:
    """Return the versions of packages: the first without its name, the others with
    theirs."""
    texts = []
    for name in packages:
        with suppress(metadata.PackageNotFoundError):
            texts.append(f"{name} {metadata.version(name)}")
    return ", ".join(texts).removeprefix(f"{packages[0]} ")


def contestants() -> dict[str, Contestant]:
    """Return all contestants by name, including those that are not installed.

    Each conic solver takes part as its authors ship it, and with what we tune (where we
    do).
    """
    contestant_list = _baselines()
    for kind in solver_types().values():
        solver = kind()
        contestant_list.append(_conic(solver, tuned=False))
        if solver.tuned_options:
            contestant_list.append(_conic(solver, tuned=True))
    return {c.name: c for c in sorted(contestant_list, key=lambda c: c.name)}


def chosen(names: list[str] | None) -> tuple[list[Contestant], list[Contestant]]:
    """Choose contestants by name.

    Parameters
    ----------
    names : list of str or None
        None for all.

    Returns
    -------
    tuple of (list of Contestant, list of Contestant)
        Those that can run, and those that are not installed.

    Raises
    ------
    InputError
        For an unknown name, or a named contestant that is not installed.
    """
    by_name = contestants()
    if names is None:
        installed = [c for c in by_name.values() if not c.absent]
        return installed, [c for c in by_name.values() if c.absent]
    for name in names:
        require_known("solver", name, by_name)
        if reason := by_name[name].absent:
            raise InputError(f"solver {name} cannot be used here", reason)
    return [by_name[name] for name in dict.fromkeys(names)], []


def _conic(solver: Solver, tuned: bool) -> Contestant:
    """Make a contestant of a conic solver alone, without our loop and certificate."""

    def solve(instance: Instance, accuracy: float) -> Answer:
        """Solve an instance to an accuracy, and bring the answer back to its units."""
        sdp = instance.sdp
        solution = solver.solve(sdp.conic, accuracy, tuned)
        multipliers = sdp.multipliers(solution)
        return Answer(
            theta=sdp.theta(solution),
            claims=solution.claims,
            status=solution.status,
            multipliers=instance.constraints.stack_multipliers(multipliers),
            entropy_slopes=sdp.entropy_slopes(solution),
            file_seconds=solution.file_seconds,
            solution=solution,
        )

    words = ""
    if not solver.tuned_options:
        words = "; no effort was made to tune it"
    elif tuned:
        words = "; tuned by us"
    return Contestant(
        name=f"{solver.name} tuned" if tuned else solver.name,
        description=solver.description.removesuffix(".") + words,
        solve=solve,
        options=lambda accuracy: solver.options(accuracy, tuned),
        version=solver.version,
        absent=solver.absent,
        takes_conic_form=True,
        entropy="exp" in solver.cones,  # log det needs exponential cones
        clock=PROGRAM_RUN if solver.requires[0] == "program" else SOLVER_CALL,
        warm_up=lambda: None if solver.absent else solver.warm_up(),
    )


def _baselines() -> list[Contestant]:
    """Return the contestants that are no conic solvers of this package.

    They are our default method, CVXPY as users call it, the penalty method, and an
    augmented Lagrangian in log-Cholesky variables.
    """
    formulas = "CVXPY as a user meets it: the formulas, unscaled, prob.solve"
    cvxpy = Contestant(
        name="cvxpy scs",
        description=f"{formulas}(): its default for these cones is SCS at eps 1e-5",
        solve=partial(solve_cvxpy, solver=None),
        options=lambda accuracy: {"eps": "1e-05 by CVXPY's default"},
        version=partial(_versions, "cvxpy", "scs"),
        promise=1e-5,
        clock=MODELLING_TOO,
        warm_up=partial(solve_tiny, None),
    )
    clarabel = replace(
        cvxpy,
        name="cvxpy clarabel",
        description=f"{formulas}(solver='CLARABEL')",
        solve=partial(solve_cvxpy, solver="CLARABEL"),
        options=lambda accuracy: {"tol_gap_rel": "1e-08 by Clarabel's default"},
        version=partial(_versions, "cvxpy", "clarabel"),
        promise=1e-8,
        warm_up=partial(solve_tiny, "CLARABEL"),
    )
    penalty = Contestant(
        name="penalty",
        description="the exact penalty, multi-start (no SDP solver)",
        solve=solve_penalty,
        options=lambda accuracy: {"starts": Penalty.starts, "tolerance": accuracy},
        entropy=False,
        clock=POSED_AND_SOLVED,
    )
    cholesky = Contestant(
        name="log-cholesky L-BFGS",
        description=(
            "log-Cholesky variables, augmented Lagrangian, SciPy's L-BFGS-B (no SDP"
            " solver)"
        ),
        solve=augmented_lagrangian.solve,
        options=augmented_lagrangian.options,
        version=partial(metadata.version, "scipy"),
        clock=POSED_AND_SOLVED,
    )
    inside = Clarabel()
    passed = _in_words(inside.options(LmiSdp.accuracy))
    portfolio = Contestant(
        name="lmi-sdp",
        description=(
            "our default, a portfolio of two: a NumPy interior point, and Clarabel where"
            " its proved gap is loose"
        ),
        solve=solve_by_default,
        options=lambda accuracy: {
            "accuracy": LmiSdp.accuracy,
            "proved gap": accuracy,
            "inside": f"{inside.name}, at most {len(ATTEMPTS)} calls ({passed})",
        },
        version=lambda: f"{__version__}, clarabel {metadata.version('clarabel')}",
        certifies=True,
        warm_up=inside.warm_up,
    )
    return [portfolio, cvxpy, clarabel, penalty, cholesky]
