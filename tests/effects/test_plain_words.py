"""What effects are called, and what they are on an arm."""

from dataclasses import replace

import numpy as np
import pytest

from sdp_vs_penalty import load_problem
from sdp_vs_penalty.effects import FittedEffect, effect_types, on_the_arm

ARM = load_problem("panda").robot


def fitted(name, value, **shape):
    """An effect of the library on the arm, all parameters of one value."""
    kind = effect_types()[name]
    effect = kind(ARM) if kind.whole_robot or kind.joins else kind(ARM, (3,))
    parameters = {p.name: value for p in effect.parameters}
    sized = effect.parameters[effect.sized_by]
    unit = sized[0].unit if sized else effect.parameters[0].unit
    joints = () if kind.whole_robot else tuple(j + 1 for j in effect.joints)
    return FittedEffect(
        name, joints, value, unit, parameters, {**effect.shape, **shape}
    )


@pytest.mark.parametrize("name", effect_types())
def test_each_effect_of_the_library_has_a_sentence_of_its_own(name):
    assert effect_types()[name].on_the_arm
    sentence = on_the_arm(fitted(name, 0.0123))
    assert sentence.startswith("On the arm: ")
    assert name not in sentence.split() or "_" not in name
    assert "{" not in sentence
    holds_a_number = any(c.isdigit() for c in sentence.replace("joint 4", ""))
    assert holds_a_number or name in ("rigid_body", "measured_curve")


def test_an_effect_of_a_users_own_has_a_sentence():
    mine = FittedEffect("my_own_effect", (2,), 0.5, "N*m", {}, {})
    assert on_the_arm(mine) == "On the arm: joint 2 has my own effect of 0.5 N m."


@pytest.mark.parametrize(
    ("name", "half_width", "amount"),
    [
        ("stribeck_friction", 10.0, "about 15 N m (5 to 25)"),
        ("stribeck_friction", 4.0, "15 N m"),
        ("joint_elasticity", 10.0, "about 859° (286 to 1432)"),
    ],
)
def test_a_rough_size_is_said_with_its_interval(name, half_width, amount):
    sentence = on_the_arm(replace(fitted(name, 15.0), half_width=half_width))
    assert f" {amount} " in sentence


@pytest.mark.parametrize("lean", [(1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)])
def test_a_base_leans_to_the_side_that_gravity_pulls_to(lean):
    """Gravity in the frame of a base whose upright axis leans by half a degree."""
    angle = np.radians(0.5)
    upright = np.array(
        [np.sin(angle) * lean[0], np.sin(angle) * lean[1], np.cos(angle)]
    )
    sideways = np.array([*lean, 0.0])
    side = sideways - (sideways @ upright) * upright  # the base's own axis on that side
    pull = float(np.array([0.0, 0.0, -9.81]) @ side / np.linalg.norm(side))
    parts = {"g_x": pull * lean[0], "g_y": pull * lean[1]}
    tilted = FittedEffect("base_tilt", (), abs(pull), "m/s^2", parts, {})
    axis = ["+x", "-x", "+y", "-y"][[(1, 0), (-1, 0), (0, 1), (0, -1)].index(lean)]
    assert f"0.5° out of level, leaning towards {axis} " in on_the_arm(tilted)


@pytest.mark.parametrize(("side", "words"), [(1.0, "above 29°"), (2.0, "below 29°")])
def test_a_stop_says_where_it_touches(side, words):
    stop = on_the_arm(fitted("end_stop", 3.1, q0=0.5, side=side))
    assert f"{words} joint 4 is pushed back as by a spring of 3.1 N m/rad" in stop


def test_a_tilt_between_two_axes_names_both():
    tilted = FittedEffect("base_tilt", (), 0.2, "m/s^2", {"g_x": -0.1, "g_y": 0.17}, {})
    assert "leaning towards +y and -x" in on_the_arm(tilted)


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("joint_spring", 3.1, "pulled back as by a spring of 3.1 N m/rad"),
        ("joint_spring", -3.1, "pushed away as by a spring of 3.1 N m/rad"),
        ("joint_spring", 3.1, "0.054 N m for each degree"),
        ("torque_gain", 0.014, "1.4 % too large"),
        ("torque_gain", -0.014, "1.4 % too small"),
        ("global_delay", 0.0023, "2.3 ms later"),
        ("global_delay", -0.0023, "2.3 ms earlier"),
        ("joint_zero_error", 0.01, "joint 4 stands 0.57° beyond"),
        ("joint_zero_error", -0.01, "joint 4 stands 0.57° short of"),
        ("payload", 2.8, "carries 2.8 kg more"),
        ("stribeck_friction", -0.2, "rubs 0.2 N m less when it creeps"),
    ],
)
def test_size_and_sign_are_said_in_everyday_units(name, value, words):
    assert words in on_the_arm(fitted(name, value))
