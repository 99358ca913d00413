"""The open shape constants of a model, estimated from measurements by variable
projection.

For every constant u (the velocity over which Coulomb friction turns round) the
coefficients theta(u) are those of least squares; what is left, |Y(u) theta(u) - tau|^2,
is a function of the constants alone (Golub, Pereyra, SIAM J. Numerical Analysis 1973),
minimised with the Jacobian of Kaufman (BIT 1975). Columns are computed on a grid of u
once, and are cubic splines of ln u between its values (:func:`estimate_shapes`); where
data tell a constant more finely, on a grid that holds what was found.

Every fold k of the motion is left out once, constants are found anew from the rest (one
step of Gauss and Newton), and the fold is predicted with a constant as found there and
as the model has it. With r what the former leaves and d the difference of the two,
sum_k |d_k|^2 + 2 r_k'd_k is taken from the squared error. A constant is confirmed where
that exceeds Student's 95 % quantile times its deviation: sqrt(sum_k (2 r_k'd_k)^2), for
noise of any colour, at least that of white noise; else the model's own value stays, the
simpler model (Breiman et al., Classification and Regression Trees, 1984, 3.4.3). What
an error of a constant makes is in sensitivity.py.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy

from sdp_vs_penalty.effects import effect_name
from sdp_vs_penalty.effects.effect import Block, Effect, Motion, Parameter
from sdp_vs_penalty.effects.model import Model
from sdp_vs_penalty.effects.shape import ShapeConstant, at_end
from sdp_vs_penalty.estimation.constants import SHAPE_FOLDS
from sdp_vs_penalty.estimators.estimator import joint_weights
from sdp_vs_penalty.parallel import ALONE, Workers
from sdp_vs_penalty.records import JsonRecord
from sdp_vs_penalty.regression.evidence import student_95
from sdp_vs_penalty.regression.linalg import (
    UNSEEN,
    column_space,
    deviations,
    least_squares,
    span,
)
from sdp_vs_penalty.regression.regression import Regression, compress_cells, triangular
from sdp_vs_penalty.robot.arrays import Array, Indices, Mask, nonzero_or_one
from sdp_vs_penalty.signals.filtered import FilteredRuns
from sdp_vs_penalty.signals.phases import PhaseFolds, motion_clocks, tracks_of
from sdp_vs_penalty.signals.splines import CubicSpline

#: Which rows take part: of a run's number and instants (N,), (N,) true or false.
Chosen = Callable[[int, Array], Mask]
#: Of a shape constant: effect, joint from 0, and the constant's name.
ConstantKey = tuple[str, int, str]
#: An effect, its joint (from 0), and the constant that is open there.
_OpenConstant = tuple[Effect, int, str]


@dataclass(frozen=True)
class ShapeEstimate(JsonRecord):
    """A shape constant as estimated."""

    #: Name of the effect.
    effect: str
    #: Joint of the effect, from 1.
    joint: int
    #: Name of the constant.
    shape: str
    #: Value that the model had.
    before: float
    #: Value as estimated.
    after: float
    #: Standard deviation, from the curvature of the squared error; infinite where the
    #: data bound the constant on one side only.
    std: float = np.inf
    #: What the change takes from that error in motion left out, in units of its variance.
    gain: float = 0.0
    #: Whether it lies at an end of the range that was searched.
    at_end: bool = False

    @property
    def index(self) -> int:
        """Index of the joint, from 0."""
        return self.joint - 1

    @property
    def key(self) -> tuple[str, int, str]:
        """Effect, index of the joint, and constant: by which models look constants
        up."""
        return self.effect, self.index, self.shape


def estimate_shapes(
    model: Model,
    runs: FilteredRuns,
    weighting: str,
    chosen: Chosen | None = None,
    workers: Workers = ALONE,
    widest: float = 0.0,
) -> list[ShapeEstimate]:
    """Estimate the open shape constants of a model by variable projection.

    A shape constant enters the torque nonlinearly (the velocity over which Coulomb
    friction changes its sign). It changes only if the new value also explains
    significantly more of motion that is left out; else the model's value stays.

    Parameters
    ----------
    model : Model
        Model with open shape constants.
    runs : FilteredRuns
        Measured runs behind their filters.
    weighting : {"noise", "none"}
        Weight the joints' rows by their noise, or equally.
    chosen : callable, optional
        Selects rows from a run's number and its instants (N,); default: all rows.
    workers : Workers
        Processes that compress the runs.
    widest : float
        Each grid of values is continued by doubling up to this value.

    Returns
    -------
    list of ShapeEstimate
        One for each open constant.
    """
    open_constants = _open_constants(model)
    if not open_constants:
        return []
    folds = PhaseFolds(motion_clocks(tracks_of(runs.measurements)), SHAPE_FOLDS)

    def profile_of(start: Model, constants: Sequence[_OpenConstant]) -> _ShapeProfile:
        """Compress the chosen rows, one block a fold of the motion."""
        wide, base, banks = _with_banks(start, constants, widest)
        cells = compress_cells(runs, wide, _Cells(folds, chosen), workers)
        blocks = {f.block for f in cells.factors if f.block < SHAPE_FOLDS}
        return _ShapeProfile(cells.select(sorted(blocks)), weighting, base, banks)

    free = model.reference_free
    estimates = profile_of(free, open_constants).confirmed_estimates()
    # Splines between grid values are accurate to 1 %. Constants that the data determine
    # more accurately are refined on a grid that contains the first estimate.
    fine = {
        s.key
        for s in estimates
        if s.after != s.before and not s.at_end and s.std < 0.01 * s.after
    }
    if not fine:
        return estimates
    estimated_model = replace(free, effects=with_shapes(free.effects, estimates))
    fine_constants = [
        (effect, joint, key)
        for effect in estimated_model.effects
        for joint in effect.joints
        for key in effect.estimated
        if (effect.name, joint, key) in fine
    ]
    profile = profile_of(estimated_model, fine_constants)
    best = profile.minimised(profile.log_model_values, np.arange(len(fine_constants)))
    refined = {s.key: s.after for s in profile.estimates_at(best)}
    return [replace(s, after=refined.get(s.key, s.after)) for s in estimates]


def _open_constants(model: Model) -> list[_OpenConstant]:
    """List the shape constants to estimate as (effect, joint from 0, constant's name).

    Constants that the user gave are not open. Only effects with one parameter a joint
    take part.
    """
    return [
        (effect, joint, key)
        for effect in model.effects
        for key in effect.estimated
        if key not in effect.given and len(effect.parameters) == len(effect.joints)
        for joint in effect.joints
    ]


@dataclass(frozen=True)
class _Cells:
    """Rows by folds of the motion; the last cell holds those that take no part."""

    folds: PhaseFolds
    chosen: Chosen | None

    @property
    def places(self) -> list[tuple[int, float, float]]:
        """Return one (run, start, stop) a cell, all zero: cells of folds have no place
        in time.

        compress_cells asks for as many entries as there are cells: one a fold, and one
        for rows that take no part.
        """
        return [(0, 0.0, 0.0)] * (self.folds.count + 1)

    def cell(self, run: int, t: Array) -> Indices:
        """Return (N,) the cell of each row: its fold of the motion, from 0.

        Rows of ``run`` at instants t (N,) [s] that are not chosen go to an extra cell
        behind the last fold.
        """
        fold = self.folds.fold(run, t)
        if self.chosen is None:
            return fold
        return np.where(self.chosen(run, t), fold, self.folds.count)


@dataclass(frozen=True)
class _Bank:
    """One shape constant of one effect on one joint, with the columns of the K values
    on its grid, whose ends are its range."""

    #: The effect, of this joint alone.
    effect: Effect
    #: Index of the joint, from 0.
    joint: int
    #: Name of the constant.
    key: str
    #: Value that the model has.
    model_value: float
    #: Cubic spline over ln u through the K unit vectors: it gives weights of the
    #: columns.
    spline: CubicSpline
    #: (K,) where the grid's columns stand among all others.
    columns: Indices

    def weights(self, u: float) -> Array:
        """Return the (2, K) weights of a cubic spline through K precomputed columns.

        A shape constant (such as a Stribeck velocity) makes one regressor column at
        each of the K values of its grid. ``u`` is the logarithm of the constant.
        weights[0] times the K columns is the column at u; weights[1] times them its
        derivative by u.
        """
        return np.array([self.spline(u), self.spline(u, 1)])


def _with_banks(
    model: Model, open_constants: Sequence[_OpenConstant], widest: float
) -> tuple[Model, Indices, list[_Bank]]:
    """Build a model with a column for every grid value of every open shape constant.

    Parameters
    ----------
    open_constants : sequence of (Effect, int, str)
        Effect, joint from 0, and name of each constant.
    widest : float
        Each grid is continued by doubling up to this value.

    Returns
    -------
    Model
        Effects without an open constant first, unchanged; then one with a column for
        each grid value of each open constant.
    (b,) array of int
        Indices of the columns without an open constant.
    list of _Bank
        For each open constant its grid as a spline, and its columns' indices.
    """
    open_ids = {id(effect) for effect, _, _ in open_constants}
    fixed = [e for e in model.effects if id(e) not in open_ids]
    first = sum(len(e.parameters) for e in fixed)  # column of the next bank
    base = np.arange(first)
    banks = list[_Bank]()
    on_grids = list[_EffectOnGrid]()
    splines = dict[tuple[float, ...], CubicSpline]()
    for effect, joint, key in open_constants:
        model_value = effect.shape[key]
        grid = _grid_with(effect, joint, key, model_value, widest)
        at_values = [effect.with_shape([joint], **{key: value}) for value in grid]
        on_grids.append(_EffectOnGrid(at_values))
        columns = first + np.arange(len(grid))
        first += len(grid)
        if grid not in splines:  # through the unit vectors: it returns weights
            splines[grid] = CubicSpline(np.log(grid), np.eye(len(grid)))
        banks.append(
            _Bank(
                effect.with_shape([joint]),
                joint,
                key,
                model_value,
                spline=splines[grid],
                columns=columns,
            )
        )
    effects = (*fixed, *on_grids)
    wide = Model(model.robot, effects, gains=model.gains, known=model.known)
    return wide, base, banks


def _grid_with(
    effect: Effect, joint: int, key: str, model_value: float, widest: float
) -> tuple[float, ...]:
    """Return the ascending grid of values at which a constant's columns are computed.

    The effect's grid is doubled up to ``widest``. The model's value replaces grid values
    within 0.1 of it in ln u, so that columns are exact there; the grid's ends stay. A
    value beyond the ends is left out.
    """
    grid = effect.shapes[key].on(effect.robot.joints[joint].kind).grid
    while grid[-1] < widest:
        grid = (*grid, 2.0 * grid[-1])
    ends = (grid[0], grid[-1])
    if not ends[0] <= model_value <= ends[-1]:
        return grid
    distant = {g for g in grid if g in ends or abs(np.log(g / model_value)) > 0.1}
    return tuple(sorted({model_value, *distant}))


class _EffectOnGrid(Effect):
    """An effect on one joint with several values of one shape constant, as columns of a
    regression."""

    name = "shape_grid"
    equation = explanation = reference = ""

    def __init__(self, effects: Sequence[Effect]) -> None:
        """Take one effect for each value of a constant, all on the same joint."""
        super().__init__(effects[0].robot, effects[0].joints)
        self.effects = effects

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:  # type: ignore[override]
        """Return one parameter for each value of the constant, its name with the
        value's number.
        """
        (parameter,) = self.effects[0].parameters
        return tuple(
            replace(parameter, name=f"{parameter.name}_{m}")
            for m in range(len(self.effects))
        )

    def blocks(self, motion: Motion) -> list[Block]:
        """Return the regressor's blocks of all grid values of the constant.

        A block holds a joint's columns (N, k) and their parameters' indices. The
        columns of the effect with grid value m go to parameter m.
        """
        blocks_of_values = (
            (m, b)
            for m, effect in enumerate(self.effects)
            for b in effect.blocks(motion)
        )
        return [
            Block(b.joint, b.parameters + m, b.columns) for m, b in blocks_of_values
        ]


class _ShapeProfile:
    """What a fit of all other columns leaves of the torque (r,) and of B banks: each
    has the columns of one open shape constant u at K values.

    - ``columns_on_grid``: what is left of each bank's columns, (K, r).
    - ``log_model_values`` (B,): ln u as the model has it, or the nearest known value.
    - ``ends`` (B, 2): the range of ln u.
    - ``is_friction`` (B,): whether the bank's coefficient may not become negative.
    - ``shown_directions`` (b, k): directions of the other columns' coefficients that the data
      determine, scaled so that each makes a torque of norm one.
    - ``variance``: of a row, times the number of rows that repeat one another.
    """

    def __init__(
        self, folds: Regression, weighting: str, base: Indices, banks: list[_Bank]
    ) -> None:
        """Project all columns without an open constant out of the banks' columns and
        the torque.

        Parameters
        ----------
        folds : Regression
            Compressed rows, one block a fold of the motion.
        weighting : {"noise", "none"}
            Weight joints by their noise, or equally.
        base : (b,) array of int
            Indices of the columns without an open constant; they come before the
            banks'.
        banks : list of _Bank
            The open constants with their grids and column indices.
        """
        self.folds = folds
        self.banks = banks
        # 1. Weigh the joints' rows by their noise, in all columns.
        data = folds.least_squares()
        self.weights = np.ones(folds.joints)
        if weighting == "noise":
            fit = scipy.linalg.lstsq(data.R, data.rho, 1e-10, lapack_driver="gelsy")
            self.weights = joint_weights(folds, fit[0])
            data = folds.least_squares(self.weights)
        # 2. Project the other columns out.
        banks_and_torque = np.column_stack([data.R[:, len(base) :], data.rho])
        base_columns, self.shown_directions = column_space(data.R[:, base])
        explained = base_columns @ (base_columns.T @ banks_and_torque)
        remaining = triangular([banks_and_torque - explained])
        self.torque = remaining[:, -1]
        self.n_bank_columns = remaining.shape[1] - 1
        # 3. The variance of what all values of all banks together leave.
        all_banks = span(remaining[:, :-1])
        residual = self.torque - all_banks @ (all_banks.T @ self.torque)
        error = float(np.sum(residual**2)) + data.residual_norm**2
        # Exact data have no variance; their constants still have a best value.
        error = max(error, 1e-12 * data.tau_squared) or 1.0
        n_columns = all_banks.shape[1] + base_columns.shape[1]
        free = max(data.rows - folds.oversampling * n_columns, 1.0)
        self.variance = folds.oversampling * error / free
        # 4. Each bank by itself.
        self.columns_on_grid = [
            np.ascontiguousarray(remaining.T[b.columns - len(base)]) for b in banks
        ]
        self.ends = np.array([b.spline.x[[0, -1]] for b in banks])
        self.log_model_values = np.clip(
            np.log([b.model_value for b in banks]), *self.ends.T
        )
        self.is_friction = np.array(
            [b.effect.parameters[0].lower == 0.0 for b in banks]
        )

    def _columns_at(self, u: Array) -> tuple[Array, Array]:
        """Return the banks' columns (r, B) at constants ln u (B,), and their
        derivatives (r, B).
        """
        interpolated = [  # of each bank (2, r): the column, and its derivative
            bank.weights(log_value) @ columns_on_grid
            for bank, columns_on_grid, log_value in zip(
                self.banks, self.columns_on_grid, u.tolist(), strict=True
            )
        ]
        # (B, 2, r) to (2, r, B)
        values, derivatives = np.array(interpolated).transpose(1, 2, 0)
        return values, derivatives

    def _residual_at(self, u: Array) -> tuple[Array, Array]:
        """Return the torque's residual (r,) at constants ln u (B,), and its Jacobian
        (r, B).

        Variable projection: the coefficients theta(u) are those of least squares, and
        the Jacobian is Kaufman's, -(1 - U U^T) (dY/du) theta, with U a basis of the
        columns. A friction column (``is_friction``) whose coefficient came out negative
        is left out: friction brakes.
        """
        columns, derivatives = self._columns_at(u)
        used = np.ones(len(u), bool)
        while True:
            U, V = column_space(columns[:, used])
            theta = np.zeros(len(u))
            theta[used] = V @ (U.T @ self.torque)
            pushes = self.is_friction & (theta < 0.0)
            if not pushes.any():
                break
            used &= ~pushes
        slopes = derivatives * theta
        residual = self.torque - U @ (U.T @ self.torque)
        return residual, U @ (U.T @ slopes) - slopes

    def _fold_grams(self, combinations: Array) -> Array:
        """Return the Gram matrices (F, k + d, k + d) of k + d columns in each fold's rows.

        The first k columns are the directions of the other columns that the data show.
        The last d are combinations (P + 1, d) of the banks' P columns and the torque.
        """
        n_others, n_shown = self.shown_directions.shape
        size = n_shown + combinations.shape[1]
        grams = np.zeros((len(self.folds.blocks), size, size))
        # rows (blocks, r, columns + 1): other columns, banks' columns, torque.
        for joint, indices, blocks, rows in self.folds.by_joint():
            n_others_of_joint = int(np.sum(indices < n_others))
            other_rows = rows[..., :n_others_of_joint]
            directions = self.shown_directions[indices[:n_others_of_joint]]
            # Rows of the combinations for this joint's banks, the last for the torque.
            bank_columns = indices[n_others_of_joint:] - n_others
            used = np.append(bank_columns, self.n_bank_columns)
            combined = rows[..., n_others_of_joint:] @ combinations[used]
            columns = np.concatenate([other_rows @ directions, combined], axis=2)
            columns = self.weights[joint] * columns
            grams[blocks] += columns.swapaxes(1, 2) @ columns
        return grams

    def held_out_gains(self, estimates: Sequence[ShapeEstimate]) -> tuple[Array, Array]:
        """Return each new constant's gain on motion left out, and the gain that it
        needs.

        With r a fold's residual with the new constant and d the change of the torque, a
        fold's gain is |d|^2 + 2 r^T d; noise acts on 2 r^T d alone.

        Returns
        -------
        (B,) array
            Decrease of the squared error on left-out folds, in units of the row
            variance.
        (B,) array
            Student's 97.5 % quantile times the gain's standard deviation under noise.
        """
        moved = [k for k, s in enumerate(estimates) if s.after != s.before]
        n_folds = len(self.folds.blocks)
        gain = np.zeros(len(estimates))
        needed = np.zeros(len(estimates))
        if not moved or n_folds < 2:
            return gain, needed
        local = self._local_columns(estimates)
        grams = self._fold_grams(local.combinations)
        size = nonzero_or_one(np.sqrt(np.diagonal(grams.sum(axis=0))))
        grams /= size * size[:, None]
        # Fit 0 has the model's constants, fits 1, 2, ... have one new constant each.
        fits = self._fits_without_folds(grams, local, moved)
        fits[..., -1] = -1.0  # the torque: (c, -1)^T G (c, -1) is the squared residual
        losses = _quadratic_forms(grams, fits)
        # From the scaled torque to units of the row variance.
        unit = size[-1] ** 2 / self.variance
        gain_of_folds = unit * (losses[0] - losses[1:])
        changes = unit * _quadratic_forms(grams, fits[1:] - fits[0])  # |d|^2
        noise_variance = np.sum((gain_of_folds - changes) ** 2, axis=1)
        white_variance = 4.0 * changes.sum(axis=1)
        noise_variance = np.maximum(noise_variance, white_variance)
        gain[moved] = gain_of_folds.sum(axis=1)
        needed[moved] = student_95(n_folds) * np.sqrt(noise_variance)
        return gain, needed

    def _local_columns(self, estimates: Sequence[ShapeEstimate]) -> _LocalColumns:
        """Linearise the fit around the estimates: return the columns that take part in
        it.

        The columns are: the k directions of the columns without an open constant (bank
        -1); each bank's column at the model's value; and, for a constant that has moved,
        its column at the new value with the derivative by ln u (without it if the value
        lies at an end of its range).
        """
        bank_of = [-1] * self.shown_directions.shape[1]
        is_new = [False] * len(bank_of)
        weights_of = list[Array]()  # (K,) of each further column, on its bank's grid
        for j, (bank, estimate) in enumerate(zip(self.banks, estimates, strict=True)):
            weights = [bank.weights(self.log_model_values[j])[0]]
            if estimate.after != estimate.before:
                value, derivative = bank.weights(float(np.log(estimate.after)))
                weights += [value] if estimate.at_end else [value, derivative]
            weights_of += weights
            bank_of += [j] * len(weights)
            is_new += [False] + [True] * (len(weights) - 1)
        combinations = np.zeros((self.n_bank_columns + 1, len(weights_of) + 1))
        n_others = len(self.shown_directions)  # columns without an open constant
        banks = bank_of[len(bank_of) - len(weights_of) :]
        for k, (j, weights_on_grid) in enumerate(zip(banks, weights_of, strict=True)):
            combinations[self.banks[j].columns - n_others, k] = weights_on_grid
        combinations[-1, -1] = 1.0  # the torque
        return _LocalColumns(combinations, np.array(bank_of), np.array(is_new))

    def _fits_without_folds(
        self, grams: Array, local: _LocalColumns, moved: Sequence[int]
    ) -> Array:
        """Return the least-squares coefficients (1 + len(moved), F, s) of the columns,
        with each of F folds left out; zero for columns that take no part.

        Parameters
        ----------
        grams : (F, s, s) array
            Gram matrices of the folds' rows: s - 1 columns, and the torque last.
        local : _LocalColumns
            Which of these columns belong to which open constant.
        moved : sequence of int
            Numbers of the constants with a new value. The first fit has the model's
            constants, each further one the new value of one of these.
        """
        n_folds, size = grams.shape[:2]
        # Gram matrices of all other folds, with a small ridge.
        training = grams.sum(axis=0) - grams + UNSEEN * np.eye(size)
        fits = np.zeros((len(moved) + 1, n_folds, size))
        for fit, constant in zip(fits, (None, *moved), strict=True):
            used = np.flatnonzero(local.used_for(constant))
            gram = training[:, used[:, None], used]
            fit[:, used] = np.linalg.solve(gram, training[:, used, -1:])[..., 0]
        return fits

    def confirmed_estimates(self) -> list[ShapeEstimate]:
        """Return the estimates, set back to the model's value where held-out data
        refuse them.

        A constant is refused if its gain on folds of the motion that are left out is
        not larger than noise allows. The others are estimated again, until none is
        refused.
        """
        u = self.best_on_grid()
        moves = np.ones(len(self.banks), bool)
        while True:
            u = self.minimised(
                np.where(moves, u, self.log_model_values), np.flatnonzero(moves)
            )
            estimates = self.estimates_at(u)
            gains, needed = self.held_out_gains(estimates)
            refused = moves & ~(gains > needed)
            if not refused.any():
                break
            moves &= ~refused
        return [
            replace(s, gain=gain)
            for s, gain in zip(estimates, gains.tolist(), strict=True)
        ]

    def best_on_grid(self) -> Array:
        """Return (B,) ln u: for each constant in turn, the grid value that explains
        most torque.

        The other constants stay at their last value meanwhile.
        """
        u = self.log_model_values.copy()
        columns, _ = self._columns_at(self.log_model_values)
        for k, (bank, grid_columns) in enumerate(
            zip(self.banks, self.columns_on_grid, strict=True)
        ):
            # Columns (K, r) on the grid, without what the other banks' columns explain.
            U, _ = column_space(np.delete(columns, k, axis=1))
            remaining = grid_columns - (grid_columns @ U) @ U.T
            products = remaining @ self.torque
            if self.is_friction[k]:
                # With a negative coefficient it would push: it explains nothing.
                products = np.maximum(products, 0.0)
            # Squared torque that each grid value explains.
            squared_norms = nonzero_or_one(np.sum(remaining**2, axis=1))
            explained = products**2 / squared_norms
            best = int(np.argmax(explained))
            u[k] = bank.spline.x[best]
            columns[:, k] = grid_columns[best]
        return u

    def minimised(self, start: Array, free: Indices) -> Array:
        """Minimise the squared residual of the torque over some of the constants.

        start (B,) is ln u of all constants; free (f,) are the indices of those that may
        move. Returns (B,) ln u; the others stay at ``start``.
        """
        if not len(free):
            return start

        def residual_and_jacobian(x: Array) -> tuple[Array, Array]:
            u = start.copy()
            u[free] = x
            residual, slopes = self._residual_at(u)
            return residual, slopes[:, free]

        low, high = self.ends[free].T
        residual, _ = self._residual_at(start)
        # A thousandth of the change of the squared error that noise alone causes.
        ftol = 1e-3 * self.variance / float(np.sum(residual**2))
        best, *_ = least_squares(
            residual_and_jacobian,
            start[free],
            ends=(low, high),
            xtol=1e-4,
            ftol=ftol,
            steps=50,
        )
        out = start.copy()
        out[free] = best
        return out

    def estimates_at(self, u: Array) -> list[ShapeEstimate]:
        """Return a ShapeEstimate for each constant at ln u (B,), with its standard
        deviation.

        The deviation of u is u times that of ln u; infinite if the data bound nothing.
        A constant that has not moved keeps the model's value exactly.
        """
        _, jacobian = self._residual_at(u)
        log_stds = np.sqrt(self.variance) * deviations(jacobian)
        return [
            _shape_estimate(
                self.banks[k],
                log_value=float(u[k]),
                log_before=float(self.log_model_values[k]),
                log_std=float(log_stds[k]),
                log_ends=(float(self.ends[k, 0]), float(self.ends[k, 1])),
            )
            for k in range(len(u))
        ]


def _shape_estimate(
    bank: _Bank,
    *,
    log_value: float,
    log_before: float,
    log_std: float,
    log_ends: tuple[float, float],
) -> ShapeEstimate:
    """Return the estimate of a bank's constant u from ln u as it is now and as the model
    has it, the standard deviation of ln u, and the ends of its range."""
    has_moved = log_value != log_before
    # Six digits, as in the text of an effect.
    after = float(f"{np.exp(log_value):.6g}") if has_moved else bank.model_value
    # Wider than a uniform distribution over the range: the data bound nothing.
    uniform_std = (log_ends[1] - log_ends[0]) / np.sqrt(12.0)
    is_at_end = has_moved and at_end(log_value, *log_ends)
    return ShapeEstimate(
        effect=bank.effect.name,
        joint=bank.joint + 1,
        shape=bank.key,
        before=bank.model_value,
        after=after,
        std=after * log_std if log_std < uniform_std else np.inf,
        at_end=bool(is_at_end),
    )


@dataclass(frozen=True)
class _LocalColumns:
    """Combinations of the banks' columns and the torque, in which constants are
    compared."""

    #: (P + 1, d) combinations of the banks' columns and the torque, the torque last.
    combinations: Array
    #: (k + d - 1,) the bank that a column belongs to; -1: none.
    bank_of: Indices
    #: (k + d - 1,) whether a column is at the constant's new value.
    is_new: Mask

    def used_for(self, constant: int | None) -> Mask:
        """Return (k + d - 1,) which columns take part in the fit with one new constant.

        Each constant has a column at the model's value, and columns at the new one if it
        has moved. The new columns of ``constant`` replace its old one; all other
        constants keep the model's value. With None all keep it.
        """
        if constant is None:
            return ~self.is_new
        return np.where(self.bank_of == constant, self.is_new, ~self.is_new)


def _quadratic_forms(grams: Array, coefficients: Array) -> Array:
    """Return (..., F) quadratic forms c^T G c: grams G (F, s, s), coefficients (..., F,
    s).
    """
    products = np.squeeze(grams @ coefficients[..., None], 3)
    return np.sum(products * coefficients, axis=2)


def with_shapes(
    effects: Sequence[Effect], estimates: Sequence[ShapeEstimate]
) -> tuple[Effect, ...]:
    """Return the effects with their estimated shape constants.

    An effect with estimated constants is split into one effect a joint, in the same
    order, so that the parameters keep their indices.

    Parameters
    ----------
    estimates : sequence of ShapeEstimate
        New values of their shape constants.

    Returns
    -------
    tuple of Effect
        Effects with the new constants.
    """
    values = {s.key: s.after for s in estimates}
    with_new_constants = list[Effect]()
    for effect in effects:
        constants_of_joint = {
            joint: {
                key: values[effect.name, joint, key]
                for key in effect.shapes
                if (effect.name, joint, key) in values
            }
            for joint in effect.joints
        }
        if any(constants_of_joint.values()):
            for joint, constants in constants_of_joint.items():
                with_new_constants.append(effect.with_shape([joint], **constants))
        else:
            with_new_constants.append(effect)
    return tuple(with_new_constants)


def constants_at_ends(model: Model) -> list[ConstantKey]:
    """List the shape constants of a model that lie at an end of the range in which a
    search refines them: widths, exponents and times."""
    return [
        (effect.name, joint, name)
        for effect in model.effects
        for joint in effect.joints
        for name, value in effect.shape.items()
        if effect.shapes[name].is_at_end(value, effect.robot.joints[joint].kind)
    ]


def constants_in_words(model: Model, keys: Collection[ConstantKey]) -> list[str]:
    """Say values of some shape constants of a model, such as "v_s = 1 rad/s of Stribeck
    friction on joint 2"; once where several joints share one."""
    lines = []
    for effect in model.effects:
        has_one_constant = effect.whole_robot or effect.joins
        joints = effect.joints[:1] if has_one_constant else effect.joints
        for joint in joints:
            kind = effect.robot.joints[joint].kind
            where = "" if effect.whole_robot else f" on joint {joint + 1}"
            lines += [
                f"{name} = {effect.shapes[name].format_with_unit(value, kind)} of"
                f" {effect_name(effect.name)}{where}"
                for name, value in effect.shape.items()
                if (effect.name, joint, name) in keys
            ]
    return lines


def changed_constants_in_words(before: Model, after: Model) -> list[str]:
    """Say which shape constants two models have differently, a line each.

    Parameters
    ----------
    before, after : Model
        Models of one robot. Effects that only one of them has are left out, and those
        of which a joint may have several.
    """
    shapes_before = {(e.name, j): e.shape for e in before.effects for j in e.joints}
    lines = []
    for effect in after.effects:
        if effect.several:
            continue
        for joint in effect.joints:
            old = shapes_before.get((effect.name, joint), effect.shape)
            kind = effect.robot.joints[joint].kind
            for key, value in effect.shape.items():
                if key not in old or old[key] == value:
                    continue
                change = ShapeEstimate(effect.name, joint + 1, key, old[key], value)
                constant = effect.shapes[key]
                lines.append(changed_constant_in_words(change, constant, kind))
    return lines


def changed_constant_in_words(
    change: ShapeEstimate, constant: ShapeConstant, kind: str
) -> str:
    """Say which value a shape constant has now, and which one it had.

    Parameters
    ----------
    change : ShapeEstimate
        Effect, joint and both values.
    constant : ShapeConstant
        How the constant is written.

    Returns
    -------
    str
        Such as "joint 4: Coulomb friction has v_s = 0.001484 rad/s, not 0.01 rad/s".
    """
    new = constant.format_with_unit(change.after, kind)
    old = constant.format_with_unit(change.before, kind)
    name = effect_name(change.effect)
    return f"joint {change.joint}: {name} has {change.shape} = {new}, not {old}"


def effects_to_estimate_again(
    effects: Sequence[Effect], shapes: Sequence[ShapeEstimate]
) -> list[str]:
    """Return the effects option with which `identify` estimates the same constants
    again.

    An effect of which ``shapes`` estimates the constants is written by its name
    ("coulomb_friction:1+3" for joints 1 and 3 only), so that they are open; any other
    with its constants.

    Returns
    -------
    list of str
        One text an effect, as the option `effects` takes it.
    """
    estimated = {(s.effect, s.joint - 1) for s in shapes}
    joints_by_text = dict[str, list[str]]()
    for effect in effects:
        is_open = all((effect.name, j) in estimated for j in effect.joints)
        text = effect.name if is_open else effect.text
        joints = joints_by_text.setdefault(text, [])
        if is_open:
            joints += [str(j + 1) for j in effect.joints]
    n_joints = effects[0].robot.n if effects else 0
    return [
        f"{text}:{'+'.join(joints)}" if 0 < len(joints) < n_joints else text
        for text, joints in joints_by_text.items()
    ]
