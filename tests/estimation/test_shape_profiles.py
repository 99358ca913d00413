"""Shape constants are estimated beside the parameters: the width over which Coulomb
friction turns."""

import numpy as np
import pytest
from arms import run_of_widths
from random_robots import sines
from unchecked import identify

from sdp_vs_penalty import Measurements
from sdp_vs_penalty.effects import effect_types
from sdp_vs_penalty.estimation import (
    ShapeSensitivity,
    fit_constants_jointly,
    free_constants,
    prior_deviation,
)
from sdp_vs_penalty.regression import compress
from sdp_vs_penalty.signals import FilteredRuns
from sdp_vs_penalty.testing.effect_contract import to_and_fro, wide_columns


def test_every_joint_gets_its_own_width_with_an_honest_spread(scara_arm):
    """In the units of each joint; the third axis slides."""
    widths = (0.02, 0.003, 0.001, 0.008)
    estimate = identify(scara_arm, run_of_widths(scara_arm, widths, 16.0), "ols")
    for found, truth in zip(estimate.details["shapes"], widths, strict=True):
        assert abs(found["after"] - truth) < 4.0 * found["std"]
        assert found["std"] < 0.2 * truth
        assert not found["at_end"]
    assert estimate.model.sign_width == tuple(
        s["after"] for s in estimate.details["shapes"]
    )


RIGID = "rigid_body,viscous_friction,torque_offset"
WANTED = [
    ("coulomb_friction", 1, "v_s"),
    ("stribeck_friction", 1, "vs"),
    ("stribeck_friction", 1, "delta"),
]


def texts(width, vs, delta):
    return f"{RIGID},coulomb_friction:2@v_s={width},stribeck_friction:2@vs={vs}@delta={delta}"


def settled_from(two_link, start, truth, stribeck=0.5):
    """From exact data of a friction with a Stribeck part of such a size."""
    model = two_link.model(texts(*truth))
    theta = two_link.nominal(model)
    theta[len(model.rigid_indices) :] = 0.5
    theta[model.indices[-1]] = stribeck
    motion = sines(np.random.default_rng(5), 2, np.arange(0.0, 10.0, 4e-3), 0.1, 5)
    data = Measurements(motion.t, motion.q, model.torque(theta, motion))
    begin = two_link.model(texts(*start))
    settings = two_link.preprocessing.resolve(data)
    return fit_constants_jointly(
        begin, WANTED, lambda m: compress(FilteredRuns.filtering(data, settings), m)
    )


@pytest.mark.parametrize(
    ("truth", "start"),
    [
        ((0.025, 0.1, 2.0), (0.01, 0.13, 2.0)),
        pytest.param((0.025, 0.07, 1.0), (0.01, 0.13, 2.0), marks=pytest.mark.long),
        pytest.param((0.004, 0.05, 2.0), (0.02, 0.09, 1.0), marks=pytest.mark.long),
    ],
)
def test_exact_data_give_exact_constants(two_link, truth, start):
    found = settled_from(two_link, start, truth)
    shapes = [effect.shape for effect in found.model.effects[-2:]]
    assert (shapes[0]["v_s"], shapes[1]["vs"]) == pytest.approx(truth[:2], rel=1e-4)
    assert shapes[1]["delta"] == truth[2]
    assert set(found.std) == set(WANTED[:2])


def test_a_constant_of_an_effect_that_is_not_there_is_not_known(two_link):
    found = settled_from(two_link, (0.025, 0.07, 1.0), (0.025, 0.07, 1.0), stribeck=0.0)
    assert found.std[WANTED[1]] > 0.1 > 1e-3 > found.std[WANTED[0]]


@pytest.mark.parametrize(
    "name", sorted(n for n, e in effect_types().items() if not e.needs_command)
)
def test_a_unit_of_a_constant_is_what_the_effect_itself_changes_by(two_link, name):
    """The linear prediction of a small change of each constant, against the effect
    moved by it."""
    kind = effect_types()[name]
    joints = None if kind.whole_robot else [1]
    effect = kind(two_link.robot, joints)
    motion = to_and_fro(two_link.robot)
    theta = np.linspace(0.5, 1.5, len(effect.parameters))
    sensitive = ShapeSensitivity(effect, theta)
    assert len(sensitive.parameters) == len(free_constants(effect))
    for k, key in enumerate(free_constants(effect)):
        relative = effect.shapes[key].scale == "log"
        change = 0.004
        moved = (
            effect.shape[key] * np.exp(change)
            if relative
            else effect.shape[key] + change
        )
        other = kind(two_link.robot, joints, **{**effect.shape, key: moved})
        truly = (wide_columns(other, motion) - wide_columns(effect, motion)) @ theta
        unit = np.zeros(len(sensitive.parameters))
        unit[k] = change / prior_deviation(effect, key)
        said = wide_columns(sensitive, motion) @ unit
        assert np.any(np.abs(truly) > 0.0)
        # Where an element just gives way, a sample changes all at once.
        assert np.linalg.norm(said - truly) < 0.2 * np.linalg.norm(truly)
