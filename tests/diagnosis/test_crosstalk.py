"""A torque channel that holds a share of another joint's torque, on a planar arm in
closed form."""

import numpy as np
import pytest
from planar_arm import URDF, friction, links_torque, noise, swings

from sdp_vs_penalty import Measurements, add, compare, diagnose, identify
from sdp_vs_penalty.effects.channel import TorqueCrosstalk
from sdp_vs_penalty.errors import InputError

#: Share of each joint's torque (columns) in each channel (rows).
BELT = np.array([[1.0, 0.0], [0.08, 1.0]])
WRONG_GAIN = np.diag([1.0, 1.12])


def logged(channels, seed):
    """A log of torque channels that mix the joints' torques."""
    t, q, dq, ddq = swings(seed)
    torque = links_torque(q, dq, ddq) + friction(dq)
    return Measurements(t, q, torque @ channels.T + noise(seed, q.shape))


def diagnosed(folder, channels):
    arm = folder / "planar.urdf"
    arm.write_text(URDF)
    train, test = logged(channels, seed=1), logged(channels, seed=2)
    model = identify(arm, train, check=False)
    return model, diagnose(model, train, test, check=False)


@pytest.mark.long
def test_a_belt_that_carries_a_share_of_the_next_joints_torque_is_named(tmp_path):
    model, found = diagnosed(tmp_path, BELT)
    (crosstalk,) = found.helpful
    assert crosstalk.text == "torque_crosstalk:2@i=1"
    assert crosstalk.size == pytest.approx(BELT[1, 0], rel=0.05)
    assert abs(crosstalk.size - BELT[1, 0]) < 2.0 * crosstalk.std
    assert "% of the torque of joint 1" in crosstalk.on_the_arm
    bigger = add(model, [crosstalk], logged(BELT, seed=1))
    before, after = compare({"before": model, "after": bigger}, logged(BELT, seed=3))
    assert after.rmse[1] < 0.3 * before.rmse[1]


@pytest.mark.long
def test_a_share_that_no_sensor_has_is_no_crosstalk(tmp_path):
    """A wrist's motor that drives through its neighbour's gear."""
    _, found = diagnosed(tmp_path, np.array([[1.0, 0.0], [0.9, 1.0]]))
    assert "torque_crosstalk" not in {f.effect for f in found.effects}


@pytest.mark.long
def test_a_wrong_gain_is_no_crosstalk(tmp_path):
    _, found = diagnosed(tmp_path, WRONG_GAIN)
    assert "torque_crosstalk" not in {f.effect for f in found.helpful}
    assert "torque_gain:2" in {f.text for f in found.effects}


def test_a_simulation_takes_the_shares_out_of_the_readings(two_link):
    crosstalk = TorqueCrosstalk(two_link.robot, [0, 1])
    shares = np.array([0.2, -0.1])
    mixture = np.array([[1.0, shares[0]], [shares[1], 1.0]])
    torque = np.random.default_rng(0).normal(size=(5, 2))
    readings = torque @ mixture.T
    undone = crosstalk.invert_channel(shares, np.arange(5.0), readings)
    np.testing.assert_allclose(undone, torque)


def test_a_joint_is_no_partner_of_itself(two_link):
    with pytest.raises(InputError, match="coupled to itself"):
        TorqueCrosstalk(two_link.robot, [1], i=2.0)
