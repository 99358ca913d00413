"""Adding effects to a model: under the bounds of its own problem, whatever its robot is
called."""

import json
from dataclasses import replace

import numpy as np
import pytest
from arms import HEAVY, THREE, run_of_widths, write_urdf
from commands import run_cli
from small_runs import small_run

import sdp_vs_penalty as sdp
from sdp_vs_penalty.data import concatenate, save
from sdp_vs_penalty.diagnosis import Diagnosis
from sdp_vs_penalty.diagnosis.doubts import Doubt
from sdp_vs_penalty.estimation.nominal import nominal_model
from sdp_vs_penalty.robot import random_trajectory
from sdp_vs_penalty.simulation.hidden_runs import hidden_runs


def reloaded(estimate, folder):
    estimate.save(folder / "model.json")
    return sdp.load_estimate(folder / "model.json")


@pytest.mark.parametrize(
    ("name", "axes"),
    [("two_link", HEAVY), pytest.param("panda", THREE, marks=pytest.mark.long)],
)
def test_a_urdf_keeps_its_own_bounds_whatever_it_is_called(name, axes, tmp_path):
    problem = sdp.load_problem(write_urdf(tmp_path / "arm.urdf", name, axes))
    made = hidden_runs(problem, [("joint_spring", [1])], "strong", seed=7)
    data = concatenate([run.rows(slice(None, None, 10)) for run in made.runs[:3]])
    estimate = sdp.identify(
        problem, data, effects=made.truth["model_effects"], check=False
    )
    bigger = sdp.add(reloaded(estimate, tmp_path), "joint_spring:2", data)
    before, after = sdp.compare({"before": estimate, "after": bigger}, made.runs[3])
    assert after.rmse[1] < 0.5 * before.rmse[1]
    assert bigger.certificate.worst == 0.0
    assert bigger.certificate.gap is not None
    assert np.all(bigger.links[:, 0] <= 100.0)


def test_a_frozen_addition_is_judged_with_the_model_that_it_extends(tmp_path):
    """Least squares ends outside the constraints; a payload beside it does not mend
    that."""
    problem = sdp.load_problem(write_urdf(tmp_path / "arm.urdf", "arm", THREE))
    data = small_run(problem)
    estimate = sdp.identify(problem, data, "ols", check=False)
    assert estimate.certificate.worst > 0.0
    loaded = sdp.add(estimate, "payload", data)
    np.testing.assert_array_equal(loaded.theta[:-10], estimate.theta)
    assert loaded.certificate.violations == problem.constraints(loaded.model).worst(
        loaded.theta
    )
    assert loaded.certificate.gap is not None
    assert (
        loaded.certificate.smallest_thickness == estimate.certificate.smallest_thickness
    )
    text = str(loaded.certificate)
    assert "every constraint holds" not in text
    assert f"{', '.join(problem.default_effects)} held fixed" in text


def test_what_is_added_beside_a_payload_leaves_the_links_alone(tmp_path):
    """A payload is the last link's twin: refitted together, neither would be
    determined."""
    problem = sdp.load_problem(write_urdf(tmp_path / "arm.urdf", "arm", THREE))
    data = small_run(problem)
    loaded = sdp.add(sdp.identify(problem, data, check=False), "payload", data)
    more = sdp.add(reloaded(loaded, tmp_path), "joint_spring:2", data)
    np.testing.assert_array_equal(more.theta[:-1], loaded.theta)
    assert [e.name for e in more.model.effects[-2:]] == ["payload", "joint_spring"]
    mixed = sdp.add(
        sdp.identify(problem, data, check=False), "payload,joint_spring:2", data
    )
    np.testing.assert_array_equal(mixed.theta[: -10 - 1], loaded.theta[:-10])


@pytest.mark.parametrize("effects", ["payload", "joint_spring:2"])
def test_an_extended_model_is_judged_on_its_runs(effects, tmp_path):
    """In Python as by the command, with a verdict of its own."""
    arm = write_urdf(tmp_path / "arm.urdf", "arm", THREE)
    run = small_run(sdp.load_problem(arm))
    save(run, tmp_path / "run.csv")
    model = sdp.identify(arm, tmp_path / "run.csv", check=False)
    model.save(tmp_path / "model.json")
    extended = sdp.add(model, effects, tmp_path / "run.csv")
    expected = sdp.compare(extended, tmp_path / "run.csv")[0].verdict
    assert extended.verdict == expected
    out = tmp_path / "extended.json"
    words = ["add", tmp_path / "model.json", effects, "--out", out]
    assert run_cli(*words, "--data", tmp_path / "run.csv") == 0
    assert sdp.load_estimate(out).verdict == expected


def test_bounds_of_a_later_version_do_not_change_an_old_model(tmp_path, monkeypatch):
    """The defaults of a robot without published bounds are written into its model."""
    problem = sdp.load_problem(write_urdf(tmp_path / "arm.urdf", "arm", THREE))
    estimate = sdp.identify(problem, small_run(problem), "ols", check=False)
    before = problem.constraints(estimate.model)
    monkeypatch.setattr("sdp_vs_penalty.problem.constants.DEFAULT_RADIUS", 9.0)
    monkeypatch.setattr(
        "sdp_vs_penalty.problem.constants.DEFAULT_LINK_MASS", (1.0, 7.0)
    )
    after = reloaded(estimate, tmp_path).problem.constraints(estimate.model)
    assert len(before.convex) == len(after.convex)
    for old, new in zip(before.convex, after.convex, strict=True):
        assert (old.family, old.name, old.cone) == (new.family, new.name, new.cone)
        np.testing.assert_array_equal(old.constant, new.constant)
        np.testing.assert_array_equal(old.coefficients, new.coefficients)
    fresh = sdp.load_problem(tmp_path / "arm.urdf").link_sizes[0]
    assert fresh[0] != estimate.problem.link_sizes[0][0]


@pytest.mark.parametrize("width", [pytest.param(0.01, marks=pytest.mark.long), 0.002])
def test_a_width_that_took_the_new_effects_torque_gives_it_back(width):
    """Without Stribeck friction in the model, Coulomb friction turns over another
    velocity."""
    problem = sdp.load_problem("two_link")
    trajectory = random_trajectory(problem.robot, seed=3, duration=20.0)
    t = np.arange(0.0, 20.0, 0.005)
    q, dq, ddq = trajectory.states(t)
    tau = problem.robot.inverse_dynamics(problem.nominal_links, q, dq, ddq)
    size = 0.6 * tau[:, 1].std()
    noise = 0.05 * tau.std(axis=0)
    tau += 0.4 * dq + 0.8 * np.tanh(dq / width) + 0.3
    tau[:, 1] += size * np.tanh(dq[:, 1] / width) * np.exp(-((dq[:, 1] / 0.07) ** 2))
    data = sdp.Measurements(
        t, q, tau + noise * np.random.default_rng(0).normal(size=tau.shape)
    )
    effects = "rigid_body,viscous_friction,coulomb_friction,torque_offset"
    before = sdp.identify(problem, data, "ols", effects=effects, check=False)
    after = sdp.add(before, "stribeck_friction:2", data)
    assert after.model.sign_width[1] == pytest.approx(width, rel=0.1)
    found = after.uncertainty.standard[-1]
    assert found.value == pytest.approx(size, rel=0.05)
    assert found.lower < size < found.upper


EFFECTS = "rigid_body,viscous_friction,torque_offset,coulomb_friction@v_s=0.01"
#: Truth: one in the middle of the usual range, a sharp one, the given one, one beyond
#: the range.
WIDTHS = (0.003, 0.0001, 0.01, 0.08)


@pytest.fixture(scope="module")
def run(scara_arm):
    """A motion that repeats."""
    return run_of_widths(scara_arm, WIDTHS, 24.0)


@pytest.fixture(scope="module")
def estimate(run, scara_arm):
    return sdp.identify(scara_arm, run, "ols", effects=EFFECTS, check=False)


@pytest.fixture(scope="module")
def found(estimate, run):
    return sdp.diagnose(estimate, run, run)


@pytest.mark.long
def test_no_effect_is_named_for_a_wrong_constant(found):
    assert found.verdict == "nothing_missing"
    retuned = {r.joint: r for r in found.retuned}
    assert {1, 4} <= set(retuned) <= {1, 2, 4}
    for joint in (1, 4):
        assert retuned[joint].after == pytest.approx(WIDTHS[joint - 1], rel=0.15)
        assert retuned[joint].confidence == "confident"
        assert retuned[joint].rmse_after < retuned[joint].rmse_before
    if 2 in retuned and retuned[2].after < 3e-5:
        assert retuned[2].confidence == "weak"  # at the end of its range


def test_add_applies_them_from_the_file_and_by_name(found, estimate, run):
    again = Diagnosis.from_dict(
        json.loads(json.dumps(found.to_dict(), allow_nan=False))
    )
    from_file = sdp.add(estimate, again, run)
    by_name = sdp.add(estimate, ",".join(r.text for r in found.retuned), run)
    np.testing.assert_array_equal(from_file.theta, by_name.theta)
    assert from_file.model.sign_width[3] == pytest.approx(WIDTHS[3], rel=0.15)
    with pytest.raises(sdp.InputError, match="list effect coulomb_friction only once"):
        sdp.add(estimate, "coulomb_friction:1", run)


def test_constants_of_several_effects_are_estimated_beside_each_other(run, scara_arm):
    """Beside links that are held, dry friction alone would take in the viscous one: its
    width ended at the end of its range."""
    of_links = nominal_model(scara_arm).with_effects(lambda e: e.name == "rigid_body")
    links = replace(of_links, method="ols")
    terms = "viscous_friction,torque_offset,coulomb_friction"
    added = sdp.add(links, terms, run, frozen=True)
    for joint in (0, 2, 3):
        assert added.model.sign_width[joint] == pytest.approx(WIDTHS[joint], rel=0.15)


def test_changed_constants_are_chosen_by_confidence(found):
    sure = next(r for r in found.retuned if r.confidence == "confident")
    weak = replace(sure, doubts=(Doubt("small"),))
    both = replace(found, retuned=(sure, weak))
    assert both.selected().retuned == both.retuned
    assert both.selected(helpful=True).retuned == (sure,)
    near_tie = replace(sure, doubts=(Doubt("rivals"),))
    with_rival = replace(found, retuned=(sure, near_tie))
    assert with_rival.selected(helpful=True).retuned == (sure, near_tie)
    assert with_rival.selected(confident=True).retuned == (sure,)
    assert "with the findings" in repr(both)
    assert "with the findings" not in repr(replace(found, retuned=()))
