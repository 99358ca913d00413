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

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Self

import numpy as np
import scipy
from numpy.typing import NDArray

from sdp_vs_penalty.effects.effect import Block, Effect, Motion, Parameter
from sdp_vs_penalty.effects.model import Model
from sdp_vs_penalty.estimation.constants import AT_END, SHAPE_FOLDS
from sdp_vs_penalty.estimators.estimator import joint_weights
from sdp_vs_penalty.files import JsonRecord
from sdp_vs_penalty.parallel import ALONE, Workers
from sdp_vs_penalty.regression.linalg import (
    UNSEEN,
    column_space,
    deviations,
    least_squares,
    span,
)
from sdp_vs_penalty.regression.regression import Regression, compress_cells, triangular
from sdp_vs_penalty.robot.arrays import Array, nonzero_or_one
from sdp_vs_penalty.signals.filtered import FilteredRuns
from sdp_vs_penalty.signals.phases import PhaseFolds, motion_clocks, tracks_of

#: Which rows take part: of a run's number and instants (N,), (N,) true or false.
Chosen = Callable[[int, Array], NDArray[np.bool_]]
#: An effect, its joint (from 0), and the constant that is open there.
_Open = tuple[Effect, int, str]


@dataclass(frozen=True)
class ShapeEstimate(JsonRecord):
    """A shape constant as estimated: ``before`` is what the model had; std : its
    standard deviation, from the curvature of the squared error; gain : what the change
    takes from that error in motion left out, in units of its variance; at_end : it lies
    at an end of the range that was searched."""

    effect: str
    joint: int
    shape: str
    before: float
    after: float
    std: float = np.inf
    gain: float = 0.0
    at_end: bool = False

    def to_dict(self) -> dict[str, Any]:
        """The record as JSON, with ``joint`` counted from 1.

        A standard deviation that is not finite becomes null: the data do not bound the
        constant on both sides.
        """
        return {**super().to_dict(), "joint": self.joint + 1}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Self:
        """What :meth:`to_dict` wrote."""
        return super().from_dict(
            {
                **data,
                "joint": data["joint"] - 1,
            }
        )


def at_end(u: float, low: float, high: float) -> bool:
    """Whether a constant lies at an end of its range, all in its own scale.

    Parameters
    ----------
    u : float
        The constant.
    low : float
        Where its range begins.
    high : float
        Where it ends.

    Returns
    -------
    bool
        Near either end.
    """
    near = AT_END * (high - low)
    return not low + near < u < high - near


def estimate_shapes(
    model: Model,
    runs: FilteredRuns,
    weighting: str,
    chosen: Chosen | None = None,
    workers: Workers = ALONE,
    widest: float = 0.0,
) -> list[ShapeEstimate]:
    """The open shape constants of a model: each at its best value if that explains
    significantly more than the one the model has, of motion left out as well, else at
    that.

    Parameters
    ----------
    model : Model
        With open constants.
    runs : FilteredRuns
        To estimate them from.
    weighting : {"noise", "none"}
        Of the joints' rows.
    chosen : callable, optional
        The rows that take part; default: all.
    workers : Workers
        Who compresses the runs.
    widest : float
        Up to which value the grids go on beyond their own, each twice the last one.

    Returns
    -------
    list of ShapeEstimate
        One a constant.
    """
    open_constants = _open_constants(model)
    if not open_constants:
        return []
    folds = PhaseFolds(motion_clocks(tracks_of(runs.measurements)), SHAPE_FOLDS)

    def profile_of(model: Model, open_constants: Sequence[_Open]) -> _Profile:
        """One pass over the chosen rows, in blocks by folds of the motion."""
        wide, base, banks = _with_banks(model, open_constants, widest)
        cells = compress_cells(runs, wide, _Cells(folds, chosen), workers)
        blocks = {f.block for f in cells.factors if f.block < SHAPE_FOLDS}
        return _Profile(cells.select(sorted(blocks)), weighting, base, banks)

    model = model.reference_free
    estimates = profile_of(model, open_constants).confirmed()
    # Splines in the grid are good to a per cent: what the data tell more finely is found
    # once more, about itself, where they are exact.
    fine = {
        (s.effect, s.joint, s.shape)
        for s in estimates
        if s.after != s.before and not s.at_end and s.std < 0.01 * s.after
    }
    if not fine:
        return estimates
    near = replace(model, effects=with_shapes(model.effects, estimates))
    again = [
        (effect, joint, key)
        for effect in near.effects
        for joint in effect.joints
        for key in effect.estimated
        if (effect.name, joint, key) in fine
    ]
    profile = profile_of(near, again)
    best = profile.best(profile.now, np.arange(len(again)))
    refined = {(s.effect, s.joint, s.shape): s.after for s in profile.estimates(best)}
    return [
        replace(s, after=refined.get((s.effect, s.joint, s.shape), s.after))
        for s in estimates
    ]


def _open_constants(model: Model) -> list[_Open]:
    """Of effects with one column a joint the constants that are estimated, and not
    given."""
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
        return [(0, 0.0, 0.0)] * (self.folds.count + 1)

    def cell(
        self,
        run: int,
        t: Array,
    ) -> NDArray[np.intp]:
        fold = self.folds.fold(run, t)
        return (
            fold
            if self.chosen is None
            else np.where(self.chosen(run, t), fold, self.folds.count)
        )


@dataclass(frozen=True)
class _Bank:
    """One shape constant of one effect on one joint: the value that the model has, the
    spline through the unit vectors at ln u of the values (K,) whose columns are known
    (the first and the last are the range), where these (K,) stand among all others."""

    effect: Effect
    joint: int
    key: str
    now: float
    spline: Any
    columns: NDArray[np.intp]

    def weights(self, u: float) -> Array:
        """(2, K) of each value's columns in those at ln u, and in their derivatives."""
        k = int(
            np.searchsorted(
                self.spline.x[1:-1],
                u,
                "right",
            )
        )
        d = u - self.spline.x[k]  # ten times as fast as asking the spline for one value
        powers = np.array(
            [
                [d**3, d**2, d, 1.0],
                [3.0 * d**2, 2.0 * d, 1.0, 0.0],
            ]
        )
        return np.asarray(powers @ self.spline.c[:, k])


def _with_banks(
    model: Model,
    open_constants: Sequence[_Open],
    widest: float,
) -> tuple[Model, NDArray[np.intp], list[_Bank]]:
    """The model with the columns of each open constant at all values of its grid; where
    all other columns stand; the grids."""

    open_effects = [effect for effect, _, _ in open_constants]
    fixed = [
        e for e in model.effects if not any(e is effect for effect in open_effects)
    ]
    first = sum(len(e.parameters) for e in fixed)
    base = np.arange(first)
    banks = list[_Bank]()
    parts = list[_Grid]()
    splines = dict[tuple[float, ...], Any]()
    for effect, joint, key in open_constants:
        now = effect.shape[key]
        grid = _grid_with(effect, joint, key, now, widest)
        parts.append(
            _Grid([effect.with_shape([joint], **{key: value}) for value in grid])
        )
        columns = first + np.arange(len(grid))
        first += len(grid)
        if grid not in splines:
            splines[grid] = scipy.interpolate.CubicSpline(
                np.log(grid), np.eye(len(grid))
            )
        banks.append(
            _Bank(
                effect.with_shape([joint]),
                joint,
                key,
                now,
                splines[grid],
                columns,
            )
        )
    effects = (*fixed, *parts)
    wide = Model(
        model.robot,
        effects,
        gains=model.gains,
        known=model.known,
    )
    return wide, base, banks


def _grid_with(
    effect: Effect,
    joint: int,
    key: str,
    now: float,
    widest: float,
) -> tuple[float, ...]:
    """The values of a constant's grid, doubled up to ``widest``. Within it the value
    ``now`` takes the place of those within a tenth: columns are exact there as well."""
    grid = effect.shapes[key].on(effect.robot.joints[joint].kind).grid
    while grid[-1] < widest:
        grid = (*grid, 2.0 * grid[-1])
    ends = (grid[0], grid[-1])
    if not ends[0] <= now <= ends[-1]:
        return grid
    others = {g for g in grid if g in ends or abs(np.log(g / now)) > 0.1}
    return tuple(sorted({now, *others}))


class _Grid(Effect):
    """An effect on one joint with several values of one shape constant, as columns of a
    regression."""

    name = "shape_grid"
    equation = explanation = reference = ""

    def __init__(self, effects: Sequence[Effect]) -> None:
        super().__init__(effects[0].robot, effects[0].joints)
        self.effects = effects

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:  # type: ignore[override]
        (parameter,) = self.effects[0].parameters
        return tuple(
            replace(parameter, name=f"{parameter.name}_{m}")
            for m in range(len(self.effects))
        )

    def blocks(self, motion: Motion) -> list[Block]:
        blocks_of_values = (
            (m, b)
            for m, effect in enumerate(self.effects)
            for b in effect.blocks(motion)
        )
        return [
            Block(
                b.joint,
                b.parameters + m,
                b.columns,
            )
            for m, b in blocks_of_values
        ]


class _Profile:
    """What least squares in all other columns leave of the banks' ``count`` and of the
    torque (r,).

    parts : of each bank its columns at all values (K, r); now, ends (B,), (B, 2) : ln u
    as the model has them, or the nearest that is known, and of their ranges; brakes
    (B,) : whose coefficients are not negative; shown (b, k) : what the data show of the
    other columns' coefficients, at unit norm of what they make; variance : of a row
    times how often rows repeat each other.
    """

    def __init__(
        self,
        folds: Regression,
        weighting: str,
        base: NDArray[np.intp],
        banks: list[_Bank],
    ) -> None:
        """Of all blocks; base : where the other columns stand, before the banks'."""
        self.folds = folds
        self.banks = banks
        data = folds.least_squares()
        self.weights = np.ones(folds.joints)
        if weighting == "noise":
            fit = scipy.linalg.lstsq(
                data.R,
                data.rho,
                1e-10,
                lapack_driver="gelsy",
            )
            self.weights = joint_weights(folds, fit[0])
            data = folds.least_squares(self.weights)
        both = np.column_stack(
            [
                data.R[:, len(base) :],
                data.rho,
            ]
        )
        shown, self.shown = column_space(data.R[:, base])
        left = triangular([both - shown @ (shown.T @ both)])
        self.torque = left[:, -1]
        self.count = left.shape[1] - 1
        U = span(left[:, :-1])
        residual = self.torque - U @ (U.T @ self.torque)
        error = float(np.sum(residual**2)) + data.residual_norm**2
        # Exact data have no variance; their constants still have a best value.
        error = max(error, 1e-12 * data.tau_squared) or 1.0
        n_columns = U.shape[1] + shown.shape[1]
        free = max(data.rows - folds.oversampling * n_columns, 1.0)
        self.variance = folds.oversampling * error / free
        self.parts = [
            np.ascontiguousarray(left.T[b.columns - len(base)]) for b in banks
        ]
        self.ends = np.array([b.spline.x[[0, -1]] for b in banks])
        self.now = np.clip(np.log([b.now for b in banks]), *self.ends.T)
        self.brakes = np.array([b.effect.parameters[0].lower == 0.0 for b in banks])

    def _made(self, u: Array) -> tuple[Array, Array]:
        """The columns (r, B) at constants ln u (B,), and their derivatives."""
        made = [
            bank.weights(x) @ part
            for bank, part, x in zip(self.banks, self.parts, u.tolist(), strict=True)
        ]
        values, derivatives = np.array(made).transpose(1, 2, 0)
        return values, derivatives

    def at(self, u: Array) -> tuple[Array, Array]:
        """What is left of the torque (r,) at constants ln u (B,), and its slopes (r,
        B); a column that would push instead of brake is left out."""
        columns, derivatives = self._made(u)
        theta = np.zeros(len(u))
        used = np.ones(len(u), bool)
        pushes = used
        while pushes.any():
            U, V = column_space(columns[:, used])
            theta[used] = V @ (U.T @ self.torque)
            theta[~used] = 0.0
            pushes = self.brakes & (theta < 0.0)
            used = used & ~pushes
        slopes = derivatives * theta
        left = self.torque - U @ (U.T @ self.torque)
        return left, U @ (U.T @ slopes) - slopes

    def _products(self, T: Array) -> Array:
        """(F, k + d, k + d) in each fold of what all other columns make in the
        directions that data show, and of combinations T (P + 1, d) of the banks'
        columns and the torque."""
        n_others, n_shown = self.shown.shape
        size = n_shown + T.shape[1]
        out = np.zeros((len(self.folds.blocks), size, size))
        for joint, indices, blocks, rows in self.folds.by_joint():
            first = int(np.sum(indices < n_others))  # the others come first
            products = rows[..., :first] @ self.shown[indices[:first]]
            of_bank = np.append(indices[first:] - n_others, self.count)
            combined = rows[..., first:] @ T[of_bank]
            both = self.weights[joint] * np.concatenate([products, combined], axis=2)
            out[blocks] += both.swapaxes(1, 2) @ both
        return out

    def held_out(self, estimates: Sequence[ShapeEstimate]) -> tuple[Array, Array]:
        """(B,) what each constant alone takes from the squared error of the folds that
        are left out, in variances, and what noise would."""
        moved = [k for k, s in enumerate(estimates) if s.after != s.before]
        n_folds = len(self.folds.blocks)
        taken = np.zeros(len(estimates))
        needed = np.zeros(len(estimates))
        if not moved or n_folds < 2:
            return taken, needed
        local = self._local_columns(estimates)
        grams = self._products(local.combinations)
        size = nonzero_or_one(np.sqrt(np.diagonal(grams.sum(axis=0))))
        grams /= size * size[:, None]
        fits = self._fits_to_others(grams, local, moved)
        fits[..., -1] = -1.0
        losses = _quadratic(grams, fits)
        scale = size[-1] ** 2 / self.variance
        gains = scale * (losses[0] - losses[1:])
        changes = scale * _quadratic(grams, fits[1:] - fits[0])
        noise = np.sum((gains - changes) ** 2, axis=1)
        noise = np.maximum(noise, 4.0 * changes.sum(axis=1))
        taken[moved] = gains.sum(axis=1)
        needed[moved] = scipy.special.stdtrit(n_folds - 1, 0.975) * np.sqrt(noise)
        return taken, needed

    def _local_columns(self, estimates: Sequence[ShapeEstimate]) -> _LocalColumns:
        """Columns in which a fit near the estimates is linear: all others, each bank's
        at the value that the model has, and, of a constant that moves, those at its new
        value and, within its range, their derivative."""
        n_shown = self.shown.shape[1]
        bank_of = [-1] * n_shown
        is_new = [False] * n_shown
        weights = list[Array]()
        for j, (bank, estimate) in enumerate(zip(self.banks, estimates, strict=True)):
            weights.append(bank.weights(self.now[j])[0])
            bank_of.append(j)
            is_new.append(False)
            if estimate.after != estimate.before:
                new = bank.weights(float(np.log(estimate.after)))
                new = new[:1] if estimate.at_end else new
                weights += [*new]
                bank_of += [j] * len(new)
                is_new += [True] * len(new)
        combinations = np.zeros((self.count + 1, len(weights) + 1))
        for column, values, j in zip(
            combinations.T,
            weights,
            bank_of[n_shown:],
            strict=False,
        ):
            column[self.banks[j].columns - len(self.shown)] = values
        combinations[-1, -1] = 1.0  # the torque
        return _LocalColumns(combinations, np.array(bank_of), np.array(is_new))

    def _fits_to_others(
        self,
        grams: Array,
        local: _LocalColumns,
        moved: Sequence[int],
    ) -> Array:
        """(1 + len(moved), F, k + d) coefficients that are best in all folds but one:
        with the model's constants, then with each new one alone."""
        n_folds, size = grams.shape[:2]
        others = grams.sum(axis=0) - grams + UNSEEN * np.eye(size)
        fits = np.zeros((len(moved) + 1, n_folds, size))
        for fit, bank in zip(fits, (None, *moved), strict=True):
            used = np.flatnonzero(local.used_for(bank))
            gram = others[:, used[:, None], used]
            fit[:, used] = np.linalg.solve(gram, others[:, used, -1:])[..., 0]
        return fits

    def confirmed(self) -> list[ShapeEstimate]:
        """The constants that together explain most, of those that folds that are left
        out confirm."""
        u = self.from_grid()
        moves = np.ones(len(self.banks), bool)
        refused = np.ones(1, bool)
        while refused.any():
            u = self.best(np.where(moves, u, self.now), np.flatnonzero(moves))
            estimates = self.estimates(u)
            gains, needed = self.held_out(estimates)
            refused = moves & ~(gains > needed)
            moves = moves & ~refused
        return [
            replace(s, gain=gain)
            for s, gain in zip(estimates, gains.tolist(), strict=True)
        ]

    def from_grid(self) -> Array:
        """(B,) ln u, each in turn at the value of its grid that leaves least."""
        u = self.now.copy()
        columns = self._made(self.now)[0]
        for k, (bank, part) in enumerate(zip(self.banks, self.parts, strict=True)):
            U = column_space(np.delete(columns, k, axis=1))[0]
            left = part - (part @ U) @ U.T
            products = left @ self.torque
            products = np.maximum(products, 0.0) if self.brakes[k] else products
            best = int(np.argmax(products**2 / nonzero_or_one(np.sum(left**2, axis=1))))
            u[k] = bank.spline.x[best]
            columns[:, k] = part[best]
        return u

    def best(
        self,
        start: Array,
        free: NDArray[np.intp],
    ) -> Array:
        """(B,) ln u with the least squared error, of which only those of the ``free``
        banks move."""
        if not len(free):
            return start

        def at(x: Array) -> tuple[Array, Array]:
            u = start.copy()
            u[free] = x
            left, slopes = self.at(u)
            return left, slopes[:, free]

        low, high = self.ends[free].T
        left, _ = self.at(start)
        ftol = 1e-3 * self.variance / float(np.sum(left**2))  # of what noise decides
        best, *_ = least_squares(
            at,
            start[free],
            (low, high),
            1e-4,
            ftol,
            steps=50,
        )
        out = start.copy()
        out[free] = best
        return out

    def estimates(self, u: Array) -> list[ShapeEstimate]:
        """What constants ln u (B,) are."""
        stds = np.sqrt(self.variance) * deviations(self.at(u)[1])
        out = []
        columns = zip(
            self.banks,
            u.tolist(),
            self.now,
            stds.tolist(),
            self.ends.tolist(),
            strict=True,
        )
        for bank, x, now, std, (low, high) in columns:
            # As many digits as a written effect has; a spread wider than the range
            # bounds nothing.
            after = bank.now if x == now else float(f"{np.exp(x):.6g}")
            std = after * std if std < (high - low) / np.sqrt(12.0) else np.inf
            end = x != now and at_end(x, low, high)
            out.append(
                ShapeEstimate(
                    effect=bank.effect.name,
                    joint=bank.joint,
                    shape=bank.key,
                    before=bank.now,
                    after=after,
                    std=std,
                    at_end=bool(end),
                )
            )
        return out


@dataclass(frozen=True)
class _LocalColumns:
    """combinations (P + 1, d) of the banks' columns and the torque, the torque last;
    bank_of (k + d - 1,) : whose a column is (-1: of no bank); is_new : whether it is at
    the constant's new value."""

    combinations: Array
    bank_of: NDArray[np.intp]
    is_new: NDArray[np.bool_]

    def used_for(self, bank: int | None) -> NDArray[np.bool_]:
        """The columns of a fit in which only this bank's constant is new."""
        of_bank = np.equal(self.bank_of, -2 if bank is None else bank)
        return np.where(of_bank, self.is_new, ~self.is_new)


def _quadratic(grams: Array, coefficients: Array) -> Array:
    """(..., F) c^T G c in each fold, of grams (F, s, s) and coefficients (..., F, s)."""
    products = np.squeeze(grams @ coefficients[..., None], 3)
    return np.asarray(np.sum(products * coefficients, axis=2))


def with_shapes(
    effects: Sequence[Effect], estimates: Sequence[ShapeEstimate]
) -> tuple[Effect, ...]:
    """The effects with estimated constants.

    Those that were estimated stand alone, a joint each, in the same order, so that the
    parameters keep their places.

    Parameters
    ----------
    effects : sequence of Effect
        A model's.
    estimates : sequence of ShapeEstimate
        Of their constants.

    Returns
    -------
    tuple of Effect
        With the new constants.
    """
    values = {(s.effect, s.joint, s.shape): s.after for s in estimates}
    out: list[Effect] = []
    for effect in effects:
        keys = [
            (j, k)
            for j in effect.joints
            for k in effect.shapes
            if (effect.name, j, k) in values
        ]
        if not keys:
            out.append(effect)
            continue
        for joint in effect.joints:
            constants = {k: values[effect.name, j, k] for j, k in keys if j == joint}
            out.append(effect.with_shape([joint], **constants))
    return tuple(out)


def asked_effects(
    effects: Sequence[Effect], shapes: Sequence[Mapping[str, Any]]
) -> list[str]:
    """How effects are written so that `identify` estimates again what it has estimated.

    Parameters
    ----------
    effects : sequence of Effect
        A model's.
    shapes : sequence of mapping
        As an estimate's details hold them.

    Returns
    -------
    list of str
        In words.
    """
    estimated = {(s["effect"], s["joint"] - 1) for s in shapes}
    requested = dict[str, list[str]]()
    for e in effects:
        open_ = all((e.name, j) in estimated for j in e.joints)
        requested.setdefault(e.name if open_ else e.text, []).extend(
            str(j + 1) for j in e.joints if open_
        )
    n_joints = effects[0].robot.n if effects else 0
    return [
        f"{x}:{'+'.join(joints_asked)}" if 0 < len(joints_asked) < n_joints else x
        for x, joints_asked in requested.items()
    ]
