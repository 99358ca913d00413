"""Samples of consistent models, bands of torque, and what further measurements buy."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from small_runs import thinned, write_run

from sdp_vs_penalty import InputError, identify, load_estimate, simulate
from sdp_vs_penalty.ranges import (
    allowed_set,
    find_ranges,
    find_samples,
    sample_models,
    torque_band,
    what_to_measure,
)
from sdp_vs_penalty.ranges.samples import (
    Chains,
    Samples,
    diagnose_chains,
    dispersed_starts,
    masses_by_bounds,
)
from sdp_vs_penalty.ranges.worth import Worth, worth_sentence
from sdp_vs_penalty.robot import constraint as build
from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.robot.constraint import ConstraintSet
from sdp_vs_penalty.solvers.small_cones import SmallCones


@pytest.fixture(scope="module")
def hidden():
    return thinned(simulate("two_link", seed=1))


@pytest.fixture(scope="module")
def model(hidden):
    return identify("two_link", hidden.train[:1], check=False)


def chains_of_a_link(largest_trace, penalty=None):
    """Chains over {P >= 0, tr P <= largest_trace}, without data."""
    link = np.arange(10)
    trace = inertia.PSEUDO_INERTIA_BASIS.trace(axis1=1, axis2=2)
    constraints = (
        build.pseudo_inertia("link", link),
        build.linear("bound", "trace", link, -trace[:, None], [largest_trace]),
    )
    cones = SmallCones(None, ConstraintSet(constraints), 10)
    start = inertia.from_pseudo_inertia(0.2 * np.eye(4))
    rng = np.random.default_rng(0)
    return Chains(cones, np.zeros((1, 10)), np.zeros(1), start, rng, penalty)


@pytest.mark.long
def test_a_flat_link_has_the_moments_of_its_cone():
    """Uniform on {P >= 0, tr P <= 1}: tr P has the density 10 x^9, and E P = 10/44 1."""
    drawn = chains_of_a_link(1.0).draw(500)
    r_hat, effective = diagnose_chains(drawn)
    assert r_hat.max() < 1.1
    P = inertia.pseudo_inertia(drawn.reshape(-1, 10))
    # Five standard errors of a mean whose samples scatter by about 0.1.
    close = 5.0 * 0.1 / np.sqrt(effective.min())
    assert_allclose(P.mean(axis=0), 10.0 / 44.0 * np.eye(4), atol=close)
    mean_trace = np.trace(P, axis1=1, axis2=2).mean()
    assert mean_trace == pytest.approx(10.0 / 11.0, abs=close)


@pytest.mark.long
def test_an_entropic_link_has_the_moments_of_wishart():
    """exp(-k (tr P - log det P) / 2) is Wishart's density with nu = k + 5 degrees of
    freedom and the scale 1/k: E P = nu / k 1, and tr P has the variance 8 nu / k^2."""
    k = 2.0

    def penalty(theta):
        P = inertia.pseudo_inertia(theta)
        return k * (np.trace(P, axis1=1, axis2=2) - np.linalg.slogdet(P)[1])

    drawn = chains_of_a_link(100.0, penalty).draw(250)
    r_hat, effective = diagnose_chains(drawn)
    assert r_hat.max() < 1.1
    P = inertia.pseudo_inertia(drawn.reshape(-1, 10))
    trace = np.trace(P, axis1=1, axis2=2)
    nu = k + 5.0
    std = np.sqrt(8.0 * nu) / k
    close = 5.0 / np.sqrt(effective.min())
    assert_allclose(P.mean(axis=0), nu / k * np.eye(4), atol=close * std / 2.0)
    assert trace.mean() == pytest.approx(4.0 * nu / k, abs=close * std)
    assert trace.std() == pytest.approx(std, rel=close)


def test_chains_start_near_the_boundary_of_the_set(model):
    """A ninth of their way further and they would leave it."""
    allowed = allowed_set(model.training.posed, model.theta)
    limit = allowed.limit(allowed.first_rise)
    centre = allowed.optimiser(allowed.first_rise).centre

    def is_inside(theta):
        residual = allowed.ball.A @ theta - allowed.ball.a
        return residual @ residual < limit and allowed.constraints.margin(theta) > 0.0

    for start in dispersed_starts(allowed, np.random.default_rng(0)):
        assert is_inside(start)
        assert not is_inside(centre + 1.12 * (start - centre))


def test_a_normal_distribution_keeps_its_moments():
    """A row far from its bound: the samples have the data's mean and variance."""
    bound = build.linear("bound", "x", [0, 1], np.eye(2), [50.0, 50.0])
    cones = SmallCones(None, ConstraintSet((bound,)), 2)
    A = np.array([[1.0, 0.5], [0.0, 2.0]])
    chains = Chains(cones, A, A @ [1.0, 2.0], np.zeros(2), np.random.default_rng(0))
    flat = chains.draw(1200).reshape(-1, 2)
    assert_allclose(flat.mean(axis=0), [1.0, 2.0], atol=0.1)
    assert_allclose(np.cov(flat.T), np.linalg.inv(A.T @ A), atol=0.12)


@pytest.mark.parametrize("prior", ["flat", "entropic"])
def test_every_sample_is_consistent(model, prior):
    allowed = allowed_set(model.training.posed, model.theta)
    samples = sample_models(allowed, 50, seed=3, prior=prior)
    assert samples.theta.shape == (50, len(model.theta))
    assert all(allowed.constraints.margin(theta) >= 0.0 for theta in samples.theta)
    again = sample_models(allowed, 50, seed=3, prior=prior)
    assert np.array_equal(samples.theta, again.theta)


def test_what_cannot_be_sampled_is_refused(model):
    with pytest.raises(InputError, match="0 samples"):
        find_samples(model, 0)


def test_the_band_holds_the_torque_of_unseen_motion(hidden, model):
    band = torque_band(model, hidden.test)
    assert band.inside().min() > 0.9
    assert np.all(band.half_width <= band.half_width_with_error)
    assert np.all(band.peaks[:, 0] < band.peaks[:, 1])
    far = replace(band, measured=band.measured + np.array([0.0, 1e3]))
    assert "of joint 2:" in far.table().notes[-1]


def test_a_measurement_leaves_a_shorter_range(model):
    worth = what_to_measure(model, "m2")
    assert {x.measurement for x in worth} >= {
        "weigh link 1",
        "weigh the arm",
        "the same motion with a known load",
    }
    assert all(x.length <= 1.0 + 1e-6 for x in worth)


def test_scales_are_taken_to_show_what_the_model_says(model):
    """What is weighed is the model's own mass, to a hundredth."""
    mass = float(model.links[1][0])
    (weighed,) = [
        x for x in what_to_measure(model, "m2") if x.measurement == "weigh the arm"
    ]
    total = sum(float(link[0]) for link in model.links)
    assert weighed.least <= mass <= weighed.greatest <= 1.02 * total


def test_a_link_without_mass_is_weighed_as_the_middle_of_the_set_has_it(hidden, model):
    """The command ended with "no consistent model": scales of 0 kg leave no room."""
    theta = model.theta.copy()
    theta[model.model.rigid_indices[:10]] = 0.0
    worth = what_to_measure(model.with_theta(theta), "m2", hidden.runs[0])
    assert "weigh link 1" in {x.measurement for x in worth}


@pytest.mark.long
@pytest.mark.parametrize(
    ("longer", "words"), [(1, "--longer 4"), (4, "--longer 16"), (16, "--bounds")]
)
def test_the_advice_goes_on_from_what_was_run(longer, words):
    samples = Samples(
        np.zeros((1, 1)), "flat", np.ones(1), np.full(1, 2.0), 0, longer=longer
    )
    assert words in samples.sentence


def test_longer_chains_forget_more_of_their_starts(model):
    short, long = (find_samples(model, 8, longer=k) for k in (1, 8))
    assert long.steps == 8 * short.steps
    assert long.r_hat.mean() < short.r_hat.mean()
    with pytest.raises(InputError, match="one time at least"):
        find_samples(model, 8, longer=0)


def test_masses_that_pile_up_at_their_bounds_are_named(hidden):
    """A first link that turns about the vertical shows no mass: the bound decides it."""
    model = identify("two_link", hidden.train[:1], check=False)
    task = model.training.posed.task
    place = task.links[0, 0]
    upper = task.box[0, 0, 1]
    theta = np.tile(model.theta, (200, 1))
    assert masses_by_bounds(theta, task) == ()
    theta[:, place] = np.linspace(0.0, upper, 200)
    assert masses_by_bounds(theta, task) == (f"m1 (below {upper:g} kg)",)
    theta[:, place] = 0.5 * upper + 0.05 * upper * np.sin(np.arange(200.0))
    assert masses_by_bounds(theta, task) == ()


def test_a_saved_model_finds_the_files_of_its_runs(two_link, tmp_path):
    """Those that it was identified from, as long as they are there."""
    path = write_run(tmp_path / "run.csv", two_link)
    identify(two_link, [path], check=False).save(tmp_path / "model.json")
    model = load_estimate(tmp_path / "model.json")
    by_name = find_ranges(model, path, ["m2"])
    assert find_ranges(model, functions=["m2"])["m2"] == by_name["m2"]
    path.unlink()
    with pytest.raises(InputError, match="no files of them that are still there"):
        find_ranges(model, functions=["m2"])


def test_the_measurement_that_would_tell_most_is_named_beside_motion():
    found = [
        Worth("a scale", 1.0, 2.0, 0.2),
        Worth("any motion, as long as you like", 1.0, 9.0, 0.75),
    ]
    assert worth_sentence(found) == (
        "Most would tell: a scale (leaves 20 % of this length); motion, however long,"
        " leaves 75 %."
    )
