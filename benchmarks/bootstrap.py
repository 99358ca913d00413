"""Block bootstrap of the SDP: the same problem a thousand times with other data, every draw certified.

Time blocks of the compressed data are drawn with replacement (Kuensch, Annals of Statistics 1989). A
draw's fit starts from the central path of all the data's fit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sdp_vs_penalty.constraints.constraint import ConstraintSet
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimators.estimator import Fit, Task
from sdp_vs_penalty.estimators.lmi_sdp import PosedSdp
from sdp_vs_penalty.parallel import ALONE, Workers
from sdp_vs_penalty.regression.regression import LeastSquares, Regression
from sdp_vs_penalty.solvers.objective import Objective

Array = NDArray[np.float64]

#: What a draw's solver is asked for; its certified gap is at most ten times that.
_ACCURACY = 1e-9


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
    """One task and its blocks; ``task.constraints`` hold every demand, the minimum thickness too."""

    task: Task
    blocks: tuple[LeastSquares, ...]

    @cached_property
    def posed(self) -> PosedSdp:
        return PosedSdp.of(self.task, Objective(self.task.data), self.task.constraints)

    @cached_property
    def whole(self) -> Fit:
        return self.posed.fit(Objective(self.task.data), _ACCURACY)

    def draw(self, counts: NDArray[np.int64]) -> tuple[Array, float, float, bool]:
        """theta, loss, certified relative gap of one draw, and whether Clarabel had to solve it."""
        data = joined(self.blocks, counts)
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
