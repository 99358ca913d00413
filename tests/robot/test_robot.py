"""Rigid-body dynamics that agree with each other and with their slopes; the exciting
trajectory."""

from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from drawn import example, given, seeds, settings, st
from numpy.testing import assert_allclose, assert_array_equal
from random_robots import link_parameters, tree
from recorded import refusal

from sdp_vs_penalty import load_problem
from sdp_vs_penalty.robot import Robot, joint_limits, load_urdf, random_trajectory
from sdp_vs_penalty.simulation import experiment


def random_case(seed, samples=3):
    """A robot, consistent parameters (10 links,), and states (3, samples, n); of seed 0
    joints that follow others."""
    rng = np.random.default_rng(seed)
    robot = tree(rng, int(rng.integers(1, 6)), link_frames=bool(rng.integers(2)))
    robot = robot if seed else load_urdf(Path(__file__).with_name("lift.urdf"))[0]
    theta = np.concatenate([link_parameters(rng, 0.5) for _ in range(robot.links)])
    return robot, theta, rng.normal(size=(3, samples, robot.n))


@given(seeds)
@example(0)
def test_the_regressor_makes_the_inverse_dynamics(seed):
    """Which MuJoCo's are, too: of trees in test_mechanism.py, of arms in
    tests/exporters."""
    robot, theta, (q, dq, ddq) = random_case(seed)
    by_rnea = robot.inverse_dynamics(theta, q, dq, ddq)
    size = np.abs(by_rnea).max() + 1e-3
    assert_allclose(robot.regressor(q, dq, ddq) @ theta, by_rnea, atol=1e-11 * size)


@given(seeds)
@example(0)
def test_masses_of_least_squares_may_be_negative(seed):
    """Pinocchio divides by what a joint carries, but all of this is linear in the
    parameters."""
    robot, theta, (q, dq, ddq) = random_case(seed)
    consistent = robot.mass_matrices(theta, q)
    exact = 0.0 if seed else 1e-15  # with followers, products on either side
    assert_allclose(consistent, np.swapaxes(consistent, 1, 2), rtol=exact, atol=exact)
    assert np.all(np.linalg.eigvalsh(consistent) > 0.0)
    k = np.arange(len(theta))
    for some in (
        k >= len(theta) - 10,
        k % 10 == 0,
    ):  # all other links weigh nothing, then no link does
        parts = robot.mass_matrices(theta * ~some, q) + robot.mass_matrices(
            theta * some, q
        )
        assert_allclose(parts, consistent, atol=1e-9 * np.abs(consistent).max())
    wild = np.random.default_rng(seed).normal(size=np.shape(theta))
    matrices = robot.mass_matrices(wild, q)
    by_q, by_dq, by_ddq = robot.inverse_dynamics_derivatives(wild, q, dq, ddq)
    rest = robot.inverse_dynamics(wild, q, dq, 0.0 * ddq)
    by_rnea = robot.inverse_dynamics(wild, q, dq, ddq) - rest
    scale = np.abs(by_rnea).max() + 1.0
    assert_allclose(np.einsum("kij,kj->ki", matrices, ddq), by_rnea, atol=1e-9 * scale)
    assert_allclose(by_ddq, matrices, atol=1e-9 * scale)
    states = np.stack([q, dq, ddq])
    for by, (k, j) in zip(
        (by_q, by_q, by_dq, by_dq), ((0, 0), (0, -1), (1, 0), (1, -1)), strict=True
    ):
        step = np.zeros_like(states)
        step[k, :, j] = 1e-6
        after = robot.inverse_dynamics(wild, *states + 1.0 * step)
        before = robot.inverse_dynamics(wild, *states + -1.0 * step)
        slope = (after - before) / 2e-6
        assert_allclose(by[:, :, j], slope, atol=1e-5 * (np.abs(slope).max() + scale))


def test_dh_tables_place_frames_as_craig_and_the_standard_do():
    a = 0.3
    alpha = 0.7
    d = 0.2
    c = np.cos(alpha)
    s = np.sin(alpha)
    (craig,), (far,) = (
        Robot.from_dh("r", [a], [alpha], [d], k).joints
        for k in ("modified", "standard")
    )
    assert_allclose(craig.placement[:3, 3], [a, -s * d, c * d])
    assert_allclose(far.link_frame[:3, 3], [a, 0.0, d])
    for turned in (craig.placement, far.link_frame):
        assert_allclose(turned[:3, :3], [[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
    assert_array_equal([craig.link_frame, far.placement], [np.eye(4)] * 2)


@settings(derandomize=False)
@given(seed=st.integers(0, 10_000))
def test_velocity_and_acceleration_are_the_derivatives(seed):
    trajectory = random_trajectory(load_problem("panda").robot, seed)
    h = 1e-5
    joins = np.array([trajectory.blend, trajectory.duration - trajectory.blend])
    t = np.random.default_rng(seed).uniform(h, trajectory.duration - h, 200)
    t = t[np.abs(t[:, None] - joins).min(axis=1) > h]  # ddq jumps there
    _, dq, ddq = trajectory.states(t)
    before = trajectory.states(t - h)
    after = trajectory.states(t + h)
    assert_allclose(dq, (after[0] - before[0]) / (2 * h), atol=1e-8)
    assert_allclose(ddq, (after[1] - before[1]) / (2 * h), atol=1e-7)


def test_it_starts_and_ends_at_rest_and_stays_there(panda):
    paper = experiment(panda).trajectory
    q, dq, ddq = paper.states([-1.0, 0.0, 21.0, 30.0])
    assert np.all(dq == 0.0)
    assert np.all(ddq == 0.0)
    series, rate, _ = paper.states([paper.blend])  # where the blend ends
    assert_allclose(
        q[:2], np.tile(series - 0.5 * paper.blend * rate, (2, 1)), atol=1e-15
    )
    assert_array_equal(q[2], q[3])


def test_random_trajectories_stay_inside_range_and_velocity_limits(panda):
    lower, upper, velocity = joint_limits(panda.robot)
    for seed in range(20):
        q, dq, _ = random_trajectory(panda.robot, seed).states(
            np.linspace(0.0, 10.0, 4001)
        )
        assert np.all((q >= lower) & (q <= upper))
        assert np.all(np.abs(dq) <= velocity)
        filled = np.maximum(
            np.ptp(q, axis=0) / (upper - lower) / 0.8,
            np.abs(dq).max(axis=0) / velocity / 0.6,
        )
        assert_allclose(filled, 1.0, rtol=1e-3)
    assert random_trajectory(panda.robot, 0).duration == 10.0
    first, again = (
        random_trajectory(panda.robot, 3).states([4.0])[0] for _ in range(2)
    )
    assert_array_equal(first, again)
    assert not np.allclose(first, random_trajectory(panda.robot, 4).states([4.0])[0])


@pytest.mark.parametrize(
    "parents", [*product((-1,), (-1, 0), (-1, 0, 1), (-1, 0, 1, 2))]
)
def test_joints_come_depth_first(two_link, parents):
    """Which they do where all that stands between a joint and its parent is below the
    parent."""
    joint = two_link.robot.joints[0]
    joints = tuple(replace(joint, name=f"{k}", parent=p) for k, p in enumerate(parents))
    if all(
        between >= p for k, p in enumerate(parents) for between in parents[p + 1 : k]
    ):
        assert Robot("r", joints).n == 4
    else:
        refusal(lambda: Robot("r", joints), "order the joints depth first")


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"name": ""}, "name is ''"),
        ({"axis": np.array([0.0, 0.0, 2.0])}, "no unit vector"),
        ({"kind": "ball"}, "kind 'ball' is unknown"),
    ],
)
def test_a_joint_that_cannot_be_is_refused(two_link, change, said):
    refusal(lambda: replace(two_link.robot.joints[0], **change), said)


def test_the_reach_of_links_is_the_callers_own():
    robot = load_problem("panda").robot
    before = robot.link_reach()
    robot.link_reach()[:] = 0.0
    assert_array_equal(robot.link_reach(), before)
