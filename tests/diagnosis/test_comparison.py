"""Measured against modelled: every figure from its definition, one band for all, one
JSON form."""

import json
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from arms import SCARA, write_urdf
from random_robots import repeating_run as run_of
from recorded import refusal

from sdp_vs_penalty import (
    identify,
    load_estimate,
    load_measurements,
    load_problem,
    where_it_fails,
)
from sdp_vs_penalty.data import Measurements
from sdp_vs_penalty.diagnosis import compare, predicted, upper_relative_error
from sdp_vs_penalty.diagnosis.comparison import Comparisons
from sdp_vs_penalty.signals import FilteredRun, FilteredRuns, Preprocessing


@pytest.fixture(scope="module")
def estimate(two_link):
    return identify(two_link, run_of(two_link, 0), check=False)


def test_figures_are_those_of_their_definitions(two_link, estimate):
    run = run_of(two_link, 1)
    (found,) = compare(estimate, run)
    rows = FilteredRun(run, estimate.preprocessing).all_rows(estimate.model)
    model = np.column_stack(
        [c.columns @ estimate.theta[c.indices] for c in rows.columns]
    )
    error = rows.torque - model
    np.testing.assert_allclose(found.mse, np.mean(error**2, axis=0), rtol=1e-12)
    np.testing.assert_allclose(found.rmse, np.sqrt(found.mse), rtol=1e-12)
    spread = np.mean((rows.torque - rows.torque.mean(axis=0)) ** 2, axis=0)
    np.testing.assert_allclose(found.r2, 1.0 - found.mse / spread, rtol=1e-12)
    relative = 100.0 * np.sqrt(np.sum(error**2) / np.sum(rows.torque**2))
    assert found.relative_error_percent == pytest.approx(relative, rel=1e-12)
    within = np.mean(np.abs(error) <= found.rare_error, axis=0)
    np.testing.assert_allclose(within, 0.99, atol=1.5 / len(error))
    assert found.band_hz == estimate.preprocessing.torque_cutoff
    np.testing.assert_allclose(predicted(rows, estimate.theta), model, rtol=1e-12)
    table = found.signals.to_frame()
    np.testing.assert_allclose(table[["residual1", "residual2"]], error, atol=1e-12)
    np.testing.assert_array_equal(table.dq2, rows.motion.dq[:, 1])
    np.testing.assert_array_equal(table.index, rows.motion.t)


def test_a_robots_file_is_the_baseline_of_a_model(tmp_path):
    """By the links and damping that it states, behind the model's filters."""
    path = write_urdf(tmp_path / "arm.urdf", "arm", SCARA[:2])
    problem = load_problem(path)
    estimate = identify(problem, run_of(problem, 0), check=False)
    run = run_of(problem, 1)
    file, ours = compare({"file": path, "ours": estimate}, run)
    (alone,) = compare(estimate, run)
    np.testing.assert_array_equal(ours.mse, alone.mse)
    np.testing.assert_array_equal(file.noise[0], alone.noise[0])
    model = estimate.model
    stated = estimate.with_theta(problem.nominal(model))
    np.testing.assert_allclose(file.mse, compare(stated, run)[0].mse, rtol=1e-12)
    assert file.new_motion_share == 1.0
    assert np.all(file.mse > ours.mse)
    assert compare(problem, run)[0].mse == pytest.approx(file.mse, rel=0.5)


def test_a_log_behind_filters_is_judged_as_the_log_is(two_link, estimate):
    run = run_of(two_link, 1)
    filtered = FilteredRuns.filtering(run, two_link.preprocessing)
    (one,), (other,) = compare(estimate, run), compare(estimate, filtered)
    np.testing.assert_array_equal(one.mse, other.mse)
    np.testing.assert_array_equal(
        identify(two_link, filtered, check=False).theta,
        identify(two_link, run, check=False).theta,
    )
    refusal(
        lambda: identify("panda", filtered, check=False), "2 joints, the robot has 7"
    )


def test_a_window_has_the_noise_of_the_recording_that_it_was_cut_from(two_link):
    run = run_of(two_link, 0)
    whole = identify(two_link, run, check=False)
    window = run.window(0.0, 0.4 * float(run.t[-1]))
    cut = identify(two_link, window, check=False)
    assert whole.provenance["noise"]["source"] == "repetition"
    assert cut.provenance["noise"]["source"] == "repetition"
    (of_window,), (of_two,) = (
        compare(cut, part) for part in (window, [window, run.window(1.0, 2.0)])
    )
    for found in (of_window, of_two):
        np.testing.assert_array_equal(
            found.noise_floor, compare(cut, run)[0].noise_floor
        )
    # A changed copy is another recording.
    assert replace(window, tau=-window.tau).recording.samples == window.samples


def test_currents_are_in_amperes_wherever_they_are_shown(two_link, tmp_path):
    """ "Joint 1 errs by 0.0851 N m" was said of a log of motor currents."""
    run = run_of(two_link, 0)
    heads = "time,position_1,position_2,current_1,current_2"
    rows = np.column_stack([run.t, run.q, run.tau / 7.0])
    path = tmp_path / "currents.csv"
    np.savetxt(path, rows, delimiter=",", header=heads, comments="", fmt="%.9g")
    measured = load_measurements(path)
    assert measured.window(0.0, 5.0).torque_unit == "A"
    model = identify(two_link, measured, effects="rigid_body", check=False)
    model.save(tmp_path / "model.json")
    (found,) = compare(load_estimate(tmp_path / "model.json"), measured)
    assert " A, " in found.verdict.headline or " A)" in found.verdict.headline
    assert "N m" not in found.verdict.headline


def test_the_loss_that_was_minimised_is_the_error_that_is_shown(two_link):
    """With all joints weighted alike: certificate.loss = sum of squares over the rows
    of compare()."""
    run = run_of(two_link, 0)
    plain = identify(two_link, run, weighting="none", check=False)
    (found,) = compare(plain, run)
    rows = len(FilteredRun(run, plain.preprocessing).all_rows(plain.model).torque)
    assert rows * found.mse.sum() == pytest.approx(plain.certificate.loss, rel=1e-9)


def test_models_are_judged_in_one_band(two_link, estimate):
    run = run_of(two_link, 1)
    narrow = identify(
        two_link, run, "ols", preprocessing=Preprocessing(3.0, 4.0), check=False
    )
    found = compare({"a": estimate, "b": narrow}, run)
    assert [c.name for c in found] == ["a", "b"]
    assert found[0].band_hz == found[1].band_hz == estimate.preprocessing.torque_cutoff
    asked = compare({"a": estimate, "b": narrow}, run, Preprocessing(6.0, 9.0))
    assert {c.band_hz for c in asked} == {9.0}
    # In a list each has a name of its own.
    assert len({c.name for c in compare([estimate, estimate], run)}) == 2


def test_a_model_keeps_the_noise_of_its_own_runs(two_link, estimate, tmp_path):
    """And of no others, nor behind other filters; no damaged one is saved."""
    run = run_of(two_link, 0)
    other = Preprocessing(6.0, 9.0)
    forgetful = replace(estimate, provenance=dict(estimate.provenance))
    del forgetful.provenance["noise"]
    estimate.save(tmp_path / "model.json")
    loaded = load_estimate(tmp_path / "model.json")
    for own, settings in ((run, None), (run, other), (run_of(two_link, 1), None)):
        (kept,), (anew,) = (compare(m, own, settings) for m in (loaded, forgetful))
        assert kept.to_dict() == anew.to_dict()
    loaded.provenance["noise"]["floor"] = [7.0, 8.0]
    assert compare(loaded, run)[0].noise_floor.tolist() == [
        7.0,
        8.0,
    ]  # it is not measured again
    assert compare(loaded, run, other)[0].noise_floor.tolist() != [7.0, 8.0]
    for damage in (
        {"floor": [1.0]},
        {"source": None},
        {"data_hash": 3},
        {"floor": "x"},
    ):
        worse = replace(loaded, provenance={**loaded.provenance})
        worse.provenance["noise"] = {**loaded.provenance["noise"], **damage}
        refusal(partial(worse.save, tmp_path / "damaged.json"), "provenance.noise")


def test_json_has_null_for_what_is_undefined(two_link, estimate):
    run = run_of(two_link, 1)
    dead = Measurements(run.t, run.q + 0.02 * run.t[:, None], run.tau * [1.0, 0.0])
    model = compare(estimate, dead)[0].to_dict()
    assert model["model"] == "lmi-sdp"
    assert model["noise_floor"] != [
        None,
        None,
    ]  # the motion drifts: the spectrum shows it
    assert model["r2"][1] is None  # a torque channel without variance
    json.dumps(model, allow_nan=False)


@pytest.mark.real_data
def test_the_real_panda_repeats_and_has_a_floor_below_every_error(panda, panda_run):
    """Its motion repeats after 2 pi / 0.15 pi = 13.33 s; the floor is what no model can
    beat."""
    estimate = identify(panda, panda_run.window(0.0, 14.0), check=False)
    (found,) = compare(estimate, panda_run)
    assert np.all(found.noise_floor < found.rmse)
    assert np.all(found.noise_floor > 1e-3)
    assert np.all(found.r2 > 0.85)
    # A window of a few seconds repeats nothing: the run that it is of shows the noise.
    for part in (
        panda_run.window(8.0, 13.2),
        [panda_run.window(0.0, 5.0), panda_run.window(8.0, 13.2)],
    ):
        (window,) = compare(estimate, part, noise_from=panda_run)
        np.testing.assert_allclose(window.noise_floor, found.noise_floor)


@pytest.mark.parametrize("every", [1, 4], ids=["250 Hz", "63 Hz"])
@pytest.mark.parametrize("base", [0.1, 0.03], ids=["fast", "slow"])
def test_a_ripple_is_seen_by_its_order_and_amplitude(two_link, base, every):
    """Neither the speed nor the rate of the log changes the amplitude: that of least
    squares, 0.6 N m."""
    run = run_of(two_link, 0, noise=0.05, base=base)
    model = identify(two_link, run, check=False)
    tau = run.tau + [[0.0, 0.6]] * np.sin(40.0 * run.q)
    rippled = Measurements(run.t[::every], run.q[::every], tau[::every])
    first, second = where_it_fails(model, rippled)
    wave = second.orders[0]
    assert wave.per_revolution == 40
    assert wave.amplitude == pytest.approx(0.6, rel=0.02)
    assert wave.over_surroundings > 6.0
    assert 40 not in [wave.per_revolution for wave in first.orders]


@pytest.mark.parametrize(
    ("errors", "torques", "low", "high"),
    [
        ([1.0] * 2, 9.0, np.inf, np.inf),  # few stretches rule nothing out
        ([1.0] * 20, 100.0, 9.999, 10.001),  # equal ones are certain
        ([30.0] + [1.0] * 19, 100.0, 20.0, np.inf),
    ],
)
def test_a_relative_errors_interval_grows_with_what_differs(errors, torques, low, high):
    upper = upper_relative_error(np.array(errors), np.full(len(errors), torques))
    assert low <= upper <= high


def test_models_are_printed_with_the_errors_of_the_same_joints(two_link, estimate):
    """Each headline names its own worst joint, which cannot be compared."""
    found = compare({"a": estimate, "b": estimate}, run_of(two_link, 1))
    noise = np.array([0.1, 0.1])
    first = replace(found[0], rmse=np.array([0.3, 0.1]), noise_floor=noise)
    second = replace(found[1], rmse=np.array([0.1, 0.2]), noise_floor=noise)
    both = Comparisons([first, second])
    lines = [line.strip() for line in str(both).splitlines()]
    assert lines[3:] == [
        "joint 1: 0.3 -> 0.1 N m, 3 -> 1 times the noise",
        "joint 2: 0.1 -> 0.2 N m, 1 -> 2 times the noise",
    ]
    short = [line.removesuffix("...") for line in repr(both).splitlines()]
    pairs = zip(str(both).splitlines(), short, strict=True)
    assert all(whole.startswith(cut) for whole, cut in pairs)
    many = Comparisons([first, second, first, second])
    assert len(repr(many).splitlines()) == 5
    assert "joint 2: 0.1 -> 0.2 -> 0.1 -> 0.2 N m" in str(many)
