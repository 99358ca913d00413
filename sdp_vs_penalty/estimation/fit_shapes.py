"""The open shape constants of a model, estimated from measurements.

First their profiles on a grid of values (:mod:`~sdp_vs_penalty.estimation.shape_profiles`), whose
columns between the grid's values are interpolated. A constant then moves only if motion that was left
out confirms it (:mod:`~sdp_vs_penalty.estimation.shape_folds`). Where the measurements tell a constant
more finely than the grid, Gauss-Newton steps with columns at the value itself follow: a constant that
exact data have is then found exactly.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.effects.effect import Block, Effect, Motion, Parameter
from sdp_vs_penalty.effects.model import Model
from sdp_vs_penalty.estimation.normal_equations import Normal
from sdp_vs_penalty.estimation.shape_folds import FOLDS, confirmed_shapes
from sdp_vs_penalty.estimation.shape_profiles import ShapeBank, ShapeEstimate, alone
from sdp_vs_penalty.parallel import ALONE, Workers
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.phases import PhaseFolds, motion_clocks, tracks_of
from sdp_vs_penalty.signals.preprocessing import Preprocessing, filtered_rows, rows_per_sample

#: Which rows take part: of a run's number and instants (N,), (N,) true or false.
Chosen = Callable[[int, Array], NDArray[np.bool_]]

#: Of one joint the places of k columns, of the torque behind them, and the products (F, k + 1, k + 1) of
#: all, fold by fold.
_Products = tuple[NDArray[np.intp], Array]

#: A constant whose relative standard deviation is below this is refined: interpolation in the grid is
#: about as good.
_INTERPOLATED = 0.01
#: Passes over the measurements in which constants are refined, and the relative change, beside their
#: standard deviation, at which they have arrived.
_STEPS, _ARRIVED = 8, 0.05
#: Half the distance of the values, in ln u, from which a slope is taken.
_SLOPE = 1e-3
#: Refining corrects interpolation: it goes no farther than this, in ln u.
_FARTHEST = 0.1
#: Values of the grid nearer than this to the model's own, in ln u, give way to it.
_APART = 0.1


def estimate_shapes(
    model: Model,
    measurements: Measurements,
    settings: Preprocessing,
    weighting: str,
    chosen: Chosen | None = None,
    workers: Workers = ALONE,
) -> list[ShapeEstimate]:
    """The open shape constants of a model, each at its best value if that explains significantly more
    than the one the model has, of motion left out as well, else at that; from the chosen rows."""
    wanted = open_shapes(model.effects)
    if not wanted:
        return []
    ranges = [effect.shapes[key].on(effect.robot.joints[j].kind).grid for effect, j, key in wanted]
    ends = [(grid[0], grid[-1]) for grid in ranges]
    grids = [_with(effect.shape[key], g) for (effect, _, key), g in zip(wanted, ranges, strict=True)]
    rows = _OpenColumns(model, wanted, ends, measurements, settings, chosen, workers)
    profile = rows.at(grids, weighting, FOLDS)
    found = confirmed_shapes(profile.folds, profile.base, profile.banks, profile.variance)
    return _refined(rows, found, weighting)


def _with(value: float, grid: Sequence[float]) -> Array:
    """The grid with one more value, where the columns are then exact as well."""
    if not grid[0] <= value <= grid[-1]:
        return np.array(grid)
    kept = [g for g in grid if g in (grid[0], grid[-1]) or abs(np.log(g / value)) > _APART]
    return np.array(sorted({*kept, value}))


def _refined(rows: _OpenColumns, found: list[ShapeEstimate], weighting: str) -> list[ShapeEstimate]:
    """Gauss-Newton steps of the constants that have moved and are told more finely than a grid's."""
    free = [
        k
        for k, s in enumerate(found)
        if s.after != s.before and not s.at_end and s.std < _INTERPOLATED * s.after
    ]
    values = np.array([s.after for s in found])
    low, high = np.array(rows.ends).T
    low, high = (
        np.maximum(low, values * np.exp(-_FARTHEST)),
        np.minimum(high, values * np.exp(_FARTHEST)),
    )
    std = np.array([s.std / s.after for s in found])
    for _ in range(_STEPS if free else 0):
        near = [v * np.exp([-_SLOPE, 0.0, _SLOPE]) if k in free else [v] for k, v in enumerate(values)]
        step = np.zeros(len(values))
        step[free] = _gauss_newton(rows.at(near, weighting), free)
        values = np.clip(values * np.exp(step), low, high)
        if np.all(np.abs(step[free]) < _ARRIVED * std[free]):
            break
    # As many digits as a written effect has.
    return [replace(s, after=float(f"{values[k]:.6g}")) if k in free else s for k, s in enumerate(found)]


def _gauss_newton(rows: _Profile, free: Sequence[int]) -> Array:
    """The step of ln u of the free constants, whose banks hold a value below, the value, one above."""
    middle = [bank.columns[len(bank.columns) // 2] for bank in rows.banks]
    linear = np.concatenate([rows.base, *middle])
    coefficients = np.zeros(len(rows.data.right))
    coefficients[linear] = rows.data.part(linear).solved()[0]
    slopes = np.zeros((len(coefficients), len(free)))
    for m, k in enumerate(free):
        below, _, above = rows.banks[k].columns
        theta = coefficients[middle[k]] / (2.0 * _SLOPE)
        slopes[below, m], slopes[above, m] = -theta, theta
    columns = np.hstack([np.eye(len(coefficients))[:, linear], slopes])
    left = rows.data.right - rows.data.gram @ coefficients
    steps = Normal(columns.T @ rows.data.gram @ columns, columns.T @ left, 0.0).solved()[0]
    return steps[len(linear) :]


def open_shapes(effects: Sequence[Effect]) -> list[tuple[Effect, int, str]]:
    """The constants that `identify` estimates: of their kind and not given, joint by joint."""
    return [
        (effect, joint, key)
        for effect in effects
        for key, shape in effect.shapes.items()
        if shape.role == "estimated" and key not in effect.given
        for joint in effect.joints
    ]


@dataclass(frozen=True)
class _Profile:
    """Normal equations (F, ...) of a model with several values of each constant, fold by fold of the
    motion; base : all other columns; variance : of one independent row, times how often rows repeat."""

    folds: Normal
    base: NDArray[np.intp]
    banks: list[ShapeBank]
    variance: float

    @cached_property
    def data(self) -> Normal:
        """Of all folds."""
        return self.folds.total()


@dataclass(frozen=True)
class _OpenColumns:
    """Measurements in the columns of a model, at any values of its open constants."""

    model: Model
    wanted: list[tuple[Effect, int, str]]
    ends: list[tuple[float, float]]
    measurements: Measurements
    settings: Preprocessing
    chosen: Chosen | None
    workers: Workers

    def at(self, values: Sequence[Sequence[float] | Array], weighting: str, folds: int = 1) -> _Profile:
        """From one pass over the measurements."""
        effects, own = self.model.reference_free.effects, [effect for effect, _, _ in self.wanted]
        fixed = [e for e in effects if not any(e is effect for effect in own)]
        first = sum(len(e.parameters) for e in fixed)
        base, banks, parts = np.arange(first), [], []
        for (effect, joint, key), tried, ends in zip(self.wanted, values, self.ends, strict=True):
            part = _Bank([alone(effect, joint, **{key: float(value)}) for value in tried])
            columns = first + np.arange(len(part.parameters)).reshape(len(tried), -1)
            first += len(part.parameters)
            one, grid, now = alone(effect, joint), np.array(tried, float), effect.shape[key]
            banks.append(ShapeBank(one, joint, key, grid, now, columns, ends))
            parts.append(part)
        bigger = Model(
            self.model.robot, (*fixed, *parts), gains=self.model.gains, known=self.model.known
        )
        products, count, oversampling = self._products(bigger, folds)
        n, p = self.model.robot.n, len(bigger.parameters)
        weights = np.ones(n)
        if weighting == "noise":
            joints = [(places, own.sum(axis=0, keepdims=True)) for places, own in products]
            theta = np.append(_normal(p, joints, weights).total().solved()[0], 0.0)
            for j, (places, own) in enumerate(joints):
                data = Normal.extended(own[0])
                left = max(data.left(theta[places[:-1]]), 1e-12 * data.square)
                weights[j] = count / left if left > 0.0 else 1.0
        profile = _Profile(_normal(p, products, weights), base, banks, 0.0)
        theta, rank = profile.data.solved()
        # Exact data have no variance; their constants still have a best value.
        error = max(profile.data.left(theta), 1e-12 * profile.data.square, 1e-300)
        free = max(n * count - oversampling * rank, 1.0)
        return replace(profile, variance=oversampling * error / free)

    def _products(self, model: Model, folds: int) -> tuple[list[_Products], int, float]:
        """Products by joint of each fold that has rows, how many rows a joint has, and how often rows
        repeat each other."""
        clocks = motion_clocks(tracks_of(self.measurements)) if folds > 1 else ()
        split = PhaseFolds(clocks, folds)
        one = partial(
            _products_of_run, model=model, settings=self.settings, split=split, chosen=self.chosen
        )
        runs = self.workers.map(one, list(enumerate(self.measurements.runs())))
        found: list[_Products] = []
        counts, samples = np.zeros(split.count, np.intp), 0.0
        # In the order of the runs, whoever was first: the same sums to the last bit.
        for own, rows, independent in runs:
            counts, samples = counts + rows, samples + independent
            found = _added(found, own)
        seen = counts > 0
        return [(k, own[seen]) for k, own in found], int(counts.sum()), counts.sum() / samples


def _products_of_run(
    numbered: tuple[int, Measurements],
    model: Model,
    settings: Preprocessing,
    split: PhaseFolds,
    chosen: Chosen | None,
) -> tuple[list[_Products], NDArray[np.intp], float]:
    """Of one run the products by joint, the rows of each fold, and how many independent ones all are."""
    index, run = numbered
    found: list[_Products] = []
    counts = np.zeros(split.count, np.intp)
    for rows in filtered_rows(run, model, settings):
        t = rows.motion.t
        fold = split.fold(index, t) if split.clocks else np.zeros(len(t), int)
        mine = np.arange(len(t)) if chosen is None else np.flatnonzero(chosen(index, t))
        mine = mine[np.argsort(fold[mine], kind="stable")]
        ends = np.searchsorted(fold[mine], np.arange(split.count + 1))
        counts += np.diff(ends)
        here: list[_Products] = []
        for j, block in enumerate(rows.columns):
            both = np.column_stack([block.columns, rows.torque[:, j]])[mine]
            own = np.stack([both[a:b].T @ both[a:b] for a, b in pairwise(ends)])
            here.append((np.append(block.indices, len(model.parameters)), own))
        found = _added(found, here)
    return found, counts, counts.sum() / rows_per_sample(run, settings)


def _added(a: list[_Products], b: list[_Products]) -> list[_Products]:
    """The products of both's rows."""
    return [(k, x + y) for (k, x), (_, y) in zip(a, b, strict=True)] if a and b else a or b


class _Bank(Effect):
    """An effect on one joint with several values of one shape constant, as columns of a regression."""

    name = "shape_bank"
    equation = explanation = reference = ""

    def __init__(self, effects: Sequence[Effect]) -> None:
        super().__init__(effects[0].robot, effects[0].joints)
        self.effects = effects

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:  # type: ignore[override]
        return tuple(
            Parameter(f"{p.name}_{m}", p.unit, self.name, p.joint)
            for m, effect in enumerate(self.effects)
            for p in effect.parameters
        )

    def blocks(self, motion: Motion) -> list[Block]:
        out, first = [], 0
        for effect in self.effects:
            out += [Block(b.joint, b.parameters + first, b.columns) for b in effect.blocks(motion)]
            first += len(effect.parameters)
        return out


def _normal(p: int, joints: Sequence[_Products], weights: Array) -> Normal:
    """Normal equations (F, ...) in all p columns of several joints' products, each weighted."""
    whole = np.zeros((len(joints[0][1]), p + 1, p + 1))
    for (places, own), weight in zip(joints, weights, strict=True):
        whole[:, places[:, None], places] += weight * own
    return Normal.extended(whole)
