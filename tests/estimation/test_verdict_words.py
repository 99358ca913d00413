"""The words of a verdict: multiples of the noise stand beside N m, one grade for all."""

import numpy as np
import pytest

from sdp_vs_penalty.estimation import changes
from sdp_vs_penalty.estimation.verdict import FIT, MISSING, PREDICTION, Line, Verdict

UNITS = ["N*m", "N*m", "N"]
BEFORE = np.array([1.0, 2.0, 4.0])
FLOOR = np.array([0.1, 0.1, 0.1])


def test_a_change_is_said_in_multiples_and_in_newton_metres():
    after = BEFORE * [1.0, 0.1, 1.0]
    sentence = changes(BEFORE, after, FLOOR, UNITS)
    assert sentence == "joint 2: 2 -> 0.2 N m, 20 -> 2 times the noise (-90 %)."


def test_a_slides_error_is_in_newtons():
    sentence = changes(BEFORE, BEFORE * [1, 1, 0.25], FLOOR, UNITS)
    assert "4 -> 1 N, 40 -> 10 times the noise (-75 %)" in sentence


def test_without_a_noise_floor_the_error_stands_alone():
    sentence = changes(BEFORE, BEFORE * [0.5, 1, 1], None, UNITS)
    assert sentence == "joint 1: 1 -> 0.5 N m (-50 %)."


def verdict(grade):
    """All lines of one grade, the noise known."""
    texts = {
        FIT: "No joint errs more than 1 times its noise.",
        PREDICTION: "1 % error.",
        MISSING: "Nothing beyond the noise; `diagnose` looks below it. The links can exist.",
    }
    lines = tuple(Line(about, grade, text) for about, text in texts.items())
    return Verdict(
        lines,
        (1.0, 1.0, 1.0),
        "repetition",
        ("test",),
        links="The links can exist.",
        links_are_possible=grade != "do not use",
    )


def test_a_second_diagnosis_replaces_what_the_first_one_said():
    lacking = verdict("good").with_missing("The model lacks base tilt.", True)
    complete = lacking.with_missing("All that was found is in the model.", False)
    assert complete == verdict("good").with_missing(
        "All that was found is in the model.", False
    )
    assert complete.grade == "good"
    assert "base tilt" not in str(complete)


def test_a_model_that_lacks_a_finding_is_at_most_usable():
    lacking = verdict("good").with_missing("Found and not added: base tilt.", True)
    assert lacking.grade == "usable"
    assert lacking.headline.startswith("Usable. Found and not added: base tilt.")


@pytest.mark.parametrize("grade", ["good", "do not use"])
def test_a_weak_finding_leaves_the_grade(grade):
    assert (
        verdict(grade).with_missing("Weak and not added: backlash.", False).grade
        == grade
    )
