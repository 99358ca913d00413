"""What an error of a shape constant makes of torque, and the constants at which least
is left.

To first order an error ds of a constant s of the columns Y(s) is one more linear
parameter, whose column is (dY/ds) theta (:class:`ShapeSensitivity`): with it in the
regression the covariance of theta is no longer conditional on s (Seber, Wild, Nonlinear
Regression 1989, ch. 5). Before anything is measured a constant lies in its range,
uniformly in its own scale. With its estimate columns are computed anew: a step of Gauss
and Newton, each a pass over the data (:func:`fit_constants_jointly`).
"""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from sdp_vs_penalty.effects.effect import Block, Effect, Motion, Parameter
from sdp_vs_penalty.effects.model import Model, turning
from sdp_vs_penalty.estimation.constants import DIFFERENCE
from sdp_vs_penalty.estimators.estimator import joint_weights, white_variance
from sdp_vs_penalty.regression.linalg import (
    deviations,
    least_squares,
    min_norm_lstsq,
    partialled,
)
from sdp_vs_penalty.regression.regression import LeastSquares, Regression
from sdp_vs_penalty.robot.arrays import Array

#: Kinds of parameters of :class:`ShapeSensitivity`: constants that are refined, and
#: those that only have the values of a grid.
REFINED = "refined constant"
ON_A_GRID = "constant on a grid"


def free_constants(effect: Effect) -> tuple[str, ...]:
    """The shape constants that measurements can tell and that vary continuously in a
    range."""
    names = (key for key in effect.searched if not effect.shapes[key].choices)
    return tuple(key for key in names if prior_deviation(effect, key) > 0.0)


def prior_deviation(effect: Effect, key: str) -> float:
    """Standard deviation of a constant that lies anywhere in its range, in the scale in
    which it is spaced (natural logarithm or value): (high - low) / sqrt(12). Zero where
    it has no range."""
    shape = effect.shapes[key]
    low, high = shape.bounds or (
        min(shape.grid, default=1.0),
        max(shape.grid, default=1.0),
    )
    return float(
        (np.log(high / low) if shape.scale == "log" else high - low) / np.sqrt(12.0)
    )


class ShapeSensitivity(Effect):
    """The torque of a unit error of each free shape constant of an effect with
    parameters theta (k,).

    The unit is the standard deviation of the prior, (range) / sqrt(12): a prior of
    these parameters is a standard normal. Columns are central differences (Y(s + h) -
    Y(s - h)) theta / 2h. ``finer`` : effects, with their parameters, that have the
    constant as well, or whose signs turn over it.
    """

    name = "shape_sensitivity"
    equation = "(dY/ds) theta"
    explanation = "What an error of an effect's shape constant makes of torque."
    reference = "Seber, Wild, Nonlinear Regression 1989, ch. 5"

    def __init__(
        self, effect: Effect, theta: Array, finer: Sequence[tuple[Effect, Array]] = ()
    ) -> None:
        super().__init__(effect.robot)
        self.effect, self.theta = effect, np.asarray(theta, float)
        self.keys, self.finer = free_constants(effect), tuple(finer)
        effects = (effect, *(e for e, _ in finer))
        #: For each constant the effect a step above and below, and the unit over their
        #: distance.
        self.varied = [
            (
                moved(effect, key, DIFFERENCE),
                moved(effect, key, -DIFFERENCE),
                0.5 * prior_deviation(effect, key) / DIFFERENCE,
            )
            for key in self.keys
        ]
        # Of what is varied, not of the class.
        self.has_memory = any(e.has_memory for e in effects)  # type: ignore[misc]
        self.needs_torque = any(e.needs_torque for e in effects)  # type: ignore[misc]
        self.needs_links = any(e.needs_links for e in effects)  # type: ignore[misc]

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        e = self.effect
        kinds = {
            key: ON_A_GRID if e.shapes[key].bounds is None else REFINED
            for key in self.keys
        }
        return tuple(
            Parameter(f"{key} of {e.text}", "-", kind, 0) for key, kind in kinds.items()
        )

    def blocks(self, motion: Motion) -> list[Block]:
        columns: dict[tuple[int, int], Array] = {}
        for k, (upper, lower, unit) in enumerate(self.varied):
            up = turning(motion, upper)
            down = turning(motion, lower)
            pairs = [(upper.blocks(up), lower.blocks(down), self.theta)]
            for e, theta in self.finer:
                if e.shape_of:
                    columns_by_constant = [
                        e.with_shape(**{c: x.shape[c] for c in e.shape})
                        for x in (upper, lower)
                    ]
                    pairs.append(
                        (
                            columns_by_constant[0].blocks(motion),
                            columns_by_constant[1].blocks(motion),
                            theta,
                        )
                    )
                elif up is not motion:
                    pairs.append((e.blocks(up), e.blocks(down), theta))
            for above_all, below_all, theta in pairs:
                for above, below in zip(above_all, below_all, strict=True):
                    change = (
                        unit * (above.columns - below.columns) @ theta[above.parameters]
                    )
                    where = above.joint, k
                    columns[where] = columns.get(where, 0.0) + change
        return [
            Block(j, np.array([k]), column[:, None])
            for (j, k), column in columns.items()
        ]


def moved(effect: Effect, key: str, step: float) -> Effect:
    """The effect with a shape constant changed by a step in its own scale."""
    value = effect.shape[key]
    new = value * np.exp(step) if effect.shapes[key].scale == "log" else value + step
    return effect.with_shape(**{key: float(new)})


def sensitivities(
    effects: Sequence[Effect], thetas: Sequence[Array]
) -> tuple[ShapeSensitivity, ...]:
    """One for each of the effects, with its parameters, that has a free shape constant."""
    both = list(zip(effects, thetas, strict=True))
    finer = [
        [b for b in both if e.name in (*b[0].refines, b[0].shape_of)] for e in effects
    ]
    pairs = zip(both, finer, strict=True)
    return tuple(
        ShapeSensitivity(*effect_and_theta, fine)
        for effect_and_theta, fine in pairs
        if free_constants(effect_and_theta[0])
    )


def with_sensitivities(
    model: Model, theta: Array, chosen: Callable[[Effect], bool] = lambda effect: True
) -> Model:
    """The model with a parameter more for each free shape constant of the effects that
    are wanted; itself where there is none."""
    sensitivities_of_model = sensitivities(
        model.effects, [theta[k] for k in model.indices]
    )
    extra = tuple(e for e in sensitivities_of_model if chosen(e.effect))
    if not extra:
        return model
    reference = model.reference
    if reference is not None:
        reference = np.concatenate(
            [reference, np.zeros(sum(len(e.parameters) for e in extra))]
        )
    return replace(model, effects=(*model.effects, *extra), reference=reference)


#: Effect, joint and name of a shape constant.
Key = tuple[str, int, str]


@dataclass(frozen=True)
class Settled:
    """model : with constants at their joint optimum; std : their standard deviations in
    their own scales; error : the squared error that is left."""

    model: Model
    std: dict[Key, float]
    error: float


def fit_constants_jointly(
    model: Model,
    free_keys: Collection[Key],
    compressed: Callable[[Model], Regression],
    weighting: str = "noise",
) -> Settled:
    """The model with its ``free_keys`` constants where they together leave the least
    squared error, from where they are and, of those that only have the values of a
    grid, from each of these: Gauss-Newton steps of those that have a range, in their
    own scales.

    compressed : the measurements in the columns of a model; weighting : of the joints'
    rows, "noise" or "none". Effects with a wanted constant act on one joint each.
    """
    first = compressed(model)
    weights = np.ones(model.robot.n)
    p = len(model.parameters)
    data = first.least_squares()
    white = max(
        white_variance(data, first.oversampling),
        1e-24 * data.tau_squared / max(data.rows, 1),
    )

    def solved(wide: Regression) -> tuple[LeastSquares, Array]:
        """Least squares of all columns, and theta (p,) of the parameters, which come
        first, alone."""
        data = wide.least_squares(weights)
        if np.isfinite(model.plausible).any():
            data = data.with_prior(
                np.append(model.plausible, np.full(wide.p - p, np.inf)), white
            )
        return data, min_norm_lstsq(data.R[:, :p], data.rho)

    _, start = solved(first)
    if weighting == "noise":
        weights = joint_weights(first, start)

    def keys_of(effect: Effect) -> list[Key]:
        """All free constants of an effect of which one is wanted."""
        keys = [(effect.name, effect.joints[0], key) for key in free_constants(effect)]
        return [] if set(keys).isdisjoint(free_keys) else keys

    places = [
        (k, key) for k, effect in enumerate(model.effects) for key in keys_of(effect)
    ]
    ranged = [model.effects[k].shapes[key[2]].bounds is not None for k, key in places]
    #: Which of the constants' columns behind the parameters' are of those that move.
    mine = np.array(
        [key in free_keys and has for (_, key), has in zip(places, ranged, strict=True)]
    )
    free = [x for x, moving in zip(places, mine, strict=True) if moving]
    gridded = [
        x
        for x, has in zip(places, ranged, strict=True)
        if not has and x[1] in free_keys
    ]
    unit = np.array([prior_deviation(model.effects[k], key[2]) for k, key in free])

    def descended(begin: tuple[Effect, ...]) -> Settled:
        """Where no step (d,) lowers the squared error any more."""
        theta = start
        variances = dict[bytes, float]()

        def at(steps: Array) -> Model:
            out = list(begin)
            for (k, key), step in zip(free, steps.tolist(), strict=True):
                out[k] = moved(out[k], key[2], step)
            return replace(model, effects=tuple(out))

        def left(steps: Array) -> tuple[Array, Array]:
            """What least squares leave (m,), and its slopes (m, d) with the parameters
            eliminated."""
            nonlocal theta
            wide = compressed(
                with_sensitivities(at(steps), theta, lambda e: bool(keys_of(e)))
            )
            data, theta = solved(wide.keeping(np.append(np.ones(p, bool), mine)))
            variances[steps.tobytes()] = white_variance(data, wide.oversampling)
            columns = -partialled(data.R[:, :p], data.R[:, p:]) / unit
            residual = np.append(data.rho - data.R[:, :p] @ theta, data.residual_norm)
            return residual, np.vstack([columns, np.zeros((1, len(free)))])

        if not free:
            return Settled(at(unit), {}, float(np.sum(left(unit)[0] ** 2)))
        low, high = np.transpose([_room(begin[k], key[2]) for k, key in free])
        best, residual, slopes = least_squares(
            left, 0.0 * unit, (low, high), xtol=1e-6, ftol=1e-9, steps=15
        )
        std = np.sqrt(variances[best.tobytes()]) * deviations(slopes)
        # With as many digits of its constants as a written effect has.
        digits = [
            {key: float(f"{x:.6g}") for key, x in e.shape.items()}
            for e in at(best).effects
        ]
        effects = tuple(
            e.with_shape(**constants)
            for e, constants in zip(begin, digits, strict=True)
        )
        known = dict(zip((key for _, key in free), std.tolist(), strict=True))
        return Settled(
            replace(model, effects=effects), known, float(residual @ residual)
        )

    optima = []
    for values in product(
        *(model.effects[k].shapes[key[2]].grid for k, key in gridded)
    ):
        effects = list(model.effects)
        for (k, key), value in zip(gridded, values, strict=True):
            effects[k] = effects[k].with_shape(**{key[2]: value})
        optima.append(descended(tuple(effects)))
    return min(optima, key=lambda s: s.error)


def _room(effect: Effect, key: str) -> tuple[float, float]:
    """How far a constant may move down and up, in its own scale: within its range;
    where it is outside of that, towards it."""
    shape = effect.shapes[key].on(effect.robot.joints[effect.joints[0]].kind)
    value = effect.shape[key]
    assert shape.bounds is not None
    ends = np.array([min(shape.bounds[0], value), max(shape.bounds[1], value)])
    low, high = (
        np.log(ends / value) if shape.scale == "log" else ends - value
    ).tolist()
    return min(low, -1e-9), max(high, 1e-9)
