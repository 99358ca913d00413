"""The data, compressed: per joint and time block one triangular factor, exact and
additive.

For the rows Y theta = tau of one joint in one block, the QR factorisation

    [Y  tau] = Q [[R, rho], [0, residual_norm]]

keeps everything that least squares can ask:
|Y theta - tau|^2 = |R theta - rho|^2 + residual_norm^2 for every theta. Factors merge by factorising
their stack, so that joint weights, cross-validation over blocks and measurements from many
files cost no pass over the samples.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import pairwise
from typing import NamedTuple, Protocol, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from sdp_vs_penalty.effects.effect import Parameter
from sdp_vs_penalty.effects.model import Model
from sdp_vs_penalty.parallel import ALONE, Workers
from sdp_vs_penalty.regression.instruments import (
    free_rows,
    instrumented,
    instrumented_rows,
)
from sdp_vs_penalty.regression.linalg import deviations, min_norm_lstsq
from sdp_vs_penalty.robot.arrays import Array, Indices, Mask
from sdp_vs_penalty.signals.filtered import FilteredRun, FilteredRuns, Rows


@dataclass(frozen=True)
class Factor:
    """One joint's rows in one block."""

    #: Number of the joint, from 0.
    joint: int
    #: Number of the block.
    block: int
    #: (k,) numbers of the columns' parameters.
    indices: Indices
    #: (r, k + 1) [Y tau], as a triangle where there are more than twice k + 1 rows.
    triangle: Array
    #: Number of rows of the data.
    rows: int


#: No block of :func:`compress` is shorter [s].
SHORTEST_BLOCK = 0.5
#: Where a block comes from: the run's index and its first and last instant [s].
TimeBlock: TypeAlias = tuple[int, float, float]


@dataclass(frozen=True)
class LeastSquares:
    """The whole data as one problem: loss(theta) = |R theta - rho|^2 + residual_norm^2
    [(N m)^2]."""

    #: (r, p) compressed columns.
    R: Array
    #: (r,) compressed torque.
    rho: Array
    #: Norm of the residual that no theta can reduce, at least 0.
    residual_norm: float
    #: |tau|^2 of the weighted torque [(N m)^2].
    tau_squared: float
    #: Number of rows of the data.
    rows: int

    @classmethod
    def stacked(
        cls, stack: Sequence[Array], rows: int, tau_squared: float | None = None
    ) -> LeastSquares:
        """Compress stacked rows [Y, tau], parts of (k, p + 1), to a triangle by a QR
        factorisation.

        Parameters
        ----------
        rows : int
            Number of rows of the data.
        tau_squared : float, optional
            |tau|^2 [(N m)^2] of the data, if some of these rows hold a prior.

        Returns
        -------
        LeastSquares
            With R (p, p), rho (p,), and the norm of the residual that no theta can
            reduce.
        """
        triangle = triangular(stack)
        p = triangle.shape[1] - 1
        torque = triangle[:, p]
        residual_norm = 0.0
        if len(triangle) > p:
            residual_norm = float(torque[p])
        if tau_squared is None:
            tau_squared = float(torque @ torque)
        R = np.ascontiguousarray(triangle[:p, :p])
        rho = torque[:p].copy()
        return cls(R, rho, residual_norm, tau_squared, rows)

    @cached_property
    def curvature(self) -> Array:
        """(p, p) Hessian of :meth:`loss`, 2 R' R."""
        return 2.0 * (self.R.T @ self.R)

    def loss(self, theta: ArrayLike) -> float:
        """Return the squared torque error |R theta - rho|^2 + residual_norm^2 [(N
        m)^2], with weighted joints, for theta (p,) [SI]."""
        residual = self.R @ np.asarray(theta, float) - self.rho
        return float(residual @ residual) + self.residual_norm**2

    def loss_scale(self, theta: ArrayLike) -> float:
        """Return the number by which a certified gap is divided: the loss at theta (p,)
        [(N m)^2], at least 1e-12 |tau|^2 (for exact data)."""
        return max(self.loss(theta), 1e-12 * self.tau_squared)

    def gap(self, upper: float, lower: float, theta: ArrayLike) -> float:
        """Return the relative distance of an objective from its lower bound, at theta
        (p,) [SI].

        Parameters
        ----------
        upper : float
            Objective at theta [(N m)^2].
        lower : float
            Lower bound of the optimum [(N m)^2].

        Returns
        -------
        float
            (upper - lower) over :meth:`loss_scale`.
        """
        scale = self.loss_scale(theta)
        return (upper - lower) / scale if scale > 0.0 else 0.0

    def gradient(self, theta: ArrayLike) -> Array:
        """Return the gradient 2 R' (R theta - rho) (p,) of :meth:`loss` at theta (p,)
        [SI]."""
        residual = self.R @ np.asarray(theta, float) - self.rho
        return 2.0 * self.R.T @ residual

    def nearest(self, near: ArrayLike) -> Array:
        """Return the least-squares parameters (p,) [SI] that are nearest to given ones,
        from which they differ only in directions that the data determine."""
        return min_norm_lstsq(self.R, self.rho, np.asarray(near, float))

    def with_prior(self, scale: ArrayLike, weight: float) -> LeastSquares:
        """Return the data with a prior that pulls parameters to zero.

        Parameters
        ----------
        scale : (p,) array
            Size of each parameter [SI]; infinite: no pull.
        weight : float
            Weight of the squares [(N m)^2].

        Returns
        -------
        LeastSquares
            With weight * sum_k (theta_k / scale_k)^2 added to the loss.
        """
        size = np.asarray(scale, float)
        is_pulled = np.isfinite(size)
        rows = np.diag(1.0 / size)[is_pulled]
        return self.with_observations(rows, np.zeros(len(rows)), weight)

    def with_observations(
        self, rows: Array, values: Array, weight: float
    ) -> LeastSquares:
        """Return the data with observed values (k,) of linear functions of the
        parameters, with coefficients (k, p).

        Parameters
        ----------
        weight : float
            Weight of the squares [(N m)^2].

        Returns
        -------
        LeastSquares
            With weight * |rows theta - values|^2 added to the loss.
        """
        p = self.R.shape[1]
        data = np.column_stack([self.R, self.rho])
        unexplained = np.zeros((1, p + 1))
        unexplained[0, p] = self.residual_norm
        observations = np.sqrt(weight) * np.column_stack([rows, values])
        stack = [data, unexplained, observations]
        return LeastSquares.stacked(stack, self.rows, self.tau_squared)

    def given(self, values: Mapping[int, float]) -> LeastSquares:
        """Return the data in the other parameters, when some are known.

        Parameters
        ----------
        values : mapping
            The known values [SI] by their index in theta.

        Returns
        -------
        LeastSquares
            In p parameters; the columns of the known ones are zero, and their torque is
            subtracted.
        """
        known = list(values)
        R = self.R.copy()
        R[:, known] = 0.0
        rho = self.rho - self.R[:, known] @ list(values.values())
        return replace(self, R=R, rho=rho)

    @property
    def column_norms(self) -> Array:
        """(p,) norms of the columns: torque of a unit of each parameter; 0 for
        rounding.
        """
        norms = np.linalg.norm(self.R, axis=0)
        rounding = 1e-10 * norms.max(initial=0.0)
        return np.where(norms > rounding, norms, 0.0)

    @property
    def own_torque(self) -> Array:
        """(p,) distance of each column from the span of all others [torque per unit of
        parameter].

        It is the torque of a unit of the parameter that no other parameter can cancel:
        1 / sqrt of the diagonal of (R^T R)^-1; zero where the data determine only sums.
        """
        return 1.0 / deviations(self.R)


class BlocksOfJoint(NamedTuple):
    """One joint's rows, block by block."""

    #: Number of the joint, from 0.
    joint: int
    #: (k,) numbers of the columns' parameters.
    indices: Indices
    #: (B,) numbers of the blocks that show the joint.
    blocks: Indices
    #: (B, r, k + 1) rows [Y tau] of each block.
    rows: Array


@dataclass(frozen=True)
class Regression:
    """The compressed data of one model, joint by joint and block by block."""

    #: The p parameters of the model.
    parameters: tuple[Parameter, ...]
    #: Number of joints.
    joints: int
    #: The blocks of time.
    blocks: tuple[TimeBlock, ...]
    #: The rows of each joint in each block.
    factors: tuple[Factor, ...]
    #: Rows per independent sample: filtered rows are decimated to a multiple of their
    #: bandwidth.
    oversampling: float = 2.0

    @property
    def p(self) -> int:
        """Number of parameters."""
        return len(self.parameters)

    def select(self, blocks: Iterable[int]) -> Regression:
        """Return the data of some blocks.

        Parameters
        ----------
        blocks : iterable of int
            Indices into ``blocks``.

        Returns
        -------
        Regression
            With these blocks, renumbered in ascending order.
        """
        numbers = sorted(blocks)
        new_number = {old: new for new, old in enumerate(numbers)}
        factors = tuple(
            replace(factor, block=new_number[factor.block])
            for factor in self.factors
            if factor.block in new_number
        )
        chosen = tuple(self.blocks[block] for block in numbers)
        return replace(self, blocks=chosen, factors=factors)

    def keeping(self, kept_columns: Mask) -> Regression:
        """Return the data in the parameters that ``kept_columns`` (p,) flags, in the
        same order."""
        if kept_columns.all():
            return self
        new_place = np.cumsum(kept_columns) - 1
        factors = []
        for factor in self.factors:
            is_kept = kept_columns[factor.indices]
            indices = new_place[factor.indices[is_kept]]
            triangle = factor.triangle[:, np.append(is_kept, True)]
            factors.append(replace(factor, indices=indices, triangle=triangle))
        kept_places = np.flatnonzero(kept_columns)
        parameters = tuple(self.parameters[k] for k in kept_places)
        return replace(self, parameters=parameters, factors=tuple(factors))

    def given_first(self, fixed: Array) -> Regression:
        """Return the data in the other parameters when the first k are known.

        Parameters
        ----------
        fixed : (k,) array
            Values of the first k parameters [SI].

        Returns
        -------
        Regression
            In p - k parameters; the torque of the first k is subtracted.
        """
        k = len(fixed)
        factors = []
        for factor in self.factors:
            is_fixed = factor.indices < k
            columns = factor.triangle[:, :-1]
            values = fixed[factor.indices[is_fixed]]
            explained = columns[:, is_fixed] @ values
            torque = factor.triangle[:, -1] - explained
            triangle = np.column_stack([columns[:, ~is_fixed], torque])
            indices = factor.indices[~is_fixed] - k
            factors.append(replace(factor, indices=indices, triangle=triangle))
        others = self.parameters[k:]
        return replace(self, parameters=others, factors=tuple(factors))

    @cached_property
    def per_joint(self) -> tuple[Factor, ...]:
        """(n,) one factor a joint: its blocks merged by a QR factorisation.

        A factor is a triangle [R, rho] with |R theta - rho| equal to the torque error
        of its rows; a joint has one for each block (a fold or a piece of a run). A
        joint without rows gets a factor with zero rows.
        """
        merged = []
        empty = Factor(0, 0, indices=np.arange(0), triangle=np.zeros((0, 1)), rows=0)
        for joint in range(self.joints):
            parts = [factor for factor in self.factors if factor.joint == joint]
            merged_part = replace(parts[0] if parts else empty, block=0)
            # Of one part with few rows a factorisation gains nothing.
            if len(parts) > 1 or len(merged_part.triangle) > 2 * self.p:
                triangle = triangular([part.triangle for part in parts])
                n_rows = sum(part.rows for part in parts)
                merged_part = replace(merged_part, triangle=triangle, rows=n_rows)
            merged.append(merged_part)
        return tuple(merged)

    def least_squares(self, weights: ArrayLike | None = None) -> LeastSquares:
        """Return the rows of all joints as one least-squares problem.

        Parameters
        ----------
        weights : (n,) array, optional
            Factor of each joint's rows; default: 1.
        """
        scale = np.ones(self.joints)
        if weights is not None:
            scale = np.asarray(weights, float)
        stack = []
        n_rows = 0
        for factor in self.per_joint:
            rows = np.zeros((len(factor.triangle), self.p + 1))
            weighted = scale[factor.joint] * factor.triangle
            rows[:, factor.indices] = weighted[:, :-1]
            rows[:, self.p] = weighted[:, -1]
            stack.append(rows)
            n_rows += factor.rows
        return LeastSquares.stacked(stack, n_rows)

    def by_joint(self) -> Iterator[BlocksOfJoint]:
        """Yield each joint's blocks as one array (blocks, rows, columns + 1), with the
        torque in the last column.

        A block is a group of rows, such as a fold. Blocks with fewer rows are filled up
        with zero rows, which change no sum of squares. Joints without rows are skipped.
        """
        for joint in range(self.joints):
            factors = [factor for factor in self.factors if factor.joint == joint]
            if not factors:
                continue
            parts = dict[int, list[Array]]()
            for factor in factors:  # several runs may show one fold
                parts.setdefault(factor.block, []).append(factor.triangle)
            stacks = [np.vstack(triangles) for triangles in parts.values()]
            longest = max(len(stack) for stack in stacks)
            rows = np.zeros((len(stacks), longest, stacks[0].shape[1]))
            for place, stack in zip(rows, stacks, strict=True):
                place[: len(stack)] = stack
            yield BlocksOfJoint(joint, factors[0].indices, np.array(list(parts)), rows)

    def joint_losses(self, theta: ArrayLike) -> Array:
        """Return the squared torque error (n,) of each joint, summed over its rows [(N
        m)^2], with parameters theta (p,) [SI]."""
        parameters = np.asarray(theta, float)
        losses = []
        for factor in self.per_joint:
            modelled = factor.triangle[:, :-1] @ parameters[factor.indices]
            residual = modelled - factor.triangle[:, -1]
            losses.append(float(residual @ residual))
        return np.array(losses)

    def joint_rows(self) -> Indices:
        """Return (n,) the number of rows of each joint."""
        counts = [factor.rows for factor in self.per_joint]
        return np.array(counts, np.int64)

    def column_norms(self) -> Array:
        """Return (n, p + 1) the norm of each joint's columns, the torque last [N m]."""
        norms = np.zeros((self.joints, self.p + 1))
        for of_joint, factor in zip(norms, self.per_joint, strict=True):
            places = np.append(factor.indices, self.p)
            of_joint[places] = np.linalg.norm(factor.triangle, axis=0)
        return norms

    def torque_norms(self, theta: ArrayLike) -> Array:
        """Return (n,) the norm of each joint's modelled torque [N m] with parameters
        theta (p,) [SI]."""
        parameters = np.asarray(theta, float)
        modelled = [
            factor.triangle[:, :-1] @ parameters[factor.indices]
            for factor in self.per_joint
        ]
        return np.array([np.linalg.norm(torque) for torque in modelled])


def triangular(parts: Sequence[Array]) -> Array:
    """Return the upper triangular R factor (s, k), s <= k, of stacked matrices (r, k),
    with a nonnegative diagonal; it has the same inner products of columns."""
    stacked = np.vstack(parts)
    triangle: Array = np.asarray(np.linalg.qr(stacked, mode="r"))
    is_negative = np.diagonal(triangle) < 0
    sign = np.where(is_negative, -1.0, 1.0)
    triangle[: len(sign)] *= sign[:, None]
    return triangle


def _folded(rows: Array) -> Array:
    """Return the triangle of rows (r, k) with the same inner products.

    Up to 2 k rows are returned as they are, since a factorisation would cost more.
    """
    if len(rows) <= 2 * rows.shape[1]:
        return rows
    return triangular([rows])


def compress(
    runs: FilteredRuns, model: Model, blocks_per_run: int = 20, workers: Workers = ALONE
) -> Regression:
    """Compress runs to triangular factors; memory does not grow with their length.

    Parameters
    ----------
    model : Model
        Model whose columns are used.
    blocks_per_run : int
        Number of blocks of equal duration in each run, at least SHORTEST_BLOCK (0.5 s)
        long.
    workers : Workers
        Processes that compress one run each; factors are merged in the order of the
        runs.

    Returns
    -------
    Regression
        One factor for each joint and block.
    """
    edges = []
    for run in runs.measurements.runs():
        start = float(run.t[0])
        stop = float(run.t[-1])
        most = int((stop - start) / SHORTEST_BLOCK)
        count = max(1, min(blocks_per_run, most))
        edges.append(np.linspace(start, stop, count + 1))
    regression = compress_cells(runs, model, _TimeBlocks(tuple(edges)), workers)
    blocks_with_rows = {factor.block for factor in regression.factors}
    return regression.select(sorted(blocks_with_rows))


@dataclass(frozen=True)
class _TimeBlocks:
    """Cells of time of each run."""

    #: Edges of each run's blocks [s].
    edges: tuple[Array, ...]

    @property
    def places(self) -> list[TimeBlock]:
        """Run, start and stop [s] of each block."""
        return [
            (k, a, b)
            for k, edges in enumerate(self.edges)
            for a, b in pairwise(edges.tolist())
        ]

    def cell(self, run: int, t: Array) -> Indices:
        """Return the block of each instant t (M,) [s] of a run, counted over all runs."""
        n_before = sum(len(edges) - 1 for edges in self.edges[:run])
        inner_edges = self.edges[run][1:-1]
        return n_before + np.searchsorted(inner_edges, t, side="right")


class TimeCells(Protocol):
    """Blocks of time: run, start and stop [s] of each (``places``), and the blocks (M,)
    of instants t (M,) of a run (``cell``)."""

    @property
    def places(self) -> Sequence[TimeBlock]: ...

    def cell(self, run: int, t: Array) -> Indices: ...


def compress_cells(
    runs: FilteredRuns, model: Model, folds: TimeCells, workers: Workers = ALONE
) -> Regression:
    """Compress runs to factors, one for each joint and cell (such as a phase of the
    motion).

    Rows of all runs and periods in one cell are merged. Where servos' errors or a
    simulated motion are in the model, the columns are replaced by instruments.

    Parameters
    ----------
    model : Model
        Model whose columns are used.
    folds : TimeCells
        Assigns instants of runs to cells.
    workers : Workers
        Processes that compress one run each.

    Returns
    -------
    Regression
        One factor for each joint and cell.
    """
    compress_run = partial(_cells_of_run, model=model, folds=folds)
    by_run = workers.map(compress_run, list(enumerate(runs.runs)))
    factors = [factor for of_run, _ in by_run for factor in of_run]
    n_rows = sum(f.rows for f in factors if f.joint == 0)
    n_samples = sum(samples for _, samples in by_run)
    own_errors = model.drives.any() and model.reference is not None
    if own_errors or any("qsim" in run.run.commanded for run in runs.runs):
        # Their columns correlate with the motion, not with the noise of positions.
        parts = [(f.joint, f.indices, f.triangle) for f in factors]
        rows_by_factor = instrumented(model, parts)
        factors = [
            replace(factor, indices=indices, triangle=_folded(rows))
            for factor, (indices, rows) in zip(factors, rows_by_factor, strict=True)
        ]
    return Regression(
        parameters=model.parameters,
        joints=model.robot.n,
        blocks=tuple(folds.places),
        factors=tuple(factors),
        oversampling=n_rows / n_samples,
    )


def _cells_of_run(
    numbered: tuple[int, FilteredRun], model: Model, folds: TimeCells
) -> tuple[list[Factor], float]:
    """Return one run's factors by cell and joint, and its number of independent
    samples.

    ``numbered`` is the run with its number.
    """
    index, run = numbered
    count = 0
    cells = dict[tuple[int, int], Factor]()
    has_instruments = "qsim" in run.run.commanded
    of_run = instrumented_rows(run, model) if has_instruments else free_rows(run, model)
    for rows in of_run:
        count += len(rows.torque)
        _merge_rows(cells, rows, folds.cell(index, rows.motion.t))
    factors = [cells[block_and_joint] for block_and_joint in sorted(cells)]
    return factors, count / run.rows_per_sample


def _merge_rows(
    cells: dict[tuple[int, int], Factor], rows: Rows, block_of_row: Indices
) -> None:
    """Merge rows into the factors ``cells``, by block and joint, in place.

    A factor is a triangle that replaces its rows in least squares. ``rows`` are M rows
    a joint; ``block_of_row`` (M,) is the fold or piece of a run that each belongs to.
    """
    # Sort the rows by block; block k of ``blocks`` begins at row begin[k].
    order = np.argsort(block_of_row, kind="stable")
    blocks, begin = np.unique(block_of_row[order], return_index=True)
    for joint, columns in enumerate(rows.columns):
        rows_and_torque = np.column_stack([columns.columns, rows.torque[:, joint]])
        rows_and_torque = rows_and_torque.take(order, axis=0)
        pieces = np.split(rows_and_torque, begin[1:])  # one a block
        for block, piece in zip(blocks.tolist(), pieces, strict=True):
            empty = Factor(
                joint, block, columns.indices, triangle=rows_and_torque[:0], rows=0
            )
            factor = cells.get((block, joint), empty)
            folded = _folded(np.vstack([factor.triangle, piece]))
            n_rows = factor.rows + len(piece)
            cells[block, joint] = replace(factor, triangle=folded, rows=n_rows)
