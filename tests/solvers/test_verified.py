"""Rigorous bounds: exact optima are known for SDPs built backwards from their own solution."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sdp_vs_penalty.regression import LeastSquares
from sdp_vs_penalty.robot import Constraint, ConstraintSet, inertia
from sdp_vs_penalty.robot import constraint as build
from sdp_vs_penalty.solvers import Objective, certificate, verified


class KnownSdp:
    """min |R theta - rho|^2 + floor^2 with a 3x3 LMI, a cone and bounds, all in whole numbers.

    Built from its own KKT point: theta, the slack w w^T (psd), (5, 3, 4) (soc) and complementary
    multipliers are chosen, R is unimodular, y = R^-T F*(S) / 2 and rho = R theta - y follow. All of
    it is exact in doubles, hence so is the optimum |y|^2 + floor^2.
    """

    def __init__(self, seed: int, size: int) -> None:
        rng = np.random.default_rng(seed)
        p = 3
        self.theta = rng.integers(-3, 4, p).astype(float)
        w = np.array([1.0, *rng.integers(-2, 3, 2)])
        v = np.array([-w[1] - w[2], 1.0, 1.0]) * size  # orthogonal to w
        coefficients = rng.integers(-2, 3, (p, 3, 3)).astype(float)
        coefficients = coefficients + np.swapaxes(coefficients, 1, 2)
        index = np.arange(p)
        lmi = Constraint(
            "lmi", "one", "psd", index, np.outer(w, w) - np.tensordot(self.theta, coefficients, 1),
            coefficients,
        )  # fmt: skip
        rows = rng.integers(-2, 3, (p, 3)).astype(float)
        cone = Constraint(
            "cone", "one", "soc", index, np.array([5.0, 3.0, 4.0]) - self.theta @ rows, rows
        )
        bounds = build.linear(
            "range", "all", index, np.hstack([np.eye(p), -np.eye(p)]), np.full(2 * p, 8.0)
        )
        self.constraints = ConstraintSet((lmi, cone, bounds))
        self.multipliers = [np.outer(v, v), size * np.array([5.0, -3.0, -4.0]), np.zeros(2 * p)]
        slope = sum(c.adjoint(s) for c, s in zip(self.constraints.convex, self.multipliers, strict=True))
        lower = np.eye(p) + np.tril(rng.integers(-1, 2, (p, p)), -1)
        upper = np.eye(p) + np.triu(rng.integers(-1, 2, (p, p)), 1)
        R = (lower @ upper).astype(float)  # determinant 1: the inverse is whole too
        y = np.rint(np.linalg.inv(R).T) @ slope / 2.0
        assert np.array_equal(2.0 * R.T @ y, slope)
        floor = float(rng.integers(0, 3))
        rho = R @ self.theta - y
        self.data = LeastSquares(R, rho, floor, float(rho @ rho) + floor**2, p)
        self.objective = Objective(self.data)
        self.optimum = sum((Fraction(x) ** 2 for x in y), Fraction(floor) ** 2)
        self.bound = np.full(p, 8.0)


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 10**6), exponent=st.integers(-3, 3), noise=st.sampled_from([0.0, 1e-9, 0.3]))
def test_lower_bound_never_exceeds_a_known_optimum(seed, exponent, noise):
    known = KnownSdp(seed, 1)
    rng = np.random.default_rng(seed)
    scale = 10.0**exponent if noise else 1.0
    multipliers = [scale * (s + noise * rng.normal(size=s.shape)) for s in known.multipliers]
    theta = known.theta + noise * rng.normal(size=3)
    lower = certificate.lower_bound(known.objective, known.constraints, multipliers, theta, known.bound)
    assert Fraction(lower) <= known.optimum
    if noise == 0.0:  # and it is not merely low
        assert known.optimum - Fraction(lower) <= Fraction(1, 10**12) * (1 + known.optimum)


def test_a_point_outside_by_one_unit_in_the_last_place_is_infeasible():
    constraint = build.linear("mass", "one", [0], [[1.0]], [-1.0])  # theta >= 1
    assert verified.certainly_feasible([constraint], np.array([1.0]))
    assert not verified.certainly_feasible([constraint], np.array([np.nextafter(1.0, 0.0)]))
    cone = build.linear("cone", "one", [0], [[1.0, 0.0, 0.0]], [0.0, 3.0, 4.0], "soc")
    assert verified.certainly_feasible([cone], np.array([5.0]))
    assert not verified.certainly_feasible([cone], np.array([np.nextafter(5.0, 0.0)]))
    link = build.pseudo_inertia("link", np.arange(10))
    rod = inertia.from_pseudo_inertia(np.outer([1.0, 2.0, 3.0, 1.0], [1.0, 2.0, 3.0, 1.0]))
    assert verified.certainly_feasible([link], rod)  # rank one: on the boundary, exactly
    rod[9] = np.nextafter(rod[9], 0.0)
    assert not verified.certainly_feasible([link], rod)


def test_infeasibility_is_proved_only_where_it_is_true():
    p = 2
    above = build.linear("lower", "sum", [0, 1], [[1.0], [1.0]], [-3.0])  # a + b >= 3
    below = build.linear("upper", "each", [0, 1], -np.eye(2), [1.0, 1.0])  # a, b <= 1
    bound = np.full(p, 10.0)
    farkas = [np.array([1.0]), np.array([1.0, 1.0])]
    assert verified.proves_infeasible([above, below], farkas, bound)
    touching = build.linear("lower", "sum", [0, 1], [[1.0], [1.0]], [-2.0])  # met by (1, 1) only
    assert not verified.proves_infeasible([touching, below], farkas, bound)
    assert not verified.proves_infeasible([above, below], [np.array([1.0]), np.zeros(2)], bound)


@pytest.mark.parametrize("cone", ["psd", "soc", "nonnegative"])
def test_garbage_multipliers_are_moved_into_their_cone_exactly(cone):
    rng = np.random.default_rng(0)
    raw = rng.normal(size=(20, 4, 4) if cone == "psd" else (20, 4))
    for moved in verified.in_cone(cone, raw)[0]:
        if cone == "psd":
            # up to the radius, which covers what the product V V^T rounds
            assert np.linalg.eigvalsh(moved.astype(float))[0] > -1e-14
            continue
        exact = [Fraction(float(x)) for x in moved]
        slack = Fraction(1, 2**52)
        if cone == "soc":
            assert (exact[0] + slack) ** 2 >= sum(x**2 for x in exact[1:])
        else:
            assert min(exact) >= 0
