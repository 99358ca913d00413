"""A gear that turns unevenly, on a planar arm whose equations stand here.

They share no code with the library: two links in closed form, and a motor that carries
its link's torque times the ratio of the link's to its own velocity.
"""

from pathlib import Path

import numpy as np
import pytest

from sdp_vs_penalty import Measurements, diagnose, identify
from sdp_vs_penalty.diagnosis import Diagnosis

MASSES, LENGTH, CENTRE, SPIN = (4.0, 3.0), 0.4, 0.25, 0.04
URDF = f"""<robot name="planar"><link name="base"/>
<link name="upper"><inertial><mass value="{MASSES[0]}"/><origin xyz="{CENTRE} 0 0"/>
<inertia ixx=".02" iyy="{SPIN}" izz="{SPIN}" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="lower"><inertial><mass value="{MASSES[1]}"/><origin xyz="{CENTRE} 0 0"/>
<inertia ixx=".02" iyy="{SPIN}" izz="{SPIN}" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/>
<axis xyz="0 0 1"/><limit lower="-3" upper="3" effort="90" velocity="9"/></joint>
<joint name="elbow" type="revolute"><parent link="upper"/><child link="lower"/>
<origin xyz="{LENGTH} 0 0"/>
<axis xyz="0 0 1"/><limit lower="-3" upper="3" effort="90" velocity="9"/></joint>
</robot>"""


def links_torque(q, dq, ddq):
    """Torque (N, 2) of two links in a horizontal plane: Lagrange's equations."""
    m1, m2 = MASSES
    coupling = m2 * LENGTH * CENTRE
    first = m1 * CENTRE**2 + m2 * LENGTH**2 + m2 * CENTRE**2 + 2.0 * SPIN
    second = m2 * CENTRE**2 + SPIN
    cos, sin = np.cos(q[:, 1]), np.sin(q[:, 1])
    m12 = second + coupling * cos
    return np.column_stack(
        [
            (first + 2.0 * coupling * cos) * ddq[:, 0]
            + m12 * ddq[:, 1]
            - coupling * sin * (2.0 * dq[:, 0] * dq[:, 1] + dq[:, 1] ** 2),
            m12 * ddq[:, 0] + second * ddq[:, 1] + coupling * sin * dq[:, 0] ** 2,
        ]
    )


def logged(
    error: float, k: int, joint: int, seed: int, ripple: float = 0.0
) -> Measurements:
    """A log of the motors' side at 500 Hz: the link of one joint is ahead of its motor
    by ``error`` cos(k q) [rad], or its motor has a ripple of so many N m."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 24.0, 0.002)
    q, dq, ddq = (np.zeros((len(t), 2)) for _ in range(3))
    for j in range(2):
        w = 2.0 * np.pi * rng.uniform(0.1, 0.8, 5)
        a, phase = rng.uniform(0.5, 1.0, 5) / w / 2.0, rng.uniform(0.0, 6.0, 5)
        waves = np.outer(t, w) + phase
        q[:, j], dq[:, j] = np.sin(waves) @ a, np.cos(waves) @ (a * w)
        ddq[:, j] = np.sin(waves) @ (-a * w * w)
    angle = k * q[:, joint]
    link_q, link_dq, link_ddq = q.copy(), dq.copy(), ddq.copy()
    ratio = 1.0 - error * k * np.sin(angle)  # velocity of the link over the motor's
    link_q[:, joint] += error * np.cos(angle)
    link_dq[:, joint] *= ratio
    bend = -error * k**2 * np.cos(angle)
    link_ddq[:, joint] = ratio * ddq[:, joint] + bend * dq[:, joint] ** 2
    torque = links_torque(link_q, link_dq, link_ddq)
    torque[:, joint] = ratio * torque[:, joint] + ripple * np.cos(angle)
    torque += np.tanh(dq / 0.01) * (0.8, 0.4) + dq * (0.5, 0.3)
    return Measurements(t, q, torque + rng.normal(0.0, 0.05, q.shape))


def diagnosed(folder: Path, **world: float) -> Diagnosis:
    arm = folder / "planar.urdf"
    arm.write_text(URDF)
    train, test = logged(seed=1, **world), logged(seed=2, **world)
    return diagnose(identify(arm, train, check=False), train, test, check=False)


@pytest.mark.parametrize(
    ("joint", "k", "error"),
    [(0, 11, 2e-3), pytest.param(1, 60, 8e-4, marks=pytest.mark.long)],
)
def test_a_gear_that_turns_unevenly_is_named_with_its_size(joint, k, error, tmp_path):
    found = diagnosed(tmp_path, joint=joint, k=k, error=error)
    first = found.effects[0]
    assert first.text.startswith(f"gear_error:{joint + 1}@k=")
    assert first.confidence == "confident"
    assert first.shape["k"] == pytest.approx(k, abs=0.1)
    assert first.size == pytest.approx(error, rel=0.05)
    assert len([f for f in found.effects if f.confidence == "confident"]) == 1


def test_a_motors_ripple_is_no_gear_error(tmp_path):
    found = diagnosed(tmp_path, joint=0, k=11, error=0.0, ripple=0.4)
    assert found.effects[0].text == "torque_ripple:1@k=11"
    assert "gear_error" not in {f.effect for f in found.effects}
