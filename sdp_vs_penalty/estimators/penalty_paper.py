"""Penalty-based retrieval as published: Gaz et al. (RA-L 2019), secs. IV-C and V, eq.
29.

    minimise  loss(p) + xi_k g(p)   subject to  lower <= p <= upper,    k = 1..5

over p = (m, c, I about the centre of mass) of each link, by simulated annealing
followed by a local search, each step from the previous step's answer, the first from a
random point of the box; weights xi = 0, 10, 20, 30, 40; ten independent runs, of which
the one of least penalised loss is kept. The external penalties g are linear in what
they punish: (lambda_max(I) - tr(I) / 2)+ of each link (the triangle inequalities, eq.
16), the total mass [kg], the conditional bounds on centres of mass [m].

A linear penalty is exact above the loss's multiplier, in (N m)^2 per kg m^2, which
grows with the data: at 40 the answer is in general not physically consistent.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Protocol

import numpy as np
import scipy

from sdp_vs_penalty.estimators.estimator import Estimator, Fit, Task
from sdp_vs_penalty.estimators.penalty import BarycentricBox
from sdp_vs_penalty.regression.regression import LeastSquares
from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.robot.arrays import Array, Indices, nonzero_or_one
from sdp_vs_penalty.robot.constraint import ConeGroup

#: Evaluations a searched parameter that MATLAB's simulannealbnd, which the authors used,
#: allows at each weight: 273 000 for the 91 of one step, 210 000 for the 70 of two.
EVALUATIONS_A_PARAMETER = 3000


@dataclass(frozen=True)
class PenaltyPaper(Estimator):
    """The published one-step retrieval.

    Notes
    -----
    The local search here gets analytic gradients, which the authors' had to estimate.
    Friction and offsets are searched with the links, inside their signs and +-max(100,
    |tau| / |Y_k|) (the authors' +-100).
    """

    name = "penalty-paper"
    table_place: ClassVar[int | None] = 3
    description = (
        "simulated annealing with penalty weights 0..40, as published (one-step)"
    )

    #: Independent runs, each from a random start inside the bounds.
    runs: int = 10
    #: Evaluations of the loss in one run, shared equally by the steps, and in each step
    #: by annealing and local search, which finish what they have begun; None: as many
    #: as the authors' program allows.
    evaluations: int | None = 3_000
    #: Penalty weight xi of each step.
    weights: tuple[float, ...] = (0.0, 10.0, 20.0, 30.0, 40.0)

    def fit(self, task: Task) -> Fit:
        """Minimise the penalised torque loss by annealing and local search, as
        published.
        """
        return self.fit_with(task, anneal_and_search)

    def fit_with(self, task: Task, search: PenaltySearch) -> Fit:
        """Fit with another search than :func:`anneal_and_search`, such as a resumable
        one.

        Parameters
        ----------
        search : PenaltySearch
            Search of one step of one run.

        Returns
        -------
        Fit
            The best of all runs.
        """
        return retrieve(self, task, self.loss(task), search)

    def loss(self, task: Task) -> PenalisedLoss:
        """Return the penalised objective: torque loss, all parameters free."""
        return PenalisedLoss(task, task.data, np.arange(len(task.bound)))


@dataclass(frozen=True)
class PenaltyPaperTwoStep(PenaltyPaper):
    """loss = |pi(p) - pi_hat|^2 over the links' parameters; friction stays as first
    estimated."""

    name = "penalty-paper-two-step"
    table_place: ClassVar[int | None] = None
    description = (
        "simulated annealing on the distance to the OLS base parameters, as published"
    )

    def loss(self, task: Task) -> PenalisedLoss:
        """Return the penalised distance to the OLS base parameters, over the links'
        parameters.

        Friction keeps its least-squares values.
        """
        return PenalisedLoss(task, task.base_distance, task.model.rigid_indices)


class PenaltySearch(Protocol):
    """One step of a run: annealing, then a local search."""

    def __call__(
        self,
        loss: PenalisedLoss,
        weight: float,
        u: Array,
        budget: int,
        rng: np.random.Generator,
    ) -> tuple[Array, int]:
        """Search from u (d,) at one penalty weight within ``budget`` evaluations.

        Returns the best u (d,), in [0, 1]^d, and the number of evaluations.
        """
        ...


def retrieve(
    settings: PenaltyPaper, task: Task, loss: PenalisedLoss, search: PenaltySearch
) -> Fit:
    """Minimise the penalised objective by several independent runs; return the best.

    Each run increases the penalty weight step by step, starting from the last step's
    result.

    Parameters
    ----------
    settings : PenaltyPaper
        Number of runs, weights and evaluations.
    task : Task
        The identification problem. Parameters that are not searched keep their
        least-squares values.
    search : PenaltySearch
        Search of one step of one run.

    Returns
    -------
    Fit
        The best of all runs, with the figures of all in its details.
    """
    budget = EVALUATIONS_A_PARAMETER * len(loss.free)
    if settings.evaluations is not None:
        budget = settings.evaluations // max(len(settings.weights), 1)
    runs: list[dict[str, Any]] = []
    best_theta, best_value = task.ols, np.inf
    for number in range(settings.runs):
        u = start_of_run(task.seed, number, len(loss.free))
        n_evaluations = 0
        for step, weight in enumerate(settings.weights):
            rng = random_numbers_of_step(task.seed, number, step)
            u, n_of_step = search(loss, weight, u, budget, rng)
            n_evaluations += n_of_step
        theta = loss.theta(u)
        violations = loss.violations(loss.p(u))
        run: dict[str, Any] = {
            "loss": task.data.loss(theta),
            "objective": loss.data.loss(theta),
            "penalised": loss.value(u, settings.weights[-1]),
            "violation": max(violations.values()),
            "violations": violations,
            "evaluations": n_evaluations,
        }
        runs.append(run)
        if run["penalised"] < best_value:
            best_value = run["penalised"]
            best_theta = loss.theta(u)
        task.progress(
            f"run {number + 1} of {settings.runs}: best {best_value:.6g}, violation"
            f" {run['violation']:.1e}"
        )
    details = {"runs": runs}
    problem = replace(task.problem, least_squares=loss.data)
    return Fit(best_theta, problem, details=details)


def start_of_run(seed: int, number: int, size: int) -> Array:
    """Return the random start (size,) of a run in the unit box; other runs do not
    influence it."""
    return np.random.default_rng([seed, number]).uniform(size=size)


def random_numbers_of_step(seed: int, number: int, step: int) -> np.random.Generator:
    """Return the random generator of one step of one run, so that a stopped run can go
    on."""
    # Steps count from 1: NumPy takes a seed that ends in 0 for the seed without that 0,
    # which is the seed of the run's start.
    return np.random.default_rng([seed, number, 1 + step])


def anneal_and_search(
    loss: PenalisedLoss, weight: float, u: Array, budget: int, rng: np.random.Generator
) -> tuple[Array, int]:
    """Spend half of the budget on simulated annealing from u (d,) in [0, 1]^d, half on
    a local search; return the best point and the number of evaluations.

    Parameters
    ----------
    weight : float
        Penalty weight xi of this step.
    budget : int
        Number of evaluations of the loss.
    rng : numpy.random.Generator
        Random numbers of the annealing.

    Notes
    -----
    The local search is SLSQP, the nearest in SciPy to the authors' fmincon; of
    L-BFGS-B, TNC and SLSQP it reached the lowest penalised losses on the Panda within
    equal evaluations.
    """
    if not len(u):
        return u, 0
    annealed = scipy.optimize.dual_annealing(
        loss.value,
        _unit_box(u),
        args=(weight,),
        x0=u,
        maxfun=budget // 2,
        no_local_search=True,
        seed=rng,
    )
    n_annealed = int(annealed.nfev)
    best, n_searched = search_locally(loss, weight, annealed.x, budget - n_annealed)
    return best, n_annealed + n_searched


@dataclass(frozen=True)
class Stopping:
    """When the local search ends."""

    #: SLSQP's tolerance of the scaled objective.
    tolerance: float = 1e-9
    #: A restart that lowers the objective by less than this share is the last one.
    gain: float = 1e-6
    #: Restarts at most.
    restarts: int = 1_000_000
    #: Steps of SLSQP in one of them at most.
    steps: int = 1_000_000


#: How the search that takes the place of the authors' ends.
AS_PUBLISHED = Stopping()


def search_locally(
    loss: PenalisedLoss,
    weight: float,
    u: Array,
    budget: int,
    stopping: Stopping = AS_PUBLISHED,
) -> tuple[Array, int]:
    """Minimise by SLSQP from a start, and restart it as long as that helps.

    SLSQP stops at kinks of the penalty, and its tolerances suit values of size 1: each
    restart rescales the objective.

    Parameters
    ----------
    u : (d,) array
        Start, in the unit box.

    Returns
    -------
    tuple
        The best point (d,), and the number of evaluations.
    """
    best = u
    lowest = loss.value(u, weight)
    n_evaluations = 0
    for _ in range(stopping.restarts):
        if not (n_evaluations < budget and lowest > 0.0):
            break
        scaled = _ScaledLoss(loss, weight, 1.0 / lowest)
        # A step of SLSQP may take more than one evaluation: it is given fewer steps than
        # evaluations are left.
        steps = max(1, (budget - n_evaluations) * 4 // 5)
        local = scipy.optimize.minimize(
            scaled.value,
            best,
            method="SLSQP",
            jac=scaled.gradient,
            bounds=_unit_box(u),
            options={"maxiter": min(steps, stopping.steps), "ftol": stopping.tolerance},
        )
        n_evaluations += int(local.nfev)
        point = np.clip(local.x, 0.0, 1.0)
        value = loss.value(point, weight)
        is_last = not value < lowest * (1.0 - stopping.gain)
        if value < lowest:
            best, lowest = point, value
        if is_last:
            break
    return best, n_evaluations


def _unit_box(u: Array) -> list[tuple[float, float]]:
    """Return the bounds (0, 1) of each entry of u (d,)."""
    return [(0.0, 1.0)] * len(u)


@dataclass(frozen=True)
class _ScaledLoss:
    """A penalised loss at one weight, times a factor."""

    loss: PenalisedLoss
    weight: float
    factor: float

    def value(self, u: Array) -> float:
        """Return the scaled loss at u (d,)."""
        return self.factor * self.loss.value(u, self.weight)

    def gradient(self, u: Array) -> Array:
        """Return the gradient (d,) of the scaled loss at u (d,)."""
        return self.factor * self.loss.gradient(u, self.weight)


class Demand(ABC):
    """What is demanded of barycentric parameters p (p,) from outside of their box: each
    margin is to be >= 0."""

    family: str
    #: How many times the margin the violation is said to be.
    violation_scale: float = 1.0

    @abstractmethod
    def margins(self, p: Array) -> Array:
        """Return the margins (k,) of the demand at barycentric p (p,), nonnegative
        where it holds."""

    @abstractmethod
    def margins_and_slopes(self, p: Array) -> tuple[Array, Array]:
        """Return the margins of the demand, and their derivatives.

        Returns
        -------
        tuple
            Margins (k,), and derivatives (k, p') by the first p' parameters.
        """

    def violation(self, p: Array) -> float:
        """Return the largest violation of the demand that all margins are nonnegative.

        Returns
        -------
        float
            0 if the demand holds, else the smallest margin, made positive and times
            ``violation_scale`` (the literature's figure for this demand).
        """
        return max(0.0, -self.violation_scale * float(self.margins(p).min()))


class TriangleInequality(Demand):
    """tr(I) / 2 - lambda_max(I) >= 0 of each link; violated by D3 - D1 - D2 [kg m^2]."""

    family = "triangle inequality"
    violation_scale = 2.0
    #: Places in I (3, 3) of the six entries, by row.
    _matrix = np.array([[0, 1, 3], [1, 2, 4], [3, 4, 5]])
    #: How often each of the six entries stands in I.
    _multiplicity = np.array([1.0, 2.0, 1.0, 2.0, 2.0, 1.0])

    def __init__(self, links: Indices, size: int) -> None:
        """Store where the inertia of each link stands among ``size`` parameters.

        links : (n, 10) indices of the links' barycentric parameters m, c (3), inertia
        (6).
        """
        self.entries = links[:, 4:]  # (n, 6): Ixx, Ixy, Iyy, Ixz, Iyz, Izz
        self.matrices = self.entries[:, self._matrix]  # (n, 3, 3)
        self.size = size

    def margins(self, p: Array) -> Array:
        """Return (n,) tr(I) / 2 - lambda_max(I) of each link [kg m^2]; p (p,) is
        barycentric.
        """
        moments = np.linalg.eigvalsh(p[self.matrices])  # (n, 3), ascending
        return 0.5 * moments.sum(axis=1) - moments[:, 2]

    def margins_and_slopes(self, p: Array) -> tuple[Array, Array]:
        """Return :meth:`margins` (n,) and their derivatives (n, p) by the parameters.

        By I they are 1 / 2 - v v^T, with v the unit eigenvector of lambda_max.
        """
        moments, vectors = np.linalg.eigh(p[self.matrices])
        v = vectors[:, :, 2]  # of the largest moment
        slopes = 0.5 * np.eye(3) - v[:, :, None] * v[:, None, :]
        rows = np.zeros((len(self.entries), self.size))
        links = np.arange(len(self.entries))[:, None]
        # Products of inertia stand twice in the matrix.
        rows[links, self.entries] = inertia.inertia_entries(slopes) * self._multiplicity
        margins = 0.5 * moments.sum(axis=1) - moments[:, 2]
        return margins, rows


class TotalMass(Demand):
    """Lower and upper bound on the sum of the masses [kg]."""

    family = "total mass"

    def __init__(self, group: ConeGroup) -> None:
        """Take the linear constraints on the total mass."""
        self.constant = group.constant.ravel()
        self.matrix = group.matrix

    def margins(self, p: Array) -> Array:
        """Return the distance (k,) of the total mass from its bounds [kg]."""
        return self.constant + self.matrix @ p[: self.matrix.shape[1]]

    def margins_and_slopes(self, p: Array) -> tuple[Array, Array]:
        """Return margins (k,) and their constant derivatives (k, p')."""
        return self.margins(p), self.matrix


class CentreCones(Demand):
    """Centres of mass inside their cones, of (1, c) in place of (m, m c) [m]."""

    family = "centre of mass cone"

    def __init__(self, group: ConeGroup, masses: Indices) -> None:
        """Take the cones, and the indices (n,) of the links' masses among the
        parameters.
        """
        self.group = group
        self.masses = masses

    def margins(self, p: Array) -> Array:
        """Return (g,) height minus radius of each centre of mass in its cone [m]."""
        values = self._values(p)
        return values[:, 0] - np.linalg.norm(values[:, 1:], axis=1)

    def margins_and_slopes(self, p: Array) -> tuple[Array, Array]:
        """Return margins (g,) and their derivatives (g, p'); those by masses are zero."""
        values = self._values(p)
        norms = np.linalg.norm(values[:, 1:], axis=1)
        units = values[:, 1:] / nonzero_or_one(norms)[:, None]
        rows = self.group.matrix.reshape(*values.shape, -1)  # (g, 3, p')
        # Of each cone g: the axis less the radial rows i along the unit vector.
        slopes = rows[:, 0] - np.einsum("gi,gip->gp", units, rows[:, 1:])
        is_mass = np.isin(np.arange(slopes.shape[1]), self.masses)
        return values[:, 0] - norms, np.where(is_mass, 0.0, slopes)

    def _values(self, p: Array) -> Array:
        """Return the cones' values (g, 3) with all masses set to one.

        The cones are linear in (m, m c); with m = 1 they are in (1, c).
        """
        point = p.copy()
        point[self.masses] = 1.0
        return self.group.values(point)


class PenalisedLoss:
    """loss(p) + weight g(p) in u in [0, 1]^d, p = lower + u (upper - lower) on the free
    parameters."""

    def __init__(self, task: Task, data: LeastSquares, free: Indices) -> None:
        """Collect box, demands and free parameters.

        ``free`` (d,) are the indices of the searched parameters; others keep their OLS
        values.
        """
        self.data = data
        self.box = BarycentricBox(task)
        self.free = free
        self.fixed = self.box.p(task.ols)
        self.lower = self.box.lower[free]
        self.width = (self.box.upper - self.box.lower)[free]
        self.demands = list[Demand]()
        if len(task.links):
            self.demands.append(TriangleInequality(task.links, len(task.bound)))
        for group in _groups(task, TotalMass.family):
            self.demands.append(TotalMass(group))
        for group in _groups(task, CentreCones.family):
            self.demands.append(CentreCones(group, task.links[:, 0]))

    def p(self, u: Array) -> Array:
        """Return the barycentric parameters (p,) of a point u (d,) of the unit box."""
        p = self.fixed.copy()
        p[self.free] = self.lower + u * self.width
        return p

    def theta(self, u: Array) -> Array:
        """Return the standard parameters (p,) of a point u (d,) of the unit box."""
        return self.box.theta(self.p(u))

    def value(self, u: Array, weight: float) -> float:
        """Return the penalised objective: loss + weight g.

        Parameters
        ----------
        u : (d,) array
            Point of the unit box.
        """
        p = self.p(u)
        loss = self.data.loss(self.box.theta(p))
        return loss + weight * self.penalty(p)

    def gradient(self, u: Array, weight: float) -> Array:
        """Return the gradient (d,) of the penalised objective at a point u (d,) of the
        unit box."""
        # Chain rule: by theta, by barycentric p, by u (p = lower + u width).
        p = self.p(u)
        by_theta = self.data.gradient(self.box.theta(p))
        by_p = self.box.pull_back(p, by_theta)
        # A subgradient of the penalty by barycentric p.
        slope = np.zeros_like(p)
        for demand in self.demands:
            margins, rows = demand.margins_and_slopes(p)
            slope[: rows.shape[1]] -= rows[margins < 0.0].sum(axis=0)
        by_p += weight * slope
        return by_p[self.free] * self.width

    def penalty(self, p: Array) -> float:
        """Return the penalty g, the sum of the violations of all demands at barycentric
        p (p,)."""
        total = 0.0
        for demand in self.demands:
            violated = np.minimum(demand.margins(p), 0.0)
            total -= float(violated.sum())
        return total

    def violations(self, p: Array) -> dict[str, float]:
        """Return the largest violation of each demand.

        Returns
        -------
        dict of str to float
            Triangle inequality D3 - D1 - D2 [kg m^2], total mass [kg], centre of mass [m].
        """
        largest = {TriangleInequality.family: 0.0}
        for demand in self.demands:
            so_far = largest.get(demand.family, 0.0)
            largest[demand.family] = max(so_far, demand.violation(p))
        return largest


def _groups(task: Task, family: str) -> tuple[ConeGroup, ...]:
    """Return the groups of cones of one family of convex constraints."""
    return task.constraints.with_families(family.__eq__).groups
