"""A wrong shape constant of the model's own effects is no missing effect: it is said, and added."""

import json
from dataclasses import replace

import numpy as np
import pytest
from arms import run_of_widths

from sdp_vs_penalty import Estimate, InputError, Measurements, Problem, add, diagnose, identify
from sdp_vs_penalty.diagnosis import Diagnosis
from sdp_vs_penalty.diagnosis.conclude import retune
from sdp_vs_penalty.estimation.shapes import ShapeEstimate
from sdp_vs_penalty.problem import as_problem

EFFECTS = "rigid_body,viscous_friction,torque_offset,coulomb_friction@v_s=0.01"
#: Truth: one in the middle of the usual range, a sharp one, the given one, one beyond the range.
WIDTHS = (0.003, 0.0001, 0.01, 0.08)


@pytest.fixture(scope="module")
def run(scara_arm: Problem) -> Measurements:
    """A motion that repeats."""
    return run_of_widths(scara_arm, WIDTHS, 24.0)


@pytest.fixture(scope="module")
def estimate(run: Measurements, scara_arm: Problem) -> Estimate:
    return identify(scara_arm, run, "ols", effects=EFFECTS)


@pytest.fixture(scope="module")
def found(estimate: Estimate, run: Measurements) -> Diagnosis:
    return diagnose(estimate, run, run)


def test_no_effect_is_named_for_a_wrong_constant(found):
    assert found.verdict == "nothing_missing"
    assert not found.effects
    retuned = {r.joint: r for r in found.retuned}
    assert {1, 4} <= set(retuned) <= {1, 2, 4}
    for joint in (1, 4):
        assert retuned[joint].estimate.after == pytest.approx(WIDTHS[joint - 1], rel=0.15)
        assert retuned[joint].confidence == "confident"
        assert retuned[joint].rmse_after < retuned[joint].rmse_before
    if 2 in retuned and retuned[2].estimate.after < 3e-5:
        assert retuned[2].confidence == "weak"  # at the end of its range


def test_add_applies_them_from_the_file_and_by_name(found, estimate, run):
    again = Diagnosis.from_dict(json.loads(json.dumps(found.to_dict(), allow_nan=False)))
    from_file = add(estimate, again, run)
    by_name = add(estimate, ",".join(r.text for r in found.retuned), run)
    np.testing.assert_array_equal(from_file.theta, by_name.theta)
    assert from_file.model.sign_width[3] == pytest.approx(WIDTHS[3], rel=0.15)
    with pytest.raises(InputError, match="list effect coulomb_friction only once"):
        add(estimate, "coulomb_friction:1", run)


def test_findings_without_retunes_still_load(found):
    old = {k: v for k, v in found.to_dict().items() if k != "retuned"}
    assert Diagnosis.from_dict(old).retuned == ()


def test_at_the_end_of_its_range_a_constant_is_weak():
    known = {"effect": "coulomb_friction", "joint": 1, "shape": "v_s", "before": 0.01, "after": 0.02}
    errors = np.array([0.0, 1.0]), np.array([0.0, 0.5])
    both = [ShapeEstimate(**known, at_end=x) for x in (False, True)]
    made = [retune(s, as_problem("two_link").robot, *errors) for s in both]
    assert [r.confidence for r in made] == ["confident", "weak"]
    assert all(r.joint == 2 and (r.rmse_before, r.rmse_after) == (1.0, 0.5) for r in made)


def test_changed_constants_are_chosen_by_confidence(found):
    sure = next(r for r in found.retuned if r.confidence == "confident")
    both = replace(found, retuned=(sure, replace(sure, confidence="weak")))
    assert both.selected().retuned == both.retuned
    assert both.selected(confident=True).retuned == (sure,)
    assert "with the findings" in repr(both)
    assert "with the findings" not in repr(replace(found, retuned=()))
