"""Bodies of links: what they hold, where they come from, and files that make it hard to
tell."""

import numpy as np
import pytest
from arms import random_arm
from drawn import given, seeds
from numpy.testing import assert_allclose, assert_array_equal
from random_robots import link_parameters, tree

from sdp_vs_penalty import load_problem
from sdp_vs_penalty.problem import ProblemFields, link_bodies, published_links
from sdp_vs_penalty.robot import Geometry, Joint, Robot, inertia
from sdp_vs_penalty.robot import constraint as build


def fits(problem, links):
    """(n,) tr(P Q) / m of each link: 1 for a point at the body's centre, below 0 for no
    fit."""
    quadrics = np.array([body.quadric for body in problem.link_bodies])
    return (
        np.einsum("kab,kab->k", quadrics, inertia.pseudo_inertia(links)) / links[:, 0]
    )


PENDULUM = Robot(
    "pendulum", (Joint("j", "revolute", -1, np.eye(4), np.eye(3)[2], np.eye(4)),)
)


def test_a_body_is_as_large_as_what_it_is_known_from_says():
    """Of one link: a metre where nothing is known, twice the ellipsoid of the inertial,
    1.2 times the least ellipsoid of a box and a layer of 3 cm, a decimetre about an
    exact centre of mass."""
    nothing = np.zeros((1, 10))
    nowhere = np.tile([-np.inf, np.inf], (1, 3, 1))
    half = np.array([0.4, 0.3, 0.2])
    centre = np.array([0.5, 0.0, 0.0])
    lifted = np.append(centre, 1.0)
    second = np.pad(np.diag(half**2 / 5.0), (0, 1)) + np.outer(lifted, lifted)
    inertial = inertia.from_pseudo_inertia(2.0 * second)[None]
    box = np.array(np.meshgrid(*np.outer(half, [-1.0, 1.0]))).reshape(3, -1).T
    exact = np.zeros((1, 3, 2))
    for expected, source, *given_ones in (
        (np.ones(3), "kinematics", nowhere, nothing),
        (2.0 * half, "inertial", nowhere, inertial),
        (
            1.2 * np.sqrt(3.0) * half + 0.03,
            "geometry",
            nowhere,
            nothing,
            [Geometry(box, 0.192)],
        ),
        (np.full(3, 0.1), "bounds", exact, nothing),
    ):
        (body,) = link_bodies(PENDULUM, *given_ones)
        assert body.source == source
        assert_allclose(np.sort(body.half_axes), np.sort(expected), rtol=1e-6)


def test_the_body_of_a_cylinder_is_not_for_rounding_to_choose():
    """Its two equal moments have no axes of their own, but where rounding sets them
    apart."""
    lifted = np.array([0.4, 0.1, 0.0, 1.0])
    nowhere = np.tile([-np.inf, np.inf], (1, 3, 1))
    second = np.pad(np.diag([0.02, 4e-4, 4e-4]), (0, 1)) + np.outer(lifted, lifted)
    quadrics = []
    for share in (-1e-12, 0.0, 1e-12):
        second[1, 2] = second[2, 1] = 4e-4 * share
        (body,) = link_bodies(
            PENDULUM, nowhere, inertia.from_pseudo_inertia(second)[None]
        )
        quadrics.append(body.quadric)
    assert_allclose(quadrics, quadrics[1:2] * 3, atol=1e-6 * np.abs(quadrics).max())


@given(seeds)
def test_truthful_arms_fit_whatever_their_file_says(seed):
    """Solid links of half a metre; the file knows nothing, or inertials that are a
    third wrong."""
    rng = np.random.default_rng(seed)
    robot = tree(rng, int(rng.integers(1, 6)))
    truth = np.array([link_parameters(rng, 0.5) for _ in robot.joints])
    wrong = truth.copy()
    for k, scale in enumerate(rng.uniform(2.0 / 3.0, 1.5, (robot.n, 4))):
        t = np.diag(scale)
        wrong[k] = inertia.from_pseudo_inertia(t @ inertia.pseudo_inertia(truth[k]) @ t)
    nowhere = np.tile([-np.inf, np.inf], (robot.n, 3, 1))
    for said in (wrong, np.zeros_like(truth)):
        for indices, body in zip(truth, link_bodies(robot, nowhere, said), strict=True):
            row = build.density_in_ellipsoid(
                "body", "link", np.arange(10), body.quadric
            )
            assert row.margin(indices) > 0.0


def test_the_published_truths_and_nominal_robots_fit():
    for name, column in (("panda", "p_hat"), ("two_link", "p_real")):
        problem = load_problem(name)
        assert {body.source for body in problem.link_bodies} == {"bounds"}
        assert np.all(fits(problem, published_links(problem, column)) > 0.0)
    for name in ("panda", "two_link", "ur10e", "emps", "tx40"):
        problem = load_problem(name)
        assert np.all(fits(problem, problem.nominal_links) > 0.3)


@pytest.mark.parametrize("seed", range(4))
def test_a_files_own_inertials_fit_and_travel(seed, tmp_path):
    problem = load_problem(random_arm(tmp_path, seed))
    assert np.all(fits(problem, problem.nominal_links) > 0.3)
    again = ProblemFields.from_problem(problem).problem(problem.robot)
    for old, new in zip(problem.link_bodies, again.link_bodies, strict=True):
        assert_array_equal(old.quadric, new.quadric)
        assert (old.source, old.volume) == (new.source, new.volume)
    assert again.nominal_from == problem.nominal_from


def arm(folder, shape, inertial="", fixed=""):
    """One moving link with a shape, another fixed to it 0.3 m out."""
    (folder / "arm.urdf").write_text(
        '<robot name="arm"><link name="base"/><link'
        f' name="rod">{inertial}<collision><geometry>{shape}</geometry></collision></link><link'
        f' name="tool">{fixed}</link><joint name="a" type="revolute"><parent'
        ' link="base"/><child link="rod"/><axis xyz="0 1 0"/><limit lower="-1"'
        ' upper="1" velocity="1" effort="1"/></joint><joint name="b"'
        ' type="fixed"><parent link="rod"/><child link="tool"/><origin xyz="0.3 0'
        ' 0"/></joint></robot>'
    )
    return load_problem(folder / "arm.urdf")


def test_the_nominal_link_fills_its_geometry(tmp_path):
    """Without inertials, with the stated density; other units and files:
    tests/robot/test_shapes.py."""
    size = np.array([0.08, 0.1, 0.4])
    problem = arm(tmp_path, '<box size="0.4 0.1 0.08"/>')
    (body,) = problem.link_bodies
    assert (body.source, problem.nominal_from) == ("geometry", ("geometry",))
    assert body.volume == pytest.approx(size.prod())
    assert_allclose(
        np.sort(body.half_axes), 1.2 * np.sqrt(0.75) * size + 0.03, rtol=0.03
    )
    assert problem.nominal_links[0, 0] == pytest.approx(1500.0 * size.prod())
    # Second moments between those of a ball and a box, of the bare ellipsoid around it.
    second = np.linalg.eigvalsh(inertia.second_moment(problem.nominal_links[0]))
    assert_allclose(second, 0.75 * size**2 / 7.0, rtol=0.06)


def visual(radius):
    return f'<visual><geometry><sphere radius="{radius}"/></geometry></visual>'


@pytest.mark.parametrize(
    ("shape", "fixed", "source"),
    [
        ('<mesh filename="package://nowhere/box.stl"/>', "", "inertial"),
        ('<mesh filename="arm.urdf"/>', "", "inertial"),  # no mesh
        ('<mesh filename="noise.stl"/>', "", "inertial"),
        ('<sphere radius="0.001"/>', "", "inertial"),  # a marker
        ('<box size="400 100 80"/>', "", "inertial"),  # millimetres called metres
        ('<box size="8 0.1 0.08"/>', "", "inertial"),  # beyond thrice a metre
        ('<box size="5 0.1 0.08"/>', "", "geometry"),
        ('<box size="0.4 x 0.08"/>', "", "inertial"),
        ('<cylinder radius="nan" length="1"/>', "", "inertial"),
        ('<mesh filename="gone.stl"/>', visual(0.02), "inertial"),
        ('<sphere radius="0.1"/>', visual(0.05), "geometry"),
    ],
)
def test_geometry_that_says_nothing_is_left_out(shape, fixed, source, tmp_path):
    """The body is then the inertial's, and what is fixed to a link is part of its body."""
    (tmp_path / "noise.stl").write_bytes(np.random.default_rng(0).bytes(400))
    inertial = (
        '<inertial><origin xyz="0.2 0 0"/><mass value="2"/><inertia ixx="0.004" ixy="0"'
        ' ixz="0" iyy="0.03" iyz="0" izz="0.03"/></inertial>'
    )
    problem = arm(tmp_path, shape, inertial, fixed)
    (body,) = problem.link_bodies
    assert body.source == source
    assert np.all(fits(problem, problem.nominal_links) > 0.3)
    if source == "geometry":
        tip = np.array([0.35, 0.0, 0.0, 1.0])
        assert tip @ body.quadric @ tip >= 0.0
