"""The parameter order and constraint arrays against what they stand for: point masses,
geometry."""

import numpy as np
import pytest
from drawn import given, seeds, st
from numpy.testing import assert_allclose, assert_array_equal
from random_robots import link_parameters, pose

from sdp_vs_penalty.robot import (
    Body,
    ConstraintSet,
    cone_margin,
    inertia,
    project,
    projected_rows,
    smallest_eigenvalue,
)
from sdp_vs_penalty.robot import constraint as build

CONES = ("psd", "soc", "nonnegative")


def random_value(rng, cone):
    if cone == "psd":
        a = rng.normal(size=(4, 4))
        return a + a.T
    return rng.normal(size=4)


@given(seeds, st.floats(0.001, 0.3))
def test_minimum_thickness_holds_exactly_if_the_link_is_that_thick(seed, radius):
    rng = np.random.default_rng(seed)
    theta = link_parameters(rng, 0.5) + rng.normal(size=10) * 10.0 ** rng.uniform(-4, 0)
    if theta[0] <= 1e-3 or abs(inertia.thickness(theta) - radius) < 1e-6:
        return
    constraint = build.pseudo_inertia("link 1", np.arange(10), radius)
    assert (constraint.margin(theta) >= 0.0) == (inertia.thickness(theta) >= radius)


@given(seeds)
def test_ellipsoid_is_the_mean_over_the_mass(seed):
    """tr(P Q) is the integral of 1 - (x - c)^T D (x - c), written here as a sum over
    points."""
    rng = np.random.default_rng(seed)
    masses = rng.uniform(0.1, 1.0, 20)
    x = rng.normal(size=(20, 3))
    axes = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    body = Body(0.3 * rng.normal(size=3), rng.uniform(0.5, 3.0, 3), axes, "geometry")
    homogeneous = np.column_stack([x, np.ones(20)])
    theta = inertia.from_pseudo_inertia((homogeneous.T * masses) @ homogeneous)
    constraint = build.density_in_ellipsoid(
        "body", "link 1", np.arange(10), body.quadric
    )
    inside = 1.0 - np.sum(((x - body.centre) @ body.axes / body.half_axes) ** 2, axis=1)
    expected = masses @ inside
    assert constraint.value(theta)[0] == pytest.approx(expected, rel=1e-9, abs=1e-9)
    if np.all(inside >= 0.0):
        assert constraint.margin(theta) >= 0.0


@pytest.mark.parametrize("cone", CONES)
@given(seed=seeds)
def test_projection_is_the_nearest_point_of_the_cone(cone, seed):
    """Moreau: x = P(x) - P(-x) with both parts in the self-dual cone and orthogonal."""
    x = random_value(np.random.default_rng(seed), cone)
    inside = project(cone, x)
    polar = project(cone, -x)
    assert cone_margin(cone, inside) >= -1e-12
    assert cone_margin(cone, polar) >= -1e-12
    assert_allclose(inside - polar, x, atol=1e-12)
    assert float(np.sum(inside * polar)) == pytest.approx(0.0, abs=1e-10)
    assert_allclose(project(cone, inside), inside, atol=1e-12)


@pytest.mark.parametrize("cone", CONES)
@given(seed=seeds)
def test_rows_have_the_gradient_and_hessian_of_half_the_projections_square(cone, seed):
    """Of f(x) = 1/2 sum |P(M + A x)|^2, whose gradient is sum A^T P(M + A x); by
    central differences."""
    rng = np.random.default_rng(seed)
    values = np.stack([random_value(rng, cone) for _ in range(3)])
    A = np.stack(
        [
            np.stack([random_value(rng, cone) for _ in range(2)], axis=-1)
            for _ in range(3)
        ]
    )

    def gradient(x):
        return np.tensordot(
            A, project(cone, values + A @ x), [range(values.ndim), range(values.ndim)]
        )

    h = 1e-6
    numeric = np.stack(
        [(gradient(h * e) - gradient(-h * e)) / (2.0 * h) for e in np.eye(2)]
    )
    r, J = projected_rows(cone, values, A.reshape(3, -1, 2))
    assert_allclose(J.T @ J, numeric, rtol=1e-4, atol=1e-5)
    assert_allclose(J.T @ r, gradient(np.zeros(2)), atol=1e-12)
    assert r @ r == pytest.approx(np.sum(project(cone, values) ** 2))


def test_worst_violation_of_each_family_in_its_own_units():
    theta = np.zeros(10)
    theta[0] = 5.0  # a point mass: consistent but only just, and 2 kg too heavy
    demands = ConstraintSet(
        (
            build.pseudo_inertia("link 1", np.arange(10)),
            build.linear("mass", "link 1", [0], [[1.0, -1.0]], [-0.5, 3.0]),
            build.linear("mass", "link 1", [0], [[-1.0]], [4.5]),
        ),
        (build.BarycentricBound("link 1", np.arange(10), 0, 0.1, 0.2),),
    )
    assert demands.worst(theta) == {
        "pseudo-inertia": 0.0,
        "mass": 2.0,
        "barycentric inertia": pytest.approx(0.1),
    }
    assert (
        demands.nonconvex[0].margin(np.zeros(10)) == 0.0
    )  # without a mass there is none
    assert demands.margin(theta) == -2.0
    assert demands.with_families(lambda f: f != "mass").margin(theta) == 0.0
    assert set(demands.with_families(lambda f: f == "mass").worst(theta)) == {"mass"}


@given(seeds)
def test_cones_of_the_two_link_robot_are_its_shapes(two_link, seed):
    """Fig. 8: link 1 a cylinder of 0.15 m around y; link 2 one of 0.08 m around x whose last
    0.2 m taper to 0.02 m at the frame's origin; the paper's alpha_2 is written as an if-else.
    """
    rng = np.random.default_rng(seed)
    cones = two_link.constraints(two_link.model(["rigid_body"])).with_families(
        lambda family: family == "centre of mass cone"
    )
    assert [c.name for c in cones.convex] == ["link 1", "link 2", "link 2"]
    theta = np.zeros(20)
    theta[[0, 10]] = 1.3
    c1 = np.array(
        [rng.uniform(-0.2, 0.2), rng.uniform(-1.5, 0.0), rng.uniform(-0.2, 0.2)]
    )
    x = rng.uniform(-0.8, 0.0)
    c2 = np.array([x, *rng.uniform(-0.1, 0.1, 2)])
    radius = 0.08 if x <= -0.2 else 0.02 + (0.08 - 0.02) * (-x) / 0.2
    theta[1:4], theta[11:14] = 1.3 * c1, 1.3 * c2
    first, *second = (c.margin(theta) >= 0.0 for c in cones.convex)
    assert first == (np.hypot(c1[0], c1[2]) <= 0.15)
    assert all(second) == (np.hypot(c2[1], c2[2]) <= radius)


@pytest.mark.parametrize("length", [1.0, 1e-3, 1e3])
def test_the_sign_of_an_eigenvalue_does_not_depend_on_units(length):
    """A link in kilometres: its moments are 1e-9 of its mass, and rounding of the mass
    is larger."""
    rng = np.random.default_rng(0)
    t = np.diag([length, length, length, 1.0])
    for smallest in (1e-9, -1e-9):
        for _ in range(50):
            q = np.linalg.qr(rng.normal(size=(3, 3)))[0]
            c = np.append(rng.normal(size=3), 1.0)
            matrix = 2.0 * np.outer(c, c)
            matrix[:3, :3] += (q * [1e-2, 1e-3, smallest]) @ q.T
            value = smallest_eigenvalue(t @ matrix @ t)
            assert np.sign(value) == np.sign(smallest)
            assert abs(value) <= max(length**2, 1.0) * 2e-9


def cloud(rng, count=30):
    """Point masses (k,) and positions (k, 3)."""
    return rng.uniform(0.01, 1.0, count), rng.normal(size=(count, 3)) + rng.normal(
        size=3
    )


def parameters_of(masses, x):
    """The ten parameters straight from their definition as integrals over the mass."""
    tensor = np.einsum(
        "k,kij->ij", masses, [(p @ p) * np.eye(3) - np.outer(p, p) for p in x]
    )
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = tensor
    return np.array([masses.sum(), *(masses @ x), xx, xy, yy, xz, yz, zz])


@given(seeds)
def test_pseudo_inertia_is_the_second_moment_of_the_mass(seed):
    masses, x = cloud(np.random.default_rng(seed))
    homogeneous = np.column_stack([x, np.ones(len(x))])
    second = np.einsum("k,ki,kj->ij", masses, homogeneous, homogeneous)
    theta = parameters_of(masses, x)
    assert_allclose(inertia.pseudo_inertia(theta), second, rtol=1e-12, atol=1e-12)
    assert_allclose(inertia.from_pseudo_inertia(second), theta, rtol=1e-12, atol=1e-12)


@given(seeds)
def test_barycentric_and_standard_invert_each_other(seed):
    rng = np.random.default_rng(seed)
    masses, x = cloud(rng)
    theta = parameters_of(masses, x)
    barycentric = inertia.barycentric_from_standard(theta)
    centre = masses @ x / masses.sum()
    assert_allclose(barycentric[1:4], centre, rtol=1e-12)
    assert_allclose(barycentric[4:], parameters_of(masses, x - centre)[4:], atol=1e-10)
    stack = np.stack([theta, 2.0 * theta]).reshape(2, 1, 10)
    back = inertia.standard_from_barycentric(inertia.barycentric_from_standard(stack))
    assert_allclose(back, stack, rtol=1e-9)


@given(seeds)
def test_transform_moves_the_mass(seed):
    rng = np.random.default_rng(seed)
    masses, x = cloud(rng)
    placement = pose(rng, 2.0)
    moved = x @ placement[:3, :3].T + placement[:3, 3]
    theta = parameters_of(masses, x)
    expected = parameters_of(masses, moved)
    assert_allclose(
        inertia.transform(placement) @ theta, expected, rtol=1e-9, atol=1e-9
    )


@given(seeds)
def test_consistent_means_positive_mass_definite_inertia_and_triangle(seed):
    """The eigenvalue of the 4x4 against the three classical conditions, on both sides."""
    rng = np.random.default_rng(seed)
    mass = rng.choice([-1.0, 1.0, 1.0, 1.0]) * rng.uniform(0.1, 3.0)
    moments = rng.uniform(-0.1, 1.0, 3)
    r = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    central = inertia.inertia_entries((r * moments) @ r.T)
    theta = inertia.standard_from_barycentric([mass, *rng.normal(size=3), *central])
    triangle = moments.sum() - 2.0 * moments.max()
    classical = mass > 0 and moments.min() > 0 and triangle > 0
    if min(abs(moments.min()), abs(triangle)) > 1e-6:
        assert (inertia.consistency_margin(theta) > 0) == classical


def test_thickness_of_known_bodies():
    ball = inertia.standard_from_barycentric(
        [3.0, 1, 2, 3, *(3.0 * 0.4 * np.array([1, 0, 1, 0, 0, 1]))]
    )
    assert inertia.thickness(ball) == pytest.approx(1.0 / np.sqrt(5.0))  # R = 1 m
    rod = inertia.standard_from_barycentric(
        [2.0, 0, 0, 0, *np.array([1, 0, 1, 0, 0, 0]) / 6.0]
    )
    assert inertia.thickness(rod) == pytest.approx(0.0, abs=1e-9)
    # No mass distribution has Ixx + Iyy < Izz.
    assert (
        inertia.thickness(
            inertia.standard_from_barycentric([1, 0, 0, 0, 1, 0, 1, 0, 0, 3])
        )
        < 0.0
    )
    assert inertia.thickness(np.zeros(10)) == 0.0
    assert inertia.thickness(np.stack([ball, rod])).shape == (2,)
    # Without a mass there is no centre, and (by filterwarnings of pyproject.toml) no
    # warning.
    nothing = inertia.barycentric_from_standard(np.zeros(10))
    assert_array_equal(nothing, [0.0, *[np.nan] * 9])
