"""The exciting trajectory: derivatives, blends, limits, and the authors' own files."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sdp_vs_penalty import InputError, Problem, load_problem
from sdp_vs_penalty.robot import FourierTrajectory, joint_limits, random_trajectory
from sdp_vs_penalty.simulation import experiment


@pytest.fixture(scope="module")
def paper(panda: Problem) -> FourierTrajectory:
    return experiment(panda).trajectory


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10_000))
def test_velocity_and_acceleration_are_the_derivatives(seed):
    trajectory = random_trajectory(load_problem("panda").robot, seed)
    h = 1e-5
    joins = np.array([trajectory.blend, trajectory.duration - trajectory.blend])
    t = np.random.default_rng(seed).uniform(h, trajectory.duration - h, 200)
    t = t[np.abs(t[:, None] - joins).min(axis=1) > h]  # ddq jumps there
    _, dq, ddq = trajectory.states(t)
    before, after = trajectory.states(t - h), trajectory.states(t + h)
    np.testing.assert_allclose(dq, (after[0] - before[0]) / (2 * h), atol=1e-8)
    np.testing.assert_allclose(ddq, (after[1] - before[1]) / (2 * h), atol=1e-7)


def test_it_starts_and_ends_at_rest_and_stays_there(paper):
    q, dq, ddq = paper.states([-1.0, 0.0, 21.0, 30.0])
    assert np.all(dq == 0.0)
    assert np.all(ddq == 0.0)
    np.testing.assert_allclose(q[:2], np.tile(paper.start, (2, 1)), atol=1e-15)
    np.testing.assert_array_equal(q[2], q[3])


def test_random_trajectories_stay_inside_range_and_velocity_limits(panda):
    lower, upper, velocity = joint_limits(panda.robot)
    for seed in range(20):
        q, dq, _ = random_trajectory(panda.robot, seed).states(np.linspace(0.0, 10.0, 4001))
        assert np.all((q >= lower) & (q <= upper))
        assert np.all(np.abs(dq) <= velocity)
        filled = np.maximum(
            np.ptp(q, axis=0) / (upper - lower) / 0.8, np.abs(dq).max(axis=0) / velocity / 0.6
        )
        np.testing.assert_allclose(filled, 1.0, rtol=1e-3)
    assert random_trajectory(panda.robot, 0).duration == 10.0
    first, again = (random_trajectory(panda.robot, 3).states([4.0])[0] for _ in range(2))
    np.testing.assert_array_equal(first, again)
    assert not np.allclose(first, random_trajectory(panda.robot, 4).states([4.0])[0])


def test_a_duration_without_room_for_the_blends_is_refused():
    with pytest.raises(InputError, match="above twice the blend"):
        FourierTrajectory(np.ones((1, 1)), np.ones((1, 1)), np.zeros(1), 1.0, 0.5, 1.0)


@pytest.mark.real_data
def test_table_two_is_what_the_generator_wrote(data_folder, paper):
    parameters = np.loadtxt(data_folder / "panda" / "gen_params.txt")
    np.testing.assert_array_equal(paper.a, parameters[:7])
    np.testing.assert_array_equal(paper.b, parameters[7:])
    # gen_q0 is the position at t = 0, Table II's q_0 the centre of the series. They agree up to a
    # sample or two of the generator's clock at the speed that the motion then has.
    start = np.loadtxt(data_folder / "panda" / "gen_q0.txt")
    assert np.abs(start - paper.q_0).max() > 1.0
    late = (start - paper.start) / paper.states([paper.blend])[1][0]
    np.testing.assert_allclose(late, late.mean(), atol=3e-4)
    assert 0.0 < -late.mean() < 2e-3
