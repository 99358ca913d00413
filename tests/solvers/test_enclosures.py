"""Bounds that claim to hold whatever was rounded, against exact rational arithmetic."""

import itertools
import math
from collections.abc import Sequence
from decimal import Decimal, localcontext
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sdp_vs_penalty.robot import Constraint, ConstraintSet, cone_margin
from sdp_vs_penalty.robot import constraint as build
from sdp_vs_penalty.robot.constraint import cone_depths, safe_depth
from sdp_vs_penalty.solvers import repair, verified, verify_proof


def determinant(matrix: Sequence[Sequence[int]] | Sequence[Sequence[Fraction]]) -> Fraction:
    """By Leibniz' formula, exactly."""
    size, out = len(matrix), Fraction(0)
    for order in itertools.permutations(range(size)):
        turns = sum(order[i] > order[j] for i in range(size) for j in range(i + 1, size))
        out += (-1) ** turns * math.prod(Fraction(matrix[i][order[i]]) for i in range(size))
    return out


def semidefinite(matrix: Sequence[Sequence[int]]) -> bool:
    """All principal minors are non-negative: no pivot is divided by."""
    return all(
        determinant([[matrix[i][j] for j in rows] for i in rows]) >= 0
        for size in range(1, len(matrix) + 1)
        for rows in itertools.combinations(range(len(matrix)), size)
    )


@settings(max_examples=300, deadline=None, derandomize=True)
@given(st.integers(2, 4), st.data())
def test_semidefinite_is_what_all_principal_minors_say(size, data):
    """Small whole numbers: zero pivots, rank-deficient and indefinite matrices are common."""
    rank = data.draw(st.integers(1, size))
    entry = st.integers(-2, 2)
    v = np.array(data.draw(st.lists(entry, min_size=size * rank, max_size=size * rank)))
    moved = np.array(data.draw(st.lists(st.integers(-1, 1), min_size=size, max_size=size)))
    whole = v.reshape(size, rank) @ v.reshape(size, rank).T + np.diag(moved)
    if data.draw(st.booleans()):
        whole[0, -1] += 1
        whole[-1, 0] += 1
    truth = semidefinite(whole.tolist())
    assert verify_proof.inside("psd", [Fraction(int(x)) for x in whole.ravel()]) is truth
    margin = cone_margin("psd", whole.astype(float))
    depth = float(cone_depths("psd", whole[None].astype(float), np.abs(whole)[None].astype(float))[0])
    if abs(margin) > 1e-9:
        assert bool(margin > 0.0) is truth
    # A depth above rounding is a proof; a violation that is one shows below zero.
    assert truth or depth < safe_depth(size)


def demands(rng: np.random.Generator, interior: np.ndarray) -> ConstraintSet:
    """One constraint of each cone in three parameters of unequal size, the interior point inside."""
    p = len(interior)
    index = np.arange(p)
    scale = 10.0 ** rng.uniform(-6.0, 6.0, p)
    matrices = rng.normal(size=(p, 3, 3)) * scale[:, None, None]
    matrices = matrices + np.swapaxes(matrices, 1, 2)
    rows, lines = rng.normal(size=(p, 4)) * scale[:, None], rng.normal(size=(p, 2)) * scale[:, None]
    root = rng.normal(size=(3, 3))
    inside = root @ root.T + 0.1 * np.eye(3)
    middle = np.append(2.0, rng.uniform(-0.8, 0.8, 3))
    return ConstraintSet(
        (
            Constraint(
                "lmi", "one", "psd", index, inside - np.tensordot(interior, matrices, 1), matrices
            ),
            build.linear("cone", "one", index, rows, middle - interior @ rows, "soc"),
            build.linear("bounds", "all", index, lines, rng.uniform(0.5, 2.0, 2) - interior @ lines),
        )
    )


@pytest.mark.parametrize("seed", range(40))
def test_a_repaired_point_is_feasible_in_rational_arithmetic_and_no_deeper_than_needed(seed):
    rng = np.random.default_rng(seed)
    interior = rng.normal(size=3) * 10.0 ** rng.uniform(-3.0, 3.0)
    constraints = demands(rng, interior)
    each = [ConstraintSet((c,)) for c in constraints.convex]
    for chosen in (constraints, *each):
        start = interior + rng.normal(size=3) * 10.0 ** rng.uniform(-3.0, 3.0)
        found = repair(chosen, start, interior)
        assert verified.certainly_feasible(chosen.convex, found)
        assert set(chosen.worst(found).values()) == {0.0}
        if not verified.certainly_feasible(chosen.convex, start):
            step = np.linalg.norm(found - start) / np.linalg.norm(interior - start)
            before = start + (1.0 - 1e-6) * step * (interior - start)
            assert not verified.certainly_feasible(chosen.convex, before)
        else:
            # Feasible by more than rounding stays where it is.
            assert chosen.depth(start) < 1e-12 or np.array_equal(found, start)


def test_a_sum_within_its_rounding_is_decided_exactly():
    """Six products that cancel: doubles call some of them positive that are negative."""
    rng, misled = np.random.default_rng(0), 0
    for theta, row in rng.normal(size=(200, 2, 6)):
        exact = sum(
            (Fraction(a) * Fraction(b) for a, b in zip(theta.tolist(), row.tolist(), strict=True))
        )
        demand = build.linear("sum", "all", np.arange(6), row[:, None], [-float(exact)])
        holds = exact >= Fraction(float(exact))
        misled += not holds and demand.margin(theta) > 0.0
        assert verified.certainly_feasible([demand], theta) == holds
    assert misled > 5


@pytest.mark.parametrize("size", [1e-300, 1e-18, 0.7, 1.0, 1e6, 1e300])
def test_logarithms_are_enclosed(size):
    """ln x as the checker has it is below the truth, and by less than 1e-49."""
    with localcontext() as context:
        context.prec = 120
        for x in np.random.default_rng(0).uniform(0.5, 1.0, 20):
            exact = Fraction(float(x)) * Fraction(size)
            truth = Fraction(Decimal(exact.numerator).ln() - Decimal(exact.denominator).ln())
            assert 0 <= truth - verify_proof.log_below(exact) < Fraction(1, 10**49)
