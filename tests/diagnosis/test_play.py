"""Play of a gear whose link flies from flank to flank, simulated with a motor of its own.

The simulation shares no code with the library: a pendulum, a motor before its gear, and
a stiff, damped contact on either side of the play.
"""

from math import sin, tanh

import numpy as np
import pytest

from sdp_vs_penalty import Measurements, diagnose, identify

MASS, LENGTH, ROTOR = 4.0, 0.5, 0.15
INERTIA = MASS * LENGTH**2 + 0.05
GRAVITY = 9.81
URDF = f"""<robot name="pendulum"><link name="base"/>
<link name="rod"><inertial><mass value="{MASS}"/><origin xyz="0 0 {-LENGTH}"/>
<inertia ixx="0.05" iyy="0.05" izz="0.05" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="hinge" type="revolute"><parent link="base"/><child link="rod"/>
<axis xyz="0 1 0"/><limit lower="-2" upper="2" effort="90" velocity="9"/></joint>
</robot>"""


def swung(play, seed, seconds=24.0):
    """A log of the motor's side, at 250 Hz: a servo follows five sines [rad] with a
    motor before a gear with this play [rad] to either side; Coulomb friction is the
    motor's."""
    rng = np.random.default_rng(seed)
    h, every = 1e-4, 40
    t = np.arange(0.0, seconds, h)
    w = 2.0 * np.pi * np.array([0.15, 0.31, 0.52, 0.83, 1.1])
    a, phase = rng.uniform(0.5, 1.0, 5) / w, rng.uniform(0.0, 6.0, 5)
    waves = np.outer(t, w) + phase
    aim, speed = np.sin(waves) @ a, np.cos(waves) @ (a * w)
    push = np.sin(waves) @ (-a * w * w)
    stiff = ROTOR * (2.0 * np.pi * 40.0) ** 2
    damp = 0.6 * (stiff * ROTOR) ** 0.5
    weight = MASS * GRAVITY * LENGTH
    # Steps of Python's own floats take a third of the time of NumPy's.
    motor = link = float(aim[0])
    v_motor = v_link = float(speed[0])
    positions, torques = [], []
    for now, v_now, a_now in zip(
        aim.tolist(), speed.tolist(), push.tolist(), strict=True
    ):
        wanted = a_now + 400.0 * (now - motor) + 28.0 * (v_now - v_motor)
        drive = (INERTIA + ROTOR) * wanted + weight * sin(motor)
        gap = motor - link
        beyond = gap - min(max(gap, -play), play)
        contact = stiff * beyond
        if beyond or not play:
            contact += damp * (v_motor - v_link)
        positions.append(motor)
        torques.append(drive + 1.0 * tanh(v_motor / 0.02))
        v_motor += h * (drive - contact) / ROTOR
        v_link += h * (contact - weight * sin(link)) / INERTIA
        motor += h * v_motor
        link += h * v_link
    q, tau = np.array(positions), np.array(torques)
    tau += rng.normal(0.0, 0.1 * np.sqrt(every), len(t))
    means = tau.reshape(-1, every).mean(axis=1)
    middle = slice(every // 2, None, every)
    return Measurements(t[middle], q[middle, None], means[:, None])


@pytest.mark.long
@pytest.mark.parametrize("play", [0.0, 0.005, 0.012])
def test_a_link_that_flies_through_its_play_is_named_with_its_size(play, tmp_path):
    arm = tmp_path / "pendulum.urdf"
    arm.write_text(URDF)
    train, test = swung(play, 1), swung(play, 2)
    found = diagnose(identify(arm, train, check=False), train, test, check=False)
    names = [f.text.split("@")[0] for f in found.effects]
    if not play:
        assert "backlash_in_flight:1" not in names
        return
    assert names[0] == "backlash_in_flight:1"
    assert found.effects[0].shape["b"] == pytest.approx(play, rel=0.4)
