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

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy import optimize

from sdp_vs_penalty.estimators.estimator import Estimator, Fit, Task
from sdp_vs_penalty.estimators.penalty import BarycentricBox
from sdp_vs_penalty.regression.regression import LeastSquares
from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.robot.arrays import Array, nonzero_or_one
from sdp_vs_penalty.solvers.objective import Objective

#: What MATLAB's simulannealbnd, which the authors used, allows for 91 parameters in
#: five steps.
PAPER_BUDGET = 5 * 3000 * 91


@dataclass(frozen=True)
class PenaltyPaper(Estimator):
    """runs : independent runs from random starts inside the bounds; weights : xi of
    each step.

    evaluations : of the loss in one run, shared equally by the steps, and in each step by annealing and
        local search, which finish what they have begun; PAPER_BUDGET is what the authors' program
        allows.

    The local search here gets analytic gradients, which the authors' had to estimate. Friction and
    offsets are searched with the links, inside their signs and +-max(100, |tau| / |Y_k|) (the authors'
    +-100).
    """

    name = "penalty-paper"
    table_place: ClassVar[int | None] = 3
    description = (
        "simulated annealing with penalty weights 0..40, as published (one-step)"
    )

    runs: int = 10
    evaluations: int = 3_000
    weights: tuple[float, ...] = (0.0, 10.0, 20.0, 30.0, 40.0)

    def fit(self, task: Task) -> Fit:
        return retrieve(self, task, task.data, np.arange(len(task.bound)))


@dataclass(frozen=True)
class PenaltyPaperTwoStep(PenaltyPaper):
    """loss = |pi(p) - pi_hat|^2 over the links' parameters; friction stays as first
    estimated."""

    name = "penalty-paper-two-step"
    table_place: ClassVar[int | None] = None
    description = (
        "simulated annealing on the distance to the OLS base parameters, as published"
    )

    def fit(self, task: Task) -> Fit:
        return retrieve(self, task, task.base_distance, task.model.rigid_indices)


def retrieve(
    settings: PenaltyPaper, task: Task, data: LeastSquares, free: NDArray[np.intp]
) -> Fit:
    """The best of several annealed runs over the parameters ``free``; the others as OLS
    has them."""
    loss = PenalisedLoss(task, data, free)
    rng = np.random.default_rng(task.seed)
    runs: list[dict[str, Any]] = []
    best: tuple[float, Array] | None = None
    budget = settings.evaluations // max(len(settings.weights), 1)
    for run in range(settings.runs):
        u = rng.uniform(size=len(free))
        evaluations = 0
        for weight in settings.weights:
            u, spent = anneal_and_search(loss, weight, u, budget, rng)
            evaluations += spent
        penalised = loss.value(u, settings.weights[-1])
        p = loss.p(u)
        theta = loss.box.theta(p)
        broken = loss.violations(p)
        best_runs = {
            "loss": task.data.loss(theta),
            "objective": data.loss(theta),
            "penalised": penalised,
        }
        worst = {"violation": max(broken.values()), "violations": broken}
        runs.append({**best_runs, **worst, "evaluations": evaluations})
        if best is None or penalised < best[0]:
            best = (penalised, theta)
        violation = runs[-1]["violation"]
        task.progress(
            f"run {run + 1} of {settings.runs}: best {best[0]:.6g}, violation"
            f" {violation:.1e}"
        )
    theta = task.ols if best is None else best[1]
    return Fit(theta, Objective(data), task.constraints, details={"runs": runs})


def anneal_and_search(
    loss: PenalisedLoss, weight: float, u: Array, budget: int, rng: np.random.Generator
) -> tuple[Array, int]:
    """Half of the budget for simulated annealing from u, half for a local search from
    its best.

    The local search is SLSQP, the nearest in SciPy to the authors' fmincon; of
    L-BFGS-B, TNC and SLSQP it reached the lowest penalised losses on the Panda within
    equal evaluations.
    """
    if not len(u):
        return u, 0
    box = [(0.0, 1.0)] * len(u)
    settings = {"maxfun": budget // 2, "no_local_search": True, "seed": rng}
    annealed = optimize.dual_annealing(
        lambda v: loss.value(v, weight), box, x0=u, **settings
    )
    best, spent = search_locally(loss, weight, annealed.x, budget - int(annealed.nfev))
    return best, int(annealed.nfev) + spent


def search_locally(
    loss: PenalisedLoss, weight: float, u: Array, budget: int
) -> tuple[Array, int]:
    """SLSQP from u, again and again while that helps; the best point and how many
    evaluations it took."""
    box = [(0.0, 1.0)] * len(u)
    best = u
    lowest = loss.value(u, weight)
    spent = 0
    while spent < budget and lowest > 0.0:
        # SLSQP stops at kinks of the penalty, and its tolerances want values of size 1:
        # start it again with the loss rescaled, while that helps.
        told: dict[str, Any] = {
            "maxiter": max(1, (budget - spent) * 4 // 5),
            "ftol": 1e-9,
        }
        local = optimize.minimize(
            lambda v, scale: loss.value(v, weight) / scale,
            best,
            (lowest,),
            "SLSQP",
            lambda v, scale: loss.gradient(v, weight) / scale,
            bounds=box,
            options=told,
        )
        spent += int(local.nfev)
        found = np.clip(local.x, 0.0, 1.0)
        value = loss.value(found, weight)
        if not value < lowest * (1.0 - 1e-6):
            break
        best = found
        lowest = value
    return best, spent


class PenalisedLoss:
    """loss(p) + weight g(p) in u in [0, 1]^d, p = lower + u (upper - lower) on the free
    parameters."""

    def __init__(self, task: Task, data: LeastSquares, free: NDArray[np.intp]) -> None:
        """free : the parameters that are searched; the others stay as OLS has them."""
        self.data, self.box, self.free = data, BarycentricBox(task), free
        self.fixed = self.box.p(task.ols)
        self.width = (self.box.upper - self.box.lower)[free]
        self.masses = task.links[:, 0]
        #: What is demanded of the masses, and of (1, c) in place of (m, m c).
        self.demands = [
            (family, group)
            for family in ("total mass", "centre of mass cone")
            for group in task.constraints.with_families(family.__eq__).groups
        ]

    def p(self, u: Array) -> Array:
        """Barycentric parameters (p,) at u (d,)."""
        out = self.fixed.copy()
        out[self.free] = self.box.lower[self.free] + u * self.width
        return out

    def value(self, u: Array, weight: float) -> float:
        """loss + weight g at u (d,)."""
        p = self.p(u)
        return self.data.loss(self.box.theta(p)) + weight * self.penalty(p)[0]

    def gradient(self, u: Array, weight: float) -> Array:
        """(d,) of the value."""
        p = self.p(u)
        slope = self.box.pull_back(p, self.data.gradient(self.box.theta(p)))
        return (slope + weight * self.penalty(p)[1])[self.free] * self.width

    def penalty(self, p: Array) -> tuple[float, Array]:
        """g(p), and its (sub)gradient (p,)."""
        total = 0.0
        slope = np.zeros_like(p)
        for _, margins, rows in self.demanded(p):
            bad = margins < 0.0
            total -= float(margins[bad].sum())
            slope[: rows.shape[1]] -= rows[bad].sum(axis=0)
        return total, slope

    def violations(self, p: Array) -> dict[str, float]:
        """Worst violation of each external demand: D3 - D1 - D2 [kg m^2], total mass
        [kg], c [m]."""
        out = {"triangle inequality": 0.0}
        for family, margins, _ in self.demanded(p):
            size = 2.0 if family == "triangle inequality" else 1.0
            out[family] = max(out.get(family, 0.0), -size * float(margins.min()))
        return out

    def demanded(self, p: Array) -> Iterator[tuple[str, Array, Array]]:
        """Of each external demand its family, margins (k,) and their gradients (k, p')."""
        if len(links := self.box.links[:, 4:]):
            # tr(I) / 2 - lambda_max(I) of each link: >= 0 is consistent.
            moments, vectors = np.linalg.eigh(inertia.inertia_matrix(p[links]))
            largest = vectors[:, :, 2]
            rows = np.zeros((len(links), len(p)))
            dyads = 0.5 * np.eye(3) - largest[:, :, None] * largest[:, None, :]
            twice = np.array([1.0, 2.0, 1.0, 2.0, 2.0, 1.0])
            rows[np.arange(len(links))[:, None], links] = (
                inertia.inertia_entries(dyads) * twice
            )
            yield "triangle inequality", 0.5 * moments.sum(axis=1) - moments[:, 2], rows
        for family, stack in self.demands:
            if family == "total mass":
                values = stack.values(p).ravel()
                yield family, values, stack.matrix.reshape(values.size, -1)
                continue
            point = p.copy()
            point[self.masses] = 1.0
            values = stack.values(point)
            norm = np.linalg.norm(values[:, 1:], axis=1)
            rows = stack.matrix.reshape(*values.shape, -1)
            unit = values[:, 1:] / nonzero_or_one(norm)[:, None]
            rows = rows[:, 0] - np.einsum("gi,gip->gp", unit, rows[:, 1:])
            rows[:, np.isin(np.arange(rows.shape[1]), self.masses)] = 0.0
            yield family, values[:, 0] - norm, rows
