"""The penalised objective's certified optimum: the slack is the penalty, bounds hold,
and the figures of the real run."""

import re
from dataclasses import replace

import numpy as np
import pandas
import pytest
from committed import RESULTS
from random_robots import posed_task

from sdp_vs_penalty import load_problem
from sdp_vs_penalty.estimators import Penalty
from sdp_vs_penalty.paper import memo, penalised_optimum
from sdp_vs_penalty.paper.penalised_box import BoxedProblem
from sdp_vs_penalty.paper.penalised_optimum import PenalisedProblem
from sdp_vs_penalty.paper.tables import Study, build_tables
from sdp_vs_penalty.paper.tables.penalty import SearchPlan, search_runs, search_table
from sdp_vs_penalty.paper.tables.routes import SameConstraints
from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.simulation import experiment

#: Weights at which the simulated Panda's links are violated, and are not.
WEIGHTS = (0.0, 10.0, 40.0, 1000.0)


@pytest.fixture(scope="module")
def small_study():
    """Of the 2R, whose optima are worked out once, beside short searches."""
    made = Study(load_problem("two_link"))
    made.effort = replace(made.effort, annealing_runs=2, evaluations=200)
    return made


@pytest.fixture(scope="module")
def task(panda):
    return posed_task(panda, experiment(panda).training_run(seed=0))


@pytest.fixture(scope="module")
def one_step(task):
    return PenalisedProblem(task, two_step=False)


def test_the_triangle_penalty_is_the_least_slack(panda):
    """lambda_max(I) - tr(I) / 2 is the least s with P + s diag(1, 1, 1, 0) >= 0."""
    rng = np.random.default_rng(0)
    corner = np.diag([1.0, 1.0, 1.0, 0.0])
    for _ in range(50):
        link = rng.normal(size=10)
        link[0] = abs(link[0]) + 0.1
        about = inertia.barycentric_from_standard(link)[4:]
        moments = np.linalg.eigvalsh(inertia.inertia_matrix(about))
        slack = moments[2] - 0.5 * moments.sum()
        matrix = inertia.pseudo_inertia(link) + slack * corner
        assert np.linalg.eigvalsh(matrix)[0] == pytest.approx(0.0, abs=1e-12)


def test_every_optimum_is_certified(one_step):
    for found in one_step.solve_all(WEIGHTS):
        assert found.lower <= found.value
        assert found.gap <= 1e-6


def test_the_objective_is_the_published_one(one_step, task):
    """The value is the one that annealing minimises, where the box holds."""
    loss = one_step.published
    u = np.random.default_rng(1).uniform(size=len(loss.free))
    theta = loss.box.theta(loss.p(u))
    assert one_step.value(theta, 7.0) == pytest.approx(loss.value(u, 7.0), rel=1e-9)


def test_a_larger_weight_violates_less_and_costs_more(one_step):
    found = one_step.solve_all(WEIGHTS)
    assert np.all(np.diff([x.value for x in found]) >= -1e-9)
    assert np.all(np.diff([x.worst for x in found]) <= 1e-9)
    assert found[1].n_links_violated > 0
    assert found[-1].n_links_violated == 0


def test_the_least_exact_weight_is_the_largest_multiplier(one_step):
    exact = one_step.exact_weight_by_theory
    assert one_step.solve(0.99 * exact).is_violated
    assert not one_step.solve(1.01 * exact).is_violated


def test_cvxpy_and_clarabel_find_the_same_optimum(one_step):
    pytest.importorskip("cvxpy")
    from penalised_cvxpy import cvxpy_optima

    found = one_step.solve_all(WEIGHTS)
    by_cvxpy = cvxpy_optima(one_step, WEIGHTS)
    for optimum in found:
        assert by_cvxpy[optimum.weight] == pytest.approx(optimum.value, rel=1e-6)


def test_the_box_is_certified_and_no_search_ends_below(one_step):
    boxed = BoxedProblem(one_step).branch_and_bound(40.0, 1e-3, 9)
    assert boxed.gap <= 1e-3
    bounds = one_step.task.constraints.nonconvex
    assert all(bound.margin(boxed.theta) >= -1e-9 for bound in bounds)
    assert boxed.lower >= one_step.solve(40.0).lower - 1e-6
    plan = SearchPlan(runs=1, evaluations=100, annealing=False)
    (point,) = search_runs(one_step.published, 0, (40.0,), plan)
    assert point.objective >= boxed.lower


def test_smaller_cells_have_higher_bounds(one_step):
    boxed = BoxedProblem(one_step)
    whole = boxed.solve_cell(40.0, boxed.c_low, boxed.c_high).relaxation
    middle = 0.5 * (boxed.c_low + boxed.c_high)
    half = boxed.solve_cell(40.0, middle, boxed.c_high).relaxation
    assert half.lower >= whole.lower - 1e-6 * whole.lower
    assert np.isfinite(whole.theta).all()


def test_both_routes_solve_one_problem(two_link):
    """SDP and penalty of the table of routes end at the same loss."""
    task = posed_task(two_link, experiment(two_link).training_run(seed=1))
    losses = [
        task.data.loss(route.fit(task).theta)
        for route in (SameConstraints(), Penalty(starts=1))
    ]
    assert losses[0] == pytest.approx(losses[1], rel=1e-6)


@pytest.mark.real_data
def test_the_published_weight_is_too_small_for_one_step(panda):
    """At 40, the largest published weight, the optimum has four impossible links."""
    study = Study(panda)
    problem = PenalisedProblem(study.task(study.measured), two_step=False)
    expected = {40.0: (-6.171, 4), 100.0: (-3.300, 3), 1000.0: (0.0, 0)}
    for weight, (excess, links) in expected.items():
        found = problem.solve(weight)
        loss = 100.0 * (found.loss / problem.feasible.upper - 1.0)
        assert loss == pytest.approx(excess, abs=0.01)
        assert found.n_links_violated == links
        assert found.gap <= 1e-6


@pytest.mark.real_data
def test_the_published_weights_suffice_for_two_steps(panda):
    study = Study(panda)
    problem = PenalisedProblem(study.task(study.measured), two_step=True)
    for found in problem.solve_all((0.1, 40.0)):
        assert found.value == pytest.approx(1.7721e-3, rel=1e-4)
        assert found.n_links_violated == 0
        assert found.gap <= 1e-6


@pytest.mark.long
def test_the_table_has_its_columns(small_study):
    (table,) = build_tables(["global"], small_study)
    columns = {"data", "problem", "xi", "optimum", "lower_bound", "gap"}
    columns |= {"excess_loss_percent", "links_violated", "free_optimum"}
    assert columns <= set(table.frame.columns)
    assert np.all(table.frame["free_gap"].astype(float) <= 1e-6)
    assert np.all(table.frame["gap"].astype(float) <= 1e-5)


def test_a_run_with_fewer_weights_is_the_beginning_of_a_longer_one(one_step):
    plan = SearchPlan(runs=1, evaluations=100)
    short = search_runs(one_step.published, 0, (0.0, 40.0), plan)
    longer = search_runs(one_step.published, 0, (0.0, 40.0, 100.0), plan)
    assert longer[:2] == short


def test_runs_are_independent_of_how_many_there_are(one_step):
    one = search_runs(one_step.published, 0, (40.0,), SearchPlan(1, 100))
    two = search_runs(one_step.published, 0, (40.0,), SearchPlan(2, 100))
    assert two[:1] == one
    assert two[1].objective != two[0].objective


def test_a_solve_that_is_read_is_the_computed_one(one_step, tmp_path, monkeypatch):
    monkeypatch.setenv(memo.VARIABLE, str(tmp_path))
    computed = one_step.solve(40.0)
    monkeypatch.setattr(penalised_optimum, "solve_certified", None)
    read = one_step.solve(40.0)
    np.testing.assert_array_equal(read.theta, computed.theta)
    assert read.lower == computed.lower


@pytest.mark.long
def test_every_run_of_a_search_lies_above_the_bound(small_study):
    (table,) = build_tables(["global"], small_study)
    runs = search_table(small_study, table.frame)
    above = runs["above_bound_percent"].astype(float).dropna()
    assert above.min() >= -1e-6
    assert set(runs["search"]) == {"annealing", "local search"}


@pytest.mark.skipif(not RESULTS.is_dir(), reason="not a checkout: no results/")
def test_results_name_one_certified_optimum():
    """The opponent's is that of the table over weights, and every kept run lies as far above
    that table's bound as it says."""
    optima = pandas.read_csv(RESULTS / "global" / "table_global.csv")
    optima = optima.set_index(["data", "problem", "xi"])
    note = (RESULTS / "tables" / "table_opponent.md").read_text()
    match = re.search(r"consistent optimum, (\S+) \(gap (\S+)\)", note)
    assert match is not None
    optimum, gap = map(float, match.groups())
    assert gap <= 1e-5
    exact = optima.loc["measured", "two-step", 40.0]
    assert optimum == pytest.approx(exact["optimum"], rel=1e-4)
    runs = pandas.read_csv(RESULTS / "global" / "annealing_runs.csv")
    runs = runs.dropna(subset="above_bound_percent")
    bounds = optima["lower_bound"].loc[
        [*zip(runs.data, runs.problem, runs.xi, strict=True)]
    ]
    above = 100.0 * (runs["objective"].to_numpy() / bounds.to_numpy() - 1.0)
    np.testing.assert_allclose(runs["above_bound_percent"], above, atol=1e-3)
