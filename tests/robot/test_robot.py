"""Kinematics and rigid-body dynamics: against Pinocchio's RNEA and against virtual work."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from random_robots import link_parameters, tree, uicker_torques

from sdp_vs_penalty.robot import Robot

seeds = st.integers(0, 2**32 - 1)
quick = settings(max_examples=30, deadline=None, derandomize=True)


def random_case(seed: int, samples: int = 3) -> tuple[Robot, np.ndarray, np.ndarray]:
    """A robot, consistent parameters (10 n,), and states (3, samples, n)."""
    rng = np.random.default_rng(seed)
    robot = tree(rng, int(rng.integers(1, 6)), link_frames=bool(rng.integers(2)))
    theta = np.concatenate([link_parameters(rng, 0.5) for _ in robot.joints])
    return robot, theta, rng.normal(size=(3, samples, robot.n))


@quick
@given(seeds)
def test_regressor_equals_inverse_dynamics_equals_virtual_work(seed):
    robot, theta, (q, dq, ddq) = random_case(seed)
    by_regressor = robot.regressor(q, dq, ddq) @ theta
    by_rnea = robot.inverse_dynamics(theta, q, dq, ddq)
    by_work = [uicker_torques(robot, theta, *state) for state in zip(q, dq, ddq, strict=True)]
    size = np.abs(by_rnea).max() + 1e-3
    np.testing.assert_allclose(by_regressor, by_rnea, atol=1e-11 * size)
    np.testing.assert_allclose(by_rnea, by_work, atol=1e-11 * size)


@quick
@given(seeds)
def test_masses_of_least_squares_may_be_negative(seed):
    """Pinocchio divides by what a joint carries, but all of this is linear in the parameters."""
    robot, theta, (q, dq, ddq) = random_case(seed)
    consistent = robot.mass_matrices(theta, q)
    np.testing.assert_array_equal(consistent, np.swapaxes(consistent, 1, 2))
    assert np.all(np.linalg.eigvalsh(consistent) > 0.0)
    wild = np.random.default_rng(seed).normal(size=np.shape(theta))
    matrices = robot.mass_matrices(wild, q)
    by_q, by_dq, by_ddq = robot.inverse_dynamics_derivatives(wild, q, dq, ddq)
    rest = robot.inverse_dynamics(wild, q, dq, 0.0 * ddq)
    by_rnea = robot.inverse_dynamics(wild, q, dq, ddq) - rest
    scale = np.abs(by_rnea).max() + 1.0
    np.testing.assert_allclose(np.einsum("kij,kj->ki", matrices, ddq), by_rnea, atol=1e-9 * scale)
    np.testing.assert_allclose(by_ddq, matrices, atol=1e-9 * scale)
    states = np.stack([q, dq, ddq])
    for k, by in enumerate((by_q, by_dq)):
        step = np.zeros_like(states)
        step[k, :, 0] = 1e-6
        after, before = (robot.inverse_dynamics(wild, *(states + s * step)) for s in (1.0, -1.0))
        slope = (after - before) / 2e-6
        np.testing.assert_allclose(by[:, :, 0], slope, atol=1e-5 * (np.abs(slope).max() + scale))


def test_dh_conventions_place_the_same_arm():
    """A planar 2R written in both conventions: the tip of the second link at the same place."""
    standard = Robot.from_dh("s", [0.7, 0.4], [0.0, 0.0], [0.0, 0.0], "standard")
    modified = Robot.from_dh("m", [0.0, 0.7], [0.0, 0.0], [0.0, 0.0], "modified")
    for arm, origins in ((standard, [[0.7, 0, 0], [1.1, 0, 0]]), (modified, [[0, 0, 0], [0.7, 0, 0]])):
        first, second = arm.joints
        poses = (first.placement, first.placement @ second.placement)
        links = [(pose @ j.link_frame)[:3, 3] for pose, j in zip(poses, arm.joints, strict=True)]
        np.testing.assert_allclose(links, origins, atol=1e-15)
    # A point mass at each link's tip: at the standard frame's origin, 0.4 m along x in Craig's.
    at_origin = np.zeros((2, 10))
    at_origin[:, 0] = 1.0
    along_x = np.zeros((2, 10))
    for row, x in zip(along_x, (0.7, 0.4), strict=True):
        row[[0, 1, 6, 9]] = 1.0, x, x**2, x**2
    state = np.random.default_rng(0).normal(size=(3, 5, 2))
    gravity = (1.0, -9.0, 2.0)
    torques = [
        Robot(robot.name, robot.joints, gravity).regressor(*state) @ theta.ravel()
        for robot, theta in ((standard, at_origin), (modified, along_x))
    ]
    np.testing.assert_allclose(torques[0], torques[1], atol=1e-12)
