"""The convex estimator: least squares subject to linear matrix inequalities, in one
step.

    minimise |R theta - rho|^2 + residual_norm^2   subject to   P_i(theta) >= 0, bounds, signs

(Sousa, Cortesao, IJRR 2014, with the 4x4 pseudo-inertia of Wensing et al. 2018, which
contains the triangle inequalities). Plain, its optimum makes rods of most links. Three
convex remedies: a body that a link's mass must lie in, an entropic pull towards the
problem's nominal robot, and a minimum thickness. The default is the first two
(results/default_method/default_method.md).

One identification SDP (:class:`PosedSdp`) is solved until our own certificate is tight,
from a point strictly inside of it (:func:`interior_point`).
"""

from collections.abc import Sequence
from contextlib import suppress
from copy import copy
from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np

from sdp_vs_penalty.errors import Infeasible, InputError
from sdp_vs_penalty.estimators.estimator import (
    Estimator,
    Fit,
    Task,
    sample_variance,
    unsolved,
    with_joint_prior,
)
from sdp_vs_penalty.regression.regression import LeastSquares
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.constraint import Constraint, ConstraintSet, safe_depth
from sdp_vs_penalty.solvers import make_solver
from sdp_vs_penalty.solvers.convex_problem import ConvexProblem, Entropy
from sdp_vs_penalty.solvers.fit import fit_by_small_cones, repair, with_best_dual
from sdp_vs_penalty.solvers.identification import (
    largest_margin,
    least_squares_sdp,
    moving_scale,
)
from sdp_vs_penalty.solvers.primal_dual import Iterate
from sdp_vs_penalty.solvers.rewrite import NotApplicableError
from sdp_vs_penalty.solvers.rigorous_bounds import TIGHT, proves_infeasible
from sdp_vs_penalty.solvers.small_cones import SmallCones

#: Solver of every SDP that our own method cannot take or does not solve tightly.
REFERENCE = "clarabel"
#: Largest certified gap of an answer that its solver did not call a solution. Rounding makes
#: gaps below 1e-6: at a larger gap than this the solver stopped short.
FAR_GAP = 1e-3
#: Of each attempt: where cones are scaled, as a share of the way from the best answer to the
#: interior point; and whether parameters are scaled by the residual instead of the torque.
ATTEMPTS = ((1.0, False), (0.3, False), (0.1, True), (0.03, False))


@dataclass(frozen=True)
class LmiSdp(Estimator):
    """One-step torque SDP with the constraints and priors that the fields choose."""

    name = "lmi-sdp"
    proves_optimum: ClassVar[bool] = True
    table_place: ClassVar[int | None] = 4
    description = (
        "best fit whose links can exist and fit their bodies, near the nominal robot"
        " where the data say nothing (the default)"
    )

    #: Whether each link's mass must lie inside of its body (:class:`~robot.body.Body`).
    body: bool = True
    #: Smallest radius of gyration of a link in any direction [m]; 0 for none.
    thickness: float = 0.0
    #: Weight of the Bregman divergence from the nominal robot, in units of the residual
    #: variance of one filtered torque row; 0: none. By default about one independent
    #: measurement a link: filtered rows repeat each other 2.3 to 4.5 times.
    entropy: float = 3.0
    #: Weight, in the same unit, of the pull of friction, offsets and other joint
    #: parameters to zero; one that alone would make all of its joint's torque costs one
    #: row; 0: none. Where a joint does not reverse, only this keeps Coulomb friction
    #: and offset from growing against each other.
    joint_prior: float = 1.0
    #: Relative standard deviation of the total mass that a file or bounds state, which
    #: counts like ``entropy`` rows; 0: no prior on it. The divergence alone lets masses
    #: follow moments.
    total_spread: float = 0.2
    #: Name of a solver; None: our own (solvers/primal_dual.py) where its answer is
    #: certified, else Clarabel.
    solver: str | None = None
    #: Relative accuracy that the solver is asked for.
    accuracy: float = 1e-10

    def fit(self, task: Task) -> Fit:
        """Solve the torque SDP of a task."""
        return self.fit_each([task])[0]

    def fit_each(self, tasks: Sequence[Task]) -> list[Fit]:
        """Solve the SDPs of tasks that differ in their data alone, with one set of
        cones."""
        problems = [self.posed(task) for task in tasks]
        first = PosedSdp(tasks[0], problems[0], self.solver)
        return [first.with_problem(problem).fit(self.accuracy) for problem in problems]

    @property
    def undetermined_by(self) -> str:
        """What decides parameters that the data do not: "prior" with an entropic pull,
        or "bounds".
        """
        return "prior" if self.entropy > 0.0 else "bounds"

    def posed(self, task: Task) -> ConvexProblem:
        """Return the SDP: loss and priors (of joint parameters, total mass, entropic
        pull), bounds, thickness, bodies.

        The total mass is observed with the relative standard deviation
        ``total_spread``, with the weight of ``entropy`` rows.
        """
        constraints = task.constraints.plus(task.minimum_thickness(self.thickness))
        if self.body:
            constraints = constraints.plus(task.bodies)
        data = with_joint_prior(task, self.joint_prior).data
        if self.total_spread > 0.0 and self.entropy > 0.0 and task.total:
            # (sum of masses - total) / (spread total) has the variance one.
            masses = np.zeros((1, data.R.shape[1]))
            masses[0, task.links[:, 0]] = 1.0 / (self.total_spread * task.total)
            of_known = masses @ task.model.with_known(np.zeros(masses.shape[1]))
            masses[0, list(task.model.known_values)] = 0.0
            data = data.with_observations(
                rows=masses,
                values=1.0 / self.total_spread - of_known,
                weight=self.entropy * sample_variance(task),
            )
        prior = None
        if self.entropy > 0.0 and task.pseudo_inertias:
            prior = Entropy(
                weight=self.entropy * sample_variance(task),
                links=task.pseudo_inertias,
                nominal=task.prior_inertias,
            )
        return replace(
            task.problem, constraints=constraints, least_squares=data, entropy=prior
        )


@dataclass(frozen=True)
class LmiSdpThickness(LmiSdp):
    name = "lmi-sdp-thickness"
    table_place: ClassVar[int | None] = None
    description = (
        "one-step torque SDP with minimum thickness, without bodies or a prior on the"
        " links"
    )
    body: bool = False
    thickness: float = 0.02  # costs about 1 % of the Panda's loss
    entropy: float = 0.0


@dataclass(frozen=True)
class LmiSdpPlain(LmiSdp):
    name = "lmi-sdp-plain"
    table_place: ClassVar[int | None] = 5
    description = (
        "one-step torque SDP without minimum thickness: links degenerate to rods"
    )
    body: bool = False
    entropy: float = 0.0
    joint_prior: float = 0.0


@dataclass(frozen=True)
class LmiSdpEntropic(LmiSdp):
    name = "lmi-sdp-entropic"
    table_place: ClassVar[int | None] = 6
    description = (
        "one-step torque SDP with an entropic pull towards the problem's nominal robot"
        " and no bodies"
    )
    body: bool = False
    entropy: float = 1.0


@dataclass(frozen=True)
class LmiSdpTwoStep(Estimator):
    """Sousa and Cortesao's chain (IJRR 2014), each step a feasible set and a distance:

    beta'   nearest feasible base parameters to the OLS estimate, Euclidean in the symbols;
    beta*   the torque SDP with pseudo-inertias only;
    beta*e  the torque SDP with centre-of-mass and mass bounds as well;
    delta   standard parameters with base parameters beta*e (their eq. 49).
    """

    name = "lmi-sdp-two-step"
    proves_optimum: ClassVar[bool] = True
    description = "Two-step SDP (Sousa and Cortesao)"

    solver: str | None = None
    accuracy: float = 1e-10

    def fit(self, task: Task) -> Fit:
        """Solve three SDPs (Sousa and Cortesao): beta', beta* and beta*e; return the
        last fit.

        beta' is the feasible point nearest to the OLS base parameters; beta* has the
        smallest torque error under physics alone; beta*e also keeps the problem's
        bounds. All three stand in the fit's details.
        """
        # beta' and beta* are subject to physics. Families that only bound the feasible
        # set stay: without them it is open to infinity.
        families = (
            "pseudo-inertia",
            "sign",
            "range",
            "trace",
            "bounding ellipsoid",
            "mass",
        )
        physics = task.constraints.with_families(families.__contains__)
        free = replace(task.problem, constraints=physics)
        nearest = self._step(task, replace(free, least_squares=task.base_distance))
        best = self._step(task, free)
        bounded = self._step(task, task.problem)
        details = {
            **bounded.details,
            "beta_prime": (task.base.rows @ nearest.theta).tolist(),
            "beta_star": (task.base.rows @ best.theta).tolist(),
            "beta_star_e": (task.base.rows @ bounded.theta).tolist(),
            "loss_beta_prime": task.data.loss(nearest.theta),
        }
        return replace(bounded, details=details)

    def _step(self, task: Task, problem: ConvexProblem) -> Fit:
        """Solve one step's SDP."""
        return PosedSdp(task, problem, self.solver).fit(self.accuracy)


class PosedSdp:
    """A problem that is solved once, or again with other data.

    - ``solver``: its name; None: our own interior-point method, then Clarabel where
      that is not tight.
    - ``interior`` (p,): a theta strictly inside the constraints.
    - ``cones``: for our own method (None: another one was asked for, or a cone is
      larger than it takes).

    Raises InputError where the constraints admit no interior point.
    """

    def __init__(
        self, task: Task, problem: ConvexProblem, solver: str | None = None
    ) -> None:
        """Find an interior point, and prepare the cones for our own interior-point
        method.

        ``solver`` None: our own method where its cones are small enough (order four).
        """
        self.task = task
        self.problem = problem
        self.solver = solver or REFERENCE
        self.interior = interior_point(task, problem.constraints, self.solver)
        self.cones: SmallCones | None = None
        if solver is None:
            with suppress(NotApplicableError):
                self.cones = SmallCones(
                    problem.entropy, problem.constraints, len(self.interior)
                )

    def with_problem(self, problem: ConvexProblem) -> Self:
        """Return a problem of the same constraints with other data and another prior,
        which shares interior point and cones."""
        posed = copy(self)
        posed.problem = problem
        if self.cones is not None:
            posed.cones = self.cones.with_entropy(problem.entropy)
        return posed

    def fit(self, accuracy: float = 1e-10, near: Fit | None = None) -> Fit:
        """Solve the SDP until our own certificate is tight.

        Our own interior-point method is tried first. Unless its certified gap is at
        most TIGHT, a conic solver solves the problem, several times with better
        scaling. The least objective and the largest bound of all answers count.

        Parameters
        ----------
        accuracy : float
            Relative accuracy for the solver.
        near : Fit or None
            Fit to similar data as a warm start; it saves about half of the steps.

        Raises
        ------
        InputError
            If no point near an optimum is found.
        """
        problem, interior = self.problem, self.interior
        answers = list[Fit]()
        if self.cones is not None:
            starts: list[Array | Iterate] = [
                self._start(problem.least_squares),
                interior,
            ]
            if near is not None and near.central is not None:
                starts.insert(0, near.central)
            fit = fit_by_small_cones(problem, self.cones, starts, interior, accuracy)
            if fit is not None:
                if fit.gap <= TIGHT:
                    return fit
                answers.append(fit)
        return _solved(self, accuracy, answers)

    def _start(self, data: LeastSquares) -> Array:
        """Return a start (p,) in which friction, rotor inertia and the like make a
        tenth of the torque.

        Next to their bound of zero their multipliers would be the first to block a
        step.
        """
        start = self.interior.copy()
        norms = np.linalg.norm(data.R, axis=0)
        lower = np.array([q.lower for q in self.task.model.parameters])
        has_sign = np.isfinite(lower) & (norms > 0.0)
        has_sign[self.task.model.rigid_indices] = False
        tenth_of_torque = 0.1 * np.sqrt(data.tau_squared)
        size = tenth_of_torque / np.where(has_sign, norms, 1.0)
        above_lower = lower + np.minimum(size, 0.5 * self.problem.bound)
        start[has_sign] = above_lower[has_sign]
        return start


def _solved(posed: PosedSdp, accuracy: float, answers: Sequence[Fit]) -> Fit:
    """Solve the SDP by a conic solver in several attempts; return the best Fit.

    Each attempt solves the same problem in other units: it is centred at the best
    answer so far, and scales the cones at a point between that and the interior point.
    The best answer has the least objective, those of our own method (``answers``)
    included, and the multipliers of all answers that prove most of it. A gap of at most
    TIGHT ends the attempts. Raises InputError if no answer is usable.
    """
    constraints = posed.problem.constraints
    interior = posed.interior
    data = posed.problem.least_squares
    answers = list(answers)
    best = min(answers, key=_objective, default=None)
    is_answered = False  # whether the solver itself called one of its points a solution
    claims_made = list[str]()
    # Lower estimate of the loss at the optimum: the unit of the objective.
    smallest_scale = 1e-6 * data.tau_squared
    for share, fine in ATTEMPTS:
        centre = interior if best is None else best.theta
        scaling_point = centre + share * (interior - centre)
        # Without noise, or with as many rows as parameters, the unconstrained residual
        # vanishes and says nothing of the optimum: a problem scaled by it looks
        # infeasible to a solver. Nor may the unit fall at once to a loss that is
        # nothing but rounding.
        if best is not None:
            smallest_scale = max(data.loss(best.theta), 1e-3 * smallest_scale)
        # 1. State the SDP in units of the scaling point, and solve it.
        problem = least_squares_sdp(
            posed.problem,
            reference=scaling_point,
            centre=centre,
            fine=fine,
            least_loss=smallest_scale,
        )
        try:
            conic_solver = make_solver(posed.solver)
            solution = conic_solver.solve_for_user(problem.conic, accuracy)
        except NotApplicableError as error:
            raise InputError(
                f"solver {posed.solver} cannot pose this method's problem ({error})",
                "choose the solver clarabel, or a method without an entropic prior,"
                " such as lmi-sdp-thickness",
            ) from error
        claims_made.append(f"{solution.status} ({solution.iterations})")
        is_answered |= solution.claims in ("optimal", "inaccurate")
        if not np.all(np.isfinite(solution.x)):
            continue
        # 2. Move the answer into the feasible set, past the solver's rounding.
        theta = repair(constraints, problem.theta(solution), interior)
        multipliers = constraints.stack_multipliers(problem.multipliers(solution))
        slopes = problem.entropy_slopes(solution)
        details = {"solver": posed.solver, "solver_said": claims_made}
        fit = Fit(
            theta=theta,
            problem=posed.problem,
            multipliers=multipliers,
            entropy_slopes=slopes,
            interior=interior,
            details=details,
        )
        # 3. Keep the least objective, and the multipliers that prove most of it.
        answers.append(fit)
        best = with_best_dual(min(answers, key=_objective), answers)
        if best.gap <= TIGHT:
            break
    if best is None or not (is_answered or best.gap <= FAR_GAP):
        raise unsolved(
            f"solver {posed.solver} gave up on a problem that has an interior point"
            f" ({', '.join(claims_made)})"
        )
    return best


def _objective(fit: Fit) -> float:
    """Return the objective at an answer."""
    return fit.upper


def interior_point(
    task: Task, constraints: ConstraintSet, solver_name: str = "clarabel"
) -> Array:
    """Return a theta (p,) strictly inside all convex constraints.

    It is the nominal theta if that is well inside, else the point of largest margin.

    Parameters
    ----------
    task : Task
        Nominal links, and bounds of theta.
    solver_name : str
        Solver that finds the largest margin.

    Raises
    ------
    Infeasible
        Names the families of constraints that exclude each other or leave no room.
    InputError
        If the solver finds neither a point nor a proof that there is none.
    """
    # A millionth of the bound above a lower end: strictly inside in any system of
    # units.
    lower = np.array([p.lower for p in task.model.parameters])
    nominal = np.where(np.isinf(lower), 0.0, lower + 1e-6 * task.bound)
    nominal[task.links] = task.nominal[task.links]
    # A nominal point near the boundary, such as an earlier estimate, is no use: scaled
    # there, cones are stretched a million times. Depth is the smallest relative margin.
    depth_well_inside = 1e-3
    if constraints.depth(nominal) >= depth_well_inside:
        return nominal
    optimum = None
    # Where a link may weigh a hundred times what it does, units as large as the bounds
    # can cost a solver the digits that decide; then units that move each matrix about
    # as far.
    for scale in (task.bound, moving_scale(constraints.convex, nominal, task.bound)):
        problem = largest_margin(constraints.convex, nominal, scale)
        solution = make_solver(solver_name).solve_for_user(problem.conic, 1e-8)
        if not np.all(np.isfinite(np.concatenate([solution.x, solution.z]))):
            continue
        theta = max((problem.theta(solution), nominal), key=constraints.depth)
        rounding = safe_depth(len(theta))
        if constraints.depth(theta) > rounding:
            return theta
        # The dual of the largest margin may prove that nothing satisfies all.
        multipliers = constraints.stack_multipliers(problem.multipliers(solution))
        nothing = ConvexProblem.without_data(constraints, task.bound)
        if proves_infeasible(nothing, multipliers):
            families = conflicting(constraints.convex, problem.shares(solution))
            demands = [*families, *_known_in_words(task)]
            what = (
                f"{' and '.join(demands)} exclude each other (from the infeasibility"
                " certificate)"
            )
            raise Infeasible(
                f"The constraints admit no parameters: {what}",
                "relax one of them",
                families=families,
                proof=(nothing, multipliers),
            )
        if solution.claims == "optimal":
            optimum = problem, solution
    if optimum is None:
        raise InputError(
            f"solver {solver_name} found neither parameters that satisfy all"
            " constraints nor a proof that there are none",
            "choose another solver, or check the units of the bounds",
        )
    families = conflicting(constraints.convex, optimum[0].shares(optimum[1]))
    demands = [*families, *_known_in_words(task)]
    raise Infeasible(
        f"The constraints leave no room for parameters: {' and '.join(demands)} can at"
        " best hold with nothing to spare (equal bounds?)",
        "widen one of them a little",
        families=families,
    )


def _known_in_words(task: Task) -> list[str]:
    """Return what is known of a task's parameters in words: "m3 = 2.5 (known)"."""
    return [f"{name} = {x:g} (known)" for name, x in task.model.known.items()]


def conflicting(constraints: Sequence[Constraint], shares: Array) -> list[str]:
    """Name the families of constraints that together prove infeasibility.

    Parameters
    ----------
    shares : (m,) array
        Share of each constraint in the proof (from its Farkas multiplier); constraints
        below a thousandth of the largest share are left out.

    Returns
    -------
    list of str
        Such as "mass (links 1, 2; robot)", the largest share first.
    """
    # Shares by family, then by name of the constraint.
    families: dict[str, dict[str, float]] = {}
    for constraint, share in zip(constraints, shares, strict=True):
        if share > 1e-3 * shares.max():
            families.setdefault(constraint.family, {})[constraint.name] = float(share)
    out = []
    for family in sorted(families, key=lambda family: -sum(families[family].values())):
        names = list(families[family])
        links = [k.removeprefix("link ") for k in names if k.startswith("link ")]
        words = []
        if links:
            plural = "s" if len(links) > 1 else ""
            words.append(f"link{plural} {', '.join(links)}")
        words += [name for name in names if not name.startswith("link ")]
        out.append(f"{family} ({'; '.join(words)})")
    return out
