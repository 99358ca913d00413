"""Shape constants as nuisances: what an estimated constant adds to the spread of linear parameters.

The columns Y(s) of an effect depend on shape constants s that were found from the same measurements as
theta. To first order an error ds of a constant is one more linear parameter, whose column is
(dY/ds) theta: with it in the regression the covariance of theta is no longer conditional on s (Seber,
Wild, Nonlinear Regression 1989, ch. 5). Before anything is measured a constant lies in its range,
uniformly in its own scale: a prior that keeps a constant which data do not show from widening all else.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.effects.effect import Block, Effect, Motion, Parameter
from sdp_vs_penalty.effects.model import Model

Array = NDArray[np.float64]

#: Step of the central differences, in the constant's own scale: a thousandth of its value, or of a wave.
_STEP = 1e-3
#: Kinds of parameters of :class:`ShapeSensitivity`: constants that are refined, and those that only have
#: the values of a grid.
REFINED, ON_A_GRID = "refined constant", "constant on a grid"
_TWO = 2.0 * _STEP


def free_constants(effect: Effect) -> tuple[str, ...]:
    """The shape constants that measurements can tell and that vary continuously in a range."""
    return tuple(
        key
        for key in effect.searched
        if not effect.shapes[key].choices and prior_deviation(effect, key) > 0.0
    )


def prior_deviation(effect: Effect, key: str) -> float:
    """Standard deviation of a constant that lies anywhere in its range, in the scale in which it is
    spaced (natural logarithm or value): (high - low) / sqrt(12). Zero where it has no range."""
    shape = effect.shapes[key]
    low, high = shape.bounds or (min(shape.grid, default=1.0), max(shape.grid, default=1.0))
    return float((np.log(high / low) if shape.scale == "log" else high - low) / np.sqrt(12.0))


def _kind(effect: Effect, key: str) -> str:
    return ON_A_GRID if effect.shapes[key].bounds is None else REFINED


class ShapeSensitivity(Effect):
    """The torque of a unit error of each free shape constant of an effect with parameters theta (k,).

    The unit is the standard deviation of the prior, (range) / sqrt(12): a prior of these parameters is
    a standard normal. Columns are central differences (Y(s + h) - Y(s - h)) theta / 2h.
    """

    name = "shape_sensitivity"
    equation = "(dY/ds) theta"
    explanation = "What an error of an effect's shape constant makes of torque."
    reference = "Seber, Wild, Nonlinear Regression 1989, ch. 5"

    def __init__(self, effect: Effect, theta: Array) -> None:
        super().__init__(effect.robot)
        self.effect, self.theta = effect, np.asarray(theta, float)
        self.keys = free_constants(effect)

    # A property of what is varied, not of the class: instance attributes hide the class's.
    @property
    def has_memory(self) -> bool:  # type: ignore[override]
        return self.effect.has_memory

    @property
    def needs_torque(self) -> bool:  # type: ignore[override]
        return self.effect.needs_torque

    @property
    def needs_links(self) -> bool:  # type: ignore[override]
        return self.effect.needs_links

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return tuple(
            Parameter(f"{key} of {self.effect.text}", "-", _kind(self.effect, key), 0)
            for key in self.keys
        )

    def blocks(self, motion: Motion) -> list[Block]:
        out = []
        for k, (upper, lower, unit) in enumerate(self._varied):
            for above, below in zip(upper.blocks(motion), lower.blocks(motion), strict=True):
                change = (above.columns - below.columns) @ self.theta[above.parameters]
                out.append(Block(above.joint, np.array([k]), unit * change[:, None]))
        return out

    @cached_property
    def _varied(self) -> list[tuple[Effect, Effect, float]]:
        """For each constant the effect a step above and below, and the unit over their distance."""
        return [
            (self._moved(k, _STEP), self._moved(k, -_STEP), prior_deviation(self.effect, k) / _TWO)
            for k in self.keys
        ]

    def _moved(self, key: str, step: float) -> Effect:
        effect, value = self.effect, self.effect.shape[key]
        moved = value * np.exp(step) if effect.shapes[key].scale == "log" else value + step
        shape = {**effect.shape, key: float(moved)}
        return type(effect)(effect.robot, effect.asked_joints, **shape)


def sensitivities(effects: Sequence[Effect], thetas: Sequence[Array]) -> tuple[ShapeSensitivity, ...]:
    """One for each of the effects, with its parameters, that has a free shape constant."""
    return tuple(
        ShapeSensitivity(effect, theta)
        for effect, theta in zip(effects, thetas, strict=True)
        if free_constants(effect)
    )


def with_sensitivities(model: Model, theta: Array) -> Model:
    """The model with a parameter more for each free shape constant; itself where there is none."""
    extra = sensitivities(model.effects, [theta[k] for k in model.indices])
    if not extra:
        return model
    reference = model.reference
    if reference is not None:
        reference = np.concatenate([reference, np.zeros(sum(len(e.parameters) for e in extra))])
    return Model(model.robot, (*model.effects, *extra), reference, model.gains)


def covariance_beside(columns: Array, constants: Array) -> Array:
    """(k, k) covariance of the coefficients of white columns (N, k) of unit variance when shape
    constants, with the columns (N, s) of :class:`ShapeSensitivity`, are estimated along with them."""
    k, s = columns.shape[1], constants.shape[1]
    everything = np.hstack([columns, constants])
    information = everything.T @ everything
    information[k:, k:] += np.eye(s)
    return np.asarray(np.linalg.pinv(information, rcond=1e-12)[:k, :k], float)
