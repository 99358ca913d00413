"""Shape constants in the regression: their columns, and what they add to the spread."""

import numpy as np
import pytest

from sdp_vs_penalty import Problem
from sdp_vs_penalty.effects import CurrentModel, Effect, Motion, effect_types
from sdp_vs_penalty.estimation import free_constants, prior_deviation
from sdp_vs_penalty.estimation.shape_constants import ShapeSensitivity
from sdp_vs_penalty.robot import random_trajectory


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
def test_a_unit_of_a_constant_is_what_the_effect_itself_changes_by(two_link, name):
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
