"""The data, compressed: per joint and time block one triangular factor, exact and
additive.

For the rows Y theta = tau of one joint in one block, the QR factorisation

    [Y  tau] = Q [[R, rho], [0, residual_norm]]

keeps everything that least squares can ask:
|Y theta - tau|^2 = |R theta - rho|^2 + residual_norm^2 for every theta. Factors merge by factorising
their stack, so that joint weights, cross-validation over blocks, bootstrap and measurements from many
files cost no pass over the samples.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import pairwise
from typing import Protocol, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sdp_vs_penalty.effects.effect import Parameter
from sdp_vs_penalty.effects.model import Model
from sdp_vs_penalty.parallel import ALONE, Workers
from sdp_vs_penalty.regression.instruments import instrumented, instrumented_rows
from sdp_vs_penalty.regression.linalg import deviations
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.filtered import FilteredRun, FilteredRuns, Rows


@dataclass(frozen=True)
class Factor:
    """One joint's rows in one block: [Y tau] (r, k + 1) for the k columns ``indices``,
    as a triangle where there are more than twice k + 1."""

    joint: int
    block: int
    indices: NDArray[np.intp]
    triangle: Array
    rows: int


#: Where a block comes from: the run's index and its first and last instant [s].
TimeBlock: TypeAlias = tuple[int, float, float]


@dataclass(frozen=True)
class LeastSquares:
    """The whole data as one problem: loss(theta) = |R theta - rho|^2 + residual_norm^2
    [(N m)^2].

    R (r, p), rho (r,), residual_norm >= 0, tau_squared = |tau|^2 (weighted), rows: how
    many it holds.
    """

    R: Array
    rho: Array
    residual_norm: float
    tau_squared: float
    rows: int

    @classmethod
    def stacked(
        cls, stack: Sequence[Array], rows: int, tau_squared: float | None = None
    ) -> LeastSquares:
        """Least squares of rows [Y, tau], compressed to their triangle.

        Parameters
        ----------
        stack : sequence of (k, p + 1) arrays
            Rows, in any number of arrays.
        rows : int
            Number of measured rows.
        tau_squared : float or None
            |tau|^2 where it is not that of these rows, as some of them hold a prior.

        Returns
        -------
        LeastSquares
            R, rho and the norm of the residual.
        """
        triangle = triangular(stack)
        p = triangle.shape[1] - 1
        residual_norm = float(triangle[p, p]) if len(triangle) > p else 0.0
        if tau_squared is None:
            tau_squared = float(triangle[:, p] @ triangle[:, p])
        R = np.ascontiguousarray(triangle[:p, :p])
        rho = triangle[:p, p].copy()
        return cls(R, rho, residual_norm, tau_squared, rows)

    @cached_property
    def curvature(self) -> Array:
        """(p, p) of :meth:`loss`: 2 R' R."""
        return 2.0 * (self.R.T @ self.R)

    def loss(self, theta: ArrayLike) -> float:
        """Sum of squared, weighted torque errors: |R theta - rho|^2 + residual_norm^2.

        Parameters
        ----------
        theta : (p,) array
            Parameters.

        Returns
        -------
        float
            Loss [(N m)^2].
        """
        residual = self.R @ np.asarray(theta, float) - self.rho
        return float(residual @ residual) + self.residual_norm**2

    def loss_scale(self, theta: ArrayLike) -> float:
        """Scale to which gaps are relative: the loss, but at least 1e-12 |tau|^2 (exact data).

        Parameters
        ----------
        theta : (p,) array
            Parameters.

        Returns
        -------
        float
            Scale [(N m)^2].
        """
        return max(self.loss(theta), 1e-12 * self.tau_squared)

    def gap(self, upper: float, lower: float, theta: ArrayLike) -> float:
        """Relative gap between the objective at a point and a lower bound.

        Parameters
        ----------
        upper, lower : float
            Objective at theta, and its lower bound.
        theta : (p,) array
            Parameters.

        Returns
        -------
        float
            (upper - lower) / loss_scale(theta).
        """
        scale = self.loss_scale(theta)
        return (upper - lower) / scale if scale > 0.0 else 0.0

    def gradient(self, theta: ArrayLike) -> Array:
        """Gradient of :meth:`loss`: 2 R' (R theta - rho).

        Parameters
        ----------
        theta : (p,) array
            Parameters.

        Returns
        -------
        (p,) array
            The gradient.
        """
        return 2.0 * self.R.T @ (self.R @ np.asarray(theta, float) - self.rho)

    def with_prior(self, scale: ArrayLike, weight: float) -> LeastSquares:
        """Add a quadratic prior around zero: weight sum_k (theta_k / scale_k)^2.

        Parameters
        ----------
        scale : (p,) array
            Scale of each parameter; infinite: no prior.
        weight : float
            Weight [(N m)^2].

        Returns
        -------
        LeastSquares
            Least squares with the prior.
        """
        size = np.asarray(scale, float)
        rows = np.diag(1.0 / size)[np.isfinite(size)]
        return self.with_observations(rows, np.zeros(len(rows)), weight)

    def with_observations(
        self, rows: Array, values: Array, weight: float
    ) -> LeastSquares:
        """Add observations of linear combinations: weight |rows theta - values|^2.

        Parameters
        ----------
        rows : (k, p) array
            Linear combinations.
        values : (k,) array
            Observed values.
        weight : float
            Weight of each.

        Returns
        -------
        LeastSquares
            Least squares with the observations.
        """
        more = np.sqrt(weight) * np.column_stack([rows, values])
        end = np.append(np.zeros(self.R.shape[1]), self.residual_norm)[None, :]
        stack = [np.column_stack([self.R, self.rho]), end, more]
        return LeastSquares.stacked(stack, self.rows, self.tau_squared)

    @property
    def column_norms(self) -> Array:
        """|Y_k| of each parameter: how much torque a unit of it makes; 0 where only rounding is left."""
        norms = np.linalg.norm(self.R, axis=0)
        return np.where(norms > 1e-10 * norms.max(initial=0.0), norms, 0.0)

    @property
    def own_torque(self) -> Array:
        """(p,) distance of each column from the span of all others [torque per unit of
        parameter].

        What a unit of the parameter makes that no other parameter can cancel: 1 / sqrt
        of the diagonal of (R^T R)^-1, zero for what the data do not determine.
        """
        return 1.0 / deviations(self.R)


@dataclass(frozen=True)
class Regression:
    """The compressed data of one model: ``factors`` for each joint and block."""

    parameters: tuple[Parameter, ...]
    joints: int
    blocks: tuple[TimeBlock, ...]
    factors: tuple[Factor, ...]
    #: Rows per independent sample: filtered rows are decimated to a multiple of their
    #: bandwidth.
    oversampling: float = 2.0

    @property
    def p(self) -> int:
        return len(self.parameters)

    def select(self, blocks: Iterable[int]) -> Regression:
        """Select blocks of rows; a block that comes k times counts k times (bootstrap).

        Parameters
        ----------
        blocks : iterable of int
            Indices of blocks.

        Returns
        -------
        Regression
            The blocks; rows of repeated ones are multiplied by sqrt(k).
        """
        numbers, counts = np.unique(np.fromiter(blocks, np.intp), return_counts=True)
        place = {block: k for k, block in enumerate(numbers.tolist())}
        factors = []
        for f in self.factors:
            if f.block not in place:
                continue
            new = place[f.block]
            count = int(counts[new])
            triangle = f.triangle
            if count > 1:
                triangle = float(np.sqrt(count)) * triangle
            factors.append(
                replace(f, block=new, triangle=triangle, rows=count * f.rows)
            )
        chosen = tuple(self.blocks[b] for b in numbers)
        return replace(self, blocks=chosen, factors=tuple(factors))

    def keeping(self, kept_columns: NDArray[np.bool_]) -> Regression:
        """Select columns.

        Parameters
        ----------
        kept_columns : (p,) array of bool
            Columns to keep.

        Returns
        -------
        Regression
            The same rows with fewer columns.
        """
        if kept_columns.all():
            return self
        place = np.cumsum(kept_columns) - 1
        factors = []
        for f in self.factors:
            keep = kept_columns[f.indices]
            rows = f.triangle[:, np.append(keep, True)]
            factors.append(replace(f, indices=place[f.indices[keep]], triangle=rows))
        parameters = tuple(
            q for q, keep in zip(self.parameters, kept_columns, strict=True) if keep
        )
        return replace(self, parameters=parameters, factors=tuple(factors))

    def given_first(self, fixed: Array) -> Regression:
        """Fix the first parameters and move their torque to the right-hand side.

        Parameters
        ----------
        fixed : (k,) array
            Values of the first k parameters.

        Returns
        -------
        Regression
            The same rows in the remaining parameters.
        """
        k = len(fixed)
        factors = []
        for f in self.factors:
            is_fixed = f.indices < k
            columns = f.triangle[:, :-1]
            explained = columns[:, is_fixed] @ fixed[f.indices[is_fixed]]
            torque = f.triangle[:, -1] - explained
            rows = np.column_stack([columns[:, ~is_fixed], torque])
            factors.append(replace(f, indices=f.indices[~is_fixed] - k, triangle=rows))
        return replace(self, parameters=self.parameters[k:], factors=tuple(factors))

    @cached_property
    def per_joint(self) -> tuple[Factor, ...]:
        """All blocks of each joint merged into one factor."""
        merged = []
        none = Factor(0, 0, np.arange(0), np.zeros((0, 1)), 0)
        for joint in range(self.joints):
            parts = [f for f in self.factors if f.joint == joint] or [none]
            if len(parts) == 1 and len(parts[0].triangle) <= 2 * self.p:
                merged.append(replace(parts[0], block=0))  # few rows: as they are
                continue
            triangle = triangular([f.triangle for f in parts])
            n_rows = sum(f.rows for f in parts)
            merged.append(Factor(joint, 0, parts[0].indices, triangle, n_rows))
        return tuple(merged)

    def least_squares(self, weights: ArrayLike | None = None) -> LeastSquares:
        """Least squares over all joints.

        Parameters
        ----------
        weights : (joints,) array or None
            Factor of each joint's rows; None: 1.

        Returns
        -------
        LeastSquares
            The stack of all joints' rows.
        """
        scale = np.ones(self.joints) if weights is None else np.asarray(weights, float)
        stack = []
        for factor in self.per_joint:
            rows = np.zeros((len(factor.triangle), self.p + 1))
            rows[:, [*factor.indices, self.p]] = scale[factor.joint] * factor.triangle
            stack.append(rows)
        return LeastSquares.stacked(stack, sum(f.rows for f in self.per_joint))

    def by_joint(
        self,
    ) -> Iterator[tuple[int, NDArray[np.intp], NDArray[np.intp], Array]]:
        """Of each joint its number, its columns' parameters (k,), the blocks that show
        it, and their rows (B, r, k + 1), of zeros where a block has fewer."""
        for joint in range(self.joints):
            factors = [f for f in self.factors if f.joint == joint]
            if not factors:
                continue
            rows = dict[int, list[Array]]()
            for f in factors:  # several runs may show one fold
                rows.setdefault(f.block, []).append(f.triangle)
            stacks = [x[0] if len(x) == 1 else np.vstack(x) for x in rows.values()]
            longest = max(map(len, stacks))
            blocks = np.zeros((len(stacks), longest, stacks[0].shape[1]))
            for place, stack in zip(blocks, stacks, strict=True):
                place[: len(stack)] = stack
            yield joint, factors[0].indices, np.array(list(rows)), blocks

    def joint_losses(self, theta: ArrayLike) -> Array:
        """Sum of squared torque errors of each joint.

        Parameters
        ----------
        theta : (p,) array
            Parameters.

        Returns
        -------
        (joints,) array
            Losses [(N m)^2].
        """
        x = np.asarray(theta, float)
        losses = []
        for f in self.per_joint:
            residual = f.triangle[:, :-1] @ x[f.indices] - f.triangle[:, -1]
            losses.append(float(residual @ residual))
        return np.array(losses)

    def joint_rows(self) -> NDArray[np.int64]:
        """(joints,) number of rows of each joint."""
        return np.array([f.rows for f in self.per_joint], np.int64)


def triangular(parts: Sequence[Array]) -> Array:
    """The R factor of stacked matrices, with a non-negative diagonal.

    Parameters
    ----------
    parts : sequence of (r, k) arrays
        The matrices.

    Returns
    -------
    (s, k) array
        Upper triangular, at most square.
    """
    r: Array = np.asarray(np.linalg.qr(np.vstack(parts), mode="r"))
    sign = np.where(np.diagonal(r) < 0, -1.0, 1.0)
    r[: len(sign)] *= sign[:, None]
    return r


def _folded(rows: Array) -> Array:
    """A triangle where rows are more than twice as many as columns: fewer cost less as
    they are."""
    return triangular([rows]) if len(rows) > 2 * rows.shape[1] else rows


def compress(
    runs: FilteredRuns, model: Model, blocks_per_run: int = 20, workers: Workers = ALONE
) -> Regression:
    """Reduce runs to factors; memory does not grow with their length.

    Parameters
    ----------
    runs : FilteredRuns
        Behind their filters.
    model : Model
        In whose columns.
    blocks_per_run : int
        Each run is cut into so many blocks of equal duration, of at least 0.5 s.
    workers : Workers
        Who does it, a run each. Factors are merged in the order of the runs.

    Returns
    -------
    Regression
        A factor for each joint and block.
    """
    edges = []
    for run in runs.measurements.runs():
        start = float(run.t[0])
        stop = float(run.t[-1])
        count = max(1, min(blocks_per_run, int((stop - start) / 0.5)))
        edges.append(np.linspace(start, stop, count + 1))
    regression = compress_cells(runs, model, _TimeBlocks(tuple(edges)), workers)
    return regression.select(sorted({f.block for f in regression.factors}))


@dataclass(frozen=True)
class _TimeBlocks:
    """Cells of time: ``edges`` [s] of each run's blocks."""

    edges: tuple[Array, ...]

    @property
    def places(self) -> list[TimeBlock]:
        return [
            (k, a, b)
            for k, edges in enumerate(self.edges)
            for a, b in pairwise(edges.tolist())
        ]

    def cell(self, run: int, t: Array) -> NDArray[np.intp]:
        n_before = sum(len(edges) - 1 for edges in self.edges[:run])
        inner_edges = self.edges[run][1:-1]
        return n_before + np.searchsorted(inner_edges, t, side="right")


class Cells(Protocol):
    """places : run, start and stop [s] of each block; cell : the blocks (M,) of a run's
    instants t."""

    @property
    def places(self) -> Sequence[TimeBlock]: ...

    def cell(self, run: int, t: Array) -> NDArray[np.intp]: ...


def compress_cells(
    runs: FilteredRuns, model: Model, folds: Cells, workers: Workers = ALONE
) -> Regression:
    """Reduce runs to factors with one block for each cell, whichever runs and periods
    show it.

    Parameters
    ----------
    runs : FilteredRuns
        Behind their filters.
    model : Model
        In whose columns.
    folds : Cells
        Such as folds by phase.
    workers : Workers
        Who does it, a run each.

    Returns
    -------
    Regression
        A factor for each joint and cell.
    """
    one = partial(_cells_of_run, model=model, folds=folds)
    by_run = workers.map(one, list(enumerate(runs.runs)))
    factors = [factor for of_run, _ in by_run for factor in of_run]
    n_rows = sum(f.rows for f in factors if f.joint == 0)
    n_samples = sum(samples for _, samples in by_run)
    own_errors = model.drives.any() and model.reference is not None
    if own_errors or any("qsim" in run.run.commanded for run in runs.runs):
        factors = _with_instruments(model, factors)
    return Regression(
        parameters=model.parameters,
        joints=model.robot.n,
        blocks=tuple(folds.places),
        factors=tuple(factors),
        oversampling=n_rows / n_samples,
    )


def _with_instruments(model: Model, factors: Sequence[Factor]) -> list[Factor]:
    """The factors in columns that the noise of the positions is no part of."""
    parts = [(f.joint, f.indices, f.triangle) for f in factors]
    both = zip(factors, instrumented(model, parts), strict=True)
    return [
        replace(f, indices=indices, triangle=_folded(rows))
        for f, (indices, rows) in both
    ]


def _cells_of_run(
    numbered: tuple[int, FilteredRun], model: Model, folds: Cells
) -> tuple[list[Factor], float]:
    """One run's factors by cell, and its independent samples."""
    index, run = numbered
    count = 0
    cells = dict[tuple[int, int], Factor]()
    has_instruments = "qsim" in run.run.commanded
    of_run = instrumented_rows(run, model) if has_instruments else run.rows(model)
    for rows in of_run:
        count += len(rows.torque)
        _take(cells, rows, folds.cell(index, rows.motion.t))
    factors = [factor for _, factor in sorted(cells.items(), key=lambda item: item[0])]
    return factors, count / run.rows_per_sample


def _take(
    cells: dict[tuple[int, int], Factor], rows: Rows, owner: NDArray[np.intp]
) -> None:
    """Add rows to factors by block and joint, each to the block that ``owner`` (M,)
    says."""
    order = np.argsort(owner, kind="stable")
    blocks, begin = np.unique(owner[order], return_index=True)
    for joint, columns in enumerate(rows.columns):
        both = np.column_stack([columns.columns, rows.torque[:, joint]])
        both = both.take(order, axis=0)
        pieces = np.split(both, begin[1:])
        for block, piece in zip(blocks.tolist(), pieces, strict=True):
            empty = Factor(joint, block, columns.indices, both[:0], 0)
            old = cells.get((block, joint), empty)
            folded = _folded(np.vstack([old.triangle, piece]))
            n_rows = old.rows + len(piece)
            cells[block, joint] = replace(old, triangle=folded, rows=n_rows)
