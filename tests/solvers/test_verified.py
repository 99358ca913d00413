"""Bounds that hold whatever was rounded: against exact rational arithmetic, and known
optima."""

import itertools
from decimal import Decimal, localcontext
from fractions import Fraction

import numpy as np
import pytest
from drawn import given, settings, st

from sdp_vs_penalty.estimators import Fit
from sdp_vs_penalty.regression import LeastSquares
from sdp_vs_penalty.robot import (
    Constraint,
    ConstraintSet,
    cone_depths,
    cone_margin,
    inertia,
    safe_depth,
)
from sdp_vs_penalty.robot import constraint as build
from sdp_vs_penalty.solvers import (
    ConvexProblem,
    optimum_proof,
    repair,
    rigorous_bounds,
    verify_proof,
)


def semidefinite(matrix):
    """All principal minors are non-negative: whole numbers, which rounding gives back."""
    places = range(len(matrix))
    every = (
        rows for size in places for rows in itertools.combinations(places, size + 1)
    )
    return all(
        round(float(np.linalg.det(matrix[np.ix_(rows, rows)]))) >= 0 for rows in every
    )


@pytest.mark.parametrize("size", [2, 3, 4])
def test_semidefinite_is_what_all_principal_minors_say(size):
    """Small whole numbers: zero pivots, rank-deficient and indefinite matrices are
    common."""
    rng = np.random.default_rng(size)
    for _ in range(100):
        v = rng.integers(-2, 3, (size, rng.integers(1, size + 1)))
        whole = v @ v.T + np.diag(rng.integers(-1, 2, size))
        whole[[0, -1], [-1, 0]] += rng.integers(2)
        truth = semidefinite(whole)
        assert (
            verify_proof.inside("psd", [*map(Fraction, whole.ravel().tolist())])
            is truth
        )
        value = whole.astype(float)
        margin = cone_margin("psd", value)
        if abs(margin) > 1e-9:
            assert (margin > 0.0) == truth
        # A depth above rounding is a proof; a violation that is one shows below zero.
        (depth,) = cone_depths("psd", value[None], np.abs(value)[None])
        assert truth or depth < safe_depth(size)


def demands(rng, interior):
    """One constraint of each cone in three parameters of unequal size, the interior
    point inside."""
    p = len(interior)
    index = np.arange(p)
    scale = 10.0 ** rng.uniform(-6.0, 6.0, p)
    matrices = rng.normal(size=(p, 3, 3)) * scale[:, None, None]
    matrices = matrices + np.swapaxes(matrices, 1, 2)
    rows = rng.normal(size=(p, 4)) * scale[:, None]
    lines = rng.normal(size=(p, 2)) * scale[:, None]
    root = rng.normal(size=(3, 3))
    inside = root @ root.T + 0.1 * np.eye(3)
    middle = np.append(2.0, rng.uniform(-0.8, 0.8, 3))
    return ConstraintSet(
        (
            Constraint(
                "lmi",
                "one",
                "psd",
                index,
                inside - np.tensordot(interior, matrices, 1),
                matrices,
            ),
            build.linear("cone", "one", index, rows, middle - interior @ rows, "soc"),
            build.linear(
                "bounds",
                "all",
                index,
                lines,
                rng.uniform(0.5, 2.0, 2) - interior @ lines,
            ),
        )
    )


@pytest.mark.parametrize("seed", range(40))
def test_a_repaired_point_is_feasible_in_rational_arithmetic_and_no_deeper_than_needed(
    seed,
):
    rng = np.random.default_rng(seed)
    interior = rng.normal(size=3) * 10.0 ** rng.uniform(-3.0, 3.0)
    constraints = demands(rng, interior)
    each = [ConstraintSet((c,)) for c in constraints.convex]
    for chosen in (constraints, *each):
        start = interior + rng.normal(size=3) * 10.0 ** rng.uniform(-3.0, 3.0)
        found = repair(chosen, start, interior)
        assert rigorous_bounds.certainly_feasible(chosen.convex, found)
        assert set(chosen.worst(found).values()) == {0.0}
        if not rigorous_bounds.certainly_feasible(chosen.convex, start):
            step = np.linalg.norm(found - start) / np.linalg.norm(interior - start)
            before = start + (1.0 - 1e-6) * step * (interior - start)
            assert not rigorous_bounds.certainly_feasible(chosen.convex, before)
        else:
            # Feasible by more than rounding stays where it is.
            assert chosen.depth(start) < 1e-12 or np.array_equal(found, start)


@pytest.mark.parametrize("seed", range(10))
def test_safely_inside_means_deeper_than_rounding_in_every_group(seed):
    rng = np.random.default_rng(seed)
    interior = rng.normal(size=3)
    constraints = demands(rng, interior)
    assert constraints.is_safely_inside(interior)
    on_the_way = interior + rng.uniform(0.0, 3.0, (20, 1)) * rng.normal(size=(20, 3))
    for theta in on_the_way:
        is_safe = all(
            depth >= safe_depth(group.constant.shape[1])
            for depth, group in zip(
                constraints.depths(theta), constraints.groups, strict=True
            )
        )
        assert constraints.is_safely_inside(theta) == is_safe


def test_a_sum_within_its_rounding_is_decided_exactly():
    """Six products that cancel: doubles call some of them positive that are negative."""
    rng = np.random.default_rng(0)
    misled = 0
    for theta, row in rng.normal(size=(200, 2, 6)):
        exact = sum(
            Fraction(a) * Fraction(b)
            for a, b in zip(theta.tolist(), row.tolist(), strict=True)
        )
        demand = build.linear("sum", "all", np.arange(6), row[:, None], [-float(exact)])
        holds = exact >= Fraction(float(exact))
        misled += not holds and demand.margin(theta) > 0.0
        assert rigorous_bounds.certainly_feasible([demand], theta) == holds
    assert misled > 5


@pytest.mark.parametrize("size", [1e-300, 1e-18, 0.7, 1.0, 1e6, 1e300])
def test_logarithms_are_enclosed(size):
    """ln x as the checker has it is below the truth, and by less than 1e-49."""
    with localcontext() as context:
        context.prec = 120
        for x in np.random.default_rng(0).uniform(0.5, 1.0, 20):
            exact = Fraction(float(x)) * Fraction(size)
            truth = Fraction(
                Decimal(exact.numerator).ln() - Decimal(exact.denominator).ln()
            )
            assert 0 <= truth - verify_proof.log_below(exact) < Fraction(1, 10**49)


class KnownSdp:
    """min |R theta - rho|^2 + floor^2 with a 3x3 LMI, a cone and bounds, all in whole
    numbers.

    Built from its own KKT point: theta, the slack w w^T (psd), (5, 3, 4) (soc) and
    complementary multipliers are chosen, R is unimodular, y = R^-T F*(S) / 2 and rho =
    R theta - y follow. All of it is exact in doubles, hence so is the optimum |y|^2 +
    floor^2.
    """

    def __init__(self, seed, size):
        rng = np.random.default_rng(seed)
        p = 3
        self.theta = rng.integers(-3, 4, p).astype(float)
        w = np.array([1.0, *rng.integers(-2, 3, 2)])
        v = np.array([-w[1] - w[2], 1.0, 1.0]) * size  # orthogonal to w
        coefficients = rng.integers(-2, 3, (p, 3, 3)).astype(float)
        coefficients = coefficients + np.swapaxes(coefficients, 1, 2)
        index = np.arange(p)
        lmi = Constraint(
            "lmi",
            "one",
            "psd",
            index,
            np.outer(w, w) - np.tensordot(self.theta, coefficients, 1),
            coefficients,
        )
        rows = rng.integers(-2, 3, (p, 3)).astype(float)
        cone = Constraint(
            "cone",
            "one",
            "soc",
            index,
            np.array([5.0, 3.0, 4.0]) - self.theta @ rows,
            rows,
        )
        bounds = build.linear(
            "range",
            "all",
            index,
            np.hstack([np.eye(p), -np.eye(p)]),
            np.full(2 * p, 8.0),
        )
        self.constraints = ConstraintSet((lmi, cone, bounds))
        each = [np.outer(v, v), size * np.array([5.0, -3.0, -4.0]), np.zeros(2 * p)]
        self.multipliers = np.concatenate([s.ravel() for s in each])
        slope = self.constraints.entries.adjoint(self.multipliers, p)
        lower = np.eye(p) + np.tril(rng.integers(-1, 2, (p, p)), -1)
        upper = np.eye(p) + np.triu(rng.integers(-1, 2, (p, p)), 1)
        R = (lower @ upper).astype(float)  # determinant 1: the inverse is whole too
        y = np.rint(np.linalg.inv(R).T) @ slope / 2.0
        assert np.array_equal(2.0 * R.T @ y, slope)
        floor = float(rng.integers(0, 3))
        rho = R @ self.theta - y
        self.data = LeastSquares(R, rho, floor, float(rho @ rho) + floor**2, p)
        self.optimum = sum((Fraction(x) ** 2 for x in y), Fraction(floor) ** 2)
        bound = np.full(p, 8.0)
        self.problem = ConvexProblem(self.data, self.constraints, bound)


@settings(max_examples=60, derandomize=False)
@given(
    seed=st.integers(0, 10**6),
    exponent=st.integers(-3, 3),
    noise=st.sampled_from([0.0, 1e-9, 0.3]),
)
def test_lower_bound_never_exceeds_a_known_optimum(seed, exponent, noise):
    known = KnownSdp(seed, 1)
    rng = np.random.default_rng(seed)
    scale = 10.0**exponent if noise else 1.0
    multipliers = scale * (
        known.multipliers + noise * rng.normal(size=len(known.multipliers))
    )
    theta = known.theta + noise * rng.normal(size=3)
    lower = Fit(theta, known.problem, multipliers).lower
    assert Fraction(lower) <= known.optimum
    if noise == 0.0:  # and it is not merely low
        assert known.optimum - Fraction(lower) <= Fraction(1, 10**12) * (
            1 + known.optimum
        )


@pytest.mark.parametrize("seed", range(6))
def test_multipliers_that_are_outside_by_rounding_make_a_proof_that_is_tight(seed):
    known = KnownSdp(seed, 1)
    rng = np.random.default_rng(seed)
    near = known.multipliers - 1e-9 * rng.random(len(known.multipliers))
    made = optimum_proof(Fit(known.theta, known.problem, near))
    lower, upper = verify_proof.check(made)
    assert lower <= known.optimum <= upper
    assert upper - lower <= Fraction(1, 10**6) * (1 + known.optimum)


def test_a_point_outside_by_one_unit_in_the_last_place_is_infeasible():
    constraint = build.linear("mass", "one", [0], [[1.0]], [-1.0])  # theta >= 1
    assert rigorous_bounds.certainly_feasible([constraint], np.array([1.0]))
    assert not rigorous_bounds.certainly_feasible(
        [constraint], np.array([np.nextafter(1.0, 0.0)])
    )
    cone = build.linear("cone", "one", [0], [[1.0, 0.0, 0.0]], [0.0, 3.0, 4.0], "soc")
    assert rigorous_bounds.certainly_feasible([cone], np.array([5.0]))
    assert not rigorous_bounds.certainly_feasible(
        [cone], np.array([np.nextafter(5.0, 0.0)])
    )
    link = build.pseudo_inertia("link", np.arange(10))
    rod = inertia.from_pseudo_inertia(
        np.outer([1.0, 2.0, 3.0, 1.0], [1.0, 2.0, 3.0, 1.0])
    )
    assert rigorous_bounds.certainly_feasible(
        [link], rod
    )  # rank one: on the boundary, exactly
    rod[9] = np.nextafter(rod[9], 0.0)
    assert not rigorous_bounds.certainly_feasible([link], rod)


def test_infeasibility_is_proved_only_where_it_is_true():
    p = 2
    above = build.linear("lower", "sum", [0, 1], [[1.0], [1.0]], [-3.0])  # a + b >= 3
    below = build.linear("upper", "each", [0, 1], -np.eye(2), [1.0, 1.0])  # a, b <= 1

    def proves(multipliers, *demands):
        nothing = ConvexProblem.without_data(ConstraintSet(demands), np.full(p, 10.0))
        return rigorous_bounds.proves_infeasible(nothing, np.array(multipliers))

    assert proves([1.0, 1.0, 1.0], above, below)
    touching = build.linear(
        "lower", "sum", [0, 1], [[1.0], [1.0]], [-2.0]
    )  # met by (1, 1) only
    assert not proves([1.0, 1.0, 1.0], touching, below)
    assert not proves([1.0, 0.0, 0.0], above, below)
