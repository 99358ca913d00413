"""The dVRK's patient-side manipulator: its remote centre, its parallelogram, its coupled motors."""

import numpy as np
import pytest

from sdp_vs_penalty import InputError, Measurements, convert, identify, load_problem
from sdp_vs_penalty.effects import Motion
from sdp_vs_penalty.robot import random_trajectory


def test_the_tool_turns_about_the_remote_centre_and_slides_through_it():
    robot = load_problem("dvrk_psm").robot
    names = [joint.name for joint in robot.tree]
    for q in robot.random_configurations(20, seed=0):
        (poses,) = robot.poses(robot.tree_state(q)[0])
        pitch, insertion = poses[names.index("pitch_joint")], poses[names.index("insertion_joint")]
        centre = insertion[:3, 3] - (q[2] - 0.4318) * insertion[:3, 2]
        np.testing.assert_allclose(centre, [0.0, 0.516, 0.0], atol=1e-9)  # on the yaw axis, fixed
        # The bars stay parallel: bottom and pitch differ by a turn that the pose does not change.
        relative = pitch[:3, :3].T @ poses[names.index("bottom_joint")][:3, :3]
        np.testing.assert_allclose(relative, np.diag([-1.0, -1.0, 1.0]), atol=1e-9)


def test_a_simulated_arm_is_identified():
    """The authors' model explains what it made; every constraint holds."""
    problem = load_problem("dvrk_psm")
    model = problem.model()
    t = np.arange(0.0, 40.0, 0.005)
    trajectory = random_trajectory(problem.robot, 6, 40.0, frequency=2.0 * np.pi * 0.18)
    motion = Motion(t, *trajectory.states(t))
    theta = problem.nominal(model)
    theta[10 * problem.robot.links :] = np.random.default_rng(0).uniform(0.05, 0.3, len(theta) - 60)
    tau = model.torque(theta, motion)
    estimate = identify(problem, Measurements(t, motion.q, tau))
    left = model.torque(estimate.theta, motion) - tau
    assert estimate.certificate.worst == 0.0
    assert np.all(np.linalg.norm(left, axis=0) < 0.03 * np.linalg.norm(tau, axis=0))


def test_tables_without_header_are_read_at_their_rate(tmp_path):
    rows = np.random.default_rng(0).normal(size=(30, 6))
    path = tmp_path / "results.csv"
    np.savetxt(path, rows, delimiter=",")
    run = convert(path, rate=200.0)
    assert run.dq is not None
    assert np.array_equal(np.hstack([run.q, run.dq, run.tau]), rows)
    np.testing.assert_allclose(np.diff(run.t), 0.005)
    for text, words in (("1,2\n3,4\n", "three a joint"), ("1,2,x\n", "not a number")):
        path.write_text(text)
        with pytest.raises(InputError, match=words):
            convert(path, rate=200.0)
    with pytest.raises(InputError, match="No such file"):
        convert(tmp_path / "none.csv", rate=200.0)
