"""The run that weighs a load: only the wrist moves; its deviations are those of estimates."""

import numpy as np
import pytest

from sdp_vs_penalty import Estimate, InputError, Problem, identify
from sdp_vs_penalty.estimation import Limits
from sdp_vs_penalty.estimation.excitation import PayloadRun, payload_run
from sdp_vs_penalty.estimation.separation import independent_rate
from sdp_vs_penalty.robot import Robot
from sdp_vs_penalty.simulation import experiment


@pytest.fixture(scope="module")
def estimate(panda: Problem) -> Estimate:
    return identify(panda, experiment(panda).training_run(), "ols")


@pytest.fixture(scope="module")
def run(estimate: Estimate) -> PayloadRun:
    return payload_run(estimate, iterations=8, seed=1)


def test_only_the_wrist_moves_and_within_its_limits(estimate, run):
    q, dq, _ = run.trajectory.states(np.linspace(0.0, 2.0, 401))
    assert np.ptp(q[:, :4], axis=0).max() == 0.0
    assert np.ptp(q[:, 4:], axis=0).min() > 0.1
    assert np.abs(dq).max() > 0.5
    assert Limits.of_robot(estimate.robot).excess(run.trajectory) <= 1.0


def test_it_weighs_better_than_a_random_motion(run):
    assert np.exp(np.mean(np.log(run.deviation / run.started))) < 0.7


def test_its_deviations_are_those_of_loads_that_are_estimated(estimate, run):
    robot: Robot = estimate.robot
    t = np.arange(0.0, 2.0, 1.0 / independent_rate(estimate))
    Y = robot.regressor(*run.trajectory.states(t))[:, :, -10:] / estimate.uncertainty.noise[:, None]
    rows = Y.reshape(-1, 10)
    noise = np.random.default_rng(5).standard_normal((len(rows), 400))
    spread = np.linalg.lstsq(rows, noise, rcond=None)[0].std(axis=1)
    np.testing.assert_allclose(spread, run.deviation, rtol=0.15)


def test_a_joint_that_does_not_exist_is_refused(estimate):
    with pytest.raises(InputError, match="joints that move: 9"):
        payload_run(estimate, joints=[8])
