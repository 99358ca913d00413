"""Several shape constants of one model at their joint optimum.

Constants that are found one after the other stop beside the least squared error where one takes what
is the other's: Coulomb friction that turns over a wide velocity and Stribeck friction that falls over a
small one. All of them together minimise what least squares leave (variable projection, as in
:mod:`~sdp_vs_penalty.estimation.shapes`); each is one linear parameter more whose column is
(dY/ds) theta (:mod:`~sdp_vs_penalty.estimation.shape_constants`). Every step is a pass over the data.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from sdp_vs_penalty.effects.effect import Effect
from sdp_vs_penalty.effects.model import Model
from sdp_vs_penalty.estimation.sandwich import white_variance
from sdp_vs_penalty.estimation.shape_constants import (
    free_constants,
    moved,
    prior_deviation,
    with_sensitivities,
)
from sdp_vs_penalty.estimators.task import joint_weights
from sdp_vs_penalty.regression.bounded_least_squares import least_squares
from sdp_vs_penalty.regression.partial import partialled, visible
from sdp_vs_penalty.regression.regression import LeastSquares, Regression
from sdp_vs_penalty.robot.arrays import Array

#: Effect, joint and name of a shape constant.
Key = tuple[str, int, str]


@dataclass(frozen=True)
class Settled:
    """model : with constants at their joint optimum; std : their standard deviations in their own
    scales; error : the squared error that is left."""

    model: Model
    std: dict[Key, float]
    error: float


def settled(
    model: Model,
    wanted: Collection[Key],
    compressed: Callable[[Model], Regression],
    weighting: str = "noise",
) -> Settled:
    """The model with its ``wanted`` constants where they together leave the least squared error, from
    where they are and, of those that only have the values of a grid, from each of these.

    compressed : the measurements in the columns of a model; weighting : of the joints' rows, "noise" or
    "none". Effects with a wanted constant act on one joint each.
    """
    first = compressed(model)
    data = first.least_squares()
    search = _Search(
        model.plausible,
        frozenset(wanted),
        compressed,
        np.ones(model.robot.n),
        max(white_variance(data, first.oversampling), 1e-24 * data.tau_squared / max(data.rows, 1)),
    )
    theta = search.solved(first)[1]
    if weighting == "noise":
        search = replace(search, weights=joint_weights(first, theta))
    return min((search.descended(form, theta) for form in _forms(model, wanted)), key=lambda s: s.error)


def _forms(model: Model, wanted: Collection[Key]) -> Iterator[Model]:
    """The model with every choice of its wanted constants on a grid."""
    grids = {
        (k, key): effect.shapes[key].grid
        for k, effect in enumerate(model.effects)
        for key in free_constants(effect)
        if (effect.name, effect.joints[0], key) in wanted and effect.shapes[key].bounds is None
    }
    for values in product(*grids.values()):
        effects = list(model.effects)
        for (k, key), value in zip(grids, values, strict=True):
            effects[k] = effects[k].with_shape(**{key: value})
        yield replace(model, effects=tuple(effects))


@dataclass(frozen=True)
class _Search:
    """plausible (p,), white : prior of the parameters and its weight, the variance of a row; weights
    (n,) : of the joints' rows."""

    plausible: Array
    wanted: frozenset[Key]
    compressed: Callable[[Model], Regression]
    weights: Array
    white: float

    def open(self, effect: Effect) -> bool:
        return any((effect.name, effect.joints[0], key) in self.wanted for key in free_constants(effect))

    def solved(self, wide: Regression) -> tuple[LeastSquares, Array]:
        """Least squares of all columns, and theta (p,) of the parameters, which come first, alone."""
        p = len(self.plausible)
        data = wide.least_squares(self.weights)
        if np.isfinite(self.plausible).any():
            data = data.with_prior(np.append(self.plausible, np.full(wide.p - p, np.inf)), self.white)
        U, V = visible(data.R[:, :p])
        return data, V @ (U.T @ data.rho)

    def descended(self, model: Model, theta: Array) -> Settled:
        """From one choice of the constants on a grid; theta (p,) : the parameters there."""
        p, effects = len(theta), model.effects
        every = [(k, key) for k, e in enumerate(effects) if self.open(e) for key in free_constants(e)]
        mine = np.array(
            [
                (effects[k].name, effects[k].joints[0], key) in self.wanted
                and effects[k].shapes[key].bounds is not None
                for k, key in every
            ]
        )
        free = [both for both, own in zip(every, mine, strict=True) if own]
        unit = np.array([prior_deviation(effects[k], key) for k, key in free])
        latest, variances = theta, dict[bytes, float]()

        def at(steps: Array) -> Model:
            out = list(effects)
            for (k, key), step in zip(free, steps.tolist(), strict=True):
                out[k] = moved(out[k], {key: step})
            return replace(model, effects=tuple(out))

        def left(steps: Array) -> tuple[Array, Array]:
            nonlocal latest
            wide = self.compressed(with_sensitivities(at(steps), latest, self.open))
            data, latest = self.solved(wide.keeping(np.append(np.ones(p, bool), mine)))
            variances[steps.tobytes()] = white_variance(data, wide.oversampling)
            columns = -partialled(data.R[:, :p], data.R[:, p:]) / unit
            rest = np.append(data.rho - data.R[:, :p] @ latest, data.residual_norm)
            return rest, np.vstack([columns, np.zeros((1, len(free)))])

        start = np.zeros(len(free))
        if not free:
            return Settled(model, {}, float(np.sum(left(start)[0] ** 2)))
        low, high = np.transpose([_room(effects[k], key) for k, key in free])
        best, rest, slopes = least_squares(left, start, (low, high), xtol=1e-6, ftol=1e-9, steps=15)
        spread = np.diagonal(np.linalg.pinv(slopes.T @ slopes, rcond=1e-12))
        std = np.sqrt(variances[best.tobytes()] * spread)
        names = [(effects[k].name, effects[k].joints[0], key) for k, key in free]
        found = replace(model, effects=tuple(map(_written, at(best).effects)))
        return Settled(found, dict(zip(names, std.tolist(), strict=True)), float(rest @ rest))


def _room(effect: Effect, key: str) -> tuple[float, float]:
    """How far a constant may move down and up, in its own scale: within its range; where it is outside
    of that, towards it."""
    shape, value = effect.shapes[key].on(effect.robot.joints[effect.joints[0]].kind), effect.shape[key]
    assert shape.bounds is not None
    ends = np.array([min(shape.bounds[0], value), max(shape.bounds[1], value)])
    low, high = (np.log(ends / value) if shape.scale == "log" else ends - value).tolist()
    return min(low, -1e-9), max(high, 1e-9)


def _written(effect: Effect) -> Effect:
    """With as many digits of its constants as a written effect has."""
    return effect.with_shape(**{key: float(f"{x:.6g}") for key, x in effect.shape.items()})
