"""What `check-urdf` says of inertials and what `--fix` writes: the one typing mistake, else
the nearest inertia, else nothing."""

import json

import numpy as np
import pytest
from commands import run_cli

from sdp_vs_penalty.exporters.inertials import check_urdf, sentences, unit_remarks
from sdp_vs_penalty.robot import inertia

ARM = """<robot name="u"><link name="base"/>
<link name="l1"><inertial><origin xyz="0 0 0.1"/><mass value="2"/>
  <inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.01"/></inertial></link>
<link name="l2"><inertial><origin xyz="0 0 0.05"/>{body}</inertial>{shape}</link>
<joint name="j1" type="revolute"><parent link="base"/><child link="l1"/><origin xyz="0 0 0.1"/>
  <axis xyz="0 0 1"/><limit lower="-3" upper="3" velocity="4" effort="200"/></joint>
<joint name="j2" type="revolute"><parent link="l1"/><child link="l2"/><origin xyz="0 0 0.2"/>
  <axis xyz="0 1 0"/><limit lower="-3" upper="3" velocity="4" effort="200"/></joint></robot>
"""
TENSOR = (
    '<mass value="1.559"/><inertia ixx="0.0026619" ixy="-3.1029e-05" ixz="9.34e-06"'
    ' iyy="0.0023025" iyz="0.000151466" izz="{izz}"/>'
)


def body(mass, *moments):
    names = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
    words = " ".join(f'{k}="{x}"' for k, x in zip(names, moments, strict=True))
    return f'<mass value="{mass}"/><inertia {words}/>'


def write(folder, body, shape=""):
    path = folder / "arm.urdf"
    path.write_text(ARM.format(body=body, shape=shape))
    return path


def said_and_fixed(path, capsys):
    """Exit code, what is printed in one line, and the file that --fix writes."""
    fixed = path.with_name("fixed.urdf")
    code = run_cli("check-urdf", path, "--fix", fixed)
    return code, " ".join(capsys.readouterr().out.split()), fixed.read_text()


def test_a_lost_decimal_point_comes_back_and_no_other_byte_changes(tmp_path, capsys):
    path = write(tmp_path, TENSOR.format(izz="1676359E-6"))
    code, said, fixed = said_and_fixed(path, capsys)
    assert code == 1
    assert 'of izz="1676359E-6" is wrong: izz="1676.359E-6" (--fix writes this)' in said
    right = ARM.format(body=TENSOR.format(izz="1676.359E-6"), shape="")
    assert fixed.replace(" />", "/>") == right


def test_rounded_numbers_move_by_what_is_needed(tmp_path, capsys):
    """The excess of 9e-11 over 1.2e-5 + 8.00001e-6, spread over three moments: 5.2e-11."""
    path = write(
        tmp_path, body("0.03", "1.2e-05", "0", "0", "8.00001e-06", "0", "2.00001e-05")
    )
    (_, check) = check_urdf(path)
    assert check.is_rounding
    assert check.distance == pytest.approx(9e-11 / np.sqrt(3.0), rel=1e-3)
    code, said, _ = said_and_fixed(path, capsys)
    assert code == 1
    assert "within the written digits" in said
    assert all(c.consistent for c in check_urdf(path.with_name("fixed.urdf")))


def test_several_mistakes_are_named_and_none_is_chosen(tmp_path, capsys):
    """Each of three signs makes the same principal moments; the nearest is written."""
    path = write(
        tmp_path,
        body(
            "0.07548248",
            "7.798716588e-05",
            "5.1716641e-06",
            "2.425498752e-05",
            "8.701457658e-05",
            "1.249373671e-05",
            "2.604813454e-05",
        ),
    )
    (_, check) = check_urdf(path)
    assert check.repair is None
    code, said, fixed = said_and_fixed(path, capsys)
    assert code == 1
    assert "4 mistakes explain it equally, none is chosen" in said
    assert all(f"the sign of {k}=" in said for k in ("ixy", "ixz", "iyz"))
    assert check.nearest.urdf_attributes["ixx"] in fixed


def test_where_the_nearest_is_beyond_the_body_the_likeliest_is_written(
    tmp_path, capsys
):
    """A lost decimal point; the nearest would have a radius of gyration of 4.6 m."""
    moments = ("0.0128427", "0", "0", "105.268", "0", "0.0128427")
    path = write(tmp_path, body("3.37179", *moments))
    code, said, fixed = said_and_fixed(path, capsys)
    assert code == 1
    assert "mistakes explain it equally, --fix writes the first: (1)" in said
    assert "the nearest consistent" not in said
    assert fixed.count("0.0128427") == 2
    (_, check) = check_urdf(path.with_name("fixed.urdf"))
    assert check.consistent


def test_numbers_that_are_written_twice_must_agree(tmp_path, capsys):
    agreeing = (
        body("1", "0.01", "0.001", "0", "0.01", "0", "0.01")
        .replace("/>", ' iyx="0.0010" izx="0"/>')
        .replace('value="1" iyx="0.0010" izx="0"', 'value="1"')
    )
    path = write(tmp_path, agreeing)
    assert run_cli("check-urdf", path) == 0
    capsys.readouterr()
    path = write(tmp_path, agreeing.replace('iyx="0.0010"', 'iyx="-0.001"'))
    code, said, fixed = said_and_fixed(path, capsys)
    assert code == 1
    assert "l2 contradictory" in said
    assert 'l2: iyx="-0.001" contradicts ixy="0.001"' in said
    assert fixed == path.read_text()


ROD = (
    '<collision><origin xyz="0 0 0.05"/><geometry><cylinder radius="0.02" length="0.6"/>'
    "</geometry></collision>"
)


def test_a_body_larger_than_its_shapes_is_named_and_kept(tmp_path, capsys):
    """A rod of .6 m whose iyy is 1 kg (.346 m)^2."""
    path = write(tmp_path, body("1", "0.12", "0", "0", "0.12", "0", "0.0002"), ROD)
    code, said, fixed = said_and_fixed(path, capsys)
    assert code == 0
    assert "l2 possible but implausible" in said
    assert "its mass is 0.346 m (root mean square) from its centre" in said
    assert "its shapes allow 0.3 m" in said
    assert fixed == path.read_text()
    path = write(tmp_path, body("1", "0.03", "0", "0", "0.03", "0", "0.0002"), ROD)
    assert [c.misfit for c in check_urdf(path)] == ["", ""]


@pytest.mark.parametrize(
    ("masses", "moments", "words"),
    [
        (
            (2000, 1000),
            (".01 0 0 .01 0 .01", ".005 0 0 .005 0 .004"),
            "the mass is in g (",
        ),
        ((2, 1), ("1 0 0 1 0 1", "1 0 0 1 0 1"), "the same inertia (1 0 0 1 0 1)"),
    ],
)
def test_a_mistake_of_all_links_is_one_explanation(
    masses, moments, words, tmp_path, capsys
):
    """Before each link is judged alone; what tells the true numbers is written."""
    shape = ROD.replace("0.6", "0.3").replace("0.02", "0.1")
    path = write(tmp_path, body(masses[1], *moments[1].split()), shape)
    first = body("2", "0.01", "0", "0", "0.01", "0", "0.01")
    text = path.read_text().replace("\n  <inertia", "<inertia")
    path.write_text(text.replace(first, body(masses[0], *moments[0].split())))
    code, said, fixed = said_and_fixed(path, capsys)
    assert code == 1
    assert words in said.partition("All links:")[2]
    assert "l1:" not in said
    assert (fixed == path.read_text()) == ("same" in words)


def test_moments_about_exchanged_axes_are_a_finding_without_a_fix(tmp_path, capsys):
    """A rod of .6 m along z; its mass lies near the middle, along x by its moments."""
    path = write(tmp_path, body("1", "0.0002", "0", "0", "0.001", "0", "0.001"), ROD)
    code, said, fixed = said_and_fixed(path, capsys)
    assert code == 0
    assert "l2 possible but implausible" in said
    assert "turned: its moments" in " ".join(said.split())
    assert "ixx and izz are exchanged" in said
    assert fixed == path.read_text()


def test_a_lost_point_of_a_mass_is_named(tmp_path):
    """A ball of 1 kg and 5 cm, as its moments have it: of 10 kg none is so small."""
    moments = ("0.001", "0", "0", "0.001", "0", "0.001")
    (_, check) = check_urdf(write(tmp_path, body("10", *moments)))
    assert "denser than any metal: its radius of gyration is 0.012 m" in check.misfit
    (_, check) = check_urdf(write(tmp_path, body("1", *moments)))
    assert not check.misfit


def test_a_link_that_is_fixed_to_another_is_judged_in_its_own_frame(tmp_path):
    """And a link without shapes not at all, since it may be anywhere."""
    tool = (
        '<link name="tool"><inertial><origin xyz="0 0 0.05"/>'
        + body("1", "0.03", "0", "0", "0.03", "0", "0.0002")
        + f'</inertial>{ROD}</link><joint name="f" type="fixed"><parent link="l2"/>'
        '<child link="tool"/><origin xyz="0.9 0 0" rpy="0 1.2 0"/></joint></robot>'
    )
    path = write(tmp_path, body("1", "0.03", "0", "0", "0.03", "0", "0.0002"))
    path.write_text(path.read_text().replace("</robot>", tool))
    assert [c.misfit for c in check_urdf(path)] == ["", "", ""]


@pytest.mark.parametrize(("shift", "is_named"), [(0.25, True), (0.0, False)])
def test_a_centre_that_is_left_out_is_named(shift, is_named, tmp_path):
    """It is at the frame's origin then, which is the end of an arm's link."""
    rod = ROD.replace("0 0 0.05", f"0 0 {shift}")
    path = write(tmp_path, body("1", "0.03", "0", "0", "0.03", "0", "0.0002"), rod)
    path.write_text(path.read_text().replace('<origin xyz="0 0 0.05"/><mass', "<mass"))
    (_, check) = check_urdf(path)
    assert ("exactly at the frame's origin" in check.misfit) is is_named


def test_a_negative_mass_is_a_sign(tmp_path, capsys):
    path = write(tmp_path, body("-1.5", "0.01", "0", "0", "0.01", "0", "0.008"))
    _, said, fixed = said_and_fixed(path, capsys)
    assert 'the sign of mass="-1.5" is wrong: mass="1.5"' in said
    assert '<mass value="1.5"' in fixed


def test_what_is_checked_is_in_the_json(tmp_path):
    path = write(tmp_path, TENSOR.format(izz="1676359E-6"))
    run_cli("check-urdf", path, "--json", tmp_path / "c.json")
    _, link = json.loads((tmp_path / "c.json").read_text())["links"]
    assert link["repairs"][0]["numbers"] == {"izz": "1676.359E-6"}


@pytest.mark.parametrize("seed", range(8))
def test_the_nearest_inertia_loads_in_mujoco(seed):
    """Of any symmetric matrix and of none."""
    mujoco = pytest.importorskip("mujoco")
    half = np.random.default_rng(seed).normal(size=(3, 3))
    matrix = 10.0 ** -(seed % 4) * (half + half.T) * (seed > 0)
    nearest = inertia.nearest_inertia(matrix, mass=1.3)
    places = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
    full = " ".join(repr(float(nearest[i, j])) for i, j in places)
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><worldbody><body><joint/><inertial pos="0 0 0" mass="1.3"'
        f' fullinertia="{full}"/></body></worldbody></mujoco>'
    )
    assert model.nv == 1


@pytest.mark.parametrize(
    ("scale", "mass", "units"),
    [
        (1e3, 1e3, {"lengths": "mm", "masses": "g", "inertias": "g mm^2"}),
        (1e3, 1.0, {"lengths": "mm", "inertias": "kg mm^2"}),
        (1e2, 1.0, {"lengths": "cm"}),
    ],
)
def test_units_of_length_and_mass_together(scale, mass, units, tmp_path):
    """A small arm: links of 0.4 kg and 0.1 m, all in one other system of units."""
    moment = 4e-4 * mass * scale**2
    link = (
        '<link name="l{0}"><inertial><origin xyz="0 0 {1}"/><mass value="{2}"/>'
        '<inertia ixx="{3}" iyy="{3}" izz="{3}"/></inertial></link>'
        '<joint name="j{0}" type="continuous"><parent link="{4}"/><child link="l{0}"/>'
        '<origin xyz="0 0 {5}"/><axis xyz="0 1 0"/></joint>'
    )
    step = (0.1 if scale == 1e3 else 0.3) * scale
    links = "".join(
        link.format(
            k, 0.05 * scale, 0.4 * mass, moment, f"l{k - 1}" if k else "base", step
        )
        for k in range(3)
    )
    path = tmp_path / "small.urdf"
    path.write_text(f'<robot name="r"><link name="base"/>{links}</robot>')
    checks = check_urdf(path)
    said = unit_remarks(path, checks)
    for quantity, unit in units.items():
        assert any(f"the {quantity}" in x and f"look like {unit}" in x for x in said), (
            said
        )
    assert ("masses" in units) == any("the masses" in x for x in said)
    assert sentences(checks, [], said)[0].endswith("all are consistent.")
