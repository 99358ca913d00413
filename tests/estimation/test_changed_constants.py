"""What is said of shape constants that a model has estimated again."""

import pytest

from sdp_vs_penalty import Problem
from sdp_vs_penalty.effects import parse_effects
from sdp_vs_penalty.effects.model import Model
from sdp_vs_penalty.estimation.shapes import changed_constants_in_words


def model(problem: Problem, effects: str) -> Model:
    return Model(problem.robot, parse_effects(effects, problem.robot))


@pytest.mark.parametrize(
    ("after", "said"),
    [
        ("coulomb_friction@v_s=0.01", []),
        (
            "coulomb_friction:1@v_s=0.01,coulomb_friction:2@v_s=0.0015",
            ["Coulomb friction, joint 2: v_s = 0.0015 rad/s, 0.01 rad/s before"],
        ),
        # An effect that is new has no constant before.
        ("coulomb_friction@v_s=0.01,stribeck_friction:1@vs=0.2", []),
    ],
)
def test_a_constant_that_has_changed_is_said_with_both_values(two_link, after, said):
    before = model(two_link, "coulomb_friction@v_s=0.01")
    assert changed_constants_in_words(before, model(two_link, after)) == said
