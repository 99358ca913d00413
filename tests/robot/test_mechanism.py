"""Joints that follow others (q_tree = B q + b, held against MuJoCo's constraints), and
transmissions."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from random_robots import link_parameters, states
from recorded import refusal, refusals, same_refusal

from sdp_vs_penalty import Measurements, convert, identify, load_problem
from sdp_vs_penalty.data import check_plausible, to_joints
from sdp_vs_penalty.effects import Motion
from sdp_vs_penalty.exporters import sdf
from sdp_vs_penalty.exporters.content import Content, Options
from sdp_vs_penalty.exporters.mjcf import make_mjcf
from sdp_vs_penalty.exporters.urdf import edit_urdf, make_urdf
from sdp_vs_penalty.robot import (
    SIDES,
    Transmission,
    load_robot,
    load_urdf,
    parse_transmission,
    random_trajectory,
)

#: A lift, a parallelogram whose loop is cut, and a gripper whose second finger mimics
#: the first: one follower is a follower's, one slides where its leader turns, one link
#: says that it has no mass.
LIFT = Path(__file__).with_name("lift.urdf")


@pytest.fixture
def urdf(tmp_path):
    return Path(shutil.copy(LIFT, tmp_path))


def some_links(robot):
    rng = np.random.default_rng(1)
    return np.array([link_parameters(rng, 0.4) for _ in range(robot.links)])


def test_inverse_dynamics_are_those_of_mujoco_under_equality_constraints(urdf):
    mujoco = pytest.importorskip("mujoco")
    robot, _ = load_urdf(urdf)
    heavy = replace(
        robot, mechanism=replace(robot.mechanism, massless=())
    )  # MuJoCo wants a mass
    links = some_links(heavy)
    content = Content.of_links(heavy, links)
    model = mujoco.MjModel.from_xml_string(make_mjcf(heavy, content).decode())
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_LIMIT
    data = mujoco.MjData(model)
    assert model.neq == 4
    ours = heavy.inverse_dynamics(links, *states(heavy, 20))
    for row, expected in zip(
        np.stack(heavy.tree_state(*states(heavy, 20)), axis=1), ours, strict=True
    ):
        data.qpos, data.qvel, data.qacc = row
        mujoco.mj_inverse(model, data)
        assert (
            np.abs(data.efc_pos).max() < 1e-12
        )  # the constraints hold where we say the tree is
        found = heavy.mechanism.matrix.T @ (data.qfrc_inverse + data.qfrc_constraint)
        assert_allclose(found, expected, rtol=1e-9, atol=1e-9)


def test_a_robot_with_followers_is_identified_and_written_back(urdf):
    problem = load_problem(urdf)
    robot = problem.robot
    links = problem.nominal_links
    t = np.arange(0.0, 20.0, 0.01)
    q, dq, ddq = random_trajectory(robot, 5, 20.0, frequency=0.6).states(t)
    tau = robot.inverse_dynamics(links, q, dq, ddq) + 2.0 * dq
    estimate = identify(
        problem,
        Measurements(t, q, tau),
        effects="rigid_body,viscous_friction",
        check=False,
    )
    torque = estimate.model.torque(estimate.theta, Motion(t, q, dq, ddq))
    assert np.linalg.norm(torque - tau) < 0.01 * np.linalg.norm(tau)
    assert len(estimate.theta) == links.size + robot.n
    assert estimate.certificate.worst == 0.0
    content = Content.from_estimate(estimate)
    for name, text in (
        ("new.urdf", make_urdf(robot, content)),
        ("own.urdf", edit_urdf(urdf, robot, content)),
        ("new.sdf", sdf.write(estimate, Options(None, force=True))[0]),
    ):
        path = urdf.with_name(name)
        path.write_bytes(text)
        file = load_robot(path)
        again, written = file.robot, file.links
        assert (again.n, again.links) == (robot.n, robot.links)
        found = again.inverse_dynamics(written, q, dq, ddq)
        assert_allclose(
            found, robot.inverse_dynamics(estimate.links, q, dq, ddq), atol=1e-8
        )


def test_a_problem_says_what_follows_by_formulas(tmp_path):
    (tmp_path / "problem.toml").write_text(
        'title = "bars"\n[kinematics]\nconvention = "modified"\na = [0, 0.3, 0.2]\n'
        "alpha_over_pi = [0.5, 0, 0]\nd = [0, 0, 0]\n[mechanism]\n"
        'joints = ["q1", "-q1 + q2 + 0.1", "q2"]\nmassless = [2]\n'
    )
    robot = load_problem(tmp_path).robot
    assert (robot.n, robot.links) == (2, 2)
    assert_allclose(robot.tree_state([[0.2, 0.5]])[0], [[0.2, 0.4, 0.5]])
    (tmp_path / "problem.toml").write_text(
        (tmp_path / "problem.toml").read_text().replace('"q2"]', '"2 q2"]')
    )
    refusal(lambda: load_problem(tmp_path), "no joint is q2 itself")


def test_the_tool_turns_about_the_remote_centre_and_slides_through_it():
    robot = load_problem("dvrk_psm").robot
    names = [joint.name for joint in robot.tree]
    for q in robot.random_configurations(20, seed=0):
        (poses,) = robot.poses(robot.tree_state(q)[0])
        pitch = poses[names.index("pitch_joint")]
        insertion = poses[names.index("insertion_joint")]
        centre = insertion[:3, 3] - (q[2] - 0.4318) * insertion[:3, 2]
        assert_allclose(centre, [0.0, 0.516, 0.0], atol=1e-9)  # on the yaw axis, fixed
        # The bars stay parallel: bottom and pitch differ by a turn that the pose does
        # not change.
        relative = pitch[:3, :3].T @ poses[names.index("bottom_joint")][:3, :3]
        assert_allclose(relative, np.diag([-1.0, -1.0, 1.0]), atol=1e-9)


def test_tables_without_header_are_read_at_their_rate(tmp_path):
    phase = 0.005 * np.arange(300.0)[:, None] * [2.0, 3.0]
    torques = np.random.default_rng(0).normal(size=phase.shape)
    rows = np.hstack([np.sin(phase), np.cos(phase) * [2.0, 3.0], torques])
    path = tmp_path / "results.csv"
    np.savetxt(path, rows, delimiter=",")
    run = convert(path, rate=200.0)
    assert np.array_equal(np.hstack([run.q, run.dq, run.tau]), rows)
    assert_allclose(np.diff(run.t), 0.005)
    five = "1,2,7,8,5\n3,4,1,2,9\n2,1,1,3,4\n"
    for text, words in ((five, "name columns by"), ("1,2,x\n", "not a number")):
        path.write_text(text)
        refusal(lambda: convert(path, rate=200.0), words)
    refusal(lambda: convert(tmp_path / "none.csv", rate=200.0), "No such file")


@pytest.mark.parametrize("seed", range(8))
def test_joints_come_back_from_channels_of_either_side(seed):
    """Of any regular coupling, each channel on either side."""
    rng = np.random.default_rng(seed)
    n = 5
    matrix = np.diag(rng.choice([-1.0, 1.0], n) * rng.uniform(20.0, 120.0, n))
    matrix[rng.integers(n), rng.integers(n)] += 30.0
    sides = [tuple(map(str, rng.choice(SIDES, n))) for _ in range(2)]
    transmission = Transmission(matrix, rng.normal(size=n), *sides)
    q, dq, motors = rng.normal(size=(3, 40, transmission.n))
    tau = motors @ transmission.matrix
    turned = q @ transmission.matrix.T + transmission.offset
    at_motor = np.array(transmission.positions) == "motor"
    torque_at_motor = np.array(transmission.torques) == "motor"
    logged = Measurements(
        np.arange(40.0),
        np.where(at_motor, turned, q),
        np.where(torque_at_motor, motors, tau),
        np.where(at_motor, dq @ transmission.matrix.T, dq),
    )
    found = to_joints(logged, transmission)
    for value, expected in ((found.q, q), (found.dq, dq), (found.tau, tau)):
        assert_allclose(value, expected, rtol=1e-9, atol=1e-9)
    power = np.sum(motors * (dq @ transmission.matrix.T), axis=1)
    assert_allclose(np.sum(found.tau * found.dq, axis=1), power, rtol=1e-9, atol=1e-9)
    restored = Transmission.from_dict(json.loads(json.dumps(transmission.to_dict())))
    assert np.array_equal(restored.joint_torques(logged.tau), found.tau)


@pytest.mark.parametrize("motors", refusals("transmission"))
def test_a_transmission_that_cannot_be_is_refused(motors):
    sentence = refusal(lambda: parse_transmission(motors.split(", ")))
    assert same_refusal("transmission", motors, sentence)


def test_the_tx40_converts_as_its_authors_do():
    """The authors' rule, written out: q = q_m / N, then q6 -= q5; tau = tau_m N, then
    tau5 += tau6."""
    robot = load_problem("tx40").robot
    rng = np.random.default_rng(0)
    q_m, tau_m = rng.normal(size=(2, 30, 6))
    ratio = np.array([32.0, 32.0, 45.0, -48.0, 45.0, 32.0])
    q = q_m / ratio
    tau = tau_m * ratio
    q[:, 5] -= q[:, 4]
    q[:, 1] -= np.pi / 2.0
    q[:, 2] += np.pi / 2.0
    tau[:, 4] += tau[:, 5]
    assert_allclose(robot.transmission.joint_positions(q_m), q, atol=1e-12)
    assert_allclose(robot.transmission.joint_torques(tau_m), tau, atol=1e-12)
    (wrist,) = robot.couplings
    assert_array_equal(wrist, [0, 0, 0, 0, 1, 1])


def test_a_log_of_motors_is_outside_the_ranges():
    robot = load_problem("tx40").robot
    t = np.arange(0.0, 2.0, 0.01)
    q = 0.5 * np.sin(np.outer(t, np.arange(1, 7)))
    tau = np.ones_like(q)
    turned = q @ robot.transmission.matrix.T + robot.transmission.offset
    check_plausible(robot, Measurements(t, q, tau))
    logged = Measurements(t, turned, tau)
    refusal(lambda: check_plausible(robot, logged), "far outside", "convert --motors")
