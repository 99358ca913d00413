"""Several shape constants of one model at their joint optimum.

Constants that are found in turns stop beside the least squared error where one takes what is the
other's: Coulomb friction that turns over a wide velocity and Stribeck friction that falls over a small
one. Gauss-Newton steps of all of them together, each one linear parameter more whose column is
(dY/ds) theta (:mod:`~sdp_vs_penalty.estimation.shape_constants`), end at the optimum; a step that does
not lower the error is halved (Bjorck, Numerical Methods for Least Squares Problems, 1996, sec. 9.2).
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.effects.effect import Effect
from sdp_vs_penalty.effects.model import Model
from sdp_vs_penalty.estimation.sandwich import visible_directions, white_variance
from sdp_vs_penalty.estimation.shape_constants import (
    free_constants,
    moved,
    prior_deviation,
    with_sensitivities,
)
from sdp_vs_penalty.estimators.task import joint_weights
from sdp_vs_penalty.regression.regression import Regression, compress
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.preprocessing import Preprocessing

#: Effect, joint and name of a shape constant.
Key = tuple[str, int, str]

#: Passes over the measurements.
_PASSES = 10
#: The farthest that a step goes, in a constant's own scale, and how often one is halved.
_FARTHEST, _HALVED = 0.5, 3
#: Of one row's variance: what a step has to promise to be worth its pass.
_WORTH = 0.01


@dataclass(frozen=True)
class Settled:
    """model : with constants at their joint optimum; std : their standard deviations in their own
    scales; error : the squared error that is left."""

    model: Model
    std: dict[Key, float]
    error: float


def settled(
    model: Model,
    theta: Array,
    wanted: Collection[Key],
    measurements: Measurements,
    settings: Preprocessing,
    weighting: str = "noise",
) -> Settled:
    """The model with its ``wanted`` constants where they together leave the least squared error, from
    where they are and, of those that only have the values of a grid, from each of these.

    theta (p,) : the model's parameters. Effects with a wanted constant act on one joint each.
    """
    weights = np.ones(model.robot.n)
    if weighting == "noise":
        weights = joint_weights(compress(measurements, model, settings), theta)
    args = theta, wanted, measurements, settings, weights
    return min((_descended(form, *args) for form in _forms(model, wanted)), key=lambda s: s.error)


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


def _descended(
    model: Model,
    theta: Array,
    wanted: Collection[Key],
    measurements: Measurements,
    settings: Preprocessing,
    weights: Array,
) -> Settled:
    """From one choice; weights (n,) : of the joints' rows."""

    def open_one(effect: Effect) -> bool:
        return any((effect.name, effect.joints[0], key) in wanted for key in free_constants(effect))

    keys = [(e, key) for e in model.effects if open_one(e) for key in free_constants(e)]
    mine = np.array(
        [(e.name, e.joints[0], k) in wanted and e.shapes[k].bounds is not None for e, k in keys]
    )
    unit = np.array([prior_deviation(e, key) for e, key in keys])
    p, step, least = len(theta), np.zeros(len(keys)), np.inf
    kept, own = np.append(np.ones(p, bool), mine), np.arange(p + mine.sum()) < p
    best, std, halved = model, np.zeros(0), 0
    for _ in range(_PASSES):
        trial = _stepped(best, open_one, step)
        wide = compress(measurements, with_sensitivities(trial, theta, open_one), settings).keeping(kept)
        error = _solved(wide.keeping(own), weights, model).error
        if error > least:
            step, halved = 0.5 * step, halved + 1
            if halved == _HALVED:
                break
            continue
        both = _solved(wide, weights, model)
        best, least, halved = trial, error, 0
        theta, std = both.theta[:p], unit[mine] * both.std[p:]
        if error - both.error < _WORTH * both.variance:
            break
        step[mine] = np.clip(unit[mine] * both.theta[p:], -_FARTHEST, _FARTHEST)
    found = [(e.name, e.joints[0], key) for (e, key), one in zip(keys, mine, strict=True) if one]
    return Settled(best, dict(zip(found, std.tolist(), strict=True)), least)


@dataclass(frozen=True)
class _Solution:
    """theta, std (p + s,) : parameters and constants in units of their prior, and their standard
    deviations in white noise; error : what they leave, of which ``variance`` is an independent row's."""

    theta: Array
    std: Array
    error: float
    variance: float


def _solved(data: Regression, weights: Array, model: Model) -> _Solution:
    """Least squares of a model's parameters, and of constants that its columns are followed by."""
    whole = data.least_squares(weights)
    scale = np.append(model.plausible, np.ones(data.p - len(model.parameters)))
    white = white_variance(whole, data.oversampling)
    if np.isfinite(scale).any():
        whole = whole.with_prior(scale, max(white, 1e-24 * whole.tau_squared / max(whole.rows, 1)))
    V = visible_directions(whole)
    theta = V @ (V.T @ (whole.R.T @ whole.rho))
    return _Solution(theta, np.sqrt(white) * np.linalg.norm(V, axis=1), whole.loss(theta), white)


def _stepped(model: Model, wanted: Callable[[Effect], bool], step: Array) -> Model:
    """The model with all free constants of the effects that are wanted moved, within their ranges."""
    steps, effects = iter(step.tolist()), list[Effect]()
    for effect in model.effects:
        keys = free_constants(effect) if wanted(effect) else ()
        own = {key: x for key in keys if (x := next(steps)) != 0.0}
        effects.append(_within(effect, moved(effect, own)) if own else effect)
    return replace(model, effects=tuple(effects))


def _within(old: Effect, new: Effect) -> Effect:
    """The new effect, its constants in their ranges, or no farther outside than the old one's."""
    shape = dict(new.shape)
    for key, value in old.shape.items():
        bounds = old.shapes[key].on(old.robot.joints[old.joints[0]].kind).bounds or (value, value)
        inside = np.clip(shape[key], min(bounds[0], value), max(bounds[1], value))
        # As many digits as a written effect has.
        shape[key] = float(f"{inside:.6g}")
    return old.with_shape(**shape)
