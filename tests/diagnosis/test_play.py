"""Play of a gear whose link flies from flank to flank, simulated with a motor of its own.

The simulation shares no code with the library: a pendulum, a motor before its gear, and
a stiff, damped contact on either side of the play.
"""

from pathlib import Path

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


def swung(play: float, seed: int, seconds: float = 24.0) -> Measurements:
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
    damp = 0.6 * np.sqrt(stiff * ROTOR)
    motor, link, v_motor, v_link = aim[0], aim[0], speed[0], speed[0]
    q, tau = np.empty(len(t)), np.empty(len(t))
    for k in range(len(t)):
        wanted = push[k] + 400.0 * (aim[k] - motor) + 28.0 * (speed[k] - v_motor)
        drive = (INERTIA + ROTOR) * wanted + MASS * GRAVITY * LENGTH * np.sin(motor)
        gap = motor - link
        beyond = gap - min(max(gap, -play), play)
        contact = stiff * beyond + damp * (v_motor - v_link) * (
            beyond != 0.0 or not play
        )
        friction = 1.0 * np.tanh(v_motor / 0.02)
        q[k], tau[k] = motor, drive + friction
        v_motor += h * (drive - contact) / ROTOR
        v_link += h * (contact - MASS * GRAVITY * LENGTH * np.sin(link)) / INERTIA
        motor += h * v_motor
        link += h * v_link
    tau += rng.normal(0.0, 0.1 * np.sqrt(every), len(t))
    means = tau.reshape(-1, every).mean(axis=1)
    middle = slice(every // 2, None, every)
    return Measurements(t[middle], q[middle, None], means[:, None])


@pytest.mark.parametrize("play", [0.0, 0.005, 0.012])
def test_a_link_that_flies_through_its_play_is_named_with_its_size(
    play, tmp_path: Path
):
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
