"""Constraints that are truly not convex, by SDPs over convex pieces, with one certificate for all.

While every centre of mass is in a cell, bounds on inertias about it have convex neighbours on both
sides (:mod:`barycentric_envelopes`), exact as the cell shrinks. The SDP over the outer set bounds the
optimum of its cell from below, certified by its dual; the inner one gives a point that satisfies
every original bound. Best-first branching over cells closes the gap: spatial branch and bound (Horst,
Tuy, Global Optimization, 1996) with an SDP at each node. A choice among finitely many convex sets (a
link that is one of two catalogue parts) is a first branching.
"""

from __future__ import annotations

import heapq
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.constraints import constraint as build
from sdp_vs_penalty.constraints.constraint import Constraint, ConstraintSet
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimators.barycentric_envelopes import inner, moment_axes, outer
from sdp_vs_penalty.estimators.catalogue_part import CataloguePart
from sdp_vs_penalty.estimators.estimator import Fit, Task
from sdp_vs_penalty.estimators.lmi_sdp import solve_sdp
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.solvers import solver
from sdp_vs_penalty.solvers.certificate import lower_bound
from sdp_vs_penalty.solvers.extremes import Slice
from sdp_vs_penalty.solvers.identification import largest_margin
from sdp_vs_penalty.solvers.objective import Objective
from sdp_vs_penalty.solvers.verified import proves_infeasible

#: Inner approximations in a row, each about the last one's centres of mass.
_INNER_ROUNDS = 3
#: Rounds of tightening the cells before the first cut, and of the iteration for each of their ends.
_TIGHTENINGS, _RATIO_ROUNDS = 2, 8
#: Weight of the pull towards the best point found, as a share of the tolerated gap.
_PULL = 0.1
#: A cell is cut no nearer than this share of its width to its ends.
_CUT_MARGIN = 0.2


@dataclass(frozen=True)
class GlobalFit:
    """theta (p,) : satisfies every bound, convex or not; upper : its objective.

    lower : no feasible theta has a lower objective, over all pieces; gap : (upper - lower) over
    max(loss, 1e-12 |tau|^2); solved : SDPs solved; choice : name of the choice that theta is from;
    choice_lower : the lower bound of each choice, infinite where it admits nothing; closed : the gap
    is within tolerance.
    """

    theta: Array
    upper: float
    lower: float
    gap: float
    solved: int
    choice: str
    choice_lower: dict[str, float]
    closed: bool


@dataclass(order=True)
class _Piece:
    lower: float
    number: int
    choice: str = field(compare=False)
    cells: Array = field(compare=False)  # (n, 3, 2)
    fit: Fit = field(compare=False)


def solve_pieces(
    task: Task,
    choices: Sequence[CataloguePart] = (),
    *,
    thickness: float = 0.0,
    tolerance: float = 1e-6,
    max_pieces: int = 400,
    solver: str = "clarabel",
) -> GlobalFit:
    """The least loss under all constraints of a task, those included that are not convex.

    choices : the parts of which exactly one is in place; none: nothing to choose.
    tolerance : of the certified gap; after max_pieces the gap reached is returned with closed False.
    Raises InputError where no parameters satisfy the constraints, or none were found.
    """
    return _Search(task, thickness, tolerance, solver).run(choices, max_pieces)


class _Search:
    """The state of one branch and bound."""

    def __init__(self, task: Task, thickness: float, tolerance: float, solver: str) -> None:
        self.task, self.tolerance = task, tolerance
        self.objective = Objective(task.data)
        self.constraints = task.constraints.plus(task.minimum_thickness(thickness))
        self.solver = solver
        self.solved = 0
        self.finished: dict[str, float] = {}
        self.best: tuple[float, Array, str] = (np.inf, task.nominal, "")

    def run(self, choices: Sequence[CataloguePart], limit: int) -> GlobalFit:
        parts: dict[str, CataloguePart | None] = {c.name: c for c in choices} or {"": None}
        sets = {name: self._with(part) for name, part in parts.items()}
        heap: list[_Piece] = []
        for name, allowed in sets.items():
            self._push(heap, allowed, name, self._whole())
        if not heap and not self.finished:
            raise InputError("No piece of the feasible set has an interior", "relax a bound")
        if self._gap(min((piece.lower for piece in heap), default=np.inf)) > self.tolerance:
            self.task.progress("tightening the cells")
            roots, heap = heap, []
            for piece in roots:
                cells = self._tightened(sets[piece.choice], piece.cells)
                self._push(heap, sets[piece.choice], piece.choice, cells, piece.lower)
        while heap and self._gap(heap[0].lower) > self.tolerance and self.solved < limit:
            piece = heapq.heappop(heap)
            self.task.progress(f"{self.solved} pieces, gap {self._gap(piece.lower):.1e}")
            halves = self._halves(piece)
            if halves is None:  # nothing left to cut: the relaxation is exact here
                self._finish(piece.choice, piece.lower)
                continue
            for cells in halves:
                self._push(heap, sets[piece.choice], piece.choice, cells, piece.lower)
        for piece in heap:
            self._finish(piece.choice, piece.lower)
        upper, theta, choice = self.best
        if not np.isfinite(upper):
            raise InputError(
                "No parameters were found that satisfy the bounds on barycentric inertias", "relax them"
            )
        lower = min(upper, *self.finished.values())
        gap = self._gap(lower)
        bounds = {name: self.finished.get(name, np.inf) for name in sets}
        return GlobalFit(theta, upper, lower, gap, self.solved, choice, bounds, gap <= self.tolerance)

    def _finish(self, choice: str, lower: float) -> None:
        """A piece that will not be cut further: its choice is bounded by the lowest of these."""
        self.finished[choice] = min(self.finished.get(choice, np.inf), lower)

    def _with(self, part: CataloguePart | None) -> ConstraintSet:
        return self.constraints if part is None else self.constraints.plus([part.constraint(self.task)])

    def _whole(self) -> Array:
        """(n, 3, 2) where each centre of mass can be: its box, or what the other bounds imply."""
        box = self.task.box[:, 1:4]
        implied = self.task.bound[self.task.links]
        reach = implied[:, 1:4] / implied[:, :1]
        low = np.where(np.isfinite(box[..., 0]), box[..., 0], -reach)
        high = np.where(np.isfinite(box[..., 1]), box[..., 1], reach)
        return np.stack([low, high], axis=-1)

    def _gap(self, lower: float) -> float:
        upper, theta, _ = self.best
        if not np.isfinite(upper):
            return np.inf
        return self.task.data.gap(upper, lower, theta)

    def _tightened(self, allowed: ConstraintSet, cells: Array) -> Array:
        """Cells that still hold every centre of mass with a loss below the best one found.

        The least c = h / m over a convex set by Dinkelbach's iteration (Management Science 1967): with
        theta the minimiser of h - t m, the next t is h / m there, until the minimum is zero; its
        certified lower bound makes t one. Optimality-based bound tightening of global optimisation.
        """
        data = self.task.data
        room = np.sqrt(max(self.best[0] - data.residual_norm**2, 0.0) * (1.0 + 1e-6))
        rows = np.vstack([np.zeros(data.R.shape[1]), data.R]).T
        offset = np.concatenate([[room], -data.rho])
        everything = np.arange(data.R.shape[1])
        below = build.second_order("loss", "best found", everything, rows, offset)
        for _ in range(_TIGHTENINGS):
            within = allowed.plus([*self._outer(cells), below])
            none = np.zeros((0, data.R.shape[1]))
            try:
                feasible = Slice.of(within, none, self.best[1], self.task.bound)
            except InputError:  # no interior: nothing is known to be cut off
                return cells
            self.solved += 2 * data.R.shape[1]
            for link, indices in enumerate(self.task.links):
                for axis in range(3):
                    cells = cells.copy()
                    for side, sign in ((0, 1.0), (1, -1.0)):
                        end = self._least_ratio(feasible, indices, axis, sign)
                        cells[link, axis, side] = sign * max(end, sign * cells[link, axis, side])
        return cells

    def _least_ratio(self, feasible: Slice, indices: NDArray[np.intp], axis: int, sign: float) -> float:
        """A certified lower bound of sign h_axis / m over a slice."""
        slope = np.zeros(len(feasible.interior))
        slope[indices[0]] = 1.0
        lightest = feasible.minimum(slope).bound
        if lightest <= 0.0:
            return -np.inf
        theta, best = feasible.interior, -np.inf
        for _ in range(_RATIO_ROUNDS):
            t = sign * theta[indices[1 + axis]] / theta[indices[0]]
            slope[indices[0]], slope[indices[1 + axis]] = -t, sign
            found = feasible.minimum(slope)
            self.solved += 1
            # h - t m >= bound and m >= lightest: h / m >= t + bound / m.
            best = max(best, t + min(found.bound, 0.0) / lightest)
            if found.value > -1e-6 * lightest:
                break
            theta = found.theta
        return best

    def _push(
        self,
        heap: list[_Piece],
        allowed: ConstraintSet,
        choice: str,
        cells: Array,
        parent: float = -np.inf,
    ) -> None:
        """Bound a piece from both sides; keep it where it may hold something better."""
        outer = allowed.plus(self._outer(cells))
        fit = self._solve(outer, self._pulled())
        if fit is None:
            # What is not proved empty may hold anything down to its parent's bound.
            if not self._empty(outer):
                self._finish(choice, parent)
            return
        assert fit.multipliers is not None
        lower = lower_bound(self.objective, outer, fit.multipliers, fit.theta, self.task.bound)
        lower = max(lower, parent)  # what bounds the whole bounds its parts
        if lower < self.best[0]:
            self._improve(allowed, choice, fit)
            heapq.heappush(heap, _Piece(lower, self.solved, choice, cells, fit))
        else:
            self._finish(choice, lower)

    def _improve(self, allowed: ConstraintSet, choice: str, fit: Fit) -> None:
        """Feasible points near the relaxed optimum; the best of all is kept."""
        theta = fit.theta
        for _ in range(_INNER_ROUNDS):
            if allowed.margin(theta) >= 0.0 and self._satisfied(theta):
                value = self.objective.value(theta)
                if value < self.best[0] * (1.0 - 1e-12):
                    self.best = (value, theta, choice)
                elif theta is not fit.theta:
                    return
            found = self._solve(allowed.plus(self._inner(theta)))
            if found is None:
                return
            theta = found.theta
        if self._satisfied(theta) and self.objective.value(theta) < self.best[0]:
            self.best = (self.objective.value(theta), theta, choice)

    def _satisfied(self, theta: Array) -> bool:
        return all(b.margin(theta) >= 0.0 for b in self.constraints.nonconvex)

    def _pulled(self) -> Objective:
        """The loss with a slight pull towards the best point found.

        Where the data see nothing, a relaxed optimum would otherwise violate bounds that cost
        nothing to keep, and cells be cut in vain. The lower bound is of the loss itself.
        """
        upper, theta, _ = self.best
        if not np.isfinite(upper):
            return self.objective
        data, p = self.task.data, len(theta)
        weights = np.diag(np.sqrt(_PULL * self.tolerance * data.loss(theta) / p) / self.task.bound)
        rows, rho = np.vstack([data.R, weights]), np.concatenate([data.rho, weights @ theta])
        return Objective(replace(data, R=rows, rho=rho))

    def _solve(self, constraints: ConstraintSet, objective: Objective | None = None) -> Fit | None:
        self.solved += 1
        try:
            return solve_sdp(self.task, objective or self.objective, constraints, self.solver, 1e-10)
        except InputError:  # no interior point, or a solver that gave up
            return None

    def _empty(self, constraints: ConstraintSet) -> bool:
        """Whether multipliers prove that nothing satisfies the constraints."""
        problem = largest_margin(constraints.convex, self.task.nominal, self.task.bound)
        solution = solver(self.solver).solve(problem.conic, 1e-8)
        return proves_infeasible(constraints.convex, problem.multipliers(solution), self.task.bound)

    def _halves(self, piece: _Piece) -> tuple[Array, Array] | None:
        """The cell cut across the centre-of-mass axis where the relaxation is loosest."""
        theta, loosest, where = piece.fit.theta, 0.0, (0, 0)
        centres = _centres(theta, self.task)
        for bound in self.constraints.nonconvex:
            if bound.margin(theta) >= 0.0:
                continue
            for axis in moment_axes(bound.entry):
                low, high = piece.cells[bound.link, axis]
                c = np.clip(centres[bound.link, axis], low, high)
                slack = theta[bound.indices[0]] * (high - c) * (c - low)
                if slack > loosest:
                    loosest, where = slack, (bound.link, axis)
        if loosest == 0.0:
            return None
        low, high = piece.cells[where]
        margin = _CUT_MARGIN * (high - low)
        cut = np.clip(centres[where], low + margin, high - margin)
        left, right = piece.cells.copy(), piece.cells.copy()
        left[where][1] = right[where][0] = cut
        return left, right

    def _outer(self, cells: Array) -> list[Constraint]:
        out = []
        for link, indices in enumerate(self.task.links):
            rows = np.zeros((4, 6))  # (m, h): l m <= h <= u m
            for axis, (low, high) in enumerate(cells[link]):
                rows[0, 2 * axis : 2 * axis + 2] = -low, high
                rows[1 + axis, 2 * axis : 2 * axis + 2] = 1.0, -1.0
            out.append(build.linear("cell", f"link {link + 1}", indices[:4], rows, np.zeros(6)))
        for bound in self.constraints.nonconvex:
            out += outer(bound, cells[bound.link])
        return out

    def _inner(self, theta: Array) -> list[Constraint]:
        centres = _centres(theta, self.task)
        return [c for b in self.constraints.nonconvex for c in inner(b, centres[b.link])]


def _centres(theta: Array, task: Task) -> Array:
    links = theta[task.links]
    return np.asarray(links[:, 1:4] / np.maximum(links[:, :1], 1e-12))


def with_upper_moments(task: Task, upper: Array) -> Task:
    """The same task with other upper bounds (n, 3) on the moments about the centres of mass."""
    bounds = tuple(
        replace(b, upper=float(upper[b.link, (0, 2, 5).index(b.entry)])) if b.entry in (0, 2, 5) else b
        for b in task.constraints.nonconvex
    )
    return replace(task, constraints=replace(task.constraints, nonconvex=bounds))
