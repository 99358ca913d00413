"""Block bootstrap of the SDP: the same problem a thousand times with other data, every draw certified.

Time blocks of the compressed data are drawn with replacement (Kuensch, Annals of Statistics 1989). A
draw's data are one small Cholesky factor; its fit starts from the central path of all the data's fit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import lapack

from sdp_vs_penalty.constraints.constraint import ConstraintSet
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimators.estimator import Fit, Task
from sdp_vs_penalty.estimators.lmi_sdp import PosedSdp
from sdp_vs_penalty.parallel import ALONE, Workers
from sdp_vs_penalty.regression.regression import LeastSquares, Regression, triangular
from sdp_vs_penalty.solvers.objective import Objective

Array = NDArray[np.float64]

#: What a draw's solver is asked for; its certified gap is at most ten times that.
_ACCURACY = 1e-9
#: Relative error of a triangle up to which Gram matrices are merged.
_ROUNDING = 1e-8


@dataclass(frozen=True)
class Draws:
    """theta (S, p) of each draw, its loss and certified relative gap (S,); again : by Clarabel."""

    theta: Array
    loss: Array
    gap: Array
    again: int


def block_data(regression: Regression, weights: ArrayLike) -> list[LeastSquares]:
    """The (weighted) data of each time block on its own."""
    return [regression.select([k]).least_squares(weights) for k in range(len(regression.blocks))]


def draw_counts(blocks: int, draw: int, seed: int) -> NDArray[np.int64]:
    """How often each block comes in a draw; independent of how draws are shared out."""
    rng = np.random.default_rng([seed, draw])
    return np.bincount(rng.integers(0, blocks, blocks), minlength=blocks)


def joined(blocks: Sequence[LeastSquares], counts: NDArray[np.int64]) -> LeastSquares:
    """The data of a draw: block k counted counts[k] times, by weights sqrt(counts[k])."""
    pairs = [(b, c) for b, c in zip(blocks, counts.tolist(), strict=True) if c]
    parts = [np.sqrt(c) * np.column_stack([b.R, b.rho]) for b, c in pairs]
    rest = np.sqrt(sum(c * b.residual_norm**2 for b, c in pairs))
    end = np.append(np.zeros(blocks[0].R.shape[1]), rest)[None]
    rows, squared = sum(c * b.rows for b, c in pairs), sum(c * b.tau_squared for b, c in pairs)
    return LeastSquares.stacked([*parts, end], rows, squared)


@dataclass(frozen=True)
class Resampler:
    """One task and its blocks; ``task.constraints`` hold every demand, the minimum thickness too.

    What the blocks see lies in the row space of what all of them see together, R = R[:, leading] D: a
    draw's triangle is that of its ``leading`` columns and torques, times D.
    """

    task: Task
    blocks: tuple[LeastSquares, ...]

    @cached_property
    def posed(self) -> PosedSdp:
        return PosedSdp.of(self.task, Objective(self.task.data), self.task.constraints)

    @cached_property
    def whole(self) -> Fit:
        return self.posed.fit(Objective(self.task.data), _ACCURACY)

    @cached_property
    def grams(self) -> tuple[Array, Array]:
        """[Y tau]^T [Y tau] (blocks, r + 1, r + 1) of the leading columns, and D (r, p)."""
        norms = self.task.data.column_norms
        scale = np.where(norms > 0.0, 1.0 / np.where(norms > 0.0, norms, 1.0), 0.0)
        r, pivots = scipy.linalg.qr(self.task.data.R * scale, mode="r", pivoting=True)
        rank = int(np.sum(np.abs(np.diagonal(r)) > 1e-10 * abs(r[0, 0])))
        dependence = np.zeros((rank, len(norms)))
        dependence[:, pivots] = scipy.linalg.solve_triangular(r[:rank, :rank], r[:rank])
        leading = pivots[:rank]
        rows = [
            triangular([np.column_stack([b.R[:, leading] * scale[leading], b.rho])]) for b in self.blocks
        ]
        visible = np.where(norms > 0.0, norms, 0.0)
        return np.array([t.T @ t for t in rows]), dependence * visible

    def data(self, counts: NDArray[np.int64]) -> LeastSquares:
        """Of a draw, by its Gram matrix where rounding cannot reach what QR would keep.

        With columns of unit length the Cholesky factor's relative error is at most (r + 1)^2 eps times
        |L^-1|^2 (Higham 2002, sec. 10.1): above ``_ROUNDING`` the rows are factorised instead.
        """
        grams, dependence = self.grams
        gram = np.tensordot(counts.astype(float), grams, axes=(0, 0))
        size = np.sqrt(np.diagonal(gram))
        if np.all(size > 0.0):
            triangle, failed = lapack.dpotrf(gram / np.outer(size, size))
            inverse, singular = lapack.dtrtri(triangle)
            r, eps = len(size) - 1, float(np.finfo(float).eps)
            error = (r + 1) ** 2 * eps * float(np.sum(np.triu(inverse) ** 2))
            if not failed and not singular and error <= _ROUNDING:
                triangle = triangle * size
                pairs = list(zip(self.blocks, counts.tolist(), strict=True))
                squared = float(triangle[r, r] ** 2) + sum(c * b.residual_norm**2 for b, c in pairs)
                torque = float(sum(c * b.tau_squared for b, c in pairs))
                rows = int(sum(c * b.rows for b, c in pairs))
                R = triangle[:r, :r] @ dependence
                return LeastSquares(R, triangle[:r, r].copy(), float(np.sqrt(squared)), torque, rows)
        return joined(self.blocks, counts)

    def draw(self, counts: NDArray[np.int64]) -> tuple[Array, float, float, bool]:
        """theta, loss, certified relative gap of one draw, and whether Clarabel had to solve it."""
        data = self.data(counts)
        fit = self.posed.fit(Objective(data), _ACCURACY, self.whole)
        return fit.theta, data.loss(fit.theta), fit.gap, fit.details["solver"] == "clarabel"


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
