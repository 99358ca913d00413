"""A load that the last link carries for a part of the time, beside a zero or a gain that
changes: told where it explains as much, and only there."""

from dataclasses import replace

import numpy as np
import pytest
from small_runs import small_run

from sdp_vs_penalty import Measurements, Problem
from sdp_vs_penalty.checks.constants import LEAST_RATIO_WITH_SIZE, PARTS
from sdp_vs_penalty.checks.issue import Issue
from sdp_vs_penalty.checks.likelihood import Likelihood
from sdp_vs_penalty.checks.one_arm import Difference, RunComparison
from sdp_vs_penalty.checks.passing_load import fit_passing_load
from sdp_vs_penalty.checks.regression_data import RegressionData
from sdp_vs_penalty.checks.rival_effects import is_clearly_worse
from sdp_vs_penalty.checks.run_log import RunLog

#: Of a load [kg, kg m, kg m^2]: half a kilogram near the flange.
LOAD = np.array([0.5, 0.02, 0.01, 0.03, 2e-3, 0.0, 2e-3, 0.0, 0.0, 2e-3])
#: A zero that changes [rad].
SHIFT = np.radians(6.0)


@pytest.fixture(scope="module")
def runs(panda: Problem) -> list[Measurements]:
    return [
        replace(small_run(panda, seconds=16.0, seed=seed), names=(name,), dq=None)
        for seed, name in enumerate(["first.csv", "second.csv"])
    ]


def with_load(problem: Problem, run: Measurements, begin: float, end: float):
    """The run with LOAD on the last link from ``begin`` to ``end`` [s]."""
    dq = np.gradient(run.q, run.t, axis=0)
    ddq = np.gradient(dq, run.t, axis=0)
    links = problem.nominal_links
    loaded = links.copy()
    loaded[-1] += LOAD
    torques = [
        problem.robot.inverse_dynamics(x.ravel(), run.q, dq, ddq)
        for x in (loaded, links)
    ]
    is_carried = (run.t >= begin) & (run.t < end)
    return replace(run, tau=run.tau + is_carried[:, None] * (torques[0] - torques[1]))


def with_zero(run: Measurements, joint: int) -> Measurements:
    """The run with another zero of a joint (from 0)."""
    q = run.q.copy()
    q[:, joint] += SHIFT
    return replace(run, q=q)


def with_gain(run: Measurements, joint: int) -> Measurements:
    """The run with nine tenths of a joint's torque (from 0)."""
    tau = run.tau.copy()
    tau[:, joint] *= 0.9
    return replace(run, tau=tau)


def compared(problem: Problem, runs: list[Measurements]) -> RunComparison:
    logs = []
    for run in runs:
        settings = problem.preprocessing.resolve(run)
        log = Likelihood(problem, RegressionData.of(problem, run, settings))
        logs.append(RunLog(log, log.as_logged, run.names[0]))
    return RunComparison(logs)


def told_of(comparison: RunComparison, kind: str, joint: int) -> Issue:
    """What is said of a gain or a zero of the first run (joint from 0)."""
    causes = [
        cause
        for cause in comparison.judge_numbers()
        if (cause.difference.kind, cause.difference.joint) == (kind, joint)
        and cause.difference.run == 0
    ]
    (cause,) = causes
    return comparison.issue(cause)


def test_the_stretch_and_the_parameters_of_a_load_are_found(panda, runs):
    """It is carried from the middle of the first run on: from part 4 of 8."""
    loaded = with_load(panda, runs[0], 8.0, 99.0)
    comparison = compared(panda, [loaded, runs[1]])
    load = fit_passing_load(comparison.runs, comparison.weights, None)
    assert load.what.startswith("a load on the last link in first.csv from t = 8.")
    assert "second" not in load.what
    assert load.errors.shape == (2 * PARTS, panda.robot.n)
    np.testing.assert_allclose(
        load.parameters.mean(axis=0)[:4], LOAD[:4], rtol=0.2, atol=0.01
    )


def test_a_load_of_both_runs_parts_is_told_run_by_run(panda, runs):
    """It is picked up in the first run, and put down in the second."""
    loaded = [with_load(panda, runs[0], 8.0, 99.0), with_load(panda, runs[1], 0.0, 4.0)]
    comparison = compared(panda, loaded)
    load = fit_passing_load(comparison.runs, comparison.weights, None)
    assert "in first.csv from t = 8." in load.what
    assert "and in second.csv until t = " in load.what


def test_parts_of_one_run_have_one_clock(panda, runs):
    loaded = with_load(panda, runs[0], 4.0, 12.0)
    (log,) = (run.log for run in compared(panda, [loaded]).runs)
    row = log.data.count // 2
    parts = [
        RunLog(log.select_rows(rows), log.as_logged, "part", is_part=True)
        for rows in (slice(row), slice(row, None))
    ]
    comparison = RunComparison(parts)
    load = fit_passing_load(comparison.runs, comparison.weights, None)
    assert load.what.startswith("a load on the last link from t = ")
    begin, end = (float(load.what.split(" t = ")[k].split()[0]) for k in (1, 2))
    assert begin == pytest.approx(4.0, abs=1.0)
    assert end == pytest.approx(12.0, abs=1.0)


@pytest.mark.parametrize("kind", ["encoder offset", "torque gain"])
def test_a_number_is_only_possible_where_a_load_explains_as_much(
    kind, panda, runs, monkeypatch
):
    """Half a kilogram is picked up; whatever joint's number is told of it."""
    loaded = with_load(panda, runs[0], 8.0, 99.0)
    comparison = compared(panda, [loaded, runs[1]])
    monkeypatch.setattr(RunComparison, "_determined_size", lambda *_: SHIFT)
    issue = told_of(comparison, kind, 5)
    assert issue.certainty.grade == "possible"
    assert "It may be instead: a load on the last link in first.csv" in issue.what
    assert issue.figures["rival_effects"] == [*issue.equivalents]


def test_a_zero_before_the_last_joint_stays_likely(panda, runs):
    comparison = compared(panda, [with_zero(runs[0], 3), runs[1]])
    issue = told_of(comparison, "encoder offset", 3)
    assert issue.certainty.grade == "likely"
    assert issue.equivalents == ()


def test_a_gain_before_the_last_joint_stays_likely(panda, runs):
    comparison = compared(panda, [with_gain(runs[0], 3), runs[1]])
    assert told_of(comparison, "torque gain", 3).certainty.grade == "likely"


def test_what_is_no_gain_and_no_zero_has_no_load_as_its_rival(panda, runs):
    comparison = compared(panda, [with_load(panda, runs[0], 0.0, 99.0), runs[1]])
    cause = comparison.judge(Difference(run=0, kind="another arm"))
    assert cause is not None
    assert comparison.effects_as_likely(cause) == []


@pytest.mark.parametrize(
    ("factor", "scatter", "expected"),
    [
        (2.0 * LEAST_RATIO_WITH_SIZE, 0.1, True),
        (0.9 * LEAST_RATIO_WITH_SIZE, 0.1, False),  # not by much
        (2.0 * LEAST_RATIO_WITH_SIZE, 5.0, False),  # not in most parts
    ],
)
def test_clearly_worse_is_by_much_and_in_most_parts(factor, scatter, expected):
    """Of one joint that moves, beside one that does not."""
    rng = np.random.default_rng(0)
    than = np.exp(rng.normal(size=(2, PARTS, 2)))
    errors = factor * than * np.exp(scatter * rng.normal(size=than.shape))
    errors[..., 0] *= factor * than[..., 0].sum() / errors[..., 0].sum()
    errors[..., 1] = 1e9 * than[..., 1]
    moving = np.array([[True, False], [True, False]])
    assert is_clearly_worse(errors, than, moving) is expected
