"""The compiled solve and bound beside the package's own proof."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import sparse

from sdp_vs_penalty.estimators import make_estimator
from sdp_vs_penalty.estimators.lmi_sdp import essential, interior_point, solve_sdp
from sdp_vs_penalty.robot import compiled
from sdp_vs_penalty.shootout.regular import chain_task, shape_cones
from sdp_vs_penalty.solvers import native
from sdp_vs_penalty.solvers.conic import Cone, ConicProblem
from sdp_vs_penalty.solvers.native import ORDER
from sdp_vs_penalty.solvers.rewrite import NotApplicableError
from sdp_vs_penalty.solvers.structured import Structured
from sdp_vs_penalty.solvers.verified import certainly_feasible, upper_bound

pytestmark = pytest.mark.skipif(
    compiled.core() is None, reason="the compiled core (native/) is not installed"
)


@pytest.mark.parametrize("method", ["lmi-sdp", "lmi-sdp-thickness"])
def test_its_bound_is_below_the_optimum_whatever_the_multipliers(method: str) -> None:
    task = chain_task(3)
    objective, constraints = make_estimator(method).posed(task)  # type: ignore[attr-defined]
    reference = solve_sdp(task, objective, constraints, "clarabel", 1e-10)
    optimum = upper_bound(objective, reference.theta)
    interior = interior_point(task, constraints)
    sent = essential(constraints, objective)
    ours = Structured.of(objective.entropy, constraints, sent, task.bound, interior)
    data = objective.least_squares
    found = ours.solve(data)
    assert found.feasible
    assert certainly_feasible(constraints.convex, found.theta)
    assert -1e-12 <= found.gap <= 1e-8
    assert found.lower <= optimum
    assert found.value >= reference.lower
    assert found.value == pytest.approx(objective.value(found.theta), rel=1e-12)

    rng = np.random.default_rng(0)
    loose = []
    for _ in range(30):
        factors = rng.normal(size=(ours.core.blocks, ORDER, ORDER))
        multipliers = found.value * factors @ np.swapaxes(factors, 1, 2) * 10.0 ** rng.uniform(-9, 0)
        theta = found.theta + 10.0 ** rng.uniform(-12, 0) * (interior - found.theta)
        args = data.R, data.rho, data.residual_norm
        loose.append(ours.core.lower_bound(*args, theta, np.ascontiguousarray(multipliers)))
    assert max(loose) <= optimum
    assert min(loose) < 0.9 * optimum  # bad multipliers say little
    # A bound of twice the data is no bound of these: it would show if the data were not looked at.
    twice = replace(data, residual_norm=2.0 * data.residual_norm + np.sqrt(optimum))
    assert ours.solve(twice).lower > optimum


@pytest.mark.parametrize("method", ["lmi-sdp", "lmi-sdp-thickness", "lmi-sdp-plain"])
@pytest.mark.parametrize("links", [2, 3])
def test_a_fit_by_it_is_proved_from_its_own_multipliers(method: str, links: int) -> None:
    """Matrices, cones of a centre of mass that bind, signs and ranges; with a log det and without."""
    task = chain_task(links)
    cones = shape_cones(task)
    task = replace(task, constraints=task.constraints.plus(cones))
    posed = make_estimator(method).posed(task)  # type: ignore[attr-defined]
    fit = solve_sdp(task, *posed, None, 1e-10)
    reference = solve_sdp(task, *posed, "clarabel", 1e-10)
    assert fit.details["solver"] == "native"
    assert fit.gap <= 1e-8
    assert fit.gap >= -1e-12
    assert min(cone.margin(fit.theta) for cone in cones) < 1e-9
    assert fit.objective.value(fit.theta) == pytest.approx(
        reference.objective.value(reference.theta), rel=2e-8
    )


def test_numbers_that_are_not_finite_are_a_failure_and_no_hang() -> None:
    A = sparse.csc_matrix(-np.ones((3, 2)))
    b = np.array([np.nan, 1.0, 1.0])
    problem = ConicProblem(sparse.csc_matrix((2, 2)), np.ones(2), A, b, (Cone("psd", 2),))
    assert native.solve(problem).claims == "failed"


def test_what_it_cannot_take_it_declines() -> None:
    for cones, rows in (((Cone("psd", 5),), 15), ((Cone("exp", 3),), 3), ((Cone("soc", 5),), 5)):
        A = sparse.csc_matrix(np.ones((rows, 2)))
        problem = ConicProblem(sparse.csc_matrix((2, 2)), np.ones(2), A, np.ones(rows), cones)
        with pytest.raises(NotApplicableError):
            native.solve(problem)
