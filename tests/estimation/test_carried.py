"""What is said of a payload, and of bodies that no material could make."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
from arms import THREE, write_urdf
from commands import run_cli
from small_runs import small_run

import sdp_vs_penalty as sdp
from sdp_vs_penalty.data import save
from sdp_vs_penalty.errors import Remark
from sdp_vs_penalty.estimation.carried import (
    doubts_of_bodies,
    doubts_of_payload,
    payload_in_words,
)
from sdp_vs_penalty.robot import inertia


def ball(mass, radius, centre):
    """Standard parameters (10,) of a uniform ball."""
    c = np.array(centre)
    about_centre = 0.4 * mass * radius**2 * np.eye(3)
    about_origin = about_centre + mass * (c @ c * np.eye(3) - np.outer(c, c))
    return np.array([mass, *(mass * c), *inertia.inertia_entries(about_origin)])


def test_the_least_density_is_that_of_a_uniform_body():
    theta = ball(2.0, 0.05, (0.1, -0.2, 0.3))
    volume = 4.0 / 3.0 * np.pi * 0.05**3
    assert inertia.least_density(theta) == pytest.approx(2.0 / volume, rel=1e-9)
    # A shell of the same mass and radius is larger than the ball with its inertia.
    point = np.array([1.0, *np.zeros(9)])
    assert inertia.least_density(point) == np.inf
    assert inertia.least_density(np.zeros(10)) == 0.0


@pytest.fixture(scope="module")
def loaded(tmp_path_factory):
    """An arm with a ball of 1.5 kg, of steel."""
    folder = tmp_path_factory.mktemp("arm")
    problem = sdp.load_problem(write_urdf(folder / "arm.urdf", "arm", THREE))
    run = small_run(problem)
    model = sdp.identify(problem, run, check=False)
    load = np.zeros_like(model.theta[model.model.rigid_indices]).reshape(-1, 10)
    load[-1] = ball(1.5, 0.035, (0.1, 0.02, 0.0))
    acceleration = np.gradient(np.gradient(run.q, run.t, axis=0), run.t, axis=0)
    velocity = np.gradient(run.q, run.t, axis=0)
    torque = problem.robot.inverse_dynamics(load, run.q, velocity, acceleration)
    return sdp.add(model, "payload", replace(run, tau=run.tau + torque))


def with_payload(model, theta, std):
    """The same model with another payload, whose parameters the data determine."""
    standard = list(model.uncertainty.standard)
    standard[-10:] = [replace(x, std=std) for x in standard[-10:]]
    uncertainty = replace(model.uncertainty, standard=tuple(standard))
    return replace(
        model,
        theta=np.concatenate([model.theta[:-10], theta]),
        report=replace(model.report, undetermined={}),
        uncertainty=uncertainty,
    )


STEEL = ball(1.5, 0.035, (0.1, 0.02, 0.0))


def test_the_mass_of_a_payload_is_said_with_its_interval(loaded):
    good = with_payload(loaded, STEEL, 0.01)
    assert good.uncertainty.std[-10] == pytest.approx(0.01)
    words = "payload: 1.5 ± 0.02 kg (95 %), centre of mass at 0.1, 0.02, 0 m"
    assert payload_in_words(good).startswith(words)
    assert doubts_of_bodies(good) == []


def test_a_payload_that_no_material_could_make_is_doubted(loaded):
    thin = with_payload(loaded, ball(1.5, 1e-5, (0.1, 0.02, 0.0)), 0.01)
    (doubt,) = doubts_of_bodies(thin)
    assert "no material is as dense" in doubt
    assert doubts_of_payload(thin) == []  # its mass is as good
    light = with_payload(loaded, ball(1e-3, 0.035, (0.1, 0.02, 0.0)), 0.01)
    (doubt,) = doubts_of_payload(light)
    assert "its mass of 0.001 kg may be zero (± 0.02 kg)" in doubt
    guessed = with_payload(loaded, STEEL, 0.01)
    unseen = replace(guessed.report, undetermined={"payload_m": "prior"})
    guessed = replace(guessed, report=unseen)
    (doubt,) = doubts_of_payload(guessed)
    assert "do not determine its mass of 1.5 kg" in doubt
    assert "1.5 kg (not from the data: prior)" in payload_in_words(guessed)


@pytest.mark.parametrize(
    "name", ["a.urdf", "a.xml", "a.sdf", "a.h", "a.json", "a.script"]
)
def test_an_export_says_it(loaded, tmp_path, name):
    thin = with_payload(loaded, ball(1.5, 1e-5, (0.1, 0.02, 0.0)), 0.01)
    with pytest.warns(Remark, match="payload: no material is as dense"):
        sdp.export(thin, tmp_path / name)
    with warnings.catch_warnings():
        warnings.simplefilter("error", Remark)
        sdp.export(with_payload(loaded, STEEL, 0.01), tmp_path / name)
        sdp.export(thin, tmp_path / "friction.csv")


def test_add_prints_the_mass_and_parameters_that_were_named(loaded, tmp_path, capsys):
    problem = loaded.problem
    run = small_run(problem)
    save(run, tmp_path / "run.csv")
    sdp.identify(problem, run, check=False).save(tmp_path / "model.json")
    base = ["add", tmp_path / "model.json"]
    options = ["--data", tmp_path / "run.csv", "--out", tmp_path / "more.json"]
    assert run_cli(*base, "payload", *options) == 0
    printed, said = capsys.readouterr()
    more = sdp.load_estimate(tmp_path / "more.json")
    assert payload_in_words(more) in " ".join(printed.split())
    doubts = doubts_of_payload(more)
    assert doubts  # the run has no load
    assert all(doubt in " ".join(said.split()) for doubt in doubts)
    assert run_cli(*base, "joint_spring:2", *options) == 0
    more = sdp.load_estimate(tmp_path / "more.json")
    text = more.value_text(len(more.theta) - 1)
    assert f"k_s2: {text}" in capsys.readouterr().out
