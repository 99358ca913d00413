"""Who takes part: our default method, every conic solver of the library, what users do
without one."""

import warnings
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import partial
from importlib import metadata
from typing import Any

import numpy as np

from sdp_vs_penalty.errors import InputError, require_known
from sdp_vs_penalty.estimators.estimator import Fit
from sdp_vs_penalty.estimators.lmi_sdp import LmiSdp, PosedSdp
from sdp_vs_penalty.estimators.penalty import Penalty, fit_penalty
from sdp_vs_penalty.shootout import augmented_lagrangian
from sdp_vs_penalty.shootout.instances import Instance
from sdp_vs_penalty.shootout.judge import Answer, no_answer
from sdp_vs_penalty.solvers import solver_types
from sdp_vs_penalty.solvers.solver import Solver
from sdp_vs_penalty.solvers.through_cvxpy import CLAIMS, ThroughCvxpy
from sdp_vs_penalty.version import __version__


def solve_cvxpy(instance: Instance, accuracy: float, solver: str | None) -> Answer:
    """Solve an instance by CVXPY as a user would write it: formulas, and default
    options.

    Minimised is |R theta - rho|^2, plus weight * sum of (trace(P0^-1 P) - log det P)
    over the links' pseudo-inertias P and nominal ones P0, if the instance has an
    entropy.

    Parameters
    ----------
    instance : Instance
        The problem.
    accuracy : float
        Ignored, since users rarely pass one.
    solver : str or None
        CVXPY's name of the solver; None for CVXPY's own choice.

    Returns
    -------
    Answer
        Without dual multipliers; theta is NaN if the solver returned none.
    """
    import cvxpy as cp

    data = instance.data
    entropy = instance.objective.entropy
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
    instance : Instance
        The problem.
    accuracy : float
        Relative accuracy that is asked for.

    Returns
    -------
    Answer
        The penalty's shifts serve as dual multipliers.
    """
    try:
        fit = fit_penalty(
            instance.task, instance.data, instance.constraints, Penalty.starts, accuracy
        )
    except InputError as error:
        return no_answer(instance, error)
    runs = fit.details["runs"]
    best = min(runs, key=lambda run: run["objective"])
    claims = "optimal" if best["residual"] <= accuracy else "inaccurate"
    status = f"residual {best['residual']:.1e}"
    return Answer(fit.theta, claims, status, fit.multipliers, attempts=len(runs))


_LOOP = "inside our loop: scaled, certified, solved again where the gap is loose"


@dataclass(frozen=True)
class Contestant:
    """name, description, solve(instance, accuracy) and version; absent : why it is not
    here, or "".

    options : what it is told at an accuracy, by the names of its documentation; None: it cannot be
        asked, and promises ``promise``. entropy : whether log det can be posed to it. warm_up : what a
        first call pays for once; it must start no thread: a forked child would wait for it for ever.
    """

    name: str
    description: str
    solve: Callable[[Instance, float], Answer]
    version: Callable[[], str] = lambda: __version__
    absent: str = ""
    options: Callable[[float], dict[str, Any]] | None = None
    promise: float = 1e-8
    entropy: bool = True
    warm_up: Callable[[], None] = lambda: None

    @property
    def is_certified(self) -> bool:
        """Whether this is a conic solver inside our certified fit, which scales the
        problem and proves the gap of the answer.
        """
        return self.name.endswith(" certified")

    def asked(self, accuracies: Iterable[float]) -> list[float]:
        """Return the accuracies at which this contestant runs, from loose to tight.

        Parameters
        ----------
        accuracies : iterable of float
            Those of the shootout.

        Returns
        -------
        list of float
            All of them; or only the accuracy that the contestant promises, if it has no
            setting for accuracy.
        """
        if self.options is None:
            return [self.promise]
        return sorted(set(accuracies), reverse=True)

    def settings(self, accuracy: float) -> str:
        """Return the key of a run's settings in runs.csv: its accuracy, or "default".

        Parameters
        ----------
        accuracy : float
            Accuracy that is asked for.

        Returns
        -------
        str
        """
        return "default" if self.options is None else f"{accuracy:.0e}"

    def options_in_words(self, accuracy: float) -> str:
        """Return the options that are passed to the solver, in words.

        Parameters
        ----------
        accuracy : float
            Accuracy that is asked for.

        Returns
        -------
        str
            Names of its documentation with values; "" if it takes none.
        """
        options = {} if self.options is None else self.options(accuracy)
        words = [
            f"{name} {value:g}" if isinstance(value, float) else f"{name} {value}"
            for name, value in options.items()
        ]
        return ", ".join(words)

    def refuses(self, instance: Instance) -> str | None:
        """Return why an instance cannot be posed to this contestant.

        Parameters
        ----------
        instance : Instance
            The problem.

        Returns
        -------
        str or None
            The reason; None if it can be posed.
        """
        posed = self.entropy or instance.objective.entropy is None
        return None if posed else "no cone for log det"


def contestants() -> dict[str, Contestant]:
    """Return all contestants by name, including those that are not installed.

    Each conic solver takes part twice: by itself, and inside our certified loop.
    """
    contestants_found = _baselines()
    for name, kind in solver_types().items():
        conic = kind()
        conic_contestant = _conic(conic)
        finest = conic.finest
        certified = replace(
            conic_contestant,
            name=f"{name} certified",
            description=f"{name} {_LOOP}",
            solve=partial(_in_our_loop, solver=name, finest=finest),
            options=None,
            promise=max(Contestant.promise, 10.0 * finest),
        )
        contestants_found += [conic_contestant, certified]
    return {c.name: c for c in sorted(contestants_found, key=lambda c: c.name)}


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
        present = [c for c in by_name.values() if not c.absent]
        absent = [c for c in by_name.values() if c.absent]
        return present, absent
    for name in names:
        require_known("solver", name, by_name)
        if reason := by_name[name].absent:
            raise InputError(f"solver {name} cannot be used here", reason)
    return [by_name[name] for name in names], []


def _conic(solver: Solver) -> Contestant:
    """Make a contestant of a conic solver alone, without our scaling loop and
    certificate.
    """

    def solve(instance: Instance, accuracy: float) -> Answer:
        """Solve an instance to an accuracy, and bring the answer back to its units."""
        sdp = instance.sdp
        solution = solver.solve(sdp.conic, accuracy)
        multipliers = sdp.multipliers(solution)
        return Answer(
            theta=sdp.theta(solution),
            claims=solution.claims,
            status=solution.status,
            multipliers=instance.constraints.stack_multipliers(multipliers),
            entropy_slopes=sdp.entropy_slopes(solution),
        )

    return Contestant(
        name=solver.name,
        description=solver.description,
        solve=solve,
        version=solver.version,
        absent=solver.absent,
        options=solver.options,
        entropy="exp" in solver.cones,  # log det needs exponential cones
        warm_up=lambda: None if solver.absent else solver.warm_up(),
    )


def _in_our_loop(
    instance: Instance, accuracy: float, solver: str | None, finest: float
) -> Answer:
    """Solve an instance by our certified fit with a conic solver inside.

    The fit scales the problem, calls the solver, and proves a gap from its multipliers.
    It claims an optimum only if that gap is within the accuracy.

    Parameters
    ----------
    instance : Instance
        The problem.
    accuracy : float
        Relative gap below which an optimum is claimed.
    solver : str or None
        Name of the conic solver; None for the default of lmi-sdp.
    finest : float
        Accuracy that is asked of the solver.

    Returns
    -------
    Answer
        With the multipliers, and the number of calls of the solver as attempts.
    """
    try:
        posed = PosedSdp(
            instance.task, instance.objective, instance.constraints, solver
        )
        fit: Fit = posed.fit(instance.objective, finest)
        gap = fit.gap
    except InputError as error:
        return no_answer(instance, error)
    solver_words: list[str] = fit.details["solver_said"]  # one text for each call
    return Answer(
        theta=fit.theta,
        claims="optimal" if gap <= accuracy else "inaccurate",
        status=f"certified gap {gap:.1e}; " + ", ".join(solver_words),
        multipliers=fit.multipliers,
        entropy_slopes=fit.entropy_slopes,
        attempts=len(solver_words),
    )


def _baselines() -> list[Contestant]:
    """Return the contestants that are no conic solvers of this package.

    They are our default method, CVXPY as users call it, the penalty method, and an
    augmented Lagrangian in log-Cholesky variables.
    """
    words = (
        "our default: the NumPy interior point, certified; Clarabel where the certified"
        " gap is loose"
    )
    cvxpy = Contestant(
        "cvxpy",
        "CVXPY as a user meets it: the formulas, prob.solve(), no options",
        partial(solve_cvxpy, solver=None),
        partial(metadata.version, "cvxpy"),
        promise=1e-5,  # what it asks of its default solver for such problems, SCS
        warm_up=ThroughCvxpy.warm_up,
    )
    return [
        Contestant(
            "lmi-sdp", words, partial(_in_our_loop, solver=None, finest=LmiSdp.accuracy)
        ),
        cvxpy,
        replace(
            cvxpy,
            name="cvxpy clarabel",
            description=(
                "CVXPY as a user meets it: the formulas, prob.solve(solver='CLARABEL')"
            ),
            solve=partial(solve_cvxpy, solver="CLARABEL"),
            promise=Contestant.promise,
        ),
        Contestant(
            "penalty",
            "the exact penalty, multi-start (no SDP solver)",
            solve_penalty,
            options=lambda accuracy: {"starts": Penalty.starts, "tolerance": accuracy},
            entropy=False,
        ),
        Contestant(
            "log-cholesky L-BFGS",
            "log-Cholesky variables, augmented Lagrangian, SciPy's L-BFGS-B (no SDP"
            " solver)",
            augmented_lagrangian.solve,
            partial(metadata.version, "scipy"),
            options=augmented_lagrangian.options,
        ),
    ]
