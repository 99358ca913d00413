"""What an error of a shape constant makes of torque, and the constants at which least
is left.

To first order an error ds of a constant s of the columns Y(s) is one more linear
parameter, whose column is (dY/ds) theta (:class:`ShapeSensitivity`): with it in the
regression the covariance of theta is no longer conditional on s (Seber, Wild, Nonlinear
Regression 1989, ch. 5). Before anything is measured a constant lies in its range,
uniformly in its own scale. With its estimate columns are computed anew: a step of Gauss
and Newton, each a pass over the data (:func:`fit_constants_jointly`).
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from sdp_vs_penalty.effects.effect import Block, Effect, Motion, Parameter
from sdp_vs_penalty.effects.model import Model, with_sign_width_of
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
    """Return the names of an effect's shape constants that vary continuously in a
    range.

    Returns
    -------
    tuple of str
        Names; discrete choices and constants without a range are left out.
    """
    names = (key for key in effect.searched if not effect.shapes[key].choices)
    return tuple(key for key in names if prior_deviation(effect, key) > 0.0)


def prior_deviation(effect: Effect, key: str) -> float:
    """Return the standard deviation of a constant that lies anywhere in its range.

    This is (high - low) / sqrt(12), of a uniform distribution.

    Returns
    -------
    float
        On the constant's scale (natural logarithm or value); zero without a range.
    """
    shape = effect.shapes[key]
    low, high = shape.bounds or (
        min(shape.grid, default=1.0),
        max(shape.grid, default=1.0),
    )
    length = np.log(high / low) if shape.scale == "log" else high - low
    return float(length / np.sqrt(12.0))


@dataclass(frozen=True)
class _Variation:
    """An effect with one of its shape constants a small step h above and below its value."""

    #: The effect with the constant s + h.
    upper: Effect
    #: The effect with the constant s - h.
    lower: Effect
    #: Unit of the constant's error over 2h: from a difference of columns to those of a
    #: unit error.
    factor: float

    @classmethod
    def by_step(cls, effect: Effect, key: str) -> _Variation:
        """Vary a constant by DIFFERENCE on its scale; the unit is its prior deviation."""
        return cls(
            with_moved_constant(effect, key, DIFFERENCE),
            with_moved_constant(effect, key, -DIFFERENCE),
            0.5 * prior_deviation(effect, key) / DIFFERENCE,
        )


class ShapeSensitivity(Effect):
    """The torque of a unit error of each free shape constant of an effect with
    parameters theta (k,).

    The unit is the standard deviation of the prior, (range) / sqrt(12): a prior of
    these parameters is a standard normal. Columns are central differences (Y(s + h) -
    Y(s - h)) theta / 2h. ``dependents`` : effects, with their parameters, that have the
    constant as well, or whose signs turn over it.
    """

    name = "shape_sensitivity"
    equation = "(dY/ds) theta"
    explanation = "What an error of an effect's shape constant makes of torque."
    reference = "Seber, Wild, Nonlinear Regression 1989, ch. 5"

    def __init__(
        self,
        effect: Effect,
        theta: Array,
        dependents: Sequence[tuple[Effect, Array]] = (),
    ) -> None:
        """Vary each free shape constant of an effect by a small step, up and down.

        Parameters
        ----------
        theta : (k,) array
            The effect's parameters.
        dependents : sequence of (Effect, (m,) array)
            Further effects whose columns depend on the same constants, with their
            parameters.
        """
        super().__init__(effect.robot)
        self.effect = effect
        self.theta = np.asarray(theta, float)
        self.keys = free_constants(effect)
        self.dependents = tuple(dependents)
        self.variations = [_Variation.by_step(effect, key) for key in self.keys]
        # What the varied effects need, not what the class says.
        effects = (effect, *(e for e, _ in dependents))
        self.has_memory = any(e.has_memory for e in effects)  # type: ignore[misc]
        self.needs_torque = any(e.needs_torque for e in effects)  # type: ignore[misc]
        self.needs_links = any(e.needs_links for e in effects)  # type: ignore[misc]

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Return one parameter [-] for each free constant: its error over its prior
        deviation.
        """
        e = self.effect
        kinds = {
            key: ON_A_GRID if e.shapes[key].bounds is None else REFINED
            for key in self.keys
        }
        return tuple(
            Parameter(f"{key} of {e.text}", "-", kind, 0) for key, kind in kinds.items()
        )

    def blocks(self, motion: Motion) -> list[Block]:
        """Return the torque of a unit error of each constant, one column (N, 1) a
        joint.

        It is the central difference unit (Y(s + h) - Y(s - h)) theta / 2h, summed over
        the effect and all effects whose columns change with the constant.
        """
        # Torque (N,) by joint and number of the constant.
        torques: dict[tuple[int, int], Array] = {}
        for k, variation in enumerate(self.variations):
            for blocks_above, blocks_below, theta in self._varied(motion, variation):
                for above, below in zip(blocks_above, blocks_below, strict=True):
                    columns = variation.factor * (above.columns - below.columns)
                    torque = columns @ theta[above.parameters]
                    place = above.joint, k
                    torques[place] = torques.get(place, 0.0) + torque
        return [
            Block(joint, np.array([k]), torque[:, None])
            for (joint, k), torque in torques.items()
        ]

    def _varied(
        self, motion: Motion, variation: _Variation
    ) -> list[tuple[list[Block], list[Block], Array]]:
        """Return (blocks with the constant above its value, blocks below, parameters) of
        each effect whose columns depend on the constant.

        The first is the effect itself; the others have the same constant, or signs of
        velocity that change over it.
        """
        upper, lower = variation.upper, variation.lower
        # The motion with signs of velocity that change over the effect's constant.
        motion_above = with_sign_width_of(motion, upper)
        motion_below = with_sign_width_of(motion, lower)
        varied = [(upper.blocks(motion_above), lower.blocks(motion_below), self.theta)]
        for effect, theta in self.dependents:
            if effect.shape_of:  # it has the same constants
                above = effect.with_shape(**{c: upper.shape[c] for c in effect.shape})
                below = effect.with_shape(**{c: lower.shape[c] for c in effect.shape})
                varied.append((above.blocks(motion), below.blocks(motion), theta))
            elif motion_above is not motion:  # its signs change with the constant
                blocks_above = effect.blocks(motion_above)
                blocks_below = effect.blocks(motion_below)
                varied.append((blocks_above, blocks_below, theta))
        return varied


def with_moved_constant(effect: Effect, key: str, step: float) -> Effect:
    """Return the effect with one shape constant changed by a step.

    Parameters
    ----------
    step : float
        Step on the constant's scale: of its logarithm, or of its value.
    """
    value = effect.shape[key]
    is_log = effect.shapes[key].scale == "log"
    new_value = value * np.exp(step) if is_log else value + step
    return effect.with_shape(**{key: float(new_value)})


def sensitivities(
    effects: Sequence[Effect], thetas: Sequence[Array]
) -> tuple[ShapeSensitivity, ...]:
    """Return the sensitivity of each effect that has a free shape constant.

    Parameters
    ----------
    effects : sequence of Effect
        All effects of a model.
    thetas : sequence of (k,) arrays
        Parameters of each effect.

    Returns
    -------
    tuple of ShapeSensitivity
        In the order of the effects.
    """
    effects_with_theta = list(zip(effects, thetas, strict=True))
    with_constants = []
    for effect, theta in effects_with_theta:
        if not free_constants(effect):
            continue
        # Effects that refine this one, or have its constants.
        dependents = [
            (other, theta_of_other)
            for other, theta_of_other in effects_with_theta
            if effect.name in (*other.refines, other.shape_of)
        ]
        with_constants.append(ShapeSensitivity(effect, theta, dependents))
    return tuple(with_constants)


def with_sensitivities(
    model: Model, theta: Array, chosen: Callable[[Effect], bool] = lambda effect: True
) -> Model:
    """Return the model with one further parameter for each free shape constant.

    A model without such constants is returned as it is.

    Parameters
    ----------
    chosen : callable
        Selects the effects whose constants become parameters; default: all.

    Returns
    -------
    Model
        The same effects, then the sensitivities of their constants.
    """
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
class FittedConstants:
    """A model whose shape constants lie at their joint optimum."""

    #: The model with these constants.
    model: Model
    #: Standard deviation of each constant in its own scale.
    std: dict[Key, float]
    #: Squared error that is left.
    error: float


def fit_constants_jointly(
    model: Model,
    free_keys: Collection[Key],
    compressed: Callable[[Model], Regression],
    weighting: str = "noise",
) -> FittedConstants:
    """Fit a model's shape constants jointly with its parameters, by least squares.

    Constants with a range move by Gauss-Newton steps from their present values.
    Constants that only take the values of a grid are tried at each of them; the best
    result counts.

    Parameters
    ----------
    model : Model
        Model whose effects with a free constant act on one joint each.
    free_keys : collection of Key
        Constants to fit, as (effect, joint from 0, name).
    compressed : callable
        Returns the measurements in the columns of a model.
    weighting : {"noise", "none"}
        Weight the joints' rows by their noise, or equally.

    Returns
    -------
    FittedConstants
        Model with the fitted constants, their standard deviations, and the squared
        error.
    """
    fit = _ConstantFit(model, free_keys, compressed, weighting)
    optima = [_Descent(fit, effects).minimise() for effects in fit.starting_effects()]
    return min(optima, key=lambda optimum: optimum.error)


@dataclass(frozen=True)
class _Constant:
    """A shape constant of one of the model's effects."""

    #: Index of the effect in the model.
    effect_index: int
    #: Effect, joint from 0, and name of the constant.
    key: Key
    #: Whether it moves continuously within a range.
    has_range: bool
    #: Whether it is one of those to be fitted.
    is_free: bool

    @property
    def name(self) -> str:
        """Name of the constant within its effect."""
        return self.key[2]


class _ConstantFit:
    """Least squares in a model's parameters and some of its shape constants.

    - ``weights`` (n,): of the joints' rows.
    - ``start`` (p,): the parameters, where no constant has moved.
    - ``moving_constants``: the d constants that move; ``unit`` (d,): the standard deviation of
      each before anything is measured.
    - ``moving_columns``: their columns among those of all constants, which stand behind
      the parameters'.
    """

    def __init__(
        self,
        model: Model,
        free_keys: Collection[Key],
        compressed: Callable[[Model], Regression],
        weighting: str,
    ) -> None:
        """Fit the parameters for the present shape constants; list the constants that
        move.

        A shape constant enters the torque nonlinearly, such as a Stribeck velocity.
        ``free_keys``: constants to fit as (effect, joint, name); ``compressed``:
        returns the measurements in a model's columns; ``weighting``: "noise" weights
        the joints' rows by their noise.
        """
        self.model = model
        self.compressed = compressed
        self.n_parameters = len(model.parameters)
        self.weights = np.ones(model.robot.n)
        first = compressed(model)
        data = first.least_squares()
        rounding = 1e-24 * data.tau_squared / max(data.rows, 1)
        # Exact data have rounding for noise.
        self.white_variance = max(white_variance(data, first.oversampling), rounding)
        _, self.start = self.solve(first)
        if weighting == "noise":
            self.weights = joint_weights(first, self.start)
        self.free_keys = free_keys
        constants = self._constants()
        # Constants with a range move; others are tried at each value of a grid.
        self.moving_columns = np.array([c.is_free and c.has_range for c in constants])
        self.moving_constants = [c for c in constants if c.is_free and c.has_range]
        self.on_grid = [c for c in constants if c.is_free and not c.has_range]
        self.unit = np.array(
            [
                prior_deviation(model.effects[c.effect_index], c.name)
                for c in self.moving_constants
            ]
        )

    def keys_of(self, effect: Effect) -> list[Key]:
        """Return the keys of an effect's free shape constants: (effect, joint, name).

        The list is empty unless at least one of them is to be fitted (``free_keys``).
        """
        keys = [(effect.name, effect.joints[0], key) for key in free_constants(effect)]
        return [] if set(keys).isdisjoint(self.free_keys) else keys

    def _constants(self) -> list[_Constant]:
        """List the constants of :meth:`keys_of` of all effects, in the model's order."""
        constants = []
        for index, effect in enumerate(self.model.effects):
            for key in self.keys_of(effect):
                has_range = effect.shapes[key[2]].bounds is not None
                is_free = key in self.free_keys
                constants.append(_Constant(index, key, has_range, is_free))
        return constants

    def starting_effects(self) -> Iterator[tuple[Effect, ...]]:
        """Yield the model's effects with each combination of values of the constants on
        a grid.
        """
        grids = [
            self.model.effects[c.effect_index].shapes[c.name].grid for c in self.on_grid
        ]
        for values in product(*grids):
            effects = list(self.model.effects)
            for constant, value in zip(self.on_grid, values, strict=True):
                effect = effects[constant.effect_index]
                effects[constant.effect_index] = effect.with_shape(
                    **{constant.name: value}
                )
            yield tuple(effects)

    def solve(self, wide: Regression) -> tuple[LeastSquares, Array]:
        """Return the least-squares problem in all columns, and theta (p,) fitted
        without some.

        The columns of ``wide`` are those of the p parameters, then those of the shape
        constants; theta uses the first p. A parameter with a plausible size known
        beforehand gets a prior of that standard deviation about zero.
        """
        p = self.n_parameters
        data = wide.least_squares(self.weights)
        if np.isfinite(self.model.plausible).any():
            unknown = np.full(wide.p - p, np.inf)
            sizes = np.append(self.model.plausible, unknown)
            data = data.with_prior(sizes, self.white_variance)
        return data, min_norm_lstsq(data.R[:, :p], data.rho)


class _Descent:
    """Gauss-Newton steps (d,) of the constants from those of ``begin``.

    - ``theta`` (p,): the parameters at the last constants.
    - ``variances``: of the noise, each by the steps at which it was estimated.
    """

    def __init__(self, fit: _ConstantFit, begin: tuple[Effect, ...]) -> None:
        """Start at the constants of the effects ``begin``."""
        self.fit = fit
        self.start_effects = begin
        self.theta = fit.start
        self.variances: dict[bytes, float] = {}

    def minimise(self) -> FittedConstants:
        """Move the constants by Gauss-Newton steps until the squared error falls no
        more.

        ``steps`` (d,) are the moves of the constants on their scale (ln of the constant,
        or the constant). The parameters theta are eliminated in each residual. Returns
        the model with the new constants, their standard deviations, and the squared
        error.
        """
        fit = self.fit
        constants = fit.moving_constants
        if not constants:
            no_steps = fit.unit  # (0,)
            residual, _ = self.residual(no_steps)
            error = float(np.sum(residual**2))
            return FittedConstants(self.model_at(no_steps), {}, error)
        low, high = np.transpose(
            [
                _allowed_steps(self.start_effects[c.effect_index], c.name)
                for c in constants
            ]
        )
        best, residual, slopes = least_squares(
            self.residual,
            np.zeros_like(fit.unit),
            (low, high),
            xtol=1e-6,
            ftol=1e-9,
            steps=15,
        )
        variance = self.variances[best.tobytes()]  # set by residual at these steps
        std = np.sqrt(variance) * deviations(slopes)
        keys = [c.key for c in constants]
        # The text of an effect has six digits, so that it reproduces the model.
        effects = []
        effects_at_best = self.model_at(best).effects
        for effect, after in zip(self.start_effects, effects_at_best, strict=True):
            digits = {key: float(f"{x:.6g}") for key, x in after.shape.items()}
            effects.append(effect.with_shape(**digits))
        return FittedConstants(
            replace(fit.model, effects=tuple(effects)),
            dict(zip(keys, std.tolist(), strict=True)),
            float(residual @ residual),
        )

    def model_at(self, steps: Array) -> Model:
        """Return the model with the d moving shape constants changed by ``steps`` (d,)
        from the start, each on its own scale (its logarithm, or its value)."""
        effects = list(self.start_effects)
        constants = self.fit.moving_constants
        for constant, step in zip(constants, steps.tolist(), strict=True):
            effect = effects[constant.effect_index]
            effects[constant.effect_index] = with_moved_constant(
                effect, constant.name, step
            )
        return replace(self.fit.model, effects=tuple(effects))

    def residual(self, steps: Array) -> tuple[Array, Array]:
        """Return the residual (m,) of least squares, and its Jacobian (m, d) by the
        steps.

        ``steps`` (d,) move the shape constants from the start. The parameters theta are
        fitted for them (variable projection), so that the Jacobian is the constants'
        columns less what the parameters' columns explain of them.

        Kept for later: theta, about which the next call linearises, and the variance of
        the noise at these steps, for :meth:`minimise`.
        """
        fit = self.fit
        p = fit.n_parameters
        # A moving constant adds a column: the derivative of the torque by it.
        model_with_derivatives = with_sensitivities(
            self.model_at(steps), self.theta, lambda effect: bool(fit.keys_of(effect))
        )
        regression = fit.compressed(model_with_derivatives)
        # Columns: those of the p parameters, then those of the d constants that move.
        kept_columns = np.append(np.ones(p, bool), fit.moving_columns)
        # Rows are compressed: |torque - columns x|^2 = |rho - R x|^2 + residual_norm^2.
        data, self.theta = fit.solve(regression.keeping(kept_columns))
        self.variances[steps.tobytes()] = white_variance(data, regression.oversampling)
        of_parameters, of_constants = np.split(data.R, [p], axis=1)
        jacobian = -partialled(of_parameters, of_constants) / fit.unit
        # No column changes the last row.
        residual = np.append(data.rho - of_parameters @ self.theta, data.residual_norm)
        return residual, np.vstack([jacobian, np.zeros((1, jacobian.shape[1]))])


def _allowed_steps(effect: Effect, key: str) -> tuple[float, float]:
    """Return how far a constant may move down (negative) and up on its scale.

    The limits are its range; outside of its range it may move towards it.
    """
    shape = effect.shapes[key].on(effect.robot.joints[effect.joints[0]].kind)
    value = effect.shape[key]
    assert shape.bounds is not None
    ends = np.array([min(shape.bounds[0], value), max(shape.bounds[1], value)])
    is_log = shape.scale == "log"
    low, high = (np.log(ends / value) if is_log else ends - value).tolist()
    # The optimiser needs room on both sides.
    return min(low, -1e-9), max(high, 1e-9)
