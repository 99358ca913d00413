"""Joints that stand still: their links belong to their parents, what mimics them stands
still with them, and a log may hold their columns or not."""

from dataclasses import replace

import numpy as np
import pytest
from arms import ELBOW, SHOULDER, TURN, write_urdf
from commands import run_cli
from numpy.testing import assert_allclose
from recorded import refusal
from small_runs import small_run

from sdp_vs_penalty import load_problem
from sdp_vs_penalty.data import read_run, save
from sdp_vs_penalty.data.files import without_held
from sdp_vs_penalty.robot import load_urdf

FINGERS = """
  <link name="left"><inertial><origin xyz="0 -0.01 0.02"/><mass value="0.04"/>
    <inertia ixx="1.4e-5" ixy="0" ixz="0" iyy="1.2e-5" iyz="0" izz="5e-6"/></inertial></link>
  <link name="right"><inertial><origin xyz="0 0.01 0.02"/><mass value="0.05"/>
    <inertia ixx="1.4e-5" ixy="0" ixz="0" iyy="1.2e-5" iyz="0" izz="5e-6"/></inertial></link>
  <joint name="finger_joint" type="revolute"><parent link="{tip}"/><child link="left"/>
    <origin xyz="-0.03 0 0.06"/><axis xyz="0 -1 0"/>
    <limit lower="0" upper="0.8" effort="50" velocity="0.5"/></joint>
  <joint name="knuckle" type="continuous"><parent link="{tip}"/><child link="right"/>
    <origin xyz="0.03 0 0.06"/><axis xyz="0 -1 0"/>
    <mimic joint="finger_joint" multiplier="-1" offset="0.1"/></joint>
</robot>"""


@pytest.fixture
def urdf(tmp_path):
    path = write_urdf(tmp_path / "arm.urdf", "arm", (TURN, SHOULDER, ELBOW))
    robot = load_urdf(path)[0]
    text = path.read_text()
    tip = text.rpartition('<link name="')[2].partition('"')[0]
    assert robot.n == 3
    path.write_text(text.replace("</robot>", FINGERS.format(tip=tip)))
    return path


def states(n, value):
    """Of n joints, and of these beside one that is held at a value."""
    moving = np.random.default_rng(3).normal(size=(3, 20, n))
    still = np.zeros((3, 20, 1))
    still[0] = value
    return moving, np.concatenate([moving, still], axis=2)


def test_a_held_arm_makes_the_torque_of_the_whole_one(urdf):
    whole, links = load_urdf(urdf)
    held, fewer = load_urdf(urdf, held={"finger_joint": 0.3})
    moving, full = states(3, 0.3)
    expected = whole.inverse_dynamics(links, *full)[:, :3]
    assert_allclose(held.inverse_dynamics(fewer, *moving), expected)


def test_held_links_belong_to_their_parents(urdf):
    held, links = load_urdf(urdf, held={"finger_joint": 0.0})
    assert held.links == 3
    assert links[:, 0].sum() == pytest.approx(load_urdf(urdf)[1][:, 0].sum())
    assert links[2, 0] == pytest.approx(ELBOW.mass + 0.09)


def test_held_joints_travel_with_the_model(urdf):
    (joint,) = load_problem(urdf, held={"finger_joint": 0.2}).robot.held
    assert (joint.name, joint.value, joint.place) == ("finger_joint", 0.2, 3)


def test_a_name_of_no_joint_is_refused(urdf):
    refusal(lambda: load_problem(urdf, held={"thumb": 0.0}), "--hold", "'thumb'")
    names = load_urdf(urdf)[0].joint_names
    refusal(lambda: load_problem(urdf, held=dict.fromkeys(names, 0.0)), "nothing moves")


def test_a_problem_says_what_is_held(urdf):
    folder = urdf.parent
    text = 'title = "t"\n[kinematics]\nurdf = "arm.urdf"\n[mechanism]\nheld = ["{}"]\n'
    (folder / "problem.toml").write_text(text.format("finger_joint=0.1"))
    assert load_problem(folder).robot.n == 3
    (folder / "problem.toml").write_text(text.format("finger_joint"))
    refusal(lambda: load_problem(folder), "finger_joint=0")


def test_a_joint_of_a_table_is_held_too():
    whole = load_problem("panda")
    held = load_problem("panda", held={"joint7": 0.4})
    moving, full = states(6, 0.4)
    expected = whole.robot.inverse_dynamics(whole.nominal_links, *full)[:, :6]
    torque = held.robot.inverse_dynamics(whole.nominal_links, *moving)
    assert_allclose(torque, expected)


def log(urdf, joints):
    """A run of the arm whose finger stands still, with or without its columns."""
    run = small_run(load_problem(urdf, held={"finger_joint": 0.0}))
    path = urdf.with_name("run.csv")
    save(run, path)
    if joints == 4:
        names, *rows = path.read_text().splitlines()
        added = [("q4", "dq4", "tau4"), *(["0.0"] * 3 for _ in rows)]
        wide = [
            [*c[:4], q, *c[4:7], dq, *c[7:], tau]
            for c, (q, dq, tau) in zip(
                (row.split(",") for row in [names, *rows]), added, strict=True
            )
        ]
        path.write_text("\n".join(map(",".join, wide)) + "\n")
    return path


def identified(urdf, path):
    """The file of the model that is identified from a file."""
    model = urdf.with_name("model.json")
    words = ("identify", urdf, "--data", path, "--method", "ols", "--out", model)
    assert run_cli(*words) == 0
    return model


def test_an_idle_joint_is_held_by_itself(urdf, capfd):
    path = log(urdf, 4)
    model = identified(urdf, path)
    said = " ".join(capfd.readouterr().err.split())
    assert "finger_joint stands still without torque: held" in said
    assert "--hold finger_joint=0" in said
    assert run_cli("compare", model, "--data", path) == 0


def test_columns_of_held_joints_are_left_out(urdf):
    names = load_problem(urdf, held={"finger_joint": 0.0}).robot.joint_names
    assert read_run(log(urdf, 4), 3, names).n == 3
    assert read_run(log(urdf, 3), 3, names).n == 3


def test_a_joint_that_moves_cannot_be_held(urdf):
    moving = small_run(load_problem(urdf))
    names = load_problem(urdf, held={"finger_joint": 0.0}).robot.joint_names
    words = "finger_joint is held at 0, but q4 of the log moves by"
    refusal(lambda: without_held(moving, names), words)
    sways = replace(moving, q=moving.q * [1.0, 1.0, 1.0, 0.001])
    assert without_held(sways, names).n == 3


def test_a_log_without_the_finger_says_how_to_hold_it(urdf):
    path = log(urdf, 3)
    names = load_problem(urdf).robot.joint_names
    refusal(lambda: read_run(path, 4, names), "--hold finger_joint=0")


def test_a_log_by_names_without_the_finger_needs_no_option(urdf):
    path = log(urdf, 3)
    robot = load_problem(urdf).robot
    header, _, rows = path.read_text().partition("\n")
    for k, name in enumerate(robot.joint_names[:3], start=1):
        for ours, theirs in (("q", "position"), ("dq", "velocity"), ("tau", "effort")):
            header = f",{header},".replace(f",{ours}{k},", f",{name}_{theirs},")[1:-1]
    path.write_text(header.replace("t,", "time,", 1) + "\n" + rows)
    refusal(
        lambda: read_run(path, 4, robot.joint_names), "finger_joint is in no column"
    )
    identified(urdf, path)
