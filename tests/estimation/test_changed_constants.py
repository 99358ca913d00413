"""What is said of shape constants that a model has estimated again."""

from types import SimpleNamespace

import numpy as np
import pytest

from sdp_vs_penalty.diagnosis.own_constants import constant_std, retune
from sdp_vs_penalty.effects import parse_effects
from sdp_vs_penalty.effects.model import Model
from sdp_vs_penalty.estimation.sensitivity import prior_deviation
from sdp_vs_penalty.estimation.shapes import ShapeEstimate, changed_constants_in_words


def model(problem, effects):
    return Model(problem.robot, parse_effects(effects, problem.robot))


@pytest.mark.parametrize(
    ("after", "said"),
    [
        ("coulomb_friction@v_s=0.01", []),
        (
            "coulomb_friction:1@v_s=0.01,coulomb_friction:2@v_s=0.0015",
            ["joint 2: Coulomb friction has v_s = 0.0015 rad/s, not 0.01 rad/s"],
        ),
        # An effect that is new has no constant before.
        ("coulomb_friction@v_s=0.01,stribeck_friction:1@vs=0.2", []),
    ],
)
def test_a_constant_that_has_changed_is_said_with_both_values(two_link, after, said):
    before = model(two_link, "coulomb_friction@v_s=0.01")
    assert changed_constants_in_words(before, model(two_link, after)) == said


def test_a_diagnosis_says_it_in_the_same_words(two_link):
    change = ShapeEstimate("coulomb_friction", 2, "v_s", 0.01, 0.0015)
    errors = np.array([0.1, 0.2])
    of_diagnosis = retune(change, 1e-4, two_link.robot, errors, 0.5 * errors)
    before = model(two_link, "coulomb_friction@v_s=0.01")
    after = model(two_link, "coulomb_friction:1@v_s=0.01,coulomb_friction:2@v_s=0.0015")
    (line,) = changed_constants_in_words(before, after)
    assert of_diagnosis.explanation == line


@pytest.mark.parametrize(
    ("name", "information", "share"),
    [
        ("coulomb_friction", 4.0, 0.5),
        ("coulomb_friction", 1.0, np.inf),  # no more than the prior has
        ("stribeck_friction", 4.0, np.inf),  # the rows have no columns of it
    ],
)
def test_a_constant_is_as_sure_as_what_its_error_makes_of_the_torque(
    name, information, share, two_link
):
    """In units of its prior deviation, which is relative on a logarithmic scale."""
    (effect,) = parse_effects("coulomb_friction", two_link.robot)
    derivatives = SimpleNamespace(effect=effect, keys=("v_s",))
    columns = np.full((1, 4, 1), 0.5 * np.sqrt(information))
    fit = SimpleNamespace(scaled=lambda x: x, residual_of=lambda x: x)
    constant = SimpleNamespace(effect=name, index=0, shape="v_s", after=0.1)
    std = constant_std(fit, [(derivatives, columns)], constant)
    assert std == pytest.approx(share * 0.1 * prior_deviation(effect, "v_s"))
