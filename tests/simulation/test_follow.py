"""Models run forward along measured runs."""

from dataclasses import replace

import numpy as np
import pytest

from sdp_vs_penalty import Estimate, InputError, Measurements, follow, identify, load_problem
from sdp_vs_penalty.robot import random_trajectory
from sdp_vs_penalty.simulation import Sensor
from sdp_vs_penalty.simulation.experiments import simulate

EFFECTS = "rigid_body,viscous_friction,coulomb_friction@v_s=0.01,torque_offset"


@pytest.fixture(scope="module")
def known() -> tuple[Estimate, Measurements]:
    """A run of known truth at 250 Hz, and the model that is this truth."""
    problem = load_problem("two_link")
    model = problem.model(EFFECTS)
    sizes = {"viscous_friction": 0.3, "coulomb_friction": 0.4, "torque_offset": 0.1}
    theta = np.array([sizes.get(p.effect, 0.0) for p in model.parameters])
    theta[model.rigid_indices] = problem.nominal_links.ravel()
    trajectory = random_trajectory(problem.robot, 1, 6.0)
    run = simulate(trajectory, lambda motion: model.torque(theta, motion), Sensor(250.0, np.zeros(2)))
    return replace(identify(problem, run, effects=EFFECTS), theta=theta), run


@pytest.mark.long
def test_the_truth_follows_itself(known):
    estimate, run = known
    made = follow(estimate, run)
    assert np.all(made.share < 0.02)
    assert not made.free[0].left
    assert made.free[0].seconds > 5.5
    assert np.all(made.free[0].rms < 2e-3)
    loop = follow(estimate, run, drive="pd")
    assert np.all(loop.share < 0.02)
    assert loop.to_dict()["free_run"][0]["loop"] is not None
    assert "follow" not in made.verdict
    assert made.verdict.startswith("Run forward, 0.1 s ahead the worst joint")


@pytest.mark.long
def test_a_wrong_model_is_found_out(known):
    estimate, run = known
    theta = estimate.theta.copy()
    theta[estimate.model.rigid_indices] *= 1.3
    wrong = replace(estimate, theta=theta)
    assert np.all(follow(wrong, run).ahead.rms > 5.0 * follow(estimate, run).ahead.rms)
    assert follow(wrong, run, drive="pd").share.max() > 0.1


def test_what_cannot_move_is_refused(known):
    estimate, run = known
    theta = estimate.theta.copy()
    theta[estimate.model.rigid_indices] *= -1.0
    with pytest.raises(InputError, match="not positive definite"):
        follow(replace(estimate, theta=theta), run)
    with pytest.raises(InputError, match="drive"):
        follow(estimate, run, drive="wind")
    with pytest.raises(InputError, match="s"):
        follow(estimate, run.window(0.0, 0.2))
