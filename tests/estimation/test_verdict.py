"""The one verdict: what it takes to be good, and that knowing less never makes it
better."""

from dataclasses import replace

import numpy as np
import pytest

from sdp_vs_penalty.estimation import (
    GRADES,
    MISSING,
    PREDICTION,
    Certificate,
    ErrorsBesideNoise,
    Verdict,
    judge,
    over_noise,
)

RMSE = np.array([0.1, 0.2])
R2 = np.array([0.99, 0.98])
MASSES = np.array([3.0, 1.0])
SOUND = Certificate({"pseudo-inertia": 0.0}, 1.0)


def verdict(
    certificate=SOUND,
    masses=MASSES,
    floor=RMSE / 1.5,
    relative=1.2,
    shares=None,
    **known,
):
    """Judge errors RMSE beside this noise floor; relative : each joint's error [% of
    its torque], or ``shares`` (n,)."""
    torque = 100.0 * RMSE / (relative if shares is None else shares)
    found = {
        "errors": ErrorsBesideNoise(RMSE, floor, torque, units=("N*m", "N*m")),
        "r2": R2,
        "noise_source": "repetition",
        "outside": 0.0,
        "new_share": 0.9,
        "certificate": certificate,
        "masses": masses,
    }
    return judge(nominal=MASSES, judged_on=("test.csv",), **found | known)


def test_good_takes_a_known_floor_unseen_motion_and_links_that_exist():
    good = verdict()
    assert good.grade == "good"
    assert all(line.grade == "good" for line in good.lines)
    assert good.error_over_noise == pytest.approx((1.5, 1.5))


@pytest.mark.parametrize(
    "less", [{"floor": None}, {"new_share": None}, {"new_share": 0.2}]
)
@pytest.mark.parametrize("relative", [1.2, 12.0, 48.5])
@pytest.mark.parametrize("times", [1.5, 1.9, 13.0])
def test_knowing_less_is_never_better(less, relative, times):
    known = verdict(relative=relative, floor=RMSE / times)
    ignorant = verdict(**{"relative": relative, "floor": RMSE / times, **less})
    assert GRADES.index(ignorant.grade) <= GRADES.index("usable")
    if known.grade != "do not use":
        assert GRADES.index(ignorant.grade) <= GRADES.index(known.grade)


def test_half_the_torque_unexplained_is_no_model():
    bad = verdict(relative=48.5, floor=None)
    assert bad.grade == "do not use"
    assert bad.headline.startswith(
        "Do not use. Joint 1 errs most: 48.5 % of its torque (0.1 N m); usable is up to"
        " 15 %; more than that: joint 2; no noise could be measured"
    )
    # What is noise is not the model's fault.
    assert verdict(relative=20.0, floor=RMSE / 1.01).grade == "good"


def test_one_joint_that_errs_by_half_its_torque_makes_the_arm_unusable():
    """A torque controller drives each joint by its own torque."""
    bad = verdict(shares=np.array([0.5, 49.0]), floor=RMSE / 20.0)
    assert bad.grade == "do not use"
    assert bad.headline == (
        "Do not use. Joint 2 errs most: 20 times its noise, 48.9 % of its torque"
        " (0.2 N m); usable is up to 15 %."
    )
    assert verdict(shares=np.array([0.5, 14.0]), floor=RMSE / 20.0).grade == "usable"


def test_an_error_on_training_motion_says_so():
    errors = ErrorsBesideNoise(
        RMSE, RMSE / 4.0, 10.0 * RMSE, ("N*m", "N*m"), "on training motion"
    )
    assert errors.joint_errs(2) == (
        "Joint 2 errs most: 4 times its noise (0.2 N m, on training motion); good is up to"
        " 2 times"
    )
    assert errors.joint_errs(1).rpartition(" (")[2] in verdict(errors=errors).headline


def test_one_rule_says_which_joint_errs_most():
    """By multiples of the noise; without a floor by the share of the joint's torque."""
    torque = np.array([1.0, 0.1])
    errors = ErrorsBesideNoise(RMSE, RMSE / (8.0, 4.0), torque, ("N*m", "N*m"))
    assert errors.worst_of([1, 2]) == 1
    assert errors.worst_of([2]) == 2
    unknown = replace(errors, floor=None)
    assert unknown.worst_of([1, 2]) == 2


def test_a_joint_that_makes_a_model_unusable_is_the_worst_one():
    """Another one errs by more times its noise, and by little of its torque."""
    torque = np.array([100.0, 0.4])
    errors = ErrorsBesideNoise(RMSE, RMSE / (8.0, 4.0), torque, ("N*m", "N*m"))
    assert errors.unusable == [2]
    assert errors.worst_joint == 2
    assert errors.size_in_words == "48.4 % of its torque"
    usable = replace(errors, torque=100.0 * RMSE)
    assert usable.worst_joint == 1
    assert usable.size_in_words == "8 times its noise"
    assert replace(usable, floor=RMSE).size_in_words == "within noise"
    assert replace(usable, floor=RMSE).size == 0.0


def test_which_joint_errs_comes_before_what_is_in_doubt_of_the_log():
    doubted = verdict(floor=RMSE / 4.0, doubt="In doubt: torque sign.")
    assert doubted.lines[0].about == "the log"
    assert doubted.headline.startswith("Usable. Joint 1 errs most: 4 times ")
    assert doubted.headline.endswith(". In doubt: torque sign.")


def test_links_that_cannot_be_are_not_to_be_used():
    broken = verdict(Certificate({"pseudo-inertia": 0.04}, 1.0))
    assert broken.grade == "do not use"
    assert broken.lines[0].about == MISSING
    assert "No robot is like this" in broken.headline
    assert verdict(Certificate({}, 1.0, body_share=1.3)).grade == "do not use"
    assert verdict(Certificate({}, 1.0, body_share=1.0)).grade == "good"  # fills it
    # Nor an estimate whose own certificate says so.
    assert verdict(Certificate({}, 1.0, gap=0.34)).grade == "do not use"
    # The certificate is of the constraints, which allow a link of ten grams.
    assert (
        "Link 2 weighs less than a thousandth of the arm (30 kg): constraints allow that"
        in verdict(masses=np.array([30.0, 0.01])).headline
    )
    # An upper bound on an inertia about the centre of mass is not convex, and rounding
    # is none.
    assert verdict(Certificate({"pseudo-inertia": 1e-12}, 1.0)).grade == "good"


def test_a_joint_without_a_model_is_named():
    """A small error of the whole arm does not hide a joint whose mean torque does
    better."""
    found = verdict(r2=np.array([0.99, -5.7]), floor=RMSE / 3.0)
    assert found.grade == "usable"
    assert "joint 2: worse than a constant torque" in str(found)
    # What is not to be used does not become usable by it.
    assert (
        verdict(r2=np.array([0.1, -5.7]), relative=60.0, floor=RMSE / 30.0).grade
        == "do not use"
    )
    # A joint that is held still: its error is noise, and so is its torque.
    assert verdict(r2=np.array([0.99, -5.7])).grade == "good"


def test_it_survives_json():
    found = verdict()
    assert Verdict.from_dict(found.to_dict()) == found
    with pytest.raises(ValueError, match=r"field lines\[0\].grade: .*'fine'"):
        Verdict.from_dict(
            {
                **found.to_dict(),
                "lines": [{"about": "fit", "grade": "fine", "text": ""}],
            }
        )


def test_a_prediction_is_not_good_where_the_motion_is_too_short_to_tell():
    found = verdict(highest=7.0)
    (line,) = (line for line in found.lines if line.about == PREDICTION)
    assert line.grade == "usable"
    assert line.text.startswith("Too short to tell")


@pytest.mark.parametrize(
    ("new_share", "n_determined", "grade"),
    [(0.1, 16, "do not use"), (0.1, 40, "usable"), (0.9, 16, "good")],
    ids=["a glimpse", "enough", "shown on new motion"],
)
def test_a_model_that_its_prior_makes_is_not_to_be_used(new_share, n_determined, grade):
    """0.6 s of motion determined 16 of 58 base parameters: "usable"."""
    found = verdict(new_share=new_share, determined=(n_determined, 58))
    assert found.grade == grade


def test_a_prediction_is_good_where_other_errors_are_ruled_out():
    found = verdict(highest=4.0)
    (line,) = (line for line in found.lines if line.about == PREDICTION)
    assert line.grade == "good"


@pytest.mark.parametrize(
    ("floor", "ratios"),
    [
        ([0.05, 0.4], [2.0, 0.5]),
        (None, None),
        ([None, None], None),
        ([0.05, 0.0], None),  # an error beside a noise that is none
    ],
)
def test_a_multiple_of_the_noise_takes_a_noise(floor, ratios):
    found = over_noise(RMSE, floor)
    assert (None if found is None else found.tolist()) == ratios
    assert over_noise(np.array([0.1, 0.0]), np.array([0.05, 0.0])).tolist() == [
        2.0,
        1.0,
    ]
