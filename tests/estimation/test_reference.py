"""The current model, from whose links and torque some effects' columns follow."""

from dataclasses import replace

import numpy as np
import pytest
from small_runs import small_run

from sdp_vs_penalty import add, compare, diagnose, identify, load_problem
from sdp_vs_penalty.effects import DEFAULT_EFFECTS
from sdp_vs_penalty.robot.inertia import link_sizes


def test_links_of_the_current_model_stay_near_those_of_the_file():
    """In two seconds rows hardly tell them: by least squares alone a link of 3 kg has
    tens of kilograms, and a gear's deflection shakes them."""
    arm = load_problem("ur10e")
    effects = [*DEFAULT_EFFECTS, "rotor_inertia", "joint_elasticity:2"]
    model = identify(arm, small_run(arm, seconds=2.0), effects=effects, check=False)
    links = model.model.reference[model.model.rigid_indices].reshape(-1, 10)
    change = (links - arm.nominal_links) / link_sizes(arm.nominal_links)
    assert np.abs(change).max() < 2.0


def scaled_run(arm, gains, seed):
    """A run of little noise whose torque channels read the gains times the torque."""
    run = small_run(arm, seconds=10.0, seed=seed, reach=3.0, noise=1e-3)
    return replace(run, tau=run.tau * np.array(gains))


@pytest.mark.parametrize("gains", [(1.0, 0.6), (0.7, 1.0), (1.0, 1.5)])
def test_a_gain_is_a_share_of_the_torque_of_the_model_itself(gains, two_link):
    """Two passes made it a share of another model's torque: friction that the run
    determines came out as 0.36 or 0.79 N m for 0.5."""
    run = scaled_run(two_link, gains, seed=0)
    joint = 1 + int(np.argmax(np.abs(np.log(gains))))
    model = add(identify(two_link, run, check=False), f"torque_gain:{joint}", run)
    np.testing.assert_allclose(model.theta[-7:-1], 0.5, atol=0.01)
    assert model.theta[-1] == pytest.approx(gains[joint - 1] - 1.0, abs=1e-3)


def test_a_gain_that_is_added_leaves_the_errors_that_were_promised(two_link):
    run, unseen = (scaled_run(two_link, (1.0, 0.6), seed) for seed in (0, 1))
    model = identify(two_link, run, check=False)
    promised = diagnose(model, run, test=unseen).error_with(["torque_gain:2"])
    (judged,) = compare({"added": add(model, "torque_gain:2", run)}, unseen)
    assert np.all(judged.rmse < 1.1 * promised)
