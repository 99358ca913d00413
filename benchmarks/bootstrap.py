"""Block bootstrap of the SDP: the same problem a thousand times with other data, set up once.

Time blocks of the compressed data are drawn with replacement (Kuensch, Annals of Statistics 1989). Each
draw changes the numbers of one block of rows of the conic problem and no position in it: Clarabel keeps
its ordering and symbolic factorisation and receives new values (its data update). Every answer is
certified like any other; one whose certified gap is loose is solved again from the beginning.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
import scipy.linalg
from clarabel import DefaultSolver
from numpy.typing import ArrayLike, NDArray
from scipy import sparse
from scipy.linalg import lapack

from sdp_vs_penalty.constraints.constraint import ConstraintSet
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimators.estimator import Task
from sdp_vs_penalty.estimators.lmi_sdp import essential, interior_point, solve_sdp
from sdp_vs_penalty.parallel import ALONE, Workers
from sdp_vs_penalty.regression.regression import LeastSquares, Regression, triangular
from sdp_vs_penalty.robot import compiled
from sdp_vs_penalty.solvers import clarabel
from sdp_vs_penalty.solvers.certificate import lower_bound, repair
from sdp_vs_penalty.solvers.conic import ConicProblem, Solution
from sdp_vs_penalty.solvers.identification import SdpProblem, least_squares_sdp
from sdp_vs_penalty.solvers.objective import Objective
from sdp_vs_penalty.solvers.structured import Structured

Array = NDArray[np.float64]

#: Certified gap, relative to the loss, above which a draw is solved again from the beginning.
_TIGHT = 1e-8
_ACCURACY = 1e-10
#: Relative error of a triangle up to which Gram matrices are merged.
_ROUNDING = 1e-8


class Updated:
    """One problem solved again and again with new values in A and b at the same places.

    Clarabel keeps its ordering and symbolic factorisation between solves (its data update), which
    needs presolve off and every place of A that will ever be non-zero to be stored from the start.
    """

    def __init__(self, problem: ConicProblem, accuracy: float) -> None:
        settings = clarabel._settings(accuracy)
        settings.presolve_enable = False
        settings.chordal_decomposition_enable = False
        settings.input_sparse_dropzeros = False
        self._values = problem.A.data.copy()
        self._b = problem.b.copy()
        start = time.perf_counter()
        self._solver = DefaultSolver(
            problem.P, problem.q, problem.A, problem.b, clarabel._cones(problem), settings
        )
        self._setup = time.perf_counter() - start

    def solve(self, where: NDArray[np.intp], values: Array, b: Array) -> Solution:
        """Solve with A.data[where] = values and the first rows of b replaced."""
        start = time.perf_counter()
        self._values[where] = values
        self._b[: len(b)] = b
        self._solver.update(A=self._values, b=self._b)
        ready = time.perf_counter()
        result = self._solver.solve()
        return clarabel._solution(result, ready - start, time.perf_counter() - ready)


@dataclass(frozen=True)
class Draws:
    """theta (S, p) of each draw, its loss and certified relative gap (S,); again: how many took two."""

    theta: Array
    loss: Array
    gap: Array
    again: int


def block_data(regression: Regression, weights: ArrayLike) -> list[LeastSquares]:
    """The (weighted) data of each time block on its own."""
    return [regression.select([k]).least_squares(weights) for k in range(len(regression.blocks))]


def joined(blocks: Sequence[LeastSquares], counts: NDArray[np.int64]) -> LeastSquares:
    """The data of a draw: block k counted counts[k] times, by weights sqrt(counts[k])."""
    p = blocks[0].R.shape[1]
    parts, squared = [], 0.0
    for block, count in zip(blocks, counts, strict=True):
        if count:
            parts.append(np.sqrt(count) * np.column_stack([block.R, block.rho]))
            squared += count * block.residual_norm**2
    triangle = triangular(parts)
    rest = float(triangle[p, p] ** 2) if len(triangle) > p else 0.0
    tau_squared = float(sum(c * b.tau_squared for b, c in zip(blocks, counts, strict=True)))
    rows = int(sum(c * b.rows for b, c in zip(blocks, counts, strict=True)))
    return LeastSquares(
        np.ascontiguousarray(triangle[:p, :p]),
        triangle[:p, p].copy(),
        float(np.sqrt(squared + rest)),
        tau_squared, rows,
    )  # fmt: skip


def draw_counts(blocks: int, draw: int, seed: int) -> NDArray[np.int64]:
    """How often each block comes in a draw; independent of how draws are shared out."""
    rng = np.random.default_rng([seed, draw])
    return np.bincount(rng.integers(0, blocks, blocks), minlength=blocks)


@dataclass(frozen=True)
class _Base:
    """The problem of all blocks, ready for new values.

    What the blocks see lies in the row space of what all of them see together, R = R[:, leading] D with
    D (r, p) the identity in the ``leading`` columns: the rows of every draw are T D with T triangular,
    at the same places (``pattern``, and ``where`` they stand in A's data).
    """

    sdp: SdpProblem
    leading: NDArray[np.intp]
    dependence: Array
    pattern: NDArray[np.bool_]
    where: NDArray[np.intp]
    solver: Updated

    @classmethod
    def of(cls, sdp: SdpProblem, p: int) -> _Base:
        A, r = sdp.conic.A.tocsc(), sdp.conic.cones[0].size
        triangle, pivots = scipy.linalg.qr(A[:r, :p].toarray(), mode="r", pivoting=True)
        dependence, pattern = np.zeros((r, p)), np.zeros((r, p), bool)
        dependence[:, pivots[:r]] = np.eye(r)
        dependence[:, pivots[r:]] = scipy.linalg.solve_triangular(triangle[:r, :r], triangle[:r, r:])
        pattern[:, pivots[:r]] = np.triu(np.ones((r, r), bool))
        pattern[:, pivots[r:]] = True
        top = sparse.hstack([sparse.csc_matrix(pattern, dtype=float), A[:r, p:]])
        filled = sparse.csc_matrix(sparse.vstack([top, A[r:]]))
        # Within a column rows ascend, so the data rows come first.
        counts = pattern.sum(axis=0)
        where = np.concatenate([filled.indptr[k] + np.arange(counts[k]) for k in range(p)])
        solver = Updated(replace(sdp.conic, A=filled), _ACCURACY)
        return cls(sdp, pivots[:r], dependence, pattern, where, solver)


@dataclass(frozen=True)
class Resampler:
    """One task and its blocks; ``task.constraints`` hold every demand, the minimum thickness too."""

    task: Task
    blocks: tuple[LeastSquares, ...]

    @cached_property
    def interior(self) -> Array:
        return interior_point(self.task, self.task.constraints)

    @cached_property
    def _base(self) -> _Base:
        objective = Objective(self.task.data)
        whole = solve_sdp(self.task, objective, self.task.constraints, "clarabel", _ACCURACY)
        sent = essential(self.task.constraints, objective)
        least = self.task.data.loss(whole.theta)
        sdp = least_squares_sdp(
            objective, sent, self.interior, self.task.bound, whole.theta, least_loss=least
        )
        return _Base.of(sdp, len(self.task.bound))

    @cached_property
    def _reduced(self) -> list[Array]:
        """Each block's rows in the leading columns, with its right side about the centre."""
        base, out = self._base, []
        for block in self.blocks:
            rows = (block.R * base.sdp.theta_scale)[:, base.leading]
            out.append(triangular([np.column_stack([rows, block.rho - block.R @ base.sdp.centre])]))
        return out

    def solve(self, counts: NDArray[np.int64]) -> tuple[Solution, SdpProblem]:
        """Clarabel's answer for one draw; only values change."""
        base = self._base
        r, scale = len(base.leading), base.sdp.loss_scale
        triangle = triangular([np.sqrt(c) * t for t, c in zip(self._reduced, counts, strict=True) if c])
        triangle = np.vstack([triangle, np.zeros((max(r - len(triangle), 0), r + 1))])[:r]
        values = (triangle[:, :r] @ base.dependence).T[base.pattern.T] / scale
        return base.solver.solve(base.where, values, triangle[:, r] / scale), base.sdp

    @cached_property
    def _quick(self) -> tuple[Structured, Array, Array] | None:
        """The compiled problem, the optimum of all blocks, each block's Gram matrix (r + 1, r + 1)."""
        if compiled.core() is None:
            return None
        sent = essential(self.task.constraints, Objective(self.task.data))
        ours = Structured.of(None, self.task.constraints, sent, self.task.bound, self.interior)
        grams = np.array([t.T @ t for t in self._reduced])
        return ours, self._base.sdp.centre, grams

    def _merged(self, counts: NDArray[np.int64]) -> LeastSquares | None:
        """The data of a draw by its Gram matrix; None where rounding could reach what QR would keep.

        With columns of unit length the Cholesky factor's relative error is at most (r + 1)^2 eps times
        |L^-1|^2 (Higham 2002, sec. 10.1): above ``_ROUNDING`` the rows are factorised instead.
        """
        assert self._quick is not None
        base, (_, _, grams) = self._base, self._quick
        gram = np.tensordot(counts.astype(float), grams, axes=(0, 0))
        size = np.sqrt(np.diagonal(gram))
        if not np.all(size > 0.0):
            return None
        triangle, failed = lapack.dpotrf(gram / np.outer(size, size))
        inverse, singular = lapack.dtrtri(triangle)
        r, eps = len(size) - 1, float(np.finfo(float).eps)
        if failed or singular or (r + 1) ** 2 * eps * float(np.sum(np.triu(inverse) ** 2)) > _ROUNDING:
            return None
        triangle = np.triu(triangle) * size
        R = (triangle[:r, :r] @ base.dependence) / base.sdp.theta_scale
        pairs = [(b, int(c)) for b, c in zip(self.blocks, counts, strict=True) if c]
        squared = float(triangle[r, r] ** 2) + sum(c * b.residual_norm**2 for b, c in pairs)
        return LeastSquares(
            R,
            triangle[:r, r] + R @ base.sdp.centre,
            float(np.sqrt(squared)),
            float(sum(c * b.tau_squared for b, c in pairs)),
            int(sum(c * b.rows for b, c in pairs)),
        )

    def draw(self, counts: NDArray[np.int64]) -> tuple[Array, float, float, bool]:
        """theta, loss, certified relative gap of one draw, and whether it was solved again."""
        if self._quick is not None and (merged := self._merged(counts)) is not None:
            ours, near, _ = self._quick
            answer = ours.solve(merged, 0.1 * _TIGHT, near)
            if answer.feasible and answer.gap <= _TIGHT:
                return answer.theta, answer.value, answer.gap, False
        data = joined(self.blocks, counts)
        objective, constraints = Objective(data), self.task.constraints
        solution, sdp = self.solve(counts)
        if solution.claims in ("optimal", "inaccurate"):
            theta = repair(constraints, sdp.theta(solution), self.interior)
            found = {
                id(p.constraint): m for p, m in zip(sdp.placed, sdp.multipliers(solution), strict=True)
            }
            multipliers = [found.get(id(c), np.zeros_like(c.constant)) for c in constraints.convex]
            lower = lower_bound(objective, constraints, multipliers, theta, self.task.bound)
            loss = data.loss(theta)
            gap = data.gap(loss, lower, theta)
            if gap <= _TIGHT:
                return theta, loss, gap, False
        fit = solve_sdp(replace(self.task, data=data), objective, constraints, "clarabel", _ACCURACY)
        return fit.theta, data.loss(fit.theta), fit.gap, True


def bootstrap(
    task: Task,
    blocks: Sequence[LeastSquares],
    draws: int = 1000,
    seed: int = 0,
    workers: Workers = ALONE,
    shares: int = 1,
) -> Draws:
    """Solve and certify ``draws`` resamples of the blocks, in so many shares, by the workers.

    task : of all the data, its constraints those to impose. Raises InputError without two blocks.
    """
    if len(blocks) < 2:
        raise InputError("A block bootstrap needs at least two blocks", "record longer")
    resampler = Resampler(
        replace(task, constraints=ConstraintSet(task.constraints.convex)), tuple(blocks)
    )
    parts = [range(k, draws, shares) for k in range(shares)]
    results = workers.map(partial(_share, resampler, seed=seed), parts)
    rows = [results[k % shares][k // shares] for k in range(draws)]
    theta, loss, gap, again = zip(*rows, strict=True)
    return Draws(np.array(theta), np.array(loss), np.array(gap), sum(again))


def _share(
    resampler: Resampler, draws: Sequence[int], seed: int
) -> list[tuple[Array, float, float, bool]]:
    count = len(resampler.blocks)
    return [resampler.draw(draw_counts(count, draw, seed)) for draw in draws]
