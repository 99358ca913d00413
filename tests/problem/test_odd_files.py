"""What is said of a robot's file that no body or joint can have, and changes no
estimate."""

import re
import warnings
from dataclasses import replace

import numpy as np
import pytest
from arms import THREE, write_urdf

from sdp_vs_penalty import load_problem
from sdp_vs_penalty.errors import InputError, Remark
from sdp_vs_penalty.exporters.inertials import check_urdf, format_remarks, unit_remarks

#: Of a ball of 2 kg about its centre [kg m^2].
MOMENTS = (0.005, 0.0, 0.005, 0.0, 0.0, 0.005)


def remarks_on(file):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        load_problem(file)
    return [str(w.message) for w in caught if issubclass(w.category, Remark)]


def arm(folder, mass=2.0, moments=MOMENTS, limits=(0.2, 2.5, 2.0)):
    axes = [*THREE]
    axes[1] = replace(axes[1], mass=mass, moments=moments)
    return write_urdf(folder / "arm.urdf", "arm", axes, limits)


@pytest.mark.parametrize(
    ("mass", "moments", "why", "stands_in"),
    [
        (-2.0, MOMENTS, "negative mass", "a guess"),
        (0.0, MOMENTS, "moment of inertia without mass", "a guess"),
        (2.0, (-0.005, 0, 0.005, 0, 0, 0.005), "negative moment", "the nearest"),
        (2.0, (0.005, 0, 0.005, 0, 0, 0.05), "triangle inequality", "the nearest"),
    ],
)
def test_a_link_that_cannot_exist_is_said(mass, moments, why, stands_in, tmp_path):
    file = arm(tmp_path, mass, moments)
    (remark,) = remarks_on(file)
    assert f"{file}: {why}" in remark
    assert "joint2" in remark
    assert stands_in in remark
    assert [c.link for c in check_urdf(file) if not c.consistent] == ["link2"]


@pytest.mark.parametrize(
    ("limits", "named"),
    [
        ((0.2, 175.0, 2.0), "limits of positions (joint"),
        ((0.2, 2.5, 180.0), "limits of velocities (joint"),
        (
            (0.2, 175.0, 37.0),
            "limits of positions (joint1, joint2, joint3) and velocities",
        ),
        ((0.2, 6.3, 8.0), ""),  # one turn to either side, in radians
        ((0.2, 2.5, 37.0), ""),  # a quadruped's drive: 353 turns a minute
        ((0.2, 1e16, 1e16), ""),  # no limit
    ],
)
def test_limits_in_degrees_are_said_by_each_command(limits, named, tmp_path):
    file = arm(tmp_path, limits=limits)
    said = [*remarks_on(file), *unit_remarks(file, check_urdf(file))]
    assert len(said) == (2 if named else 0)
    assert all(named in remark and "radians" in remark for remark in said)


def test_a_robot_as_people_build_it_is_not_remarked_on(tmp_path):
    file = arm(tmp_path)
    assert remarks_on(file) == []
    assert np.all(load_problem(file).nominal_links[:, 0] > 0.0)


#: How far joints reach, what is changed in the text of an arm's file, and what is said of it.
LIMITS = '(<joint name="joint2".*?<limit) lower="[^"]*" upper="[^"]*"'
CHANGED = {
    "a rail in mm": (
        150.0,
        '(<joint name="joint3" type=)"revolute"',
        r'\1"prismatic"',
        "limits of joint3 reach 150 m and look like millimetres",
    ),
    "an axis left out": (
        2.5,
        '(<joint name="joint2".*?)<axis[^>]*>',
        r"\1",
        "joint2 without <axis>",
    ),
    "one joint in degrees": (
        2.5,
        LIMITS,
        r'\1 lower="-100" upper="100"',
        "limits of positions (joint2) look like degrees",
    ),
    "a joint of many turns": (2.5, LIMITS, r'\1 lower="-47.1" upper="47.1"', ""),
}


@pytest.mark.parametrize("case", CHANGED)
def test_a_mistake_of_a_joint_is_said(case, tmp_path):
    reach, pattern, new, words = CHANGED[case]
    file = arm(tmp_path, limits=(0.2, reach, 2.0))
    text, n_changed = re.subn(pattern, new, file.read_text(), count=1, flags=re.DOTALL)
    assert n_changed == 1
    file.write_text(text)
    said = unit_remarks(file, check_urdf(file))
    assert any(words in remark for remark in said) if words else said == []


def test_a_centre_of_one_number_is_said_where_it_stands(tmp_path):
    """The base's is read by nothing but the check of the file."""
    file = arm(tmp_path)
    base = (
        '<link name="link0"><inertial><origin xyz="0.003"/><mass value="9"/></inertial>'
    )
    text = file.read_text().replace('<link name="link0"/>', f"{base}</link>")
    assert base in text
    file.write_text(text)
    with pytest.raises(InputError, match=r"<origin xyz='0.003'> must hold 3 finite"):
        check_urdf(file)


def test_round_numbers_that_all_links_share_hold_a_place(tmp_path):
    moments = (1.0, 0.0, 1.0, 0.0, 0.0, 1.0)
    axes = [replace(axis, mass=1.0, moments=moments) for axis in THREE]
    file = write_urdf(tmp_path / "arm.urdf", "arm", axes, (0.2, 2.5, 2.0))
    assert {"placeholders" in x.of_all for x in check_urdf(file)} == {True}


@pytest.mark.parametrize("z", [9.81, -9.81])
def test_gravity_upwards_of_an_mjcf_is_said(z, tmp_path):
    file = tmp_path / "arm.xml"
    file.write_text(
        f'<mujoco><option gravity="0 0 {z}"/><worldbody><body name="b"><joint name="j"/>'
        '<inertial pos="0 0 0.1" mass="1" diaginertia="0.01 0.01 0.01"/></body>'
        "</worldbody></mujoco>"
    )
    assert bool(format_remarks(file)) is (z > 0.0)


@pytest.mark.parametrize(
    ("inertial", "words"),
    [
        ("<mass>1</mass><inertia><ixx>1</ixx><iyy>1</iyy><izz>1</izz></inertia>", ""),
        ("<inertia><ixx>1</ixx><iyy>1</iyy><izz>1</izz></inertia>", "mass of b"),
        ("<mass>2</mass>", "ixx, iyy and izz of b"),
    ],
)
def test_what_an_sdf_leaves_to_its_default_is_said(inertial, words, tmp_path):
    file = tmp_path / "arm.sdf"
    link = f'<link name="a"/><link name="b"><inertial>{inertial}</inertial></link>'
    file.write_text(f'<sdf version="1.7"><model name="m">{link}</model></sdf>')
    said = format_remarks(file)
    assert (words in said[0]) if words else said == []
