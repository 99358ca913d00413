"""A gear that turns unevenly, on a planar arm in closed form.

They share no code with the library: a motor carries its link's torque times the ratio
of the link's to its own velocity.
"""

import numpy as np
import pytest
from planar_arm import URDF, friction, links_torque, noise, swings

from sdp_vs_penalty import Measurements, diagnose, identify


def logged(error, k, joint, seed, ripple=0.0):
    """A log of the motors' side at 500 Hz: the link of one joint is ahead of its motor
    by ``error`` cos(k q) [rad], or its motor has a ripple of so many N m."""
    t, q, dq, ddq = swings(seed)
    angle = k * q[:, joint]
    link_q, link_dq, link_ddq = q.copy(), dq.copy(), ddq.copy()
    ratio = 1.0 - error * k * np.sin(angle)  # velocity of the link over the motor's
    link_q[:, joint] += error * np.cos(angle)
    link_dq[:, joint] *= ratio
    bend = -error * k**2 * np.cos(angle)
    link_ddq[:, joint] = ratio * ddq[:, joint] + bend * dq[:, joint] ** 2
    torque = links_torque(link_q, link_dq, link_ddq)
    torque[:, joint] = ratio * torque[:, joint] + ripple * np.cos(angle)
    torque += friction(dq)
    return Measurements(t, q, torque + noise(seed, q.shape))


def diagnosed(folder, **world):
    arm = folder / "planar.urdf"
    arm.write_text(URDF)
    train, test = logged(seed=1, **world), logged(seed=2, **world)
    return diagnose(identify(arm, train, check=False), train, test, check=False)


@pytest.mark.long
@pytest.mark.parametrize(("joint", "k", "error"), [(0, 11, 2e-3), (1, 60, 8e-4)])
def test_a_gear_that_turns_unevenly_is_named_with_its_size(joint, k, error, tmp_path):
    found = diagnosed(tmp_path, joint=joint, k=k, error=error)
    first = found.effects[0]
    assert first.text.startswith(f"gear_error:{joint + 1}@k=")
    assert first.confidence == "confident"
    assert first.shape["k"] == pytest.approx(k, abs=0.1)
    assert first.size == pytest.approx(error, rel=0.05)
    assert len([f for f in found.effects if f.confidence == "confident"]) == 1


@pytest.mark.long
def test_a_motors_ripple_is_no_gear_error(tmp_path):
    found = diagnosed(tmp_path, joint=0, k=11, error=0.0, ripple=0.4)
    assert found.effects[0].text == "torque_ripple:1@k=11"
    assert "gear_error" not in {f.effect for f in found.effects}
