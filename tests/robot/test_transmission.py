"""Transmissions: joints from channels logged on either side, and the same power on both."""

import json
from dataclasses import replace

import numpy as np
import pytest

from sdp_vs_penalty import InputError, Measurements, load_problem
from sdp_vs_penalty.data import check_plausible
from sdp_vs_penalty.data.datasets import to_joints
from sdp_vs_penalty.robot import parse_transmission
from sdp_vs_penalty.robot.joint import SIDES, Transmission

CASES = pytest.mark.parametrize("seed", range(8))


def drawn(seed: int, n: int = 5) -> tuple[Transmission, np.random.Generator]:
    """Any regular coupling, each channel on either side."""
    rng = np.random.default_rng(seed)
    matrix = np.diag(rng.choice([-1.0, 1.0], n) * rng.uniform(20.0, 120.0, n))
    matrix[rng.integers(n), rng.integers(n)] += 30.0
    sides = [tuple(map(str, rng.choice(SIDES, n))) for _ in range(2)]
    return Transmission(matrix, rng.normal(size=n), *sides), rng


@CASES
def test_joints_come_back_from_channels_of_either_side(seed):
    transmission, rng = drawn(seed)
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
    assert found.dq is not None
    for value, expected in ((found.q, q), (found.dq, dq), (found.tau, tau)):
        np.testing.assert_allclose(value, expected, rtol=1e-9, atol=1e-9)
    power = np.sum(motors * (dq @ transmission.matrix.T), axis=1)
    np.testing.assert_allclose(np.sum(found.tau * found.dq, axis=1), power, rtol=1e-9, atol=1e-9)
    restored = Transmission.from_dict(json.loads(json.dumps(transmission.to_dict())))
    assert np.array_equal(restored.joint_torques(logged.tau), found.tau)


@pytest.mark.parametrize(
    ("motors", "words"),
    [
        (["q1 q1"], "no sum"),
        (["32 x1"], "no sum"),
        (["q1", "q3"], "joint 3"),
        (["q1 + q2", "2 q1 + 2 q2"], "do not follow"),
        (["q1", "5"], "do not follow"),
        ([""], "do not follow"),
        (["1e999 q1"], "finite numbers"),
    ],
)
def test_a_transmission_that_cannot_be_is_refused(motors, words):
    with pytest.raises(InputError, match=words):
        parse_transmission(motors)


def test_the_tx40_converts_as_its_authors_do():
    """The authors' rule, written out: q = q_m / N, then q6 -= q5; tau = tau_m N, then tau5 += tau6."""
    robot = load_problem("tx40").robot
    assert robot.transmission is not None
    rng = np.random.default_rng(0)
    q_m, tau_m = rng.normal(size=(2, 30, 6))
    ratio = np.array([32.0, 32.0, 45.0, -48.0, 45.0, 32.0])
    q, tau = q_m / ratio, tau_m * ratio
    q[:, 5] -= q[:, 4]
    q[:, 1] -= np.pi / 2.0
    q[:, 2] += np.pi / 2.0
    tau[:, 4] += tau[:, 5]
    np.testing.assert_allclose(robot.transmission.joint_positions(q_m), q, atol=1e-12)
    np.testing.assert_allclose(robot.transmission.joint_torques(tau_m), tau, atol=1e-12)
    (wrist,) = robot.couplings
    np.testing.assert_array_equal(wrist, [0, 0, 0, 0, 1, 1])


def test_a_log_of_motors_is_recognised_by_the_robots_transmission():
    robot = load_problem("tx40").robot
    assert robot.transmission is not None
    t = np.arange(0.0, 2.0, 0.01)
    q = 0.5 * np.sin(np.outer(t, np.arange(1, 7)))
    tau = np.ones_like(q)
    turned = q @ robot.transmission.matrix.T + robot.transmission.offset
    check_plausible(robot, Measurements(t, q, tau))
    with pytest.raises(InputError, match=r"those of the motors.*convert --motor-side"):
        check_plausible(robot, Measurements(t, turned, tau))
    unknown = replace(robot, transmission=None)
    with pytest.raises(InputError, match=r"far outside.*convert --motors"):
        check_plausible(unknown, Measurements(t, turned, tau))
