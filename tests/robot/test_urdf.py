"""URDF files: the same robot as Pinocchio's own parser builds, and refusals in one
sentence."""

import re
from pathlib import Path

import numpy as np
import pytest
from arms import urdfdom_torque
from numpy.testing import assert_allclose, assert_array_equal
from recorded import refusal, refusals, same_refusal

from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.robot import load_urdf
from sdp_vs_penalty.robot.urdf import numbers_of, parse_urdf

#: A gantry arm: a prismatic base axis, a continuous shoulder, an elbow, a tool behind
#: two fixed joints, a camera arm as a branch, a fixed pedestal; link "upper" and the
#: camera mount have no inertial.
GANTRY = Path(__file__).with_name("gantry.urdf")
ARM = GANTRY.read_text()


def test_torques_equal_those_of_pinocchios_own_parser():
    robot, theta = load_urdf(GANTRY)
    states = np.random.default_rng(2).normal(size=(3, 20, robot.n))
    expected = urdfdom_torque(GANTRY, robot, *states)
    assert_allclose(
        robot.inverse_dynamics(theta, *states), expected, rtol=1e-12, atol=1e-12
    )


@pytest.mark.parametrize("case", refusals("urdf"))
def test_a_bad_urdf_is_refused(case, tmp_path, monkeypatch):
    """Of the gantry, and of a lift whose joints follow others."""
    old, new, _ = refusals("urdf")[case]
    sound = next(
        text for text in (ARM, GANTRY.with_name("lift.urdf").read_text()) if old in text
    )
    monkeypatch.chdir(tmp_path)
    Path("bad.urdf").write_text(sound.replace(old, new, 1))
    assert same_refusal("urdf", case, refusal(lambda: load_urdf("bad.urdf")))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (re.sub("prismatic|continuous|revolute", "fixed", ARM), "no moving joint"),
        (ARM[: len(ARM) // 2], "not an XML file"),
        ("<model/>", "outermost element is <model>"),
        ("<sdf/>", "or convert it to URDF"),
        ("version https://git-lfs.github.com/spec/v1\noid x\n", "git lfs pull"),
        ("\n<!DOCTYPE html>\n<html><br></html>", "a web page"),
    ],
)
def test_what_is_no_robot_is_refused(text, words, tmp_path):
    (tmp_path / "bad.urdf").write_text(text)
    refusal(lambda: load_urdf(tmp_path / "bad.urdf"), words)


def test_entities_and_missing_files_do_no_harm(tmp_path):
    secret = tmp_path / "secret.txt"
    secret.write_text(
        "<link name='b'/><joint name='j' type='continuous'><parent link='a'/><child"
        " link='b'/></joint>"
    )
    path = tmp_path / "x.urdf"
    path.write_text(
        f'<!DOCTYPE robot [<!ENTITY e SYSTEM "{secret}">]><robot name="r"><link'
        ' name="a"/>&e;</robot>'
    )
    refusal(lambda: load_urdf(path), "no moving joint")
    refusal(lambda: load_urdf(tmp_path / "absent.urdf"), "cannot be read")


@pytest.mark.parametrize("place", ["joint", "inertial"])
def test_angles_in_degrees_are_refused_with_their_radians(place, tmp_path):
    text = (Path(__file__).parents[2] / "docs" / "my_arm.urdf").read_text()
    origin = {"joint": '<origin xyz="0.4 0 0"', "inertial": '<origin xyz="0.2 0 0"'}[
        place
    ]
    path = tmp_path / "arm.urdf"
    path.write_text(text.replace(origin, f'{origin} rpy="90 0 -180"'))
    with pytest.raises(
        InputError, match=r"in degrees.*1\.57079632679 0 -3\.14159265359"
    ):
        load_urdf(path)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1e3", 1e3),
        (" -.5\n", -0.5),
        ("+2.E-3", 2e-3),
        ("1_000", np.nan),
        ("\u0661", np.nan),  # an Arabic one
        ("1\u00a0", np.nan),  # a blank that is none of XML's
        ("0x10", np.nan),
        ("1,5", np.nan),
        ("1 2", np.nan),
        ("", np.nan),
    ],
)
def test_numbers_are_those_of_xml(text, value):
    assert_array_equal(numbers_of(text, 1), [value])


def test_macros_are_refused_by_every_reader(tmp_path):
    path = tmp_path / "arm.urdf"
    path.write_text('<robot name="a"><link name="b"/><xacro:hand parent="b"/></robot>')
    with pytest.raises(InputError, match="a xacro file, which is no URDF yet"):
        parse_urdf(path)
