"""Robots from MJCF: the torque is MuJoCo's own to 1e-9 for arms in a row, with a mimic
joint, a slide, armature and two trees; names of robot_descriptions."""

import re
import sys
from types import ModuleType

import numpy as np
import pytest
from arms import ELBOW, SHOULDER, write_urdf
from commands import run_cli
from dynamics_files import mujoco_torque
from numpy.testing import assert_allclose
from recorded import refusal
from small_runs import small_run

from sdp_vs_penalty import load_problem
from sdp_vs_penalty.data import save
from sdp_vs_penalty.errors import Remark
from sdp_vs_penalty.robot import load_mjcf

mujoco = pytest.importorskip("mujoco")

INERTIA = 'mass="{}" pos=".05 .02 .1" quat=".9 .1 .3 -.2" diaginertia="{} {} {}"'


def inertial(mass):
    moments = [0.01 * mass, 0.012 * mass, 0.008 * mass]
    return f"<inertial {INERTIA.format(mass, *moments)}/>"


SERIAL = f"""<mujoco model="serial"><compiler angle="radian"/><worldbody>
<body name="pedestal" pos="0 0 1" quat=".8 .6 0 0"><geom size=".1" mass="5"/>
 <body pos="0 0 .3" quat=".9 .2 .1 .3"><joint name="a" axis="0 0 1" pos=".1 0 .05"/>
  {inertial(4)}
  <body pos=".3 .1 0" euler=".3 .2 .1"><joint name="b" axis="1 1 0" ref=".4"/>{inertial(2)}
   <body name="tool" pos="0 .1 .2">{inertial(0.5)}</body>
   <body pos=".2 0 .1"><joint name="c" axis="0 1 0"/><joint name="d" axis="1 0 0" pos="0 .1 0"/>
    {inertial(1)}</body></body></body></body></worldbody></mujoco>"""
MIMIC = f"""<mujoco><compiler angle="radian"/><worldbody><body>
 <joint name="lift" axis="0 1 0"/>{inertial(3)}
 <body pos=".3 0 0"><joint name="left" axis="0 1 0"/>{inertial(0.3)}</body>
 <body pos=".3 .1 0"><joint name="right" axis="0 1 0"/>{inertial(0.4)}</body></body></worldbody>
<equality><joint joint1="right" joint2="left" polycoef=".1 -2 0 0 0"/></equality></mujoco>"""
SLIDE = f"""<mujoco><option gravity="0 -9.81 0"/><worldbody><body>
 <joint name="rail" type="slide" axis="1 0 .2" ref=".3" range="-1 2"/>{inertial(6)}
 <body pos="0 0 .4"><joint name="turn" axis="0 1 1" range="-90 90"/>{inertial(2)}</body>
</body></worldbody></mujoco>"""
ARMATURE = f"""<mujoco><worldbody><body>
 <joint name="a" axis="0 1 0" armature=".3" damping="1.5" frictionloss=".7"/>{inertial(3)}
 <body pos=".3 0 0"><joint name="b" axis="0 1 0" armature=".05"/>{inertial(1)}</body>
</body></worldbody><actuator><position joint="b" kp="600" kv="20"/></actuator></mujoco>"""
TREES = f"""<mujoco><worldbody>
<body pos="0 .5 0"><joint name="l1" axis="0 1 0"/>{inertial(3)}
 <body pos=".3 0 0"><joint name="l2" axis="0 0 1"/>{inertial(1)}</body></body>
<body pos="0 -.5 0"><joint name="r1" axis="0 1 0"/>{inertial(2)}
 <body pos=".3 0 0"><joint name="r2" axis="1 0 1"/>{inertial(0.7)}</body></body>
</worldbody></mujoco>"""
ARMS = {
    "serial": SERIAL,
    "mimic": MIMIC,
    "slide": SLIDE,
    "armature": ARMATURE,
    "trees": TREES,
}


def write(folder, name):
    path = folder / f"{name}.xml"
    path.write_text(ARMS[name])
    return path


@pytest.mark.parametrize("name", ARMS)
def test_torques_are_mujoco_s(name, tmp_path):
    robot, links, values, _ = load_mjcf(write(tmp_path, name))
    q, dq, ddq = np.random.default_rng(0).normal(size=(3, 30, robot.n))
    matrix = np.eye(robot.n) if robot.mechanism is None else robot.mechanism.matrix
    whole = robot.tree_state(q, dq, ddq)
    model = mujoco.MjModel.from_xml_string(ARMS[name])
    expected = mujoco_torque(model, whole) @ matrix
    torque = robot.inverse_dynamics(links, q, dq, ddq)
    for k in range(robot.n):
        torque[:, k] += values.get(f"I_a{k + 1}", 0.0) * ddq[:, k]
        torque[:, k] += values.get(f"f_v{k + 1}", 0.0) * dq[:, k]
    assert_allclose(torque, expected, rtol=1e-9, atol=1e-9)


def test_joint_values_are_nominal_ones(tmp_path):
    with pytest.warns(Remark, match="--known kp2=600,kd2=20"):
        problem = load_problem(write(tmp_path, "armature"))
    model = problem.model("rigid_body,rotor_inertia,viscous_friction,coulomb_friction")
    by_name = dict(
        zip([p.name for p in model.parameters], problem.nominal(model), strict=True)
    )
    shown = [by_name[name] for name in ("I_a1", "I_a2", "f_v1", "f_c1")]
    assert_allclose(shown, [0.3, 0.05, 1.5, 0.7])


def test_a_held_joint_s_links_belong_to_the_parent(tmp_path):
    path = write(tmp_path, "mimic")
    whole, links, *_ = load_mjcf(path)
    held, fewer, *_ = load_mjcf(path, held={"left": 0.2})
    q, dq, ddq = np.random.default_rng(0).normal(size=(3, 10, 1))
    zeros = np.zeros((10, 1))
    full = np.hstack([q, zeros + 0.2]), np.hstack([dq, zeros]), np.hstack([ddq, zeros])
    expected = whole.inverse_dynamics(links, *full)[:, :1]
    assert_allclose(held.inverse_dynamics(fewer, q, dq, ddq), expected)
    assert fewer[:, 0].sum() == pytest.approx(links[:, 0].sum())


@pytest.mark.filterwarnings("ignore::sdp_vs_penalty.errors.Remark")
@pytest.mark.parametrize("name", ["slide", "armature"])
def test_a_model_is_identified_and_saved(name, tmp_path):
    path = write(tmp_path, name)
    save(small_run(load_problem(path)), tmp_path / "run.csv")
    out = tmp_path / "model.json"
    words = (
        "identify",
        path,
        "--data",
        tmp_path / "run.csv",
        "--out",
        out,
        "--no-check",
    )
    assert run_cli(*words, "--method", "ols") == 0
    assert run_cli("compare", out, "--data", tmp_path / "run.csv") == 0


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (
            '<joint name="a" axis="0 0 1" pos=".1 0 .05"/>',
            '<joint type="ball"/>',
            "is free",
        ),
        ("</worldbody>", "", "MuJoCo does not read it"),
        (
            "</mujoco>",
            '<equality><connect body1="tool" body2="pedestal" anchor="0 0 0"/></equality>'
            "</mujoco>",
            "connect of 'tool' and 'pedestal', as of a closed loop",
        ),
    ],
)
def test_what_is_no_tree_of_hinges_and_slides_is_refused(old, new, words, tmp_path):
    path = tmp_path / "arm.xml"
    path.write_text(SERIAL.replace(old, new, 1))
    refusal(lambda: load_problem(path), "arm.xml", words)


MESHES = """<mujoco><compiler meshdir="assets/meshes"/><asset><mesh name="a" file="{}"/>
<texture name="t" type="2d" file="none.png"/><material name="m" texture="t"/></asset><worldbody>
<body name="upper"><joint name="j" axis="0 1 0"/>{}<geom type="mesh" mesh="a" material="m"/></body>
</worldbody></mujoco>"""


def test_meshes_of_bodies_with_an_inertial_are_not_read(tmp_path):
    """They may lie anywhere, be large or missing: nothing of the robot depends on them."""
    path = tmp_path / "arm.xml"
    path.write_text(MESHES.format("gone.stl", inertial(2)))
    assert load_mjcf(path)[1][:, 0] == pytest.approx([2.0])
    path.write_text(MESHES.format("gone.stl", ""))
    refusal(lambda: load_problem(path), "arm.xml", "gone.stl")


def test_a_mesh_of_which_a_body_is_made_may_lie_two_folders_down(tmp_path):
    """It takes 1.9 MB, of which MuJoCo needs 600 MB: more than the file's size allows."""
    n = 300
    u, v = np.meshgrid(np.linspace(0, 2 * np.pi, n), np.linspace(0.01, 3.13, n // 2))
    ball = np.stack([np.cos(u) * np.sin(v), np.sin(u) * np.sin(v), np.cos(v)], -1)
    a, b, c, d = ball[:-1, :-1], ball[1:, :-1], ball[1:, 1:], ball[:-1, 1:]
    corners = np.concatenate(
        [np.stack(x, 2).reshape(-1, 9) for x in ((a, b, c), (a, c, d))]
    )
    triangles = np.zeros(
        len(corners), [("normal", "<f4", 3), ("at", "<f4", 9), ("x", "<u2")]
    )
    triangles["at"] = 0.1 * corners
    (tmp_path / "assets/meshes").mkdir(parents=True)
    (tmp_path / "assets/meshes/ball.stl").write_bytes(
        b"\0" * 80 + np.uint32(len(triangles)).tobytes() + triangles.tobytes()
    )
    path = tmp_path / "arm.xml"
    path.write_text(
        MESHES.format("ball.stl", "").replace(
            'file="none.png"', 'builtin="flat" height="1" width="1"'
        )
    )
    assert load_mjcf(path)[1][0, 0] == pytest.approx(4188.8e-3, rel=0.01)


def test_a_tendon_that_pulls_is_named(tmp_path):
    """Its torque is left out; one that only a drive pulls couples nothing."""
    path = write(tmp_path, "slide")
    joints = re.findall('<joint name="([^"]*)"', path.read_text())
    tendon = (
        f'<tendon><fixed name="strap"{{}}><joint joint="{joints[0]}" coef="1"/></fixed>'
    )
    text = path.read_text()
    for pull, named in ((' stiffness="9"', True), ("", False)):
        end = f"{tendon.format(pull)}</tendon></mujoco>"
        path.write_text(text.replace("</mujoco>", end))
        assert ("tendon 'strap': not read" in load_mjcf(path)[3]) == named


def test_mujoco_leaves_no_log_in_the_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = write(tmp_path, "slide")
    key = '<keyframe><key qpos="nan 0"/></keyframe></mujoco>'  # MuJoCo warns of it
    path.write_text(path.read_text().replace("</mujoco>", key))
    assert load_mjcf(path)[0].n == 2
    assert [x.name for x in tmp_path.iterdir()] == ["slide.xml"]


def test_names_of_robot_descriptions(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "robot_descriptions", None)
    refusal(lambda: load_problem("panda_description"), "pip install robot_descriptions")
    package = ModuleType("robot_descriptions")
    one = ModuleType("own_description")
    one.URDF_PATH = str(write_urdf(tmp_path / "plain.urdf", "arm", (SHOULDER, ELBOW)))
    monkeypatch.setitem(sys.modules, "robot_descriptions", package)
    monkeypatch.setitem(sys.modules, "robot_descriptions.own_description", one)
    assert load_problem("own_description").robot.n == 2
    refusal(lambda: load_problem("other_description"), "'other_description'")


def test_a_parser_that_ends_is_one_sentence(tmp_path, monkeypatch):
    from sdp_vs_penalty.robot import mjcf

    def ends(*_, **__):
        raise mjcf.ParserEndedError("its parser was ended by SIGSEGV")

    monkeypatch.setattr(mjcf, "parse_isolated", ends)
    path = write(tmp_path, "slide")
    refusal(lambda: load_problem(path), "slide.xml", "ended by SIGSEGV")


def test_radians_that_are_read_as_degrees_are_said(tmp_path, capsys):
    """check-urdf reads an MJCF as any other robot's file."""
    path = write(tmp_path, "serial")
    assert run_cli("check-urdf", str(path)) == 0
    assert "all are consistent" in capsys.readouterr().out
    arm = path.read_text().replace('<compiler angle="radian"/>', "")
    path.write_text(arm.replace("<joint ", '<joint limited="true" range="-2 1.5" '))
    assert run_cli("check-urdf", str(path)) == 1
    assert "read as degrees" in " ".join(capsys.readouterr().out.split())


def test_moments_in_the_order_of_a_urdf_are_said(tmp_path):
    path = tmp_path / "arm.xml"
    wrong = '<inertial pos="0 0 0" mass="1" fullinertia=".02 .001 0 .02 0 .01"/>'
    path.write_text(MESHES.format("gone.stl", wrong))
    refusal(lambda: load_mjcf(path), "inertia must", "Ixx Iyy Izz Ixy Ixz Iyz")
    wrong = '<inertial pos="0 0 0" mass="1" diaginertia=".02 .01 .05"/>'
    path.write_text(MESHES.format("gone.stl", wrong))
    refusal(lambda: load_mjcf(path), "A + B", "correct its diaginertia, 0.02 0.01 0.05")
