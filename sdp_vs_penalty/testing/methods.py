"""What every estimator and every solver keeps."""

from __future__ import annotations

import ast
import dataclasses
import inspect
import json
import textwrap
from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np

from sdp_vs_penalty.estimators.estimator import Estimator, Task, make_task
from sdp_vs_penalty.problem.load import load_problem
from sdp_vs_penalty.regression.regression import LeastSquares, compress
from sdp_vs_penalty.robot import constraint as build
from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.constraint import ConstraintSet
from sdp_vs_penalty.signals.filtered import FilteredRuns
from sdp_vs_penalty.solvers.conic import Solution
from sdp_vs_penalty.solvers.convex_problem import ConvexProblem, Entropy
from sdp_vs_penalty.solvers.fit import Fit, repair
from sdp_vs_penalty.solvers.identification import SdpProblem, least_squares_sdp
from sdp_vs_penalty.solvers.rewrite import NotApplicableError
from sdp_vs_penalty.solvers.rigorous_bounds import certainly_feasible
from sdp_vs_penalty.solvers.solver import EVERYTHING, Solver
from sdp_vs_penalty.testing.demand import demand
from sdp_vs_penalty.testing.robots import measured

#: Options that a solver's ``run`` may pass besides those that it is given.
_SILENCE = {"verbose", "print", "show_progress"}


@cache
def small_task() -> Task:
    """Return a task of two links with friction, from ten seconds with noise."""
    problem = load_problem("two_link")
    run = replace(measured(problem, noise=3.0), dq=None)
    filtered = FilteredRuns.filtering(run, problem.preprocessing.resolve(run))
    model = problem.model()
    return make_task(problem, model, compress(filtered, model), seed=4)


@cache
def first_fit(estimator: Estimator) -> Fit:
    """Return an estimator's fit of :func:`small_task`, which is made once."""
    return estimator.fit(small_task())


def check_settings(estimator: Estimator) -> None:
    """An estimator is a frozen record of its settings, which are plain JSON, and says
    what it is."""
    kind = type(estimator)
    parameters = getattr(kind, "__dataclass_params__", None)
    demand(parameters and parameters.frozen, f"{kind.__name__} is no frozen dataclass")
    about = getattr(kind, "description", "")
    demand(len(about) > 15 and "\n" not in about, "describe it in a line of text")
    demand((kind.__doc__ or "").strip(), "it has no docstring")
    settings = dataclasses.asdict(estimator)  # type: ignore[call-overload]
    stored = json.loads(json.dumps(settings, allow_nan=False))
    demand(stored.keys() == settings.keys(), "its settings are no plain JSON")
    demand(kind(**settings) == estimator, "its settings do not make it again")


def check_fit(estimator: Estimator) -> None:
    """A fit is finite, says what it minimised, and its certificate sees every
    constraint."""
    task = small_task()
    fit = first_fit(estimator)
    demand(fit.theta.shape == task.bound.shape, "theta has another length")
    demand(np.isfinite(fit.theta).all(), "theta is not finite")
    demand(np.isfinite(fit.problem.value(fit.theta)), "its objective is not finite")
    gradient = fit.problem.gradient(fit.theta)
    demand(gradient.shape == fit.theta.shape, "its gradient has another length")
    json.dumps(fit.details, allow_nan=False)
    imposed = {c.family for c in fit.problem.constraints.convex}
    demand({"pseudo-inertia", "mass", "sign"} <= imposed, "it drops constraints")
    others = {c.family for c in task.constraints.nonconvex}
    demand(
        {c.family for c in fit.problem.constraints.nonconvex} >= others,
        "it drops bounds",
    )


def check_seed(estimator: Estimator) -> None:
    """The seed decides everything."""
    again = estimator.fit(small_task()).theta
    same = np.array_equal(first_fit(estimator).theta, again)
    demand(same, "two fits with one seed differ")


@dataclasses.dataclass(frozen=True)
class LinkProblem:
    """One link with a pseudo-inertia, a mass range and a centre of mass in a cone, from
    noisy data; with a log det of the pseudo-inertia if it is entropic."""

    #: What is minimised, and what the link has to fulfil.
    problem: ConvexProblem
    #: (10,) a link inside the constraints.
    nominal: Array

    @classmethod
    def drawn(cls, entropic: bool = False) -> LinkProblem:
        """Draw the problem; it is always the same."""
        rng = np.random.default_rng(5)
        nominal, thin = inertia.standard_from_barycentric(
            [
                [2.0, 0.1, 0, 0.05, 0.05, 0, 0.06, 0, 0, 0.05],
                [2.2, 0.15, 0, 0, 1e-4, 0, 0.06, 0, 0, 0.06],
            ]
        )
        index = np.arange(10)
        radius = np.zeros((4, 3))
        radius[0, 0], radius[2, 1], radius[3, 2] = 0.1, 1.0, 1.0
        link = build.pseudo_inertia("link 1", index)
        mass = build.linear("mass", "link 1", [0], [[1.0, -1.0]], [-0.5, 3.0])
        family = "centre of mass cone"
        cone = build.linear(family, "link 1", index[:4], radius, np.zeros(3), "soc")
        trace = build.linear("trace", "link 1", [4, 6, 9], -np.eye(3), [1.0, 1.0, 1.0])
        R = rng.normal(size=(14, 10))
        rho = R @ thin + 0.05 * rng.normal(size=14)
        entropy = None
        if entropic:
            entropy = Entropy(1e-3, (link,), inertia.pseudo_inertia(nominal)[None])
        data = LeastSquares(R, rho, 0.1, float(rho @ rho) + 0.01, 14)
        constraints = ConstraintSet((link, mass, cone, trace))
        bound = np.array([3.0, *[1.0] * 9])
        return cls(ConvexProblem(data, constraints, bound, entropy), nominal)

    @property
    def sdp(self) -> SdpProblem:
        """The problem in a solver's form."""
        return least_squares_sdp(self.problem, self.nominal, self.nominal)

    def certified_gap(self, solution: Solution) -> tuple[float, float]:
        """Return the certified relative gap of a solution after feasible repair, and its
        largest relative violation before."""
        sdp = self.sdp
        theta = sdp.theta(solution)
        constraints = self.problem.constraints
        multipliers = constraints.stack_multipliers(sdp.multipliers(solution))
        slopes = sdp.entropy_slopes(solution)
        fit = Fit(theta, self.problem, multipliers, slopes)
        point = repair(constraints, theta, self.nominal)
        feasible = certainly_feasible(constraints.convex, point)
        demand(feasible, "no feasible point is near its solution")
        scale = self.problem.least_squares.loss(point)
        gap = (self.problem.value(point) - fit.lower) / scale
        return gap, max(constraints.worst(theta).values())


def check_declaration(solver: Solver) -> None:
    """A solver says what it is, which cones it takes, what an accuracy means, and its
    version."""
    demand(solver.description, "its docstring says nothing")
    demand(solver.cones <= EVERYTHING, f"its cones are not among {sorted(EVERYTHING)}")
    demand(solver.options(1e-5) != solver.options(1e-7), "no option is the accuracy")
    if not solver.absent and solver.requires[0] == "package":
        demand(solver.version()[:1].isdigit(), "its version is not known: distribution")


def check_all_options_are_declared(solver: Solver) -> None:
    """Whatever a package is told, but to be silent, stands in ``default_options`` or
    ``tuned_options``, which the shootout prints."""
    run = ast.parse(textwrap.dedent(inspect.getsource(type(solver).run))).body[0]
    assert isinstance(run, ast.FunctionDef)
    options = run.args.args[2].arg

    def unpacks(value: ast.expr) -> bool:
        return isinstance(value, ast.Name) and value.id == options

    passed = set[str]()
    for node in ast.walk(run):
        if isinstance(node, ast.Call) and any(
            k.arg is None and unpacks(k.value) for k in node.keywords
        ):
            passed |= {k.arg for k in node.keywords if k.arg}
        elif isinstance(node, ast.Dict) and any(map(unpacks, node.values)):
            passed |= {str(k.value) for k in node.keys if isinstance(k, ast.Constant)}
    hidden = ", ".join(sorted(passed - _SILENCE))
    demand(not hidden, f"run passes {hidden}: declare it in default_options")


def check_optimum(solver: Solver, largest_gap: float = 1e-4) -> None:
    """Its primal and dual solution prove the optimum, with a log det or without; what
    it cannot take it declines."""
    for entropic in (False, True):
        problem = LinkProblem.drawn(entropic)
        sdp = problem.sdp
        if entropic and "exp" not in solver.cones:
            try:
                solver.solve(sdp.conic, 1e-7)
            except NotApplicableError:
                continue
            demand(False, "it solves cones that it does not declare")
        solution = solver.solve(sdp.conic, 1e-7)
        claims = solution.claims in ("optimal", "inaccurate")
        demand(claims, f"it ends in {solution.status!r}: status_meaning")
        demand(solution.x.shape == sdp.conic.q.shape, "x has another length")
        demand(solution.z.shape == sdp.conic.b.shape, "z has another length")
        gap, violation = problem.certified_gap(solution)
        demand(-1e-12 <= gap <= largest_gap, f"the certified gap is {gap:.2g}")
        demand(violation <= 1e-4, f"constraints are violated by {violation:.2g}")
        # What a file says of its optimum is the objective there; P is the upper half.
        x, P = solution.x, sdp.conic.P
        square = x @ (P @ x) - 0.5 * x @ (P.diagonal() * x)
        stated = sdp.offset + sdp.loss_scale**2 * (square + sdp.conic.q @ x)
        value = problem.problem.value(sdp.theta(solution))
        demand(np.isclose(stated, value, rtol=1e-3), "its x has another objective")
        demand(solution.iterations > 0, "it does not count iterations")


def check_empty_set(solver: Solver) -> None:
    """An empty feasible set is never called solved."""
    drawn = LinkProblem.drawn()
    # m >= 4 where m <= 3
    heavy = build.linear("total mass", "robot", [0], [[1.0]], [-4.0])
    none = drawn.problem.constraints.plus([heavy])
    empty = replace(drawn, problem=replace(drawn.problem, constraints=none))
    claims = solver.solve(empty.sdp.conic, 1e-7).claims
    solved = claims in ("optimal", "inaccurate", "unbounded")
    demand(not solved, f"it calls an empty set {claims}")


ESTIMATOR_CONTRACTS: tuple[Callable[..., None], ...] = (
    check_settings,
    check_fit,
    check_seed,
)
SOLVER_CONTRACTS: tuple[Callable[..., None], ...] = (
    check_declaration,
    check_all_options_are_declared,
    check_optimum,
    check_empty_set,
)
