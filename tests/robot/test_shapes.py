"""Shapes of links, motions from point to point, and cones' depths: against their closed
forms."""

import numpy as np
import pytest
from drawn import given, seeds, st
from numpy.testing import assert_allclose, assert_array_equal
from recorded import refusal

from sdp_vs_penalty.robot import (
    cone_margin,
    constraint,
    directions,
    geometry,
    joint,
    load_robot,
    load_urdf,
    trajectory,
)

ARM = """<robot name="r"><link name="base"/><link name="a">{shapes}</link>
<joint name="j" type="revolute"><parent link="base"/><child link="a"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="1" velocity="1" effort="1"/></joint>{more}</robot>"""


def robot_file(folder, *shapes, tag="collision", more=""):
    text = "".join(f"<{tag}>{shape}</{tag}>" for shape in shapes)
    (folder / "r.urdf").write_text(ARM.format(shapes=text, more=more))
    return folder / "r.urdf"


#: A shape, its volume, and how far it reaches along directions d (N, 3).
SHAPES = {
    "box": ('<box size="0.2 0.4 0.6"/>', 0.048, lambda d: np.abs(d) @ [0.1, 0.2, 0.3]),
    "sphere": ('<sphere radius="0.3"/>', 0.036 * np.pi, lambda d: np.full(len(d), 0.3)),
    "cylinder": (
        '<cylinder radius="0.2" length="0.6"/>',
        0.024 * np.pi,
        lambda d: 0.2 * np.hypot(d[:, 0], d[:, 1]) + 0.3 * np.abs(d[:, 2]),
    ),
    "capsule": (
        '<capsule radius="0.2" length="0.6"/>',
        0.024 * np.pi,
        lambda d: 0.2 + 0.3 * np.abs(d[:, 2]),
    ),
}


@pytest.mark.parametrize("name", SHAPES)
@pytest.mark.parametrize("tag", ["collision", "visual"])
def test_a_shape_lies_in_the_hull_of_its_points(name, tag, tmp_path):
    """Which is at most as large as a box around it; where the shape is in its link,
    twice."""
    shape, volume, reach = SHAPES[name]
    pose = '<origin xyz="0.5 0 1" rpy="0 1.5707963267948966 0"/>'  # its axes z, y, -x
    body = f"<geometry>{shape}</geometry>"
    (found,) = geometry.link_geometry(
        robot_file(tmp_path, body, f"{pose}{body}", tag=tag)
    )
    assert found.volume == pytest.approx(2.0 * volume)
    d = directions(200)
    half = len(found.points) // 2
    own = found.points[:half]
    turned = found.points[half:] - [0.5, 0.0, 1.0]
    for points, along in ((own, d), (turned, d[:, [2, 1, 0]] * [-1.0, 1.0, 1.0])):
        hull = (points @ d.T).max(axis=0)
        assert np.all(hull >= reach(along) - 1e-12)
        assert np.all(hull <= np.abs(along) @ reach(np.eye(3)) + 0.01)


def test_a_mesh_is_found_beside_the_file_and_where_ros_has_it(tmp_path, monkeypatch):
    """A tetrahedron of one sixth; without a file, or a surface, there is no geometry."""
    corners = "".join(
        f"v {x} {y} {z}\n" for x, y, z in [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)]
    )
    text = corners + "f 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
    for variable, inside in (
        ("ROS_PACKAGE_PATH", ""),
        ("AMENT_PREFIX_PATH", "share"),
        ("", ""),
    ):
        home = tmp_path / (variable or "beside")
        mesh = home / inside / "arm" / "meshes" / "link.obj"
        mesh.parent.mkdir(parents=True)
        mesh.write_text(text)
        if variable:
            monkeypatch.setenv(variable, f"/nowhere:{home}")
        at = home / "urdf" if not variable else tmp_path
        at.mkdir(exist_ok=True)
        shape = (
            '<geometry><mesh filename="package://arm/meshes/link.obj" scale="1 2'
            ' 3"/></geometry>'
        )
        (found,) = geometry.link_geometry(robot_file(at, shape))
        assert_allclose(found.points.max(axis=0), [1.0, 2.0, 3.0])
        assert found.volume == pytest.approx(1.0)
        if variable:
            monkeypatch.delenv(variable)
            assert geometry.link_geometry(robot_file(at, shape)) == [None]
    assert geometry.link_geometry(robot_file(tmp_path)) == [None]


@given(seeds)
def test_a_move_from_point_to_point_is_smooth_and_as_fast_as_its_limits(seed):
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(4, 3))
    limits = rng.uniform(0.5, 3.0, (3, 3)) ** [[1], [2], [3]]
    limits[np.arange(3) != seed % 3] *= (
        100.0  # of velocity, acceleration and jerk one binds
    )
    moves = trajectory.shortest_moves(points, *limits)
    path = trajectory.PointTrajectory(points, moves, np.array([0.5, 0.0, 0.2, 1.0]))
    assert path.duration == pytest.approx(1.7 + moves.sum())
    starts = np.cumsum([0.5, moves[0], moves[1] + 0.2])
    for at, point in zip(
        [0.0, *(starts + moves), path.duration], points[[0, 1, 2, 3, 3]], strict=True
    ):
        q, dq, ddq = path.states([at])
        assert_allclose(q[0], point, atol=1e-9)
        assert max(np.abs(dq).max(), np.abs(ddq).max()) < 1e-9
    t = np.linspace(0.0, path.duration, 4001)
    h = 1e-4
    (q, dq, ddq), (before, low, _), (after, high, _) = (
        path.states(t + x) for x in (0.0, -h, h)
    )
    assert_allclose(dq, (after - before) / (2.0 * h), atol=1e-4)
    assert_allclose(ddq, (high - low) / (2.0 * h), atol=1e-2)
    jerk = np.abs(np.diff(ddq, axis=0)) / t[1]
    for k, (start, time) in enumerate(zip(starts, moves, strict=True)):
        inside = (t >= start) & (t <= start + time)
        rows = np.abs(dq[inside]), np.abs(ddq[inside]), jerk[inside[1:] & inside[:-1]]
        filled = max(
            (x.max(axis=0) / limit).max() for x, limit in zip(rows, limits, strict=True)
        )
        assert filled == pytest.approx(1.0, abs=0.02), k
    assert trajectory.shortest_moves(
        points[:1].repeat(2, axis=0), *limits
    ).tolist() == [0.01]


@given(seeds, st.sampled_from(["psd", "soc", "nonnegative"]))
def test_the_depth_in_a_cone_has_its_margins_sign_in_any_unit(seed, cone):
    rng = np.random.default_rng(seed)
    terms = [np.array([1.0, 0.7, 0.7, 0.1]), np.eye(4)[0], np.eye(4)[1]]
    if cone == "psd":
        terms = [x @ x.T for x in rng.normal(size=(3, 3, 3))]
    signs = np.array([1.0, -0.3, 0.4])
    value = np.tensordot(signs, terms, axes=1)
    size = np.tensordot(np.abs(signs), terms, axes=1)
    unit = 2.0 ** rng.integers(-20, 20)
    found = [
        constraint.cone_depths(cone, x[None], np.abs(y)[None])[0]
        for x, y in ((value, size), (unit * value, unit * size))
    ]
    assert found[0] == pytest.approx(found[1])
    assert -1.0 <= found[0] <= 1.0
    if abs(margin := float(cone_margin(cone, value))) > 1e-9:
        assert np.sign(found[0]) == np.sign(margin)
    assert constraint.safe_depth(4) == 128.0 * np.finfo(float).eps


def transmission(kind, joints, motors):
    return (
        f'<transmission name="t"><type>a/{kind}</type>{joints}{motors}</transmission>'
    )


@pytest.mark.parametrize(
    ("kind", "expected"),
    [
        ("SimpleTransmission", [[6.0, 0.0], [0.0, 15.0]]),
        ("DifferentialTransmission", [[6.0, 9.0], [10.0, -15.0]]),
        ("FourBarLinkageTransmission", [[6.0, 0.0], [5.0, 15.0]]),
    ],
)
def test_the_motors_of_a_transmission_turn_as_ros_control_says(
    kind, expected, tmp_path
):
    """Joint reductions 2 and 3, motor reductions 3 and 5."""
    second = (
        '<link name="b"/><joint name="k" type="revolute"><parent link="a"/><child'
        ' link="b"/><axis xyz="0 0 1"/><limit lower="-1" upper="1" velocity="1"'
        ' effort="1"/></joint>'
    )
    parts = [
        "".join(
            f"<{tag}"
            f' name="{name}"><mechanicalReduction>{x}</mechanicalReduction></{tag}>'
            for name, x in pairs
        )
        for tag, pairs in (
            ("joint", [("j", 2), ("k", 3)]),
            ("actuator", [("m", 3), ("n", 5)]),
        )
    ]
    path = robot_file(tmp_path, more=second + transmission(kind, *parts))
    assert_array_equal(load_urdf(path)[0].transmission.matrix, expected)
    good = path.read_text()
    for text in ("0", "reduction"):  # what a xacro leaves of a property
        path.write_text(good.replace(">5<", f">{text}<"))
        left_out = load_robot(path)
        assert left_out.robot.transmission is None
        assert f"<mechanicalReduction> holds '{text}' (line" in left_out.couplings
    fixed = robot_file(
        tmp_path,
        more=second + transmission(kind, parts[0].replace('"k"', '"x"'), parts[1]),
    )
    assert load_urdf(fixed)[0].transmission is None


def test_formulas_of_joints_are_sums():
    for text, row in (
        ("32 q2 - 1.5q1 + .25", [-1.5, 32.0, 0.0, 0.25]),
        ("-q3*1", None),
        ("q1 - 2*q1 - 1e-1", [-1.0, 0.0, 0.0, -0.1]),
        (" + 2 q3 ", [0.0, 0.0, 2.0, 0.0]),
    ):
        if row is None:
            refusal(lambda text=text: joint.parse_formula(text, 3), "no sum")
        else:
            assert joint.parse_formula(text, 3).tolist() == row
