"""The nearest consistent payload: against a general solver, with its certificate."""

import numpy as np
import pytest

from sdp_vs_penalty.online import ConeProjection
from sdp_vs_penalty.robot import inertia


def projected(precision, centre):
    projection = ConeProjection()
    projection.start(precision, centre)
    while not projection.is_done:
        projection.step()
    return projection


def case(seed):
    """A metric with unequal axes, and a payload that noise made impossible."""
    rng = np.random.default_rng(seed)
    rows = rng.normal(size=(14, 10)) * 10.0 ** rng.uniform(-2.0, 2.0, 10)
    precision = rows.T @ rows + 0.04 * np.eye(10)
    body = np.array([1.0, 0.2, 0.1, -0.3, 0.3, 0.0, 0.3, 0.0, 0.0, 0.3])
    noise = np.linalg.solve(np.linalg.cholesky(precision).T, rng.normal(size=10))
    return precision, body + 3.0 * noise


@pytest.mark.parametrize("seed", range(20))
def test_the_gap_bounds_the_distance_to_the_optimum(seed):
    cvxpy = pytest.importorskip("cvxpy")
    precision, centre = case(seed)
    projection = projected(precision, centre)
    x = cvxpy.Variable(10)
    root = np.linalg.cholesky(precision).T
    matrix = cvxpy.Variable((4, 4), PSD=True)
    terms = [x[k] * inertia.PSEUDO_INERTIA_BASIS[k] for k in range(10)]
    problem = cvxpy.Problem(
        cvxpy.Minimize(0.5 * cvxpy.sum_squares(root @ (x - centre))),
        [matrix == sum(terms)],
    )
    problem.solve(solver="CLARABEL")
    error = projection.theta - centre
    value = 0.5 * error @ precision @ error
    assert projection.gap <= 1e-4
    assert -1e-6 * (1.0 + value) <= value - problem.value
    assert value - problem.value <= projection.gap + 1e-6 * (1.0 + value)


@pytest.mark.parametrize("seed", range(20))
def test_the_projected_payload_is_consistent(seed):
    projection = projected(*case(seed))
    assert inertia.consistency_margin(projection.theta) >= 0.0


def test_a_consistent_payload_stays_where_it_is():
    precision, _ = case(0)
    body = np.array([1.0, 0.2, 0.1, -0.3, 0.3, 0.0, 0.3, 0.0, 0.0, 0.3])
    projection = projected(precision, body)
    np.testing.assert_array_equal(projection.theta, body)
    assert projection.gap == 0.0


def test_a_renewed_projection_takes_at_most_eight_steps():
    """So that one step a cycle at 1 kHz renews it at 100 Hz or more."""
    precision, centre = case(3)
    projection = projected(precision, centre)
    rng = np.random.default_rng(0)
    steps = []
    for _ in range(100):
        row = rng.normal(size=10)
        precision = precision + 0.01 * np.outer(row, row)
        noise = np.linalg.solve(np.linalg.cholesky(precision).T, rng.normal(size=10))
        projection.start(precision, centre + 0.05 * noise)
        while not projection.is_done:
            projection.step()
        assert projection.gap <= 1e-4
        steps.append(projection.steps)
    assert max(steps) <= 10
    assert np.median(steps) <= 8
