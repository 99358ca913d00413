"""Penalty-based retrieval as published: Gaz et al. (RA-L 2019), secs. IV-C and V, eq. 29.

    minimise  loss(p) + xi_k g(p)   subject to  lower <= p <= upper,    k = 1..5

over p = (m, c, I about the centre of mass) of each link, by simulated annealing followed by a local
search, each step from the previous step's answer, the first from a random point of the box; weights
xi = 0, 10, 20, 30, 40; ten independent runs, of which the one of least penalised loss is kept. The
external penalties g are linear in what they punish: (lambda_max(I) - tr(I) / 2)+ of each link (the
triangle inequalities, eq. 16), the total mass [kg], the conditional bounds on centres of mass [m].

A linear penalty is exact above the loss's multiplier, in (N m)^2 per kg m^2, which grows with the data:
at 40 the answer is in general not physically consistent.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.estimators.estimator import Array, Estimator, Fit, Task
from sdp_vs_penalty.regression.regression import LeastSquares
from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.robot.arrays import or_one
from sdp_vs_penalty.solvers.objective import Objective

#: What MATLAB's simulannealbnd, which the authors used, allows for 91 parameters in five steps.
PAPER_BUDGET = 5 * 3000 * 91
#: The authors' box for friction and offset parameters [N m, N m s / rad] (bounds of their one-step
#: identification). Widened where a parameter must be larger to make the measured torque.
JOINT_PARAMETER_RANGE = 100.0


class BarycentricBox:
    """Bounds of p (p,): each link's ten barycentric parameters in place of theta's, the rest as is.

    The problem's box; where it is open, what the problem implies (Task.bound). Centres of mass: |c| <=
    largest |m c| / largest m; moments and products of inertia: the largest moment about the frame. Joint
    parameters: their sign, and max(100, |tau| / |Y_k|) in SI units, where |tau| / |Y_k| is the size at
    which parameter k alone makes all the measured torque.
    """

    def __init__(self, task: Task) -> None:
        norms, self.links = task.data.column_norms, task.links
        alone = np.where(norms > 0.0, np.sqrt(task.data.tau_squared), 0.0) / or_one(norms)
        self.upper = np.minimum(np.maximum(JOINT_PARAMETER_RANGE, alone), task.bound)
        lowest = [parameter.lower for parameter in task.model.parameters]
        self.lower = np.maximum(-self.upper, lowest)
        implied = task.bound[self.links]
        implied[:, 1:4] /= or_one(implied[:, :1])
        low, (least, most) = -implied, np.moveaxis(task.box[: len(self.links)], 2, 0)
        low[:, [0, 4, 6, 9]] = 0.0
        self.lower[self.links] = np.where(np.isfinite(least), least, low)
        self.upper[self.links] = np.where(np.isfinite(most), most, implied)

    def theta(self, p: Array) -> Array:
        """Standard parameters of p: h = m c, J = I + m (c.c 1 - c c^T)."""
        out = p.copy()
        out[self.links] = inertia.standard_from_barycentric(p[self.links])
        return out

    def pull_back(self, p: Array, gradient: Array) -> Array:
        """(d theta / d p)^T gradient."""
        out, c, g = gradient.copy(), p[self.links[:, 1:4]], gradient[self.links]
        across = np.einsum("ne,eij,nj->ni", g[:, 4:], inertia.STEINER_FORMS, c)  # half of d J / d(m c)
        out[self.links[:, 0]] += np.sum(c * (g[:, 1:4] + across), axis=1)
        out[self.links[:, 1:4]] = p[self.links[:, :1]] * (g[:, 1:4] + 2.0 * across)
        return out

    def p(self, theta: Array) -> Array:
        """p of standard parameters, put inside the box (a massless link: its middle)."""
        out = theta.copy()
        out[self.links] = inertia.barycentric_from_standard(theta[self.links])
        middle = 0.5 * (self.lower + self.upper)
        return np.clip(np.where(np.isfinite(out), out, middle), self.lower, self.upper)


@dataclass(frozen=True)
class PenaltyPaper(Estimator):
    """runs : independent runs from random starts inside the bounds; weights : xi of each step.

    evaluations : of the loss in one run, shared equally by the steps, and in each step by annealing and
        local search, which finish what they have begun; PAPER_BUDGET is what the authors' program
        allows.

    The local search here gets analytic gradients, which the authors' had to estimate. Friction and
    offsets are searched with the links, inside their signs and +-max(100, |tau| / |Y_k|) (the authors'
    +-100).
    """

    name = "penalty-paper"
    table_place: ClassVar[int | None] = 3
    description = "simulated annealing with penalty weights 0..40, as published (one-step)"

    runs: int = 10
    evaluations: int = 3_000
    weights: tuple[float, ...] = (0.0, 10.0, 20.0, 30.0, 40.0)

    def fit(self, task: Task) -> Fit:
        return retrieve(self, task, task.data, np.arange(len(task.bound)))


@dataclass(frozen=True)
class PenaltyPaperTwoStep(PenaltyPaper):
    """loss = |pi(p) - pi_hat|^2 over the links' parameters; friction stays as first estimated."""

    name = "penalty-paper-two-step"
    table_place: ClassVar[int | None] = None
    description = "simulated annealing on the distance to the OLS base parameters, as published"

    def fit(self, task: Task) -> Fit:
        return retrieve(self, task, task.base_distance, task.model.rigid_indices)


def retrieve(settings: PenaltyPaper, task: Task, data: LeastSquares, free: NDArray[np.intp]) -> Fit:
    """The best of several annealed runs over the parameters ``free``; the others as OLS has them."""
    loss = PenalisedLoss(task, data, free)
    rng = np.random.default_rng(task.seed)
    runs: list[dict[str, Any]] = []
    best: tuple[float, Array] | None = None
    budget = settings.evaluations // max(len(settings.weights), 1)
    for run in range(settings.runs):
        u, evaluations = rng.uniform(size=len(free)), 0
        for weight in settings.weights:
            u, spent = anneal_and_search(loss, weight, u, budget, rng)
            evaluations += spent
        penalised, p = loss.value(u, settings.weights[-1]), loss.p(u)
        theta, broken = loss.box.theta(p), loss.violations(p)
        found = {"loss": task.data.loss(theta), "objective": data.loss(theta), "penalised": penalised}
        worst = {"violation": max(broken.values()), "violations": broken}
        runs.append({**found, **worst, "evaluations": evaluations})
        if best is None or penalised < best[0]:
            best = (penalised, theta)
        violation = runs[-1]["violation"]
        task.progress(f"run {run + 1} of {settings.runs}: best {best[0]:.6g}, violation {violation:.1e}")
    theta = task.ols if best is None else best[1]
    return Fit(theta, Objective(data), task.constraints, details={"runs": runs})


def anneal_and_search(
    loss: PenalisedLoss, weight: float, u: Array, budget: int, rng: np.random.Generator
) -> tuple[Array, int]:
    """Half of the budget for simulated annealing from u, half for a local search from its best.

    The local search is SLSQP, the nearest in SciPy to the authors' fmincon; of L-BFGS-B, TNC and
    SLSQP it reached the lowest penalised losses on the Panda within equal evaluations.
    """
    from scipy import optimize

    if not len(u):
        return u, 0
    box = [(0.0, 1.0)] * len(u)
    settings = {"maxfun": budget // 2, "no_local_search": True, "seed": rng}
    annealed = optimize.dual_annealing(lambda v: loss.value(v, weight), box, x0=u, **settings)
    best, lowest, spent = annealed.x, float(annealed.fun), int(annealed.nfev)
    while spent < budget and lowest > 0.0:
        # SLSQP stops at kinks of the penalty, and its tolerances want values of size 1: start it
        # again with the loss rescaled, while that helps.
        scale = lowest

        def scaled(v: Array, scale: float = scale) -> tuple[float, Array]:
            value, gradient = loss.value_and_gradient(v, weight)
            return value / scale, gradient / scale

        steps = {"maxiter": max(1, (budget - spent) * 4 // 5), "ftol": 1e-9}
        local = optimize.minimize(scaled, best, jac=True, method="SLSQP", bounds=box, options=steps)
        spent += int(local.nfev)
        found = np.clip(local.x, 0.0, 1.0)
        value = loss.value(found, weight)
        if not value < lowest * (1.0 - 1e-6):
            break
        best, lowest = found, value
    return best, spent


class PenalisedLoss:
    """loss(p) + weight g(p) in u in [0, 1]^d, p = lower + u (upper - lower) on the free parameters."""

    def __init__(self, task: Task, data: LeastSquares, free: NDArray[np.intp]) -> None:
        """free : the parameters that are searched; the others stay as OLS has them."""
        self.data, self.box, self.free = data, BarycentricBox(task), free
        self.fixed, self.width = self.box.p(task.ols), (self.box.upper - self.box.lower)[free]
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
        value = self.data.loss(self.box.theta(p))
        return value if weight == 0.0 else value + weight * self.penalty(p)[0]

    def value_and_gradient(self, u: Array, weight: float) -> tuple[float, Array]:
        """The same, and its gradient (d,)."""
        p = self.p(u)
        residual = self.data.R @ self.box.theta(p) - self.data.rho
        value = float(residual @ residual) + self.data.residual_norm**2
        gradient = self.box.pull_back(p, 2.0 * (residual @ self.data.R))
        if weight != 0.0:
            g, slope = self.penalty(p)
            value, gradient = value + weight * g, gradient + weight * slope
        return value, gradient[self.free] * self.width

    def penalty(self, p: Array) -> tuple[float, Array]:
        """g(p), and its (sub)gradient (p,)."""
        total, slope = 0.0, np.zeros_like(p)
        for _, margins, rows in self.demanded(p):
            bad = margins < 0.0
            total -= float(margins[bad].sum())
            slope[: rows.shape[1]] -= rows[bad].sum(axis=0)
        return total, slope

    def violations(self, p: Array) -> dict[str, float]:
        """Worst violation of each external demand: D3 - D1 - D2 [kg m^2], total mass [kg], c [m]."""
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
            largest, rows = vectors[:, :, 2], np.zeros((len(links), len(p)))
            dyads = 0.5 * np.eye(3) - largest[:, :, None] * largest[:, None, :]
            twice = np.array([1.0, 2.0, 1.0, 2.0, 2.0, 1.0])
            rows[np.arange(len(links))[:, None], links] = inertia.inertia_entries(dyads) * twice
            yield "triangle inequality", 0.5 * moments.sum(axis=1) - moments[:, 2], rows
        for family, stack in self.demands:
            point, total = p.copy(), family == "total mass"
            if not total:
                point[self.masses] = 1.0
            values = stack.values(point)
            margins, rows = values.ravel(), stack.matrix.reshape(*values.shape, -1)
            if stack.cone == "nonnegative":
                rows = rows.reshape(values.size, -1)
            else:
                norm = np.linalg.norm(values[:, 1:], axis=1)
                unit = values[:, 1:] / or_one(norm)[:, None]
                margins, rows = (
                    values[:, 0] - norm,
                    rows[:, 0] - np.einsum("gi,gip->gp", unit, rows[:, 1:]),
                )
            fixed = np.isin(np.arange(rows.shape[1]), self.masses) & (not total)
            yield family, margins, np.where(fixed, 0.0, rows)
