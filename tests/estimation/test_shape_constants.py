"""Shape constants in the regression: their columns, and what they add to the spread."""

from __future__ import annotations

import numpy as np
import pytest

from sdp_vs_penalty import Problem
from sdp_vs_penalty.effects import effect_types, parse_effects
from sdp_vs_penalty.effects.effect import CurrentModel, Effect, Motion
from sdp_vs_penalty.estimation.shape_constants import (
    ShapeSensitivity,
    covariance_beside,
    free_constants,
    prior_deviation,
    with_sensitivities,
)
from sdp_vs_penalty.robot.trajectory import random_trajectory


def motion_of(problem: Problem) -> Motion:
    trajectory = random_trajectory(problem.robot, seed=1, duration=5.0)
    t = np.linspace(0.0, 5.0, 1001)
    states = trajectory.states(t)
    current = CurrentModel(problem.robot, problem.nominal_links)
    torque, warm = 1.0 + 0.5 * states[0], np.stack([20.0 + t, 30.0 - t], axis=1)
    return Motion(t, *states, torque, current, temperature=warm)


def torque(effect: Effect, theta: np.ndarray, motion: Motion) -> np.ndarray:
    out = np.zeros_like(motion.q)
    for block in effect.blocks(motion):
        out[:, block.joint] += block.columns @ theta[block.parameters]
    return out


@pytest.mark.parametrize("name", sorted(n for n, e in effect_types().items() if not e.needs_command))
def test_a_unit_of_a_constant_is_what_the_effect_itself_changes_by(two_link: Problem, name: str) -> None:
    """The linear prediction of a small change of each constant, against the effect moved by it."""
    kind = effect_types()[name]
    joints = None if kind.whole_robot else [1]
    effect = kind(two_link.robot, joints)
    motion, theta = motion_of(two_link), np.linspace(0.5, 1.5, len(effect.parameters))
    sensitive = ShapeSensitivity(effect, theta)
    assert len(sensitive.parameters) == len(free_constants(effect))
    for k, key in enumerate(free_constants(effect)):
        relative = effect.shapes[key].scale == "log"
        change = 0.004
        moved = effect.shape[key] * np.exp(change) if relative else effect.shape[key] + change
        other = kind(two_link.robot, joints, **{**effect.shape, key: moved})
        truly = torque(other, theta, motion) - torque(effect, theta, motion)
        unit = np.zeros(len(sensitive.parameters))
        unit[k] = change / prior_deviation(effect, key)
        said = torque(sensitive, unit, motion)
        assert np.any(np.abs(truly) > 0.0)
        # Where an element just gives way, a sample changes all at once.
        assert np.linalg.norm(said - truly) < 0.2 * np.linalg.norm(truly)


def test_a_model_gets_a_parameter_a_constant_and_no_more(two_link: Problem) -> None:
    effects = parse_effects("rigid_body,stribeck_friction:1@vs=0.05,coulomb_friction", two_link.robot)
    model = two_link.model(effects)
    wide = with_sensitivities(model, np.ones(len(model.parameters)))
    names = [p.name for p in wide.parameters[len(model.parameters) :]]
    assert names[0].startswith("vs of stribeck_friction:1")
    assert names[1].startswith("delta of stribeck_friction:1")
    bare = two_link.model("rigid_body,viscous_friction")
    assert with_sensitivities(bare, np.ones(len(bare.parameters))) is bare


def test_the_spread_is_that_of_fits_with_the_constant_refitted() -> None:
    """tau = a exp(-x / s) with white noise: a's deviation over fits of both, not of a alone."""
    rng = np.random.default_rng(0)
    x = np.linspace(0.0, 1.0, 200)
    a, s, sd = 2.0, 0.4, 0.02
    column, slope = np.exp(-x / s), a * np.exp(-x / s) * x / s  # d / d ln s
    found = []
    grid = s * np.exp(np.linspace(-0.5, 0.5, 401))
    shapes = np.exp(-x / grid[:, None])
    for _ in range(300):
        y = a * column + sd * rng.normal(size=len(x))
        amplitude = shapes @ y / np.sum(shapes**2, axis=1)
        loss = np.sum((y - amplitude[:, None] * shapes) ** 2, axis=1)
        found.append(amplitude[np.argmin(loss)])
    told = np.sqrt(covariance_beside(column[:, None] / sd, slope[:, None] / sd)[0, 0])
    alone = sd / np.linalg.norm(column)
    assert told == pytest.approx(np.std(found), rel=0.12)
    assert told > 1.3 * alone


def test_a_constant_without_data_stays_within_its_prior() -> None:
    column = np.ones((50, 1))
    told = covariance_beside(column, 3.0 * column)
    assert told[0, 0] == pytest.approx(1.0 / 50 + 9.0)
