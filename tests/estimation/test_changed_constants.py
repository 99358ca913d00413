"""What is said of shape constants that a model has estimated again."""

import numpy as np
import pytest

from sdp_vs_penalty.diagnosis.own_constants import retune
from sdp_vs_penalty.effects import parse_effects
from sdp_vs_penalty.effects.model import Model
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
    assert of_diagnosis.explanation.startswith(f"{line};")
