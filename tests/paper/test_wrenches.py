"""Internal wrenches: Newton-Euler, the unfeasible example, certified intervals."""

import numpy as np
import pytest

from sdp_vs_penalty import InputError, Problem, load_problem
from sdp_vs_penalty.paper.tables.wrenches import (
    WrenchIntervals,
    unfeasible_retrievals,
    wrench_intervals,
    wrench_regressor,
)
from sdp_vs_penalty.problem import published_links
from sdp_vs_penalty.regression.base_parameters import base_parameters
from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.robot._pinocchio import pin
from sdp_vs_penalty.solvers.extremes import Slice


def states(problem: Problem, count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    dq, ddq = np.random.default_rng(seed).normal(size=(2, count, problem.robot.n))
    return problem.robot.random_configurations(count, seed), dq, ddq


def links_slice(problem: Problem, links: np.ndarray) -> Slice:
    model = problem.model("rigid_body")
    base, _ = base_parameters(model)
    bound = problem.parameter_bound(model)
    return Slice.of(problem.constraints(model), base, links.ravel(), bound)


@pytest.fixture(scope="module")
def real(two_link: Problem) -> np.ndarray:
    return published_links(two_link, "p_real")


@pytest.fixture(scope="module")
def feasible(two_link: Problem, real: np.ndarray) -> Slice:
    return links_slice(two_link, real)


@pytest.fixture(scope="module")
def intervals(two_link: Problem, feasible: Slice) -> WrenchIntervals:
    return wrench_intervals(feasible, wrench_regressor(two_link.robot, *states(two_link, 3)))


@pytest.mark.parametrize(("name", "column"), [("two_link", "p_real"), ("panda", "p_hat")])
def test_wrenches_are_those_of_recursive_newton_euler(name: str, column: str) -> None:
    problem = load_problem(name)
    robot, links = problem.robot, published_links(problem, column)
    q, dq, ddq = states(problem, 5)
    wrenches = wrench_regressor(robot, q, dq, ddq) @ links.ravel()
    model = robot._with_inertias(links)
    data = model.createData()
    for k in range(5):
        pin.rnea(model, data, q[k], dq[k], ddq[k])
        reference = np.array([data.f[j + 1].vector for j in range(robot.n)])
        assert np.abs(wrenches[k] - reference).max() < 1e-10


def test_unfeasible_parameters_make_the_same_torques_and_absurd_wrenches(
    two_link: Problem, real: np.ndarray
) -> None:
    base, _ = base_parameters(two_link.model("rigid_body"), two_link.independent)
    q, dq, ddq = states(two_link, 50)
    torque = two_link.robot.inverse_dynamics(real.ravel(), q, dq, ddq)
    Y = wrench_regressor(two_link.robot, q, dq, ddq)
    true = Y @ real.ravel()
    worst = []
    for links in unfeasible_retrievals(two_link, base @ real.ravel(), 5, boxed=False):
        assert inertia.consistency_margin(links).min() < 0.0
        theirs = two_link.robot.inverse_dynamics(links.ravel(), q, dq, ddq)
        assert np.abs(theirs - torque).max() < 1e-6 * np.abs(torque).max()
        wrenches = Y @ links.ravel()
        worst.append(np.abs(wrenches - true).max() / np.abs(true).max())
    assert len(worst) == 5
    assert max(worst) > 1e3


def test_interval_contains_the_truth_and_is_certified(
    two_link: Problem, real: np.ndarray, intervals: WrenchIntervals
) -> None:
    true = wrench_regressor(two_link.robot, *states(two_link, 3)) @ real.ravel()
    assert np.all(intervals.lower_bound <= true)
    assert np.all(true <= intervals.upper_bound)
    assert np.all(intervals.lower_bound <= intervals.lower)
    assert np.all(intervals.upper <= intervals.upper_bound)
    assert intervals.slack < 1e-6


def test_a_slice_without_interior_is_refused(two_link: Problem, real: np.ndarray) -> None:
    impossible = real.copy()
    impossible[1, 9] = -5.0  # Izz2 is identifiable: no feasible parameters have these torques
    with pytest.raises(InputError, match="strictly inside all constraints"):
        links_slice(two_link, impossible)
