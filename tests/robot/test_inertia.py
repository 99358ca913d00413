"""The parameter order, the conversions between conventions, and what consistency means."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from random_robots import pose

from sdp_vs_penalty.robot import inertia

seeds = st.integers(0, 2**32 - 1)
quick = settings(max_examples=40, deadline=None, derandomize=True)


def cloud(rng: np.random.Generator, count: int = 30) -> tuple[np.ndarray, np.ndarray]:
    """Point masses (k,) and positions (k, 3)."""
    return rng.uniform(0.01, 1.0, count), rng.normal(size=(count, 3)) + rng.normal(size=3)


def parameters_of(masses: np.ndarray, x: np.ndarray) -> np.ndarray:
    """The ten parameters straight from their definition as integrals over the mass."""
    tensor = np.einsum("k,kij->ij", masses, [(p @ p) * np.eye(3) - np.outer(p, p) for p in x])
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = tensor
    return np.array([masses.sum(), *(masses @ x), xx, xy, yy, xz, yz, zz])


@quick
@given(seeds)
def test_pseudo_inertia_is_the_second_moment_of_the_mass(seed):
    masses, x = cloud(np.random.default_rng(seed))
    homogeneous = np.column_stack([x, np.ones(len(x))])
    second = np.einsum("k,ki,kj->ij", masses, homogeneous, homogeneous)
    theta = parameters_of(masses, x)
    np.testing.assert_allclose(inertia.pseudo_inertia(theta), second, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(inertia.from_pseudo_inertia(second), theta, rtol=1e-12, atol=1e-12)


@quick
@given(seeds)
def test_barycentric_and_standard_invert_each_other(seed):
    rng = np.random.default_rng(seed)
    masses, x = cloud(rng)
    theta = parameters_of(masses, x)
    barycentric = inertia.barycentric_from_standard(theta)
    centre = masses @ x / masses.sum()
    np.testing.assert_allclose(barycentric[1:4], centre, rtol=1e-12)
    np.testing.assert_allclose(barycentric[4:], parameters_of(masses, x - centre)[4:], atol=1e-10)
    np.testing.assert_allclose(inertia.standard_from_barycentric(barycentric), theta, rtol=1e-9)
    stack = np.stack([theta, 2.0 * theta]).reshape(2, 1, 10)
    back = inertia.standard_from_barycentric(inertia.barycentric_from_standard(stack))
    np.testing.assert_allclose(back, stack, rtol=1e-9)


@quick
@given(seeds)
def test_transform_moves_the_mass(seed):
    rng = np.random.default_rng(seed)
    masses, x = cloud(rng)
    placement = pose(rng, 2.0)
    moved = x @ placement[:3, :3].T + placement[:3, 3]
    theta, expected = parameters_of(masses, x), parameters_of(masses, moved)
    np.testing.assert_allclose(inertia.transform(placement) @ theta, expected, rtol=1e-9, atol=1e-9)
    there_and_back = inertia.transform(np.linalg.inv(placement)) @ inertia.transform(placement)
    np.testing.assert_allclose(there_and_back, np.eye(10), atol=1e-9)
    further = pose(rng, 1.0)
    np.testing.assert_allclose(
        inertia.transform(further @ placement),
        inertia.transform(further) @ inertia.transform(placement),
        atol=1e-9,
    )


@quick
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
    if mass > 0:
        assert inertia.triangle_margin(theta) == pytest.approx(triangle, abs=1e-9)


def test_thickness_of_known_bodies():
    ball = inertia.standard_from_barycentric([3.0, 1, 2, 3, *(3.0 * 0.4 * np.array([1, 0, 1, 0, 0, 1]))])
    assert inertia.thickness(ball) == pytest.approx(1.0 / np.sqrt(5.0))  # R = 1 m
    rod = inertia.standard_from_barycentric([2.0, 0, 0, 0, *np.array([1, 0, 1, 0, 0, 0]) / 6.0])
    assert inertia.thickness(rod) == pytest.approx(0.0, abs=1e-9)
    # No mass distribution has Ixx + Iyy < Izz.
    assert inertia.thickness(inertia.standard_from_barycentric([1, 0, 0, 0, 1, 0, 1, 0, 0, 3])) < 0.0
    assert inertia.thickness(np.zeros(10)) == 0.0
    assert inertia.thickness(np.stack([ball, rod])).shape == (2,)


def test_a_massless_link_has_no_centre_of_mass_and_no_warning(recwarn):
    barycentric = inertia.barycentric_from_standard(np.zeros(10))
    assert barycentric[0] == 0.0
    assert np.all(np.isnan(barycentric[1:]))
    assert not recwarn.list
