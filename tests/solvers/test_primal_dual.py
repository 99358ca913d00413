"""Our own interior-point method beside Clarabel: the same optima, proved from its own multipliers."""

from dataclasses import replace

import numpy as np
import pytest

from sdp_vs_penalty.estimators import Fit, Task, make_estimator, solve_sdp
from sdp_vs_penalty.estimators.sdp_fit import PosedSdp
from sdp_vs_penalty.robot import ConstraintSet
from sdp_vs_penalty.robot.constraint import second_order
from sdp_vs_penalty.shootout.standard_instances import chain_task, shape_cones
from sdp_vs_penalty.solvers import Objective
from sdp_vs_penalty.solvers.verified import certainly_feasible, upper_bound

OURS = "primal-dual"
METHODS = ["lmi-sdp", "lmi-sdp-thickness", "lmi-sdp-plain"]


def both(task: Task, method: str) -> tuple[Fit, Fit]:
    """The default fit, and Clarabel's."""
    posed = make_estimator(method).posed(task)
    return solve_sdp(task, *posed, None, 1e-10), solve_sdp(task, *posed, "clarabel", 1e-10)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("links", [2, 3, 7])
def test_a_fit_is_proved_from_its_own_multipliers(method, links):
    """Matrices, cones of a centre of mass that bind, signs and ranges; with a log det and without."""
    task = chain_task(links)
    cones = shape_cones(task)
    task = replace(task, constraints=task.constraints.plus(cones))
    fit, reference = both(task, method)
    assert fit.details["solver"] == OURS
    assert -1e-12 <= fit.gap <= 1e-8
    assert min(cone.margin(fit.theta) for cone in cones) < 1e-6
    assert certainly_feasible(fit.constraints.convex, fit.theta)
    assert fit.lower <= upper_bound(reference.objective, reference.theta)
    assert reference.lower <= upper_bound(fit.objective, fit.theta)


@pytest.mark.parametrize("unit", [1e-6, 1.0, 1e6])
def test_units_change_nothing(unit):
    """Torques in other units and parameters in others: as many steps, the same optimum."""
    task = chain_task(3)
    data = task.data
    scaled = replace(
        data,
        R=unit * data.R,
        rho=unit * data.rho,
        residual_norm=unit * data.residual_norm,
        tau_squared=unit**2 * data.tau_squared,
    )
    plain, moved = both(task, "lmi-sdp")[0], both(replace(task, data=scaled), "lmi-sdp")[0]
    assert moved.details["solver"] == OURS
    # A gap of 1e-8 of the loss lets the loss itself differ by as much of the whole objective.
    share = plain.objective.value(plain.theta) / data.loss(plain.theta)
    assert data.loss(moved.theta) == pytest.approx(data.loss(plain.theta), rel=1e-8 * share)


@pytest.mark.parametrize("method", METHODS)
def test_similar_data_take_fewer_steps_from_the_last_fit(method):
    task = chain_task(7)
    objective, constraints = make_estimator(method).posed(task)
    posed = PosedSdp.of(task, objective, constraints)
    first = posed.fit(objective)
    data = objective.least_squares
    noise = 0.1 * np.linalg.norm(data.rho) / np.sqrt(len(data.rho) * data.rows)
    moved = replace(data, rho=data.rho + noise * np.random.default_rng(1).normal(size=len(data.rho)))
    again = Objective(moved, objective.entropy)
    cold, warm = posed.fit(again), posed.fit(again, near=first)

    def steps(fit: Fit) -> int:
        return int(fit.details["solver_said"][0].rpartition("(")[2].rstrip(")"))

    assert cold.gap <= 1e-8
    assert warm.gap <= 1e-8
    assert again.value(warm.theta) == pytest.approx(again.value(cold.theta), rel=2e-8)
    assert steps(warm) < steps(cold)


def test_cones_of_a_higher_order_are_clarabels():
    task = chain_task(2)
    link = task.links[0]
    size = 5  # |(m, c, a constant)| within a bound
    columns = np.zeros((4, size))
    columns[np.arange(4), np.arange(1, size)] = 1.0
    ball = second_order("ball", "link 1", link[:4], columns, [100.0, 0.0, 0.0, 0.0, 0.0])
    task = replace(task, constraints=ConstraintSet((*task.constraints.convex, ball)))
    fit, reference = both(task, "lmi-sdp")
    assert fit.details["solver"] == "clarabel"
    assert fit.gap <= 1e-8
    np.testing.assert_array_equal(fit.theta, reference.theta)
