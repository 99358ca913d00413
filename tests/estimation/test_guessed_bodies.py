"""Guessed bodies that the data reject grow; those that somebody states do not."""

from dataclasses import replace

import pytest
from small_runs import thinned

from sdp_vs_penalty import (
    cross_validate,
    identify,
    load_estimate,
    load_problem,
    simulate,
)


@pytest.fixture(scope="module")
def runs():
    return thinned(simulate("two_link", seed=3))


def in_small_bodies(source):
    """Return the two-link arm, each link within a tenth of its body about the body's
    centre, as ``source`` says.
    """
    problem = load_problem("two_link")
    bodies = [
        replace(body.larger(0.1), source=source, enlarged=1.0)
        for body in problem.link_bodies
    ]
    return replace(problem, bodies=tuple(bodies))


def test_a_guess_that_the_data_reject_grows(runs, tmp_path):
    """It costs no more of the error than 5 %, and the model's file keeps its body."""
    free = identify("two_link", runs.train, check=False)
    model = identify(in_small_bodies("inertial"), runs.train, check=False)
    assert model.certificate.loss <= 1.05**2 * free.certificate.loss
    ((label, text),) = model.held_by_bounds
    assert label == "guessed bodies"
    assert "link 2 (" in text
    model.save(tmp_path / "model.json")
    again = load_estimate(tmp_path / "model.json")
    assert again.held_by_bounds == model.held_by_bounds


def test_a_stated_body_holds_against_the_data(runs):
    """Bounds are knowledge: the estimate keeps them, and says that it lies on them."""
    model = identify(in_small_bodies("bounds"), runs.train, check=False)
    free = identify("two_link", runs.train, check=False)
    assert model.certificate.loss > 4.0 * free.certificate.loss
    assert "body of link 2" in dict(model.held_by_bounds)["on their bounds"]


def test_at_a_limit_that_nobody_stated_the_advice_is_to_state_one(runs):
    """Wider bounds would free what is too free already."""
    problem = load_problem("two_link")
    box = problem.box.copy()
    box[:, 0] = [[0.01, 100.0], [1.0, 5.0]]
    stated = replace(problem, box=box)
    assert stated.assumed_masses.all(axis=1).tolist() == [True, False]
    model = identify("two_link", runs.train, check=False)
    bounds = ("mass of link 1", "mass of link 2")
    report = replace(model.report, on_bounds=bounds)
    on = replace(model, problem=stated, report=report).held_by_bounds
    texts = {label: text for label, text in on if label != "guessed bodies"}
    assert "mass of link 2: widen the bounds" in texts["on their bounds"]
    assert "mass of link 1: " in texts["at our widest limits"]
    assert "--bounds" in texts["at our widest limits"]


def test_a_guess_that_the_data_allow_stays(runs):
    """Without a contradiction nothing is said of bodies."""
    problem = load_problem("two_link")
    guessed = [replace(body, source="inertial") for body in problem.link_bodies]
    guessing = replace(problem, bodies=tuple(guessed))
    model = identify(guessing, runs.train, check=False)
    assert "guessed bodies" not in dict(model.held_by_bounds)


def test_folds_grow_their_guesses_as_well(runs):
    """Unseen motion is predicted as well as without the wrong guess."""
    errors = [
        cross_validate(problem, runs.train, folds=3).relative_error_percent
        for problem in (in_small_bodies("inertial"), load_problem("two_link"))
    ]
    assert errors[0] <= 1.1 * errors[1]
