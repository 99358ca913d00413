"""What leaves for a simulator makes the same torques there; nothing else of a user's
file changes."""

import json
import re
from dataclasses import replace
from functools import cache
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import random_robots
from commands import run_cli
from drawn import HealthCheck, example, given, settings, st
from dynamics_files import FULL, READERS, estimate_of
from lxml import etree
from recorded import refusal

from sdp_vs_penalty import export, load_problem
from sdp_vs_penalty.effects import Motion
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimation.verdict import FIT, Line, Verdict
from sdp_vs_penalty.exporters import EXPORTS
from sdp_vs_penalty.exporters.friction_table import friction_curves
from sdp_vs_penalty.exporters.inertials import check_urdf, massless_links
from sdp_vs_penalty.page import jobs
from sdp_vs_penalty.robot import inertia, load_urdf
from sdp_vs_penalty.testing.files import EXPORT_CONTRACTS

PARITY = 1e-9  # N m

#: A tree with fixed joints, odd spacing and line ends, and unknown attributes.
TREE_FILE = Path(__file__).with_name("tree.urdf")
TREE = TREE_FILE.read_bytes().decode()


@cache
def robots():
    return {
        **{name: load_problem(name).robot for name in ("panda", "two_link", "emps")},
        "tree": load_urdf(TREE_FILE)[0],
        "random": random_robots.tree(np.random.default_rng(5), 6, link_frames=True),
    }


def check_parity(path, estimate, ending=".urdf"):
    """Torques of the reloaded file against the model's, without what the file has no
    place for."""
    robot, (readers, lost) = estimate.robot, READERS[ending]
    q, dq, ddq = random_robots.states(robot, 30, 1)
    expected = estimate.torque(Motion(np.zeros(len(q)), q, dq, ddq))
    for p, value in zip(estimate.model.parameters, estimate.theta, strict=True):
        if p.effect in lost:
            expected[:, p.joint - 1] -= value * (
                ddq[:, p.joint - 1] if p.effect[0] == "r" else 1.0
            )
    for read in readers:
        assert np.abs(read(path, robot, q, dq, ddq) - expected).max() <= PARITY


@pytest.mark.parametrize("ending", READERS)
@pytest.mark.parametrize("name", robots())
def test_every_file_of_dynamics_makes_the_models_torques(name, ending, tmp_path):
    estimate = estimate_of(robots()[name], f"{FULL},torque_offset", 3)
    left_out = export(estimate, tmp_path / f"out{ending}")
    assert {text.partition(":")[0] for text in left_out} == set(READERS[ending][1])
    check_parity(tmp_path / f"out{ending}", estimate, ending)


def only_numbers_of_inertials_changed(before, after):
    """Cut the inertials and dynamics elements out of both: the rest is the same to the
    byte."""

    def rest(text):
        text = re.sub(rb"\s*<inertial.*?</inertial>\s*", b"", text, flags=re.S)
        text = re.sub(rb"\s*<dynamics[^>]*/>\s*", b"", text)
        # What <link name="x"/> becomes when it gets its first inertial.
        text = re.sub(rb"<link name=\"bare\">\s*</link>", b'<link name="bare"/>', text)
        return re.sub(rb">\s+<", b"><", text)

    assert rest(before) == rest(after)
    for kept in (
        rb"<!--.*?-->",
        rb"<\?xml.*?\?>",
        rb"<(?:mesh|visual|gazebo|mu1)[^>]*>",
    ):
        assert re.findall(kept, before, re.S) == re.findall(kept, after, re.S)


def test_a_users_urdf_is_edited_byte_for_byte(tmp_path):
    out = tmp_path / "out.urdf"
    estimate = estimate_of(robots()["tree"], FULL, 3)
    export(estimate, out, urdf=TREE_FILE)
    check_parity(out, estimate)
    before = TREE_FILE.read_bytes()
    after = out.read_bytes()
    only_numbers_of_inertials_changed(before, after)
    # Where bytes differ, only inside inertials and dynamics; odd quotes and spaces
    # stay.
    for text in (
        '<inertial extra="kept">',
        "<!-- beside -->",
        'secret="1 > 0"',
        '">\r\n',
    ):
        assert text.encode() in after
    # The base keeps its inertial, and so does what is fixed to it.
    assert before.count(b'<mass value="5"/>') == after.count(b'<mass value="5"/>') == 1
    assert after.count(b'<mass value="3"/>') == 1
    reloaded, _ = load_urdf(out)
    assert reloaded.n == 3
    by_link = {check.link: check for check in check_urdf(out)}
    assert (
        by_link["plate"].inertial_given.mass
        == by_link["tip"].inertial_given.mass
        == 0.0
    )
    assert by_link["bare"].inertial_given.mass == pytest.approx(
        estimate.links[1, 0], abs=0
    )
    # A second export over the result changes nothing at all.
    again = tmp_path / "again.urdf"
    export(estimate, again, urdf=out)
    assert again.read_bytes() == after


def test_a_model_from_dh_goes_into_a_urdf_with_other_frames(tmp_path):
    """The same two-link arm with frames elsewhere on the joint axes, as a vendor would
    draw it."""
    robot = load_problem("two_link").robot
    estimate = estimate_of(robot, "rigid_body", 4)
    theirs = tmp_path / "vendor.urdf"
    out = tmp_path / "out.urdf"
    theirs.write_text(
        '<robot name="vendor"><link name="floor"/><link name="post"/><link'
        ' name="arm"/><joint name="first" type="continuous"><parent'
        ' link="floor"/><child link="post"/><origin xyz="0 0 0.7" rpy="0 0 0.3"/><axis'
        ' xyz="0 0 1"/></joint><joint name="second" type="continuous"><parent'
        ' link="post"/><child link="arm"/><origin xyz="0 0 0.8" rpy="1.5707963267948966'
        ' 0 -0.3"/><axis xyz="0 0 1"/></joint></robot>'
    )
    export(estimate, out, urdf=theirs)
    q, dq, ddq = random_robots.states(robot, 30, 1)
    vendor, links = load_urdf(out, robot.gravity)
    expected = robot.inverse_dynamics(estimate.links.ravel(), q, dq, ddq)
    assert (
        np.abs(vendor.inverse_dynamics(links.ravel(), q, dq, ddq) - expected).max()
        <= PARITY
    )
    text = theirs.read_text()
    theirs.write_text(text.replace(" -0.3", " 0"))
    refusal(lambda: export(estimate, out, urdf=theirs), "second")
    theirs.write_text(
        text.replace('xyz="0 0 0.8"', 'xyz="5e-5 0 0.8"')
    )  # as rounded tables lie
    export(estimate, out, urdf=theirs)
    for apart, far in (("0.01", "9.55"), ("1.5e-4", "0.14")):
        theirs.write_text(text.replace('xyz="0 0 0.8"', f'xyz="{apart} 0 0.8"'))
        refusal(
            lambda: export(estimate, out, urdf=theirs),
            f"its axis lies {far}",
            " mm away",
        )
    theirs.write_text(TREE)
    refusal(lambda: export(estimate, out, urdf=theirs), "3 moving joint")


def test_a_payload_for_the_makers_controllers(tmp_path):
    """Mass, centre from the flange, inertia about the centre: the body's own, whoever
    writes it."""
    robot = load_problem("panda").robot
    mass = 1.3
    com = np.array([0.01, -0.02, 0.15])
    tensor = np.diag([0.004, 0.005, 0.003])
    moments = tensor[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]
    estimate = estimate_of(robot, "rigid_body,payload", 3)
    theta = estimate.theta.copy()
    theta[-10:] = inertia.standard_from_barycentric([mass, *com, *moments])
    estimate = replace(estimate, theta=theta)
    export(estimate, tmp_path / "endeffector-config.json", flange=(0.0, 0.0, 0.107))
    told = json.loads((tmp_path / "endeffector-config.json").read_text())
    assert told["mass"] == pytest.approx(mass)
    assert told["centerOfMass"] == pytest.approx((com - [0.0, 0.0, 0.107]).tolist())
    assert told["inertia"] == pytest.approx(tensor.ravel().tolist(), abs=1e-12)
    estimate.save(tmp_path / "model.json")
    request = {
        "model": str(tmp_path / "model.json"),
        "folder": str(tmp_path),
        "flange": "0,0,0.05",
        "verdict": Verdict((Line(FIT, "good", "No error."),), None, "", ()).to_dict(),
    }
    jobs.take(
        jobs.JobRequest({**request, "name": "endeffector-config.json"})
    )  # as the page asks for it
    told = json.loads((tmp_path / "endeffector-config.json").read_text())
    assert told["centerOfMass"] == pytest.approx((com - [0.0, 0.0, 0.05]).tolist())
    export(estimate, tmp_path / "load.script")
    line = (tmp_path / "load.script").read_text().splitlines()[1]
    figures = [float(x) for x in re.findall(r"-?[0-9.]+(?:e-?[0-9]+)?", line)]
    assert figures == pytest.approx(
        [mass, *com, *np.diag(tensor), 0.0, 0.0, 0.0], abs=1e-12
    )
    refusal(
        lambda: export(estimate_of(robot, FULL, 3), tmp_path / "load.script"),
        "no payload",
    )


def test_a_motor_takes_commands_in_the_units_that_its_channel_reads(tmp_path):
    estimate = estimate_of(load_problem("two_link").robot, FULL, 3)
    made = replace(estimate, model=replace(estimate.model, gains=(0.5, 2.0)))
    for one, gears in ((estimate, [None, None]), (made, ["2.0", "0.5"])):
        export(one, tmp_path / "arm.xml")
        motors = etree.parse(str(tmp_path / "arm.xml")).findall("actuator/motor")
        assert [m.get("gear") for m in motors] == gears


@pytest.mark.parametrize("suffix", [".urdf", ".xml"])
def test_inconsistent_inertials_are_refused(suffix, tmp_path):
    robot = load_problem("two_link").robot
    rng = np.random.default_rng(0)
    links = np.array([random_robots.link_parameters(rng, 0.4) for _ in range(2)])
    links[1, 4] += 10.0  # Ixx > Iyy + Izz
    out = tmp_path / f"out{suffix}"
    refusal(lambda: export(estimate_of(robot, "rigid_body", 0, links), out), "link 2")
    assert not out.exists()
    estimate = estimate_of(robot, FULL, 1)
    is_f_c2 = np.array([p.name == "f_c2" for p in estimate.model.parameters])
    negative, without = (
        estimate.with_theta(np.where(is_f_c2, f_c2, estimate.theta))
        for f_c2 in (-0.1, 0.0)
    )
    refusal(lambda: export(negative, out), "coulomb_friction")
    export(without, out)
    rod = np.tile([1.0, 0, 0, 0, 0.1, 0, 0.1, 0, 0, 0.0], (2, 1))
    estimate = estimate_of(robot, "rigid_body", 0, rod)
    if suffix == ".xml":
        refusal(lambda: export(estimate, out), "moment of inertia")
    else:
        export(estimate, out)  # a rod is a possible body


def test_other_refusals(tmp_path):
    estimate = estimate_of(load_problem("emps").robot, "viscous_friction", 0)
    refusal(lambda: export(estimate, tmp_path / "out.urdf"), "rigid_body")
    refusal(
        lambda: export(estimate, tmp_path / "out.xml", urdf=tmp_path / "x.urdf"),
        ".urdf",
    )
    path = tmp_path / "dtd.urdf"
    path.write_text('<!DOCTYPE robot [<!ENTITY a "b">]>' + TREE.split("?>", 1)[1])
    full = estimate_of(robots()["tree"], "rigid_body", 0)
    refusal(lambda: export(full, tmp_path / "out.urdf", urdf=path), "DOCTYPE")
    path.write_text(
        TREE.replace("utf-8", "utf-16").replace("UTF-8", "UTF-16"), "utf-16"
    )
    refusal(
        lambda: export(full, tmp_path / "out.urdf", urdf=path), "save the file as UTF-8"
    )


def test_check_urdf_names_the_link_and_mends_it(tmp_path):
    path = tmp_path / "bad.urdf"
    fixed = tmp_path / "fixed.urdf"
    path.write_bytes(
        TREE.replace(
            'izz="0.01"/>\n    </inertial>', 'izz="0.05"/>\n    </inertial>'
        ).encode()
    )
    checks = {c.link: c for c in check_urdf(path)}
    assert not checks["upper"].consistent
    assert checks["upper"].triangle_margin == pytest.approx(0.02 + 0.02 - 0.05)
    # Moments (0.02, 0.02, 0.05): the nearest with D1 + D2 = D3 moves each by 0.01 / 3.
    # The link that is offered lies a little inside, so that simulators load it.
    on_the_edge = 0.01 / np.sqrt(3.0)
    assert on_the_edge < checks["upper"].distance < 1.001 * on_the_edge
    # A point with mass: no simulator loads it.
    assert not checks["tip"].consistent
    others = [c for name, c in checks.items() if name not in ("upper", "tip")]
    assert all(c.consistent for c in others)
    assert run_cli("check-urdf", path, "--fix", fixed) == 1
    assert all(c.consistent for c in check_urdf(fixed))
    only_numbers_of_inertials_changed(path.read_bytes(), fixed.read_bytes())
    for moment, verdict in (
        ("-0.01", "negative moment of inertia"),
        ("0.05", "triangle inequality"),
    ):
        path.write_bytes(TREE.replace('ixx="0.02"', f'ixx="{moment}"').encode())
        assert {c.link: c for c in check_urdf(path)}["upper"].verdict.startswith(
            verdict
        )


def test_check_urdf_names_moving_links_without_inertial(tmp_path, capsys):
    """Unless something with an inertial is fixed to them; the base and fixed links need
    none."""
    path = tmp_path / "bare.urdf"
    joint = (
        '<joint name="{0}" type="{2}"><parent link="{1}"/><child link="{0}"/></joint>'
    )
    tensor = " ".join(
        f'{k}="{v}"' for k, v in zip(("ixx", "iyy", "izz"), "111", strict=True)
    )
    body = f'<inertial><mass value="1"/><inertia {tensor}/></inertial>'
    path.write_text(
        '<robot name="r"><link name="base"/><link name="bare"/><link'
        f' name="hand"/><link name="tip"/><link name="tool">{body}</link>'
        + joint.format("bare", "base", "continuous")
        + joint.format("hand", "bare", "continuous")
        + joint.format("tool", "hand", "fixed")
        + joint.format("tip", "base", "fixed")
        + "</robot>"
    )
    assert massless_links(path) == ["bare"]
    assert run_cli("check-urdf", path, "--json", tmp_path / "c.json") == 0
    assert "Moving links without an inertial: bare. " in capsys.readouterr().out
    assert json.loads((tmp_path / "c.json").read_text())[
        "moving_links_without_inertial"
    ] == ["bare"]


@settings(
    max_examples=8,
    derandomize=False,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(
    seed=st.integers(0, 10_000),
    joints=st.integers(1, 7),
    frames=st.booleans(),
    turned=st.booleans(),
)
@example(
    seed=190, joints=4, frames=False, turned=False
)  # joints a thousand kilometres apart
def test_any_tree_survives_being_written_and_edited(
    tmp_path, seed, joints, frames, turned
):
    """A random tree of revolute and prismatic joints: made, reloaded, edited with
    another model.

    turned : the user's file names the joints in the opposite order.
    """
    rng = np.random.default_rng(seed)
    robot = random_robots.tree(rng, joints, link_frames=frames)
    made = tmp_path / "made.urdf"
    edited = tmp_path / "edited.urdf"
    export(
        estimate_of(robot, "rigid_body,viscous_friction,coulomb_friction", seed), made
    )
    other = estimate_of(robot, "rigid_body,viscous_friction,coulomb_friction", seed + 1)
    if turned:
        root = ElementTree.parse(made).getroot()
        root[:] = reversed(root)
        made.write_bytes(ElementTree.tostring(root))
    export(other, edited, urdf=made)
    check_parity(edited, other)
    assert all(check.consistent for check in check_urdf(edited))


@pytest.mark.parametrize("ending", EXPORTS.all())
def test_every_export_keeps_every_contract(ending):
    for contract in EXPORT_CONTRACTS:
        contract(EXPORTS.all()[ending])


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("robot.xml", "<mujoco><worldbody/></mujoco>", "MJCF"),
        ("robot.sdf", '<sdf version="1.7"><model name="x"/></sdf>', "SDF"),
        ("robot.usda", "#usda 1.0\n", "USD"),
    ],
)
def test_another_format_than_urdf_is_named(tmp_path, name, text, words):
    path = tmp_path / name
    path.write_text(text)
    with pytest.raises(InputError, match=f"{words}, not a URDF.*convert it to URDF"):
        check_urdf(path)


def test_a_held_joints_link_keeps_its_inertial_in_an_edited_urdf(tmp_path):
    """The arm was identified with its slide held, and the file has that joint: its link
    and the tip that is fixed to it stay as they are."""
    path, out = tmp_path / "own.urdf", tmp_path / "new.urdf"
    path.write_bytes(TREE.encode())
    held = {"slide": 0.1}
    robot, links = load_urdf(path, held=held)
    links *= 1.1
    links[1] = links[0]  # the file gives this link nothing
    estimate = estimate_of(robot, "rigid_body", 3, links)
    export(estimate, out, urdf=path, force=True)
    _, reloaded = load_urdf(out, held=held)
    assert reloaded == pytest.approx(links, abs=1e-12)
    tip = '<link name="tip"><inertial><mass value="0.1"/></inertial></link>'
    assert tip in TREE
    assert tip in out.read_text()


def test_a_table_of_friction_needs_friction_over_velocity(tmp_path):
    estimate = estimate_of(load_problem("two_link").robot, "rigid_body", 3)
    with pytest.raises(InputError, match="no friction that follows the velocity alone"):
        export(estimate, tmp_path / "friction.csv")
    assert friction_curves(estimate) == []
