"""The one door: which format a file has, xacro, SDF, and what couples links besides."""

import sys
from pathlib import Path

import numpy as np
import pytest
import random_robots
from arms import ELBOW, SHOULDER, write_urdf
from commands import run_cli
from dynamics_files import FULL, estimate_of
from numpy.testing import assert_allclose
from recorded import refusal

from sdp_vs_penalty import export, load_problem
from sdp_vs_penalty.errors import Remark
from sdp_vs_penalty.robot import load_robot, load_urdf

#: What tools write into a URDF for a simulator, and a remark about its origin.
EXTENSIONS = """<mujoco><compiler meshdir="meshes"/></mujoco>
<!-- made from <xacro:include filename="arm.xacro"/> --></robot>"""


def arm(folder):
    return write_urdf(folder / "plain.urdf", "arm", (SHOULDER, ELBOW))


def with_end(path, end, name="changed.urdf"):
    """A copy of a URDF with other elements before its end."""
    out = path.with_name(name)
    out.write_text(path.read_text().replace("</robot>", end))
    return out


def same_arm(path, other):
    ours, plain = load_robot(path), load_robot(other)
    assert_allclose(ours.links, plain.links, rtol=1e-12, atol=1e-15)
    q, dq, ddq = np.random.default_rng(0).normal(size=(3, 20, plain.robot.n))
    torque = plain.robot.inverse_dynamics(plain.links, q, dq, ddq)
    again = ours.robot.inverse_dynamics(ours.links, q, dq, ddq)
    assert_allclose(again, torque, rtol=1e-9, atol=1e-12)


def test_a_mujoco_block_and_a_comment_make_no_other_format(tmp_path):
    path = arm(tmp_path)
    same_arm(with_end(path, EXTENSIONS), path)


def test_bullets_version_of_xml_is_read(tmp_path):
    path = arm(tmp_path)
    bullet = tmp_path / "bullet.urdf"
    bullet.write_text('<?xml version="0.0" ?>\n' + path.read_text())
    same_arm(bullet, path)


def xacro_file(folder):
    """A URDF, and a xacro that includes its joints and links from a package."""
    path = arm(folder)
    package = folder / "my_arm"
    package.mkdir()
    text = path.read_text().replace(
        "<robot ", '<robot xmlns:xacro="http://ros.org/wiki/xacro" '
    )
    (package / "macros.xacro").write_text(text)
    out = folder / "arm.urdf.xacro"
    head = text[: text.index(">", text.index("<robot")) + 1]
    out.write_text(
        f'{head}<xacro:include filename="$(find my_arm)/macros.xacro"/></robot>'
    )
    return path, out


def test_xacro_is_expanded_without_ros(tmp_path):
    pytest.importorskip("xacro")
    path, macros = xacro_file(tmp_path)
    same_arm(macros, path)


def test_what_xacro_refuses_is_one_sentence_about_the_users_file(tmp_path):
    pytest.importorskip("xacro")
    _, path = xacro_file(tmp_path)
    path.write_text(path.read_text().replace("my_arm", "their_arm"))
    refusal(lambda: load_problem(path), "arm.urdf.xacro: ", "'their_arm'")


@pytest.mark.parametrize(
    ("macros", "words"),
    [
        (
            '<xacro:macro name="a" params=""><xacro:a/></xacro:macro><xacro:a/>',
            "recursion",
        ),
        ("<xacro:a/><link name=\"${len('a' * 10**11)}\"/>", "too much memory"),
        ("<xacro:a/><link name=\"${open('x', 'w')}\"/>", "'open' is not defined"),
    ],
)
def test_macros_that_take_too_much_end_their_own_process(macros, words, tmp_path):
    pytest.importorskip("xacro")
    path = tmp_path / "arm.urdf.xacro"
    known = '<xacro:macro name="a" params=""/>' if "macro name" not in macros else ""
    path.write_text(
        f'<robot name="r" xmlns:xacro="http://ros.org/wiki/xacro">{known}{macros}</robot>'
    )
    refusal(lambda: load_problem(path), "arm.urdf.xacro: xacro does not expand", words)
    assert [x.name for x in tmp_path.iterdir()] == ["arm.urdf.xacro"]


def test_without_xacro_its_command_and_the_extra_are_named(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "xacro", None)
    _, path = xacro_file(tmp_path)
    refusal(lambda: load_problem(path), f"`xacro {path} > ", "sdp-vs-penalty[formats]")


def test_an_sdf_that_we_write_is_read_again(tmp_path):
    robot = load_urdf(Path(__file__).with_name("gantry.urdf"))[0]
    for name, arm_of in (
        ("gantry", robot),
        ("tree", random_robots.tree(np.random.default_rng(5), 6)),
    ):
        estimate = estimate_of(arm_of, FULL, seed=1)
        paths = tmp_path / f"{name}.urdf", tmp_path / f"{name}.sdf"
        for path in paths:
            export(estimate, path)
        same_arm(paths[1], paths[0])


#: A link frame beside its joint, a joint pose, an axis of the model, a quaternion, degrees.
SDF = """<sdf version="1.9"><world name="w"><model name="m">
<link name="base"/><joint name="fix" type="fixed"><parent>world</parent><child>base</child></joint>
<link name="one"><pose degrees="true">.1 .2 .3 0 0 90</pose><inertial><pose>0 .1 0 0 0 0</pose>
 <mass>2</mass><inertia><ixx>.02</ixx><iyy>.01</iyy><izz>.02</izz></inertia></inertial></link>
<joint name="a" type="revolute"><pose>0 .05 0 0 0 0</pose><parent>base</parent><child>one</child>
 <axis><xyz expressed_in="__model__">1 0 0</xyz></axis></joint>
<frame name="tip" attached_to="one"><pose rotation_format="quat_xyzw">0 .4 0 0 0 0 1</pose></frame>
<link name="two"><pose relative_to="tip"/><inertial><mass>1</mass><inertia><ixx>.01</ixx>
 <iyy>.01</iyy><izz>.01</izz></inertia></inertial></link>
<joint name="b" type="prismatic"><parent>tip</parent><child>two</child><axis><xyz>0 1 0</xyz>
 <limit><lower>0</lower><upper>.5</upper><effort>-1</effort></limit></axis></joint>
</model></world></sdf>"""


def test_an_axis_of_an_old_sdf_is_the_models(tmp_path):
    path = tmp_path / "arm.sdf"
    path.write_text(SDF)
    new = load_robot(path)
    axis = '<xyz expressed_in="__model__">1 0 0</xyz>'
    old = SDF.replace(axis, "<xyz>1 0 0</xyz>").replace('"1.9"', '"1.4"')
    path.write_text(old.replace("<xyz>0 1 0</xyz>", "<xyz>-1 0 0</xyz>"))
    for ours, theirs in zip(
        load_robot(path).robot.joints, new.robot.joints, strict=True
    ):
        assert_allclose(ours.axis, theirs.axis, atol=1e-12)


def test_a_mimic_joint_of_an_sdf_counts_from_its_reference(tmp_path):
    path = tmp_path / "arm.sdf"
    numbers = "<multiplier>2</multiplier><offset>.3</offset><reference>.1</reference>"
    mimic = f'<mimic joint="a">{numbers}</mimic>'
    path.write_text(SDF.replace("<xyz>0 1 0</xyz>", f"<xyz>0 1 0</xyz>{mimic}"))
    robot = load_robot(path).robot
    assert robot.joint_names == ("a",)
    assert robot.leader(1) == ("a", 2.0, pytest.approx(0.3 - 2.0 * 0.1))


def test_meshes_lie_beside_the_users_file(tmp_path):
    """Of an SDF, whose URDF lies elsewhere."""
    corners = np.zeros(4, [("normal", "<f4", 3), ("at", "<f4", 9), ("x", "<u2")])
    tetrahedron = 0.1 * np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    faces = [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]
    corners["at"] = tetrahedron[faces].reshape(4, 9)
    (tmp_path / "meshes").mkdir()
    content = b"\0" * 80 + np.uint32(4).tobytes() + corners.tobytes()
    (tmp_path / "meshes/one.stl").write_bytes(content)
    shape = (
        "<visual><geometry><mesh><uri>meshes/one.stl</uri></mesh></geometry></visual>"
    )
    path = tmp_path / "arm.sdf"
    path.write_text(SDF.replace("</inertial></link>", f"</inertial>{shape}</link>", 1))
    first, second = load_robot(path).geometry
    assert second is None
    assert first.volume == pytest.approx(0.1**3 / 6.0)


def test_an_sdf_is_checked_and_its_urdf_repaired(tmp_path):
    path = tmp_path / "arm.sdf"
    path.write_text(SDF.replace("<izz>.02</izz>", "<izz>-.02</izz>"))
    assert run_cli("check-urdf", path, "--fix", tmp_path / "fixed.urdf") == 1
    path.write_text(SDF)
    same_arm(tmp_path / "fixed.urdf", path)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('<model name="m">', '<model name="n"/><model name="m">', ["2 <model>s"]),
        ('attached_to="one"', 'attached_to="gone"', ["'tip'", "'gone'"]),
        ('<link name="base"/>', '<link name="base"/><include/>', ["<include>"]),
        ('type="prismatic"', 'type="screw"', ["'b'", "'screw'"]),
        (">.1 .2 .3 0 0 90<", ">.1 .2 .3 0 0<", ["line 3", "6 numbers"]),
    ],
)
def test_what_an_sdf_may_not_hold_is_one_sentence(old, new, words, tmp_path):
    path = tmp_path / "arm.sdf"
    path.write_text(SDF.replace(old, new))
    refusal(lambda: load_problem(path), "arm.sdf: ", *words)


@pytest.mark.parametrize(
    ("end", "words"),
    [
        (
            '<constraint type="loop" parent="a" child="b"/></robot>',
            "<constraint type='loop'",
        ),
        (
            "<gazebo><joint name='close' type='revolute'/></gazebo></robot>",
            "<joint name='close'",
        ),
        ('<loop_joint name="bar"/></robot>', "<loop_joint name='bar'>"),
        (
            "<mujoco><equality><connect body1='a' body2='b'/></equality></mujoco></robot>",
            "<connect body1='a' body2='b'>",
        ),
    ],
)
def test_what_couples_links_besides_is_named(end, words, tmp_path):
    path = with_end(arm(tmp_path), end)
    with pytest.warns(Remark, match="not read: the arm is the tree of joints") as said:
        load_problem(path)
    assert words in str(said[0].message)


def test_what_couples_links_of_an_sdf_is_named(tmp_path):
    path = tmp_path / "arm.sdf"
    plugin = (
        '<plugin name="p"><constraint type="loop"><connect body1="a"/></constraint>'
        "</plugin></model>"
    )
    path.write_text(SDF.replace("</model>", plugin))
    said = load_robot(path).couplings
    assert said.startswith("<constraint type='loop'>, <connect body1='a'>: not read")


def test_only_a_file_s_own_lines_of_couplings_are_said(tmp_path, capsys):
    """Those of the URDF that is made of an SDF are no lines of the user's."""
    coupling = '<constraint type="loop"/>'
    urdf = with_end(arm(tmp_path), f"{coupling}</robot>")
    sdf = tmp_path / "arm.sdf"
    sdf.write_text(SDF.replace("</model>", f"{coupling}</model>"))
    for path, has_lines in ((urdf, True), (sdf, False)):
        assert ("(line " in load_robot(path).couplings) == has_lines
        run_cli("check-urdf", path)
        said = capsys.readouterr().out
        assert "<constraint type='loop'>" in said
        assert ("(line " in said) == has_lines
