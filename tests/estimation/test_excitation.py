"""Exciting trajectories: limits, gradient, conditioning, and the file that a robot plays."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sdp_vs_penalty import Estimate, InputError, Problem, identify, load_problem
from sdp_vs_penalty.estimation import Limits
from sdp_vs_penalty.estimation.excitation import (
    PayloadRun,
    Regressor,
    excite,
    payload_run,
    save_trajectory,
)
from sdp_vs_penalty.estimation.separation import independent_rate
from sdp_vs_penalty.robot import FourierTrajectory, Robot, random_trajectory
from sdp_vs_penalty.simulation import experiment


@pytest.fixture(scope="module")
def paper(panda: Problem) -> FourierTrajectory:
    return experiment(panda).trajectory


positive = st.floats(0.05, 3.0)


@settings(max_examples=8, deadline=None)
@given(
    low=st.lists(st.floats(-2.5, 1.0), min_size=2, max_size=2),
    span=st.lists(positive, min_size=2, max_size=2),
    velocity=st.lists(positive, min_size=2, max_size=2),
    acceleration=st.lists(positive, min_size=2, max_size=2),
    duration=st.floats(4.0, 20.0),
    seed=st.integers(0, 1000),
)
def test_an_optimised_trajectory_keeps_any_limits(low, span, velocity, acceleration, duration, seed):
    problem = load_problem("two_link")
    lower = np.array(low)
    limits = Limits(lower, lower + span, np.array(velocity), np.array(acceleration))
    found = excite(problem, limits=limits, duration=duration, seed=seed, iterations=2)
    t = np.linspace(0.0, duration, 2 * round(1000 * duration) + 1)
    q, dq, ddq = found.trajectory.states(t)
    assert np.all(q >= limits.lower - 1e-6)
    assert np.all(q <= limits.upper + 1e-6)
    assert np.all(np.abs(dq) <= limits.velocity * (1 + 1e-5))
    assert np.all(np.abs(ddq) <= limits.acceleration * (1 + 1e-4))
    assert np.abs(dq[[0, -1]]).max() < 1e-9


def test_better_conditioned_than_the_papers_within_the_papers_own_extremes(panda, paper):
    limits = Limits.of_trajectory(paper)
    before = Regressor.of(panda).condition(paper)
    assert 105.0 < before < 125.0  # the paper's own figure is 109 to 122, depending on the basis
    found = excite(panda, limits=limits, start=paper, iterations=12)
    assert found.condition < 0.75 * before
    assert limits.excess(found.trajectory) <= 1.0
    assert found.trajectory.duration == paper.duration
    assert found.history[0] == pytest.approx(before)


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"lower": np.array([0.0, 2.0]), "upper": np.array([1.0, 1.0])}, "joint 2"),
        ({"velocity": np.array([0.0, 1.0])}, "joint 1"),
        ({"acceleration": np.array([1.0, -1.0])}, "joint 2"),
        ({"upper": np.array([np.inf, 1.0])}, "joint 1"),
        ({"velocity": np.array([np.nan, 1.0])}, "joint 1"),
    ],
)
def test_limits_that_admit_no_trajectory_are_refused(two_link, change, match):
    with pytest.raises(InputError, match=match):
        replace(Limits.of_robot(two_link.robot), **change)


def test_other_input_is_refused(two_link):
    with pytest.raises(InputError, match="objective"):
        excite(two_link, objective="loud")
    with pytest.raises(InputError, match="duration"):
        excite(two_link, duration=0.5)


def test_a_robot_can_play_the_file(two_link, tmp_path):
    trajectory = random_trajectory(two_link.robot, 0, 4.0)
    path = tmp_path / "trajectory.csv"
    save_trajectory(trajectory, path)
    header = path.read_text().splitlines()[0]
    assert header == "t,q1,q2,dq1,dq2,ddq1,ddq2"
    rows = np.loadtxt(path, delimiter=",", skiprows=1)
    assert rows.shape == (4001, 7)
    q, dq, ddq = trajectory.states(rows[:, 0])
    np.testing.assert_allclose(rows[:, 1:], np.hstack([q, dq, ddq]), atol=1e-7)


@pytest.fixture(scope="module")
def estimate(panda: Problem) -> Estimate:
    return identify(panda, experiment(panda).training_run(), "ols")


@pytest.fixture(scope="module")
def run(estimate: Estimate) -> PayloadRun:
    return payload_run(estimate, iterations=8, seed=1)


def test_only_the_wrist_moves_and_within_its_limits(estimate, run):
    assert run.trajectory.duration == 2.0
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
    Y = (
        robot.regressor(*run.trajectory.states(t))[:, :, -10:]
        / estimate.uncertainty.torque_noise[:, None]
    )
    rows = Y.reshape(-1, 10)
    noise = np.random.default_rng(5).standard_normal((len(rows), 400))
    spread = np.linalg.lstsq(rows, noise, rcond=None)[0].std(axis=1)
    np.testing.assert_allclose(spread, run.deviation, rtol=0.15)


def test_a_joint_that_does_not_exist_is_refused(estimate):
    with pytest.raises(InputError, match="joints that move: 9"):
        payload_run(estimate, joints=[8])
