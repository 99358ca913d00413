"""Reverse engineering from a black box, against the links that answered."""

import numpy as np
import pytest
from commands import run_cli
from hypothesis import given, settings
from hypothesis import strategies as st

from sdp_vs_penalty import InputError, Problem, identify, load_estimate, load_problem
from sdp_vs_penalty.regression import BlackBox, load_answers
from sdp_vs_penalty.regression.base_parameters import base_parameters
from sdp_vs_penalty.regression.black_box import compress_black_box
from sdp_vs_penalty.simulation import experiment


def answers(problem: Problem, count: int, seed: int = 0) -> BlackBox:
    links = experiment(problem).links
    return BlackBox.of_links(problem.robot, links, problem.robot.random_configurations(count, seed))


@settings(max_examples=10, deadline=None)
@given(name=st.sampled_from(["panda", "two_link"]), seed=st.integers(0, 1000))
def test_base_parameters_come_back(name, seed):
    problem = load_problem(name)
    estimate = identify(problem, answers(problem, 60, seed), "reverse-engineering")
    base, _ = base_parameters(problem.model("rigid_body"), problem.independent)
    truth = base @ experiment(problem).links.ravel()
    np.testing.assert_allclose(base @ estimate.theta, truth, atol=1e-8)
    assert estimate.details["relative_error_percent"] < 1e-8
    assert estimate.details["condition_number"] > 1.0


def test_the_rows_are_gravity_and_the_upper_triangle(panda):
    box = answers(panda, 3)
    model = panda.model("rigid_body")
    data = compress_black_box(box, model).least_squares()
    assert data.rows == 3 * (7 + 28)
    upper = np.triu_indices(7)
    expected = np.sum(box.gravity**2) + sum(np.sum(m[upper] ** 2) for m in box.mass_matrix)
    assert data.tau_squared == pytest.approx(expected)
    assert data.loss(experiment(panda).links.ravel()) < 1e-16 * expected
    # A wrong entry of M shows in the loss with its own size, whichever side of the factors it is on.
    wrong = box.mass_matrix.copy()
    wrong[1, 2, 5] = wrong[1, 5, 2] = wrong[1, 2, 5] + 0.1
    loss = compress_black_box(BlackBox(box.q, box.gravity, wrong), model).least_squares()
    assert loss.loss(experiment(panda).links.ravel()) == pytest.approx(0.01)


def test_a_friction_model_cannot_come_from_a_black_box(panda):
    with pytest.raises(InputError, match="rigid_body"):
        identify(panda, answers(panda, 20), "reverse-engineering", effects="rigid_body,viscous_friction")


def test_measured_runs_are_refused_with_what_is_needed(two_link):
    with pytest.raises(InputError, match="mass_matrix"):
        identify(two_link, experiment(two_link).training_run(), "reverse-engineering")


def test_a_consistent_model_from_a_black_box(two_link):
    estimate = identify(two_link, answers(two_link, 40), "lmi-sdp-plain")
    assert estimate.certificate.violations["pseudo-inertia"] == 0.0
    base, _ = base_parameters(two_link.model("rigid_body"), two_link.independent)
    truth = base @ experiment(two_link).links.ravel()
    np.testing.assert_allclose(base @ estimate.theta, truth, atol=1e-4)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"gravity": None}, "array gravity is missing"),
        ({"gravity": np.zeros((5, 6))}, r"shape \(5, 6\)"),
        ({"mass_matrix": np.zeros((5, 7))}, "array mass_matrix has shape"),
        ({"q": np.full((5, 7), np.nan)}, "configuration 1: not a finite number"),
        ({"mass_matrix": np.triu(np.ones((5, 7, 7)))}, "not symmetric"),
        ({"q": np.zeros(7)}, "one row a configuration"),
    ],
)
def test_bad_files_are_named(tmp_path, change, message):
    file = tmp_path / "box.npz"
    arrays = {"q": np.zeros((5, 7)), "gravity": np.zeros((5, 7)), "mass_matrix": np.zeros((5, 7, 7))}
    np.savez(file, **{k: v for k, v in (arrays | change).items() if v is not None})
    with pytest.raises(InputError, match=message):
        load_answers(file)


def test_another_robots_file_and_several_files_are_refused(panda, tmp_path):
    box, file = answers(panda, 20), tmp_path / "box.npz"
    np.savez(file, q=box.q, gravity=box.gravity, mass_matrix=box.mass_matrix)
    with pytest.raises(InputError, match="7 joint"):
        load_answers(file, joints=2)
    with pytest.raises(InputError, match="from one file"):
        load_answers([file, file])
    assert load_answers([tmp_path / "run.csv"]) is None
    (tmp_path / "torn.npz").write_bytes(file.read_bytes()[:100])
    assert load_answers(tmp_path / "torn.npz") is None


def test_the_command_line_takes_a_black_box(panda, tmp_path, capsys):
    box, file = answers(panda, 30), tmp_path / "blackbox.npz"
    np.savez(file, q=box.q, gravity=box.gravity, mass_matrix=box.mass_matrix)
    words = ["identify", "panda", "--data", str(file), "--method", "reverse-engineering"]
    assert run_cli(*words, "--out", tmp_path / "model.json") == 0
    assert "reverse-engineering" in capsys.readouterr().out
    base, _ = base_parameters(panda.model("rigid_body"), panda.independent)
    theta = load_estimate(tmp_path / "model.json").theta
    np.testing.assert_allclose(base @ theta, base @ experiment(panda).links.ravel(), atol=1e-8)
