"""The user's own MJCF with a model's numbers: MuJoCo's torques are the model's, and
nothing else of the file changes."""

import numpy as np
import pytest
import random_robots
from dynamics_files import by_mujoco, estimate_of
from recorded import refusal

from sdp_vs_penalty import export
from sdp_vs_penalty.effects import Motion
from sdp_vs_penalty.robot.robot_file import load_robot

mujoco = pytest.importorskip("mujoco", minversion="3.0")

#: Degrees, a class of joints, a cover that is fixed, a joint off its body's origin, an
#: inertial in another notation, a finger, and actuators of two kinds.
OWN = """<mujoco model="toy">
  <compiler angle="degree" settotalmass="7"/>
  <default><default class="big"><joint damping="3" armature=".1"/></default></default>
  <worldbody>
    <light pos="0 0 3"/>
    <!-- my base -->
    <body name="base" pos="0 0 .1">
      <geom type="box" size=".1 .1 .1"/>
      <body name="upper" pos="0 0 .2" quat=".7071 0 .7071 0">
        <joint name="shoulder" axis="0 0 1" range="-170 170" class="big"/>
        <geom type="capsule" fromto="0 0 0 .4 0 0" size=".04"/>
        <body name="cover" pos=".1 0 .05"><geom type="box" size=".05 .02 .02"/></body>
        <body name="fore" pos=".4 0 0" euler="0 0 30">
          <inertial pos=".1 0 0" quat=".9 .1 0 0" mass="1.5" diaginertia=".01 .02 .02"/>
          <joint name="elbow"  axis="0 1 0" pos="0 0.01 0" ref="20" range="-120 120"/>
          <geom type="capsule" fromto="0 0 0 .3 0 0" size=".03"/>
          <body name="finger" pos=".3 0 0">
            <joint name="grip" type="slide" axis="0 1 0" range="0 .05"/>
            <geom type="box" size=".02 .01 .01"/>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator><motor name="a1" joint="shoulder" gear="2"/><position joint="elbow" kp="50"/></actuator>
</mujoco>
"""
EFFECTS = "rigid_body,viscous_friction,coulomb_friction,rotor_inertia,joint_spring,torque_offset"
AT = 0.02  # where the finger stands [m]


@pytest.fixture
def own(tmp_path):
    path = tmp_path / "my arm.xml"
    path.write_text(OWN)
    return path


@pytest.mark.parametrize("held", [{}, {"grip": AT}], ids=["all move", "finger held"])
def test_mujoco_makes_the_models_torque_from_the_edited_file(own, tmp_path, held):
    """The settings of the user's file that alter masses are gone."""
    robot = load_robot(own, held=held).robot
    estimate = estimate_of(robot, EFFECTS, 3)
    out = tmp_path / "new.xml"
    assert export(estimate, out, mjcf=own, force=True) == ()
    q, dq, ddq = random_robots.states(robot, 30, 1)
    motion = Motion(np.zeros(len(q)), q, dq, ddq)
    made = by_mujoco(out, robot, q, dq, ddq, held.items())
    assert np.abs(made - estimate.torque(motion)).max() < 1e-9


def test_all_but_inertials_and_joints_stays(own, tmp_path):
    robot = load_robot(own).robot
    out = tmp_path / "new.xml"
    export(estimate_of(robot, EFFECTS, 3), out, mjcf=own, force=True)
    parts = ("<!-- my base -->", "<light", "<default>", "<actuator>", "<geom", "euler")
    kept = [line for line in OWN.splitlines() if '"cover"' not in line]
    before = [line for line in kept if any(p in line for p in parts)]
    text = out.read_text()
    assert [line for line in before if line.strip() not in text] == []
    assert 'range="-170 170" class="big"' in text
    assert mujoco.MjModel.from_xml_path(str(out)).nu == 2


@pytest.mark.parametrize(
    ("edit", "words"),
    [
        (lambda text: text.replace('name="grip" type="slide"', 'name="grip"'), "grip"),
        (
            lambda text: text.replace(
                '<body name="cover"', '<replicate count="2"><body name="cover"'
            ).replace('.02 .02"/></body>', '.02 .02"/></body></replicate>'),
            "not all written in this file",
        ),
    ],
    ids=["another joint", "replicated"],
)
def test_a_file_of_another_arm_is_refused(own, tmp_path, edit, words):
    estimate = estimate_of(load_robot(own).robot, EFFECTS, 3)
    own.write_text(edit(OWN))
    refusal(lambda: export(estimate, tmp_path / "new.xml", mjcf=own, force=True), words)


def test_endings_and_kinds_are_said(own, tmp_path):
    estimate = estimate_of(load_robot(own).robot, EFFECTS, 3)
    refusal(
        lambda: export(estimate, tmp_path / "new.urdf", mjcf=own),
        "an edited MJCF must end in .xml",
    )
    refusal(
        lambda: export(estimate, tmp_path / "new.xml", urdf=own, mjcf=own), "two files"
    )
