"""Problems: nominal robots that are plausible whatever the robot, and defaults that
shut nothing out."""

import tomllib
from dataclasses import replace

import numpy as np
import pytest
from drawn import given, seeds
from numpy.testing import assert_allclose
from random_robots import bare, open_problem, task_of, tree, with_box
from recorded import refusal

from sdp_vs_penalty.estimators import interior_point
from sdp_vs_penalty.paper.tables.errata import pi_p_hat
from sdp_vs_penalty.problem import (
    EXAMPLE,
    CentreOfMassCone,
    check_fields,
    load_problem,
    open_box,
    plausible_links,
    published_cell,
    published_links,
    published_values,
    with_bounds,
)
from sdp_vs_penalty.regression.base_parameters import base_parameters
from sdp_vs_penalty.robot import Joint, Robot, inertia
from sdp_vs_penalty.simulation import experiment


@given(seeds)
def test_of_kinematics_alone_a_nominal_robot_is_plausible_and_has_room_inside(seed):
    """From tiny ones to excavators, whose joints are six metres apart, and joints in
    one place."""
    rng = np.random.default_rng(seed)
    robot = tree(rng, int(rng.integers(1, 6)))
    scale = np.diag([*[rng.choice([0.0, 3e-3, 1.0, 20.0])] * 3, 1.0])
    rigid = np.diag([1.0, 1.0, 1.0, 0.0])
    joints = (
        replace(
            j,
            placement=j.placement @ rigid + (scale @ j.placement) @ (np.eye(4) - rigid),
        )
        for j in robot.joints
    )
    problem = bare(replace(robot, joints=tuple(joints)))
    links = problem.nominal_links
    assert np.all((links[:, 0] > 0.1) & (links[:, 0] < 100.0))
    assert np.all(inertia.consistency_margin(links) > 0.0)
    task = task_of(problem)
    demands = task.constraints.plus(task.minimum_thickness(0.02))
    inside = interior_point(task, demands)
    assert demands.margin(inside) > 0.0
    assert np.all(np.abs(inside) <= task.bound)


@pytest.mark.parametrize("name", ["panda", "two_link"])
def test_nominal_robots_of_built_in_problems_come_from_their_bounds(name, request):
    """Never from the published estimates: those are what the tables compare with."""
    problem = request.getfixturevalue(name)
    model = problem.model()
    demands = problem.constraints(model).with_families(
        lambda family: family not in ("sign", "range")
    )
    assert demands.margin(problem.nominal(model)) > 0.0
    for column in ("p_hat", "delta", "p_real"):
        published = published_values(problem, column)
        for link, mass in enumerate(problem.nominal_links[:, 0], start=1):
            assert not abs(published.get(f"m{link}", np.nan) - mass) <= 1e-3


def test_turned_gravity_finds_its_own_base_parameters(panda):
    """Mounted on a wall, joint 1 carries weight: more parameters make torque than the
    43 named."""
    upright = panda.with_gravity((0.0, 0.0, -9.8))
    wall = panda.with_gravity((-9.81, 0.0, 0.0))
    assert upright.independent == panda.independent
    assert (
        len(base_parameters(upright.model("rigid_body"), upright.independent)[0]) == 43
    )
    assert len(base_parameters(wall.model("rigid_body"), wall.independent)[0]) == 45


def test_bounds_by_a_word(two_link):
    """In place of the problem's; the rest stays, what the file states too, and the prior
    of a link outside is at their middle."""
    mass = two_link.nominal_links[1, 0]
    made = with_bounds(two_link, f"m2={2 * mass}:{3 * mass},c1x=-0.2:,total=:9")
    assert made.box[1, 0].tolist() == [2 * mass, 3 * mass]
    assert made.box[0, 1].tolist() == [-0.2, np.inf]
    assert made.total_mass == (0.0, 9.0)
    assert np.array_equal(made.nominal_links, two_link.nominal_links)
    assert made.prior_links[1] == pytest.approx(
        np.sqrt(6.0) * two_link.nominal_links[1]
    )
    nearest = with_bounds(two_link, f"m2=0:{mass / 2}")  # zero has no geometric mean
    assert nearest.prior_links[1] == pytest.approx(0.5 * two_link.nominal_links[1])
    assert np.array_equal(made.prior_links[0], two_link.nominal_links[0])
    untouched = np.ones(two_link.box.shape, dtype=bool)
    untouched[1, 0] = untouched[0, 1] = False
    assert np.array_equal(made.box[untouched], two_link.box[untouched])
    exact = with_bounds(two_link, "m1=3:3,total=9:9")  # known, and no contradiction
    assert exact.box[0, 0].tolist() == [3.0, 3.0]
    assert exact.known == {"m1": 3.0}
    centre = with_bounds(two_link, "m2=2:2,c2x=0.1:0.1,c1z=0:0")
    assert centre.known == {"mz1": 0.0, "m2": 2.0, "mx2": 0.2}
    assert exact.total_mass == (9.0, 9.0)
    for wrong in ("m9=1:2", "m1=5:1", "m1=a:b", "m1", "m1=nan:2", "mass=1:2"):
        refusal(lambda wrong=wrong: with_bounds(two_link, wrong))


def test_the_example_of_all_fields_is_one():
    check_fields(tomllib.loads(EXAMPLE))
    other = tomllib.loads(EXAMPLE.replace("massless = [3.0]", "massless = 3.0"))
    refusal(lambda: check_fields(other), "massless")


@pytest.mark.parametrize(
    ("made", "shown", "differ"),
    [(True, True, set()), (True, False, {17}), (False, False, {17, 21, 25, 39})],
)
def test_with_the_corrections_every_printed_digit_of_table_three_follows(
    made, shown, differ, panda
):
    """And as printed the known rows do not; two are printed empty (erratum 8)."""
    found = set()
    empty = set()
    for row, value in zip(
        panda.published["table_III"], pi_p_hat(panda, made), strict=False
    ):
        text = published_cell(panda, "table_III", row, "pi_p_hat", shown)
        (found if text else empty).add(int(row["row"]))
        if text and f"{value:.4f}".replace("-0.0000", "0.0000") == f"{float(text):.4f}":
            found.remove(int(row["row"]))
    assert (found, empty) == (differ, {8, 24})


def test_an_unknown_column_is_refused(panda):
    refusal(
        lambda: published_links(panda, "p_star"), "no published parameters 'p_star'"
    )


#: A joint that turns about z.
UPRIGHT = Joint("j", "revolute", -1, np.eye(4), np.array([0.0, 0.0, 1.0]), np.eye(4))


def two_joints(length, efforts=(np.inf, np.inf)):
    """Two that turn about y, the second so far along x."""
    apart = np.eye(4)
    apart[0, 3] = length
    turned = replace(UPRIGHT, axis=np.array([0.0, 1.0, 0.0]))
    places = zip((np.eye(4), apart), efforts, strict=True)
    joints = (
        replace(turned, name=f"j{k}", parent=k - 1, placement=place, effort=effort)
        for k, (place, effort) in enumerate(places)
    )
    return Robot("two", tuple(joints))


@pytest.mark.parametrize("length", [0.6, 6.0])
@pytest.mark.parametrize("efforts", [(200.0, 40.0), (np.inf, np.inf), (500.0, 500.0)])
def test_a_nominal_link_is_a_tube_between_half_actuators(length, efforts):
    """4 kg/m, a quarter as thick as long; actuators of 0.08 kg (torque / N m)^(3/4), by
    torque limits, or, where these are missing or placeholders, thrice what holds 10
    kg/m, up to 1000 N m.
    """
    arm = two_joints(length, efforts)
    (first, last), sources = plausible_links(arm, np.zeros((2, 10)))
    assert sources == ("kinematics",) * 2
    torque = 1.5 * 10.0 * 9.81 * np.array([2.0 * length, length]) ** 2
    torque = np.minimum(efforts if efforts[0] == 200.0 else torque, 1000.0)
    tube, (own, next_) = 4.0 * length, 0.5 * 0.08 * torque**0.75
    expected = np.diag([0.2 * (0.25 * length) ** 2] * 3 + [0.0]) * (tube + own + next_)
    for mass, x in ((tube, 0.5 * length), (own, 0.0), (next_, length)):
        at = np.array([x, 0.0, 0.0, 1.0])
        expected += mass * np.outer(at, at)
    assert_allclose(inertia.pseudo_inertia(first), expected, rtol=1e-12, atol=1e-12)
    # What it ends in is not known: all of it at its joint.
    assert last[0] == pytest.approx(tube + next_)
    assert_allclose(last[1:4], 0.0, atol=1e-12)


def test_moments_about_the_frame_are_bounded_by_steiner(panda):
    """The largest of a link: its largest moments, its mass in its farthest corner."""
    mass, com, moments = panda.link_sizes
    about_com = np.zeros((panda.robot.n, 6))
    about_com[:, [0, 2, 5]] = panda.box[:, [4, 6, 9], 1]
    largest = inertia.standard_from_barycentric(np.column_stack([mass, com, about_com]))
    assert_allclose(largest[:, [4, 6, 9]], moments, rtol=1e-12)


def test_what_bounds_a_link_by_default_is_the_largest_that_is_known():
    """1 m, 1.5 times the reach, the stroke, twice a given mass's root mean square; 100
    kg or thrice."""
    arm = UPRIGHT
    far = np.eye(4)
    far[0, 3] = 2.0
    ball = inertia.standard_from_barycentric([50.0, 0.8, 0, 0, 0.5, 0, 0.5, 0, 0, 0.5])
    mean = np.sqrt(0.8**2 + 0.5 * 3 * 0.5 / 50.0)
    for joints, links, mass, radius in (
        ((arm,), [[0.0] * 10], 100.0, 1.0),
        (
            (arm, replace(arm, name="k", parent=0, placement=far)),
            [[0.0] * 10] * 2,
            100.0,
            3.0,
        ),
        (
            (replace(arm, kind="prismatic", lower=-1.0, upper=3.0),),
            [[0.0] * 10],
            100.0,
            4.0,
        ),
        ((arm,), [ball], 150.0, 2.0 * mean),
    ):
        robot = Robot("one", joints)
        problem = open_problem(robot, np.array(links))
        assert_allclose(problem.link_defaults, [[mass, radius]] * robot.n, rtol=1e-12)
        assert not problem.guessed_links.any()  # nothing says so
    problem = open_problem(Robot("one", (arm,)), np.zeros((1, 10)))
    # Where a centre of mass may be, the link reaches.
    assert with_box(problem, 0, 1, -3.0, 1.0).link_defaults[0, 1] == 4.5


def test_the_exciting_trajectory_is_that_of_table_two(panda):
    """Every printed coefficient in its place, joint by joint."""
    found = experiment(panda).trajectory
    names = [f"{letter}_{k}" for letter in "ab" for k in range(1, 6)] + ["q_0"]
    printed = {row["coefficient"]: row for row in panda.published["table_II"]}
    assert set(names) == set(printed)
    for name, values in zip(
        names, np.column_stack([found.a, found.b, found.q_0]).T, strict=True
    ):
        assert values.tolist() == [
            float(printed[name][f"joint_{j}"]) for j in range(1, 8)
        ]
    motion = tomllib.loads((panda.folder / "simulation.toml").read_text())["trajectory"]
    assert found.frequency / np.pi == pytest.approx(motion["frequency_over_pi"])
    assert (found.blend, found.duration) == (motion["blend"], motion["duration"])


def test_bounds_on_central_inertia_are_sent_as_their_convex_consequence(panda):
    """J_aa <= upper + m (c_b^2 + c_c^2), at the farthest centre of mass that the bounds
    allow."""
    theta = np.random.default_rng(0).normal(size=70)
    demands = panda.constraints(panda.model("rigid_body")).convex
    sent = np.array([c.value(theta) for c in demands if c.family == "trace"])
    far = np.abs(panda.box[:, 1:4]).max(axis=2) ** 2
    mass = theta.reshape(7, 10)[:, :1]
    moments = theta.reshape(7, 10)[:, [4, 6, 9]]
    others = np.roll(far, 1, axis=1) + np.roll(far, 2, axis=1)
    assert_allclose(sent, panda.box[:, [4, 6, 9], 1] + mass * others - moments)


@pytest.mark.parametrize(
    ("length", "thin", "kept"), [(0.1, 5e-3, True), (3.0, 1e-3, False)]
)
def test_a_given_inertial_is_as_slender_as_its_link_is_long(length, thin, kept):
    """A rod of 5 mm is a short link's, one of 1 mm is no link of three metres; its
    weight stays."""
    moments = [2.0 * thin**2, 0, 2.0 * thin**2, 0, 0, 2.0 * thin**2]
    theirs = inertia.standard_from_barycentric([[1.5, 0, 0, 0, *moments]] * 2)
    found, sources = plausible_links(two_joints(length), theirs)
    assert sources == ("inertial",) * 2
    assert np.array_equal(found, theirs) is kept
    assert_allclose(found[:, 0], 1.5)


@pytest.mark.parametrize(
    ("ends", "across"), [((-np.inf, 0.5), np.inf), ((-0.2, 0.5), 0.25)]
)
def test_a_cone_bounds_a_centre_of_mass_where_it_ends(ends, across):
    """|c across z| <= 0.1 + 0.3 c_z: as wide as at its wide end, or without bound."""
    problem = open_problem(Robot("one", (UPRIGHT,)), np.zeros((1, 10)))
    made = replace(
        with_box(problem, 0, 3, *ends), cones=(CentreOfMassCone(1, "z", 0.1, 0.3),)
    )
    assert_allclose(made.centre_boxes[0, :2], [[-across, across]] * 2)


def test_what_a_problem_leaves_out_is_open(tmp_path):
    """A folder of no more than a DH table."""
    (tmp_path / "problem.toml").write_text(
        'title = "t"\n[kinematics]\nconvention = "standard"\na = [0.0, 0.5]\nd = [0.2,'
        " 0.0]\nalpha_over_pi = [0.5, 0.0]\n"
    )
    problem = load_problem(tmp_path)
    plain = replace(load_problem("two_link"), effects=None)
    assert np.array_equal(problem.box, open_box(2))
    assert (problem.total_mass, problem.cones, problem.independent) == (
        (0.0, np.inf),
        (),
        None,
    )
    assert (problem.torque_side, problem.robot.gravity) == (
        "unknown",
        (0.0, 0.0, -9.81),
    )
    assert problem.preprocessing == type(problem.preprocessing)()
    assert [j.lower for j in problem.robot.joints] + [
        j.effort for j in problem.robot.joints
    ] == [-np.inf, -np.inf, np.inf, np.inf]
    assert problem.nominal_from == ("kinematics",) * 2
    assert problem.guessed_links.all()
    families = {
        c.family for c in problem.constraints(problem.model("rigid_body")).convex
    }
    assert families == {"pseudo-inertia", "mass", "bounding ellipsoid"}
    for side, rotors in (("unknown", True), ("motor", True), ("link", False)):
        made = replace(plain, torque_side=side)
        assert ("rotor_inertia" in made.default_effects) is rotors
    one = bare(
        Robot("one", problem.robot.joints[:1])
    )  # cannot be told from what it moves
    assert "rotor_inertia" not in replace(one, torque_side="unknown").default_effects


@pytest.mark.parametrize(
    ("centre", "diagonal"),
    [
        ([0.155, 0.002, -0.004], [0.0017, 0.0181, 0.0220]),  # no triangle
        ([0.155, 0.002, -0.004], [0.0, 0.0, 0.0]),
        ([0.0, 0.0, 0.1], [0.02, 0.001, 0.02]),
        ([0.0, 0.0, 0.0], [0.02, 0.001, 0.001]),
    ],
)
def test_a_link_with_impossible_moments_keeps_its_mass_and_centre(centre, diagonal):
    """Many files state moments of inertia that no body has."""
    barycentric = [3.2, *centre, diagonal[0], 0, diagonal[1], 0, 0, diagonal[2]]
    theirs = inertia.standard_from_barycentric([barycentric] * 2)
    found, sources = plausible_links(two_joints(0.3), theirs)
    assert sources == ("inertial",) * 2
    assert_allclose(found[:, :4], theirs[:, :4], atol=1e-12)
    assert np.all(inertia.consistency_margin(found) > 0.0)


def test_the_moments_of_an_impossible_link_are_the_nearest_possible_ones():
    """No body has diag(1, 1, 4); diag(5, 5, 10) / 3 is the nearest inertia of one. That
    body is flat across z, and the link thicker."""
    robot = Robot("one", (UPRIGHT,))
    theirs = inertia.standard_from_barycentric(
        [[2.0, 0.1, 0.0, 0.0, 0.001, 0.0, 0.001, 0.0, 0.0, 0.004]]
    )
    (found,), _ = plausible_links(robot, theirs)
    about_centre = inertia.barycentric_from_standard(found)[4:]
    thin = 2.0 * (0.05 * robot.link_reach()[0]) ** 2 / 5.0
    across = 0.005 / 3.0 + thin
    expected = [across, 0.0, across, 0.0, 0.0, 0.01 / 3.0]
    assert_allclose(about_centre, expected, rtol=1e-6, atol=1e-12)
