"""One posing: the file that `export-sdp` writes holds the problem that `identify`
solves."""

import json
import shutil
from dataclasses import fields, replace
from itertools import combinations
from pathlib import Path

import pytest
from numpy.testing import assert_allclose
from recorded import refusal
from sdp_readers import outside_optimum
from unchecked import identify

from sdp_vs_penalty import load_estimate, load_measurements
from sdp_vs_penalty.data import save
from sdp_vs_penalty.diagnosis.held_out import fitted_parameters
from sdp_vs_penalty.estimation import PoseOptions
from sdp_vs_penalty.estimation.proofs import posed_again, verify_proof_file
from sdp_vs_penalty.exporters.sdp import SDPA_METHOD, write_posed
from sdp_vs_penalty.parallel import Workers
from sdp_vs_penalty.problem import (
    load_problem,
    measured_runs,
    with_bounds,
    with_filters,
)
from sdp_vs_penalty.signals import Preprocessing
from sdp_vs_penalty.simulation import experiment

_FRICTION = ["rigid_body", "viscous_friction", "coulomb_friction"]
#: Joints with friction, one slide; the others take longer.
_REAL = (
    "emps",
    *(pytest.param(x, marks=pytest.mark.long) for x in ("tx40", "ur10")),
    *(pytest.param(x, marks=pytest.mark.slow) for x in ("panda", "ur10e")),
)


def _arm(name, folder):
    if name != "ur10":
        return load_problem(name), replace(
            next(iter(measured_runs(name).values())), dq=None
        )
    problem = load_problem(folder / "ur10_salerno" / "robot.urdf")
    names = problem.robot.joint_names
    return problem, load_measurements(
        folder / "ur10_salerno" / "train.csv", joints=6, names=names
    )


def _same(problem, run, tmp_path, options, **told):
    file = tmp_path / "a.dat-s"
    about = write_posed(problem, run, file, options=options)
    estimate = identify(problem, run, SDPA_METHOD, **told)
    lower = estimate.certificate.lower
    upper = estimate.certificate.upper
    assert about["method"] == SDPA_METHOD
    assert about["effects"] == [effect.text for effect in estimate.model.effects]
    assert_allclose((about["lower"], about["upper"]), (lower, upper), rtol=1e-7)
    programs = [p for p in ("csdp", "sdpa") if shutil.which(p)] or ["csdp"]
    losses = [
        about["offset"] + about["scale"] * outside_optimum(p, tmp_path)
        for p in programs
    ]
    assert min(max(lower - x, x - upper) for x in losses) <= 1e-6 * upper
    return json.loads((tmp_path / "a.dat-s.json").read_text())


@pytest.mark.real_data
@pytest.mark.parametrize("name", _REAL)
def test_the_file_holds_the_problem_that_identify_solves(name, data_folder, tmp_path):
    _same(*_arm(name, data_folder), tmp_path, PoseOptions())


def test_of_a_simulated_arm_with_friction_under_every_option(two_link, tmp_path):
    run = experiment(two_link).training_run(seed=2).window(0.0, 8.0)
    problem = with_filters(
        with_bounds(two_link.with_gravity((0.0, -9.7, 1.0)), "m2=0.1:9"), "4,6"
    )
    told = {"effects": _FRICTION, "weighting": "none"}
    about = _same(problem, run, tmp_path, PoseOptions(**told), **told)
    assert about["gravity"] == [0.0, -9.7, 1.0]
    assert about["filters"]["state_cutoff"] == 4.0
    assert any("@v_s=" in effect for effect in about["effects"])


def test_a_default_file_for_cbf_is_the_default_method(two_link, tmp_path):
    run = experiment(two_link).training_run(seed=2).window(0.0, 8.0)
    about = write_posed(two_link, run, tmp_path / "a.cbf")
    assert about["method"] == "lmi-sdp"
    estimate = identify(two_link, run)
    found = (estimate.certificate.lower, estimate.certificate.upper)
    assert_allclose((about["lower"], about["upper"]), found, rtol=1e-7)


def test_options_are_read_from_texts_and_what_is_not_given_is_the_default():
    asked = PoseOptions.from_texts(
        known="kp2=600,kd2=20",
        gain_uncertainty="0.01",
        known_loads=["load.csv:2.5"],
        effects=None,
        seed=None,
    )
    assert asked == PoseOptions(
        known={"kp2": 600.0, "kd2": 20.0},
        gain_uncertainty=0.01,
        known_loads=[(Path("load.csv"), 2.5)],
    )


@pytest.mark.parametrize(
    ("texts", "word"),
    [
        ({"known": "kp2"}, "--known"),
        ({"known_loads": ["load.csv"]}, "--known-load"),
        ({"gain_uncertainty": "a"}, "gain uncertainty"),
    ],
)
def test_a_text_that_is_no_option_is_refused(texts, word):
    refusal(lambda: PoseOptions.from_texts(**texts), word)


#: A value other than the default of each option; runs stand for what only a run has.
CHOICES = {
    "effects": "rigid_body,viscous_friction,torque_offset",
    "preprocessing": Preprocessing(12.0, 8.0),
    "weighting": "none",
    "gain_uncertainty": 0.02,
    "known_loads": lambda run: [(run, 0.01)],
    "seed": 3,
    "known": {"f_v1": 0.1},
    "instruments": "command",
    "workers": Workers(1),
    "progress": print,
}


#: What each option refuses, and words of the sentence; "progress" is any function.
OUT_OF_RANGE = {
    "effects": (lambda run: "coulomb_friction:3", "joint 3 does not exist"),
    "preprocessing": (lambda run: Preprocessing(-1.0, 8.0), "above 0 Hz"),
    "weighting": (lambda run: "loud", "weighting 'loud' is unknown"),
    "gain_uncertainty": (lambda run: -0.1, "relative standard deviation"),
    "known_loads": (lambda run: [(run, -1.0)], "known load of -1 kg"),
    "seed": (lambda run: -1, "whole number from 0"),
    "known": (lambda run: {"m9": 1.0}, "'m9' is unknown"),
    "instruments": (lambda run: "odd", "instruments 'odd' is unknown"),
    "workers": (lambda run: 2, "give a Workers"),
}


def _commanded_run(problem):
    run = experiment(problem).training_run(seed=2).window(0.0, 6.0)
    return replace(run, commanded={"qcmd": run.q})


def test_each_option_is_tried():
    assert set(CHOICES) == {f.name for f in fields(PoseOptions)}
    assert set(OUT_OF_RANGE) == set(CHOICES) - {"progress"}


@pytest.mark.parametrize("option", OUT_OF_RANGE)
def test_an_option_out_of_range_is_refused_in_a_sentence(option, two_link):
    value_of, word = OUT_OF_RANGE[option]
    run = _commanded_run(two_link)
    refusal(lambda: identify(two_link, run, **{option: value_of(run)}), word)


def check_that_the_proof_is_accepted(problem, run, options, folder):
    """Identify with a proof, which the model of the file accepts on the file of the run;
    both models."""
    proof = folder / "proof.json"
    model = identify(problem, run, **options, proof=proof)
    model.save(folder / "model.json")
    kept = load_estimate(folder / "model.json")
    save(run, folder / "run.csv")
    is_accepted, sentence = verify_proof_file(proof, kept, folder / "run.csv")
    assert is_accepted, sentence
    return model, kept


@pytest.mark.parametrize(
    "pair",
    [
        pytest.param(x, marks=() if "known_loads" in x else pytest.mark.long)
        for x in combinations(sorted({*CHOICES} - {"workers", "progress"}), 2)
    ],
    ids="+".join,
)
def test_two_options_together_are_proved_from_the_file(pair, two_link, tmp_path):
    run = _commanded_run(two_link)
    options = {name: CHOICES[name] for name in pair}
    if "known_loads" in options:
        options["known_loads"] = options["known_loads"](run)
    check_that_the_proof_is_accepted(two_link, run, options, tmp_path)


@pytest.mark.parametrize("option", CHOICES)
def test_what_identify_minimised_is_posed_again_from_the_file(
    option, two_link, tmp_path
):
    """`verify`, `add` and `ranges` do it: an option that the model.json does not hold
    would leave them another problem."""
    run = _commanded_run(two_link)
    value = CHOICES[option]
    value = value(run) if option == "known_loads" else value
    model, kept = check_that_the_proof_is_accepted(
        two_link, run, {option: value}, tmp_path
    )
    posed = posed_again(kept, run)
    assert posed is not None
    assert posed.task.data.loss(kept.theta) == pytest.approx(model.certificate.loss)
    before = model.training.posed
    gram, other = (x.task.data.R.T @ x.task.data.R for x in (before, posed))
    assert_allclose(other, gram, rtol=0.0, atol=1e-9 * gram.max())
    assert_allclose(posed.task.bound, before.task.bound)
    assert_allclose(posed.gain_errors, before.gain_errors)
    assert posed.task.model.known == before.task.model.known
    # A diagnosis fits the model anew to some of its rows; to all of them it is the same.
    rows = [before.regression]
    (theta,) = fitted_parameters(model, model.model.effects, (), rows, frozen=False)
    assert_allclose(theta, model.theta, rtol=0.0, atol=1e-9)
    convex, again = (kept.estimator.posed(x.task) for x in (before, posed))
    assert again.entropy.weight == pytest.approx(convex.entropy.weight)
