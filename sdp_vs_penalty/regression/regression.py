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
from typing import NamedTuple, Protocol, TypeAlias

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


#: No block of :func:`compress` is shorter [s].
SHORTEST_BLOCK = 0.5
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
        cls,
        stack: Sequence[Array],
        rows: int,
        tau_squared: float | None = None,
    ) -> LeastSquares:
        """Compress stacked rows to one triangle.

        Parameters
        ----------
        stack : sequence of (k, p + 1) arrays
            Rows [Y, tau].
        rows : int
            How many rows of the data they stand for.
        tau_squared : float, optional
            |tau|^2 [(N m)^2], where it is not that of these rows: some hold a prior.

        Returns
        -------
        LeastSquares
            With R (p, p).
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
        """(p, p) of :meth:`loss`: 2 R' R."""
        return 2.0 * (self.R.T @ self.R)

    def loss(self, theta: ArrayLike) -> float:
        """Squared torque error, joints weighted.

        Parameters
        ----------
        theta : (p,) array
            Parameters [SI].

        Returns
        -------
        float
            |R theta - rho|^2 + residual_norm^2 [(N m)^2].
        """
        residual = self.R @ np.asarray(theta, float) - self.rho
        return float(residual @ residual) + self.residual_norm**2

    def loss_scale(self, theta: ArrayLike) -> float:
        """What a gap is divided by.

        Parameters
        ----------
        theta : (p,) array
            Parameters [SI].

        Returns
        -------
        float
            The loss, and of exact data 1e-12 of |tau|^2 [(N m)^2].
        """
        return max(self.loss(theta), 1e-12 * self.tau_squared)

    def gap(
        self,
        upper: float,
        lower: float,
        theta: ArrayLike,
    ) -> float:
        """Relative distance of an objective from its lower bound.

        Parameters
        ----------
        upper : float
            The objective at theta [(N m)^2].
        lower : float
            Its lower bound [(N m)^2].
        theta : (p,) array
            Parameters [SI].

        Returns
        -------
        float
            As a share of the loss at theta.
        """
        scale = self.loss_scale(theta)
        return (upper - lower) / scale if scale > 0.0 else 0.0

    def gradient(self, theta: ArrayLike) -> Array:
        """Slope of :meth:`loss`.

        Parameters
        ----------
        theta : (p,) array
            Parameters [SI].

        Returns
        -------
        (p,) array
            2 R' (R theta - rho).
        """
        residual = self.R @ np.asarray(theta, float) - self.rho
        return 2.0 * self.R.T @ residual

    def with_prior(self, scale: ArrayLike, weight: float) -> LeastSquares:
        """The data with a pull of parameters to zero.

        Parameters
        ----------
        scale : (p,) array
            What a parameter's size is divided by [SI]; infinite: no pull.
        weight : float
            Of the squares [(N m)^2].

        Returns
        -------
        LeastSquares
            With weight |theta_k / scale_k|^2 added, summed over k.
        """
        size = np.asarray(scale, float)
        is_pulled = np.isfinite(size)
        rows = np.diag(1.0 / size)[is_pulled]
        return self.with_observations(rows, np.zeros(len(rows)), weight)

    def with_observations(
        self,
        rows: Array,
        values: Array,
        weight: float,
    ) -> LeastSquares:
        """The data with observations of linear functions of the parameters.

        Parameters
        ----------
        rows : (k, p) array
            The functions.
        values : (k,) array
            Their observed values.
        weight : float
            Of the squares [(N m)^2].

        Returns
        -------
        LeastSquares
            With weight |rows theta - values|^2 added.
        """
        p = self.R.shape[1]
        data = np.column_stack([self.R, self.rho])
        unexplained = np.zeros((1, p + 1))
        unexplained[0, p] = self.residual_norm
        observations = np.sqrt(weight) * np.column_stack([rows, values])
        stack = [data, unexplained, observations]
        return LeastSquares.stacked(stack, self.rows, self.tau_squared)

    @property
    def column_norms(self) -> Array:
        """(p,) norms |Y_k|: torque that a unit of each parameter makes; 0 where only
        rounding is left."""
        norms = np.linalg.norm(self.R, axis=0)
        rounding = 1e-10 * norms.max(initial=0.0)
        return np.where(norms > rounding, norms, 0.0)

    @property
    def own_torque(self) -> Array:
        """(p,) distance of each column from the span of all others [torque per unit of
        parameter].

        What a unit of the parameter makes that no other parameter can cancel: 1 / sqrt
        of the diagonal of (R^T R)^-1, zero for what the data do not determine.
        """
        return 1.0 / deviations(self.R)


class BlocksOfJoint(NamedTuple):
    """One joint's rows, block by block.

    joint : from 0; indices (k,) : its columns' parameters; blocks (B,) : which show it;
    rows (B, r, k + 1) : [Y tau] of each.
    """

    joint: int
    indices: NDArray[np.intp]
    blocks: NDArray[np.intp]
    rows: Array


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
        """Number of parameters."""
        return len(self.parameters)

    def select(self, blocks: Iterable[int]) -> Regression:
        """Only some blocks.

        Parameters
        ----------
        blocks : iterable of int
            Indices into ``blocks``. One that comes k times, as in a bootstrap, counts k
            times: its rows are multiplied by sqrt(k).

        Returns
        -------
        Regression
            Of these, numbered anew in ascending order.
        """
        asked = np.fromiter(blocks, np.intp)
        numbers, counts = np.unique(asked, return_counts=True)
        new_number = {int(old): new for new, old in enumerate(numbers)}
        factors = []
        for factor in self.factors:
            if factor.block not in new_number:
                continue
            number = new_number[factor.block]
            count = int(counts[number])
            triangle = factor.triangle
            if count > 1:
                triangle = float(np.sqrt(count)) * triangle
            n_rows = count * factor.rows
            factors.append(
                replace(factor, block=number, triangle=triangle, rows=n_rows)
            )
        chosen = tuple(self.blocks[block] for block in numbers)
        return replace(self, blocks=chosen, factors=tuple(factors))

    def keeping(self, kept_columns: NDArray[np.bool_]) -> Regression:
        """Only some parameters.

        Parameters
        ----------
        kept_columns : (p,) array of bool
            Which of them.

        Returns
        -------
        Regression
            In these; rows keep their order.
        """
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
        """The same in the other parameters when the first ones are known.

        Parameters
        ----------
        fixed : (k,) array
            Values of the first k parameters [SI].

        Returns
        -------
        Regression
            In the other p - k, with their torque taken off; rows keep their order.
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
        """All blocks of each joint merged into one factor (n,)."""
        merged = []
        empty = Factor(
            0,
            0,
            np.arange(0),
            np.zeros((0, 1)),
            0,
        )
        for joint in range(self.joints):
            parts = [factor for factor in self.factors if factor.joint == joint]
            parts = parts or [empty]
            first = parts[0]
            if len(parts) == 1 and len(first.triangle) <= 2 * self.p:
                # Few rows: as they are.
                merged.append(replace(first, block=0))
                continue
            triangle = triangular([part.triangle for part in parts])
            n_rows = sum(part.rows for part in parts)
            merged.append(Factor(joint, 0, first.indices, triangle, n_rows))
        return tuple(merged)

    def least_squares(self, weights: ArrayLike | None = None) -> LeastSquares:
        """Stack the rows of all joints to one problem.

        Parameters
        ----------
        weights : (n,) array, optional
            What each joint's rows are multiplied by; default: 1.

        Returns
        -------
        LeastSquares
            In all p parameters.
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
        """The blocks of each joint that has rows, from the first joint on.

        Returns
        -------
        iterator of BlocksOfJoint
            All with as many rows: where a block has fewer, zeros follow.
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
            yield BlocksOfJoint(
                joint,
                factors[0].indices,
                np.array(list(parts)),
                rows,
            )

    def joint_losses(self, theta: ArrayLike) -> Array:
        """Squared torque error of each joint.

        Parameters
        ----------
        theta : (p,) array
            Parameters [SI].

        Returns
        -------
        (n,) array
            Sums over its rows [(N m)^2].
        """
        parameters = np.asarray(theta, float)
        losses = []
        for factor in self.per_joint:
            modelled = factor.triangle[:, :-1] @ parameters[factor.indices]
            residual = modelled - factor.triangle[:, -1]
            losses.append(float(residual @ residual))
        return np.array(losses)

    def joint_rows(self) -> NDArray[np.int64]:
        """(n,) number of rows of each joint."""
        counts = [factor.rows for factor in self.per_joint]
        return np.array(counts, np.int64)


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
    stacked = np.vstack(parts)
    triangle: Array = np.asarray(np.linalg.qr(stacked, mode="r"))
    is_negative = np.diagonal(triangle) < 0
    sign = np.where(is_negative, -1.0, 1.0)
    triangle[: len(sign)] *= sign[:, None]
    return triangle


def _folded(rows: Array) -> Array:
    """A triangle where rows are more than twice as many as columns: fewer cost less as
    they are."""
    if len(rows) <= 2 * rows.shape[1]:
        return rows
    return triangular([rows])


def compress(
    runs: FilteredRuns,
    model: Model,
    blocks_per_run: int = 20,
    workers: Workers = ALONE,
) -> Regression:
    """Reduce runs to factors; memory does not grow with their length.

    Parameters
    ----------
    runs : FilteredRuns
        Behind their filters.
    model : Model
        In whose columns.
    blocks_per_run : int
        Each run is cut into so many blocks of equal duration, of ``SHORTEST_BLOCK``
        or more.
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
        most = int((stop - start) / SHORTEST_BLOCK)
        count = max(1, min(blocks_per_run, most))
        edges.append(np.linspace(start, stop, count + 1))
    regression = compress_cells(runs, model, _TimeBlocks(tuple(edges)), workers)
    blocks_with_rows = {factor.block for factor in regression.factors}
    return regression.select(sorted(blocks_with_rows))


@dataclass(frozen=True)
class _TimeBlocks:
    """Cells of time: ``edges`` [s] of each run's blocks."""

    edges: tuple[Array, ...]

    @property
    def places(self) -> list[TimeBlock]:
        """Run, start and stop [s] of each block."""
        return [
            (k, a, b)
            for k, edges in enumerate(self.edges)
            for a, b in pairwise(edges.tolist())
        ]

    def cell(
        self,
        run: int,
        t: Array,
    ) -> NDArray[np.intp]:
        """The blocks of a run's instants.

        Parameters
        ----------
        run : int
            Its number.
        t : (M,) array
            Instants [s].

        Returns
        -------
        (M,) array of int
            Numbers of blocks.
        """
        n_before = sum(len(edges) - 1 for edges in self.edges[:run])
        inner_edges = self.edges[run][1:-1]
        return n_before + np.searchsorted(inner_edges, t, side="right")


class Cells(Protocol):
    """places : run, start and stop [s] of each block; cell : the blocks (M,) of a run's
    instants t."""

    @property
    def places(self) -> Sequence[TimeBlock]: ...

    def cell(
        self,
        run: int,
        t: Array,
    ) -> NDArray[np.intp]: ...


def compress_cells(
    runs: FilteredRuns,
    model: Model,
    folds: Cells,
    workers: Workers = ALONE,
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
    out = []
    rows_by_factor = instrumented(model, parts)
    for factor, (indices, rows) in zip(factors, rows_by_factor, strict=True):
        out.append(
            replace(
                factor,
                indices=indices,
                triangle=_folded(rows),
            )
        )
    return out


def _cells_of_run(
    numbered: tuple[int, FilteredRun],
    model: Model,
    folds: Cells,
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
    factors = [cells[block_and_joint] for block_and_joint in sorted(cells)]
    return factors, count / run.rows_per_sample


def _take(
    cells: dict[tuple[int, int], Factor],
    rows: Rows,
    owner: NDArray[np.intp],
) -> None:
    """Add rows to factors by block and joint, each to the block that ``owner`` (M,)
    says."""
    order = np.argsort(owner, kind="stable")
    blocks, begin = np.unique(owner[order], return_index=True)
    for joint, columns in enumerate(rows.columns):
        both = np.column_stack(
            [
                columns.columns,
                rows.torque[:, joint],
            ]
        )
        both = both.take(order, axis=0)
        pieces = np.split(both, begin[1:])
        for block, piece in zip(blocks.tolist(), pieces, strict=True):
            empty = Factor(
                joint,
                block,
                columns.indices,
                both[:0],
                0,
            )
            old = cells.get((block, joint), empty)
            folded = _folded(np.vstack([old.triangle, piece]))
            n_rows = old.rows + len(piece)
            cells[block, joint] = replace(old, triangle=folded, rows=n_rows)
