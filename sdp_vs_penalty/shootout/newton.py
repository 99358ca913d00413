"""Identification without an SDP solver: descent in a chart, with exact Hessians, by Newton's method.

Links are consistent by construction (:mod:`chart`). What remains (bounds, cones) is imposed by a
logarithmic barrier whose weight falls to what the accuracy needs; the links' determinants take part
in it (the entropy of Lee, Wensing, Park), because a variable that has run to minus infinity no longer
feels any slope. In theta each barrier problem is convex, and both charts map one to one onto the
interior: there is one stationary point, whatever the start. The Hessian is indefinite all the same,
hence the damping. Rounding may end a run early; then it is started again from another point.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
import scipy.linalg

from sdp_vs_penalty.constraints.constraint import Constraint, ConstraintSet, ConstraintStack
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.shootout.chart import Frame, Geodesic, LogCholesky, Point, owners
from sdp_vs_penalty.shootout.contestant import no_answer
from sdp_vs_penalty.shootout.instance import Instance
from sdp_vs_penalty.shootout.judge import Answer
from sdp_vs_penalty.solvers.objective import Objective

#: Starting points, tried until one run converges; steps of one run.
_STARTS, _STEPS = 4, 600
#: Each barrier's weight in units of the one before.
_FALL = 0.1
#: A promised decrease below which a barrier problem counts as solved, in units of its distance
#: from the optimum.
_ENOUGH = 0.1


def solve(instance: Instance, accuracy: float, chart: type[LogCholesky | Geodesic]) -> Answer:
    """Minimise the objective to a relative accuracy; its multipliers are those of the barrier."""
    start = time.perf_counter()
    interior = instance.interior
    if interior is None:
        return no_answer(instance, "no interior point to start from", 0.0)
    barrier = Barrier.of(instance, interior)
    rng = np.random.default_rng(instance.task.seed)
    ready = time.perf_counter()
    best, steps, attempts = None, 0, 0
    for attempt in range(_STARTS):
        begin: Point = chart.of(barrier.frame, interior)
        if attempt:
            begin = barrier.inside(begin, 0.5 * rng.normal(size=len(interior)))
        run = barrier.minimise(begin, accuracy)
        steps, attempts = steps + run.steps, attempt + 1
        if best is None or (run.converged, -run.loss) > (best.converged, -best.loss):
            best = run
        if run.converged:
            break
    assert best is not None
    theta = best.point.theta
    end = time.perf_counter()
    sent = ((c, barrier.size * best.weight * m) for c, m in barrier.duals(theta))
    return Answer(
        theta,
        "optimal" if best.converged else "failed",
        f"barrier {best.weight:.1e}, promised {best.promised:.1e}",
        steps,
        ready - start,
        end - ready,
        instance.all_multipliers(sent),
        attempts=attempts,
    )


@dataclass(frozen=True)
class Run:
    """Where one start ended.

    weight : of the last barrier; promised : what another step would gain there; loss : without barrier.
    """

    point: Point
    converged: bool
    loss: float
    weight: float
    promised: float
    steps: int


@dataclass(frozen=True)
class Barrier:
    """objective / size - weight sum log(distance from each constraint's boundary), in the chart.

    order : the barrier's parameter, the sum over cones of their ranks; twice: 2 R^T R / size.
    """

    objective: Objective
    size: float
    frame: Frame
    stacks: tuple[ConstraintStack, ...]
    order: int
    twice: Array

    @classmethod
    def of(cls, instance: Instance, interior: Array) -> Self:
        data = instance.data
        size = max(data.loss(instance.task.ols), 1e-9 * data.tau_squared, 1e-300)
        sent = ConstraintSet(tuple(instance.sent))
        ranks = {"psd": lambda d: d, "soc": lambda _: 2, "nonnegative": lambda d: d}
        order = sum(ranks[c.cone](len(c.constant)) for c in sent.convex)
        frame = Frame.at(owners(sent.convex), interior)
        twice = 2.0 * data.R.T @ data.R / size
        return cls(instance.objective, size, frame, sent.stacks, order, twice)

    def value(self, point: Point, weight: float) -> float:
        """Infinite outside of the constraints."""
        theta = point.theta
        total = 0.0
        for stack in self.stacks:
            total += _log_barrier(stack, theta)
            if not np.isfinite(total):
                return np.inf
        return self.objective.value(theta) / self.size + weight * total

    def derivatives(self, point: Point, weight: float) -> tuple[Array, Array, Array]:
        """Slope (n,) and Hessian (n, n) in two parts: convex, and the chart's curvature."""
        theta = point.theta
        slope, hessian = self.objective.gradient(theta) / self.size, self.twice.copy()
        if self.objective.entropy is not None:
            entropy = self.objective.entropy
            _add_cones(entropy.links, theta, entropy.weight / self.size, np.zeros_like(slope), hessian)
        for stack in self.stacks:
            if stack.cone == "nonnegative":
                inverse = 1.0 / stack.values(theta).ravel()
                width = stack.matrix.shape[1]
                slope[:width] -= weight * stack.matrix.T @ inverse
                scaled = stack.matrix * inverse[:, None]
                hessian[:width, :width] += weight * scaled.T @ scaled
            else:
                _add_cones(stack.members, theta, weight, slope, hessian)
        inner = point.pull(point.pull(hessian).T)
        return point.pull(slope[None])[0], inner, point.curvature(slope)

    def minimise(self, point: Point, accuracy: float) -> Run:
        """Barrier problem after barrier problem, until its weight is a tenth of what was asked."""
        data, steps = self.objective.least_squares, 0
        weight = 0.1 * self.objective.value(point.theta) / self.size / self.order
        while True:
            point, promised, taken = self._newton(point, weight)
            steps += taken
            theta = point.theta
            goal = data.loss_scale(theta) / self.size
            last = 0.1 * accuracy * goal / self.order
            solved = 0.0 <= promised <= _ENOUGH * self.order * weight
            if not solved or weight <= last:
                value = self.objective.value(theta)
                return Run(point, solved and weight <= last, value, weight, promised, steps)
            weight = max(_FALL * weight, 0.999 * last)

    def _newton(self, point: Point, weight: float) -> tuple[Point, float, int]:
        """Damped Newton steps until the next one promises little; the point, that promise, the steps.

        The promise of an undamped step is Newton's decrement: free of units, unlike the slope.
        """
        value, damping, promised = self.value(point, weight), 0.0, np.inf
        slope, convex, bend = self.derivatives(point, weight)
        for taken in range(_STEPS):
            step, promised = _newton_step(slope, convex, bend, damping)
            if damping == 0.0 and 0.0 <= promised <= _ENOUGH * self.order * weight:
                return point, promised, taken
            trial, reached = self._lowest(point, step, weight)
            share = (value - reached) / promised if promised > 0.0 else -1.0
            largest = float(np.diagonal(convex).max())
            if share < 0.1:
                damping = max(10.0 * damping, 1e-10 * largest)
                if abs(promised) <= 1e-15 * abs(value):
                    break  # nothing that rounding would not hide
                continue
            point, value = trial, reached
            slope, convex, bend = self.derivatives(point, weight)
            damping = 0.1 * damping if share > 0.5 else damping
            damping = 0.0 if damping < 1e-11 * largest else damping
        _, promised = _newton_step(slope, convex, bend, 0.0)
        return point, promised, taken

    def _lowest(self, point: Point, step: Array, weight: float) -> tuple[Point, float]:
        """The point after a step, or after a second-order correction: theta as far as was promised.

        Along what the data see sharply the chart is a bent valley, in which straight steps stay short.
        """
        jacobian = point.pull(np.eye(len(step)))
        trial = point.moved(step)
        missed = trial.theta - point.theta - jacobian @ step
        bent = point.moved(step - np.linalg.solve(jacobian, missed))
        value, straight = self.value(bent, weight), self.value(trial, weight)
        return (bent, value) if value < straight else (trial, straight)

    def inside(self, point: Point, step: Array) -> Point:
        """The first point after a step / 2^k that satisfies every constraint."""
        while not np.isfinite(self.value(point.moved(step), 1.0)):
            step = 0.5 * step
        return point.moved(step)

    def duals(self, theta: Array) -> list[tuple[Constraint, Array]]:
        """Each constraint with the slope of its barrier's logarithm: multipliers for weight one."""
        out: list[tuple[Constraint, Array]] = []
        for c in (c for stack in self.stacks for c in stack.members):
            value = c.value(theta)
            if c.cone == "psd":
                out.append((c, np.asarray(np.linalg.inv(value), float)))
            elif c.cone == "soc":
                out.append((c, _mirrored(value)))
            else:
                out.append((c, 1.0 / value))
        return out


def _newton_step(slope: Array, convex: Array, bend: Array, damping: float) -> tuple[Array, float]:
    """The step and what the quadratic model promises of it.

    With the exact Hessian where that is positive definite, else with its convex part (the generalised
    Gauss-Newton matrix of a convex function of the chart).
    """
    shift = max(damping, 1e-15 * float(np.diagonal(convex).max()))
    hessian = convex + bend + shift * np.eye(len(slope))
    while True:
        try:
            factor = scipy.linalg.cho_factor(hessian)
            break
        except np.linalg.LinAlgError:
            hessian = convex + shift * np.eye(len(slope))
            shift *= 10.0
    step = -scipy.linalg.cho_solve(factor, slope)
    return step, -float(slope @ step + 0.5 * step @ hessian @ step)


def _log_barrier(stack: ConstraintStack, theta: Array) -> float:
    values = stack.values(theta)
    if stack.cone == "psd":
        try:
            factors = np.linalg.cholesky(values)
        except np.linalg.LinAlgError:
            return np.inf
        return -2.0 * float(np.log(np.diagonal(factors, axis1=1, axis2=2)).sum())
    if stack.cone == "soc":
        axis = values[:, 0]
        inside = axis**2 - np.sum(values[:, 1:] ** 2, axis=1)
        return -float(np.log(inside).sum()) if axis.min() > 0.0 and inside.min() > 0.0 else np.inf
    return -float(np.log(values).sum()) if values.min() > 0.0 else np.inf


def _add_cones(
    cones: Sequence[Constraint], theta: Array, weight: float, slope: Array, hessian: Array
) -> None:
    """Add slope and Hessian of -weight log det F or -weight log(s^2 - |u|^2) of each, in place."""
    for c in cones:
        value = c.value(theta)
        if c.cone == "psd":
            root = np.linalg.inv(np.linalg.cholesky(value))
            local = (root @ c.coefficients @ root.T).reshape(len(c.indices), -1)
            first = local @ np.eye(len(value)).ravel()
            second = local @ local.T
        else:
            mirrored = _mirrored(value)
            first = c.coefficients @ mirrored
            signs = np.append(1.0, -np.ones(len(value) - 1))
            inside = float(value @ (signs * value))
            second = np.outer(first, first) - 2.0 / inside * (c.coefficients * signs) @ c.coefficients.T
        slope[c.indices] -= weight * first
        hessian[np.ix_(c.indices, c.indices)] += weight * second


def _mirrored(value: Array) -> Array:
    """2 (s, -u) / (s^2 - |u|^2): minus the slope of a second-order cone's barrier."""
    flipped = np.append(value[0], -value[1:])
    return np.asarray(2.0 * flipped / float(value @ flipped))
