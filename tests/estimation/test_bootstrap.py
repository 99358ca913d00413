"""The block bootstrap of the SDP: the same answers as solving each draw from the beginning."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))

import bootstrap

from sdp_vs_penalty.constraints.constraint import ConstraintSet
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimators.estimator import Task
from sdp_vs_penalty.estimators.lmi_sdp import solve_sdp
from sdp_vs_penalty.estimators.task import joint_weights, make_task
from sdp_vs_penalty.parallel import Workers
from sdp_vs_penalty.problem.load import load_problem
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.regression.regression import LeastSquares, Regression, compress
from sdp_vs_penalty.shootout.instance import Instance, in_units
from sdp_vs_penalty.simulation.experiment import experiment
from sdp_vs_penalty.solvers.objective import Objective


def prepared(
    problem: Problem, run: Measurements
) -> tuple[Task, list[LeastSquares], Regression, np.ndarray]:
    model = problem.model()
    regression = compress(run, model, problem.preprocessing.resolve(run))
    task = make_task(problem, model, regression)
    weights = joint_weights(regression, make_task(problem, model, regression, "none").ols)
    constraints = ConstraintSet(task.constraints.plus(task.minimum_thickness(0.02)).convex)
    return (
        replace(task, constraints=constraints),
        bootstrap.block_data(regression, weights),
        regression,
        weights,
    )


@pytest.fixture(scope="module")
def two_link_blocks() -> tuple[Task, list[LeastSquares], Regression, np.ndarray]:
    problem = load_problem("two_link")
    return prepared(problem, experiment(problem).training_run(seed=0))


def test_a_draw_is_the_selection_of_its_blocks(two_link_blocks) -> None:  # type: ignore[no-untyped-def]
    _, blocks, regression, weights = two_link_blocks
    counts = bootstrap.draw_counts(len(blocks), 3, seed=1)
    assert counts.sum() == len(blocks)
    chosen = np.repeat(np.arange(len(blocks)), counts)
    direct = regression.select(chosen.tolist()).least_squares(weights)
    found = bootstrap.joined(blocks, counts)
    np.testing.assert_allclose(found.R.T @ found.R, direct.R.T @ direct.R, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(found.R.T @ found.rho, direct.R.T @ direct.rho, rtol=1e-9, atol=1e-9)
    assert found.tau_squared == pytest.approx(direct.tau_squared)
    assert found.rows == direct.rows
    theta = np.random.default_rng(0).normal(size=found.R.shape[1])
    assert found.loss(theta) == pytest.approx(direct.loss(theta), rel=1e-9)


def test_updated_values_give_what_a_fresh_problem_gives(two_link_blocks) -> None:  # type: ignore[no-untyped-def]
    task, blocks, _, _ = two_link_blocks
    draws = bootstrap.bootstrap(task, blocks, draws=12, seed=5)
    assert draws.gap.max() <= 1e-8
    assert draws.theta.std(axis=0).max() > 0.0
    for k in (0, 7):
        data = bootstrap.joined(blocks, bootstrap.draw_counts(len(blocks), k, 5))
        fresh = solve_sdp(replace(task, data=data), Objective(data), task.constraints, "clarabel", 1e-10)
        assert draws.loss[k] == pytest.approx(data.loss(fresh.theta), rel=2e-8)
        assert task.constraints.margin(draws.theta[k]) >= 0.0


def test_draws_do_not_depend_on_how_they_are_shared_out(two_link_blocks) -> None:  # type: ignore[no-untyped-def]
    task, blocks, _, _ = two_link_blocks
    alone = bootstrap.bootstrap(task, blocks, 6, 2)
    shared = bootstrap.bootstrap(task, blocks, 6, 2, Workers(2), shares=3)
    np.testing.assert_allclose(alone.loss, shared.loss, rtol=1e-9)
    with pytest.raises(InputError, match="two blocks"):
        bootstrap.bootstrap(task, blocks[:1])


@pytest.mark.real_data
@pytest.mark.parametrize("unit", [1.0, 1e-3, 1e3])
def test_real_draws_are_certified_in_every_unit(panda, panda_run, unit: float) -> None:  # type: ignore[no-untyped-def]
    task, blocks, _, _ = prepared(panda, panda_run.window(0.0, 14.0))
    moved = [in_units(Instance("b", replace(task, data=b), Objective(b)), unit, unit) for b in blocks]
    whole = in_units(Instance("w", task, Objective(task.data)), unit, unit).task
    draws = bootstrap.bootstrap(whole, [m.data for m in moved], draws=10)
    assert np.all(draws.gap >= 0.0)
    assert draws.gap.max() <= 1e-8  # proved, in every system of units
