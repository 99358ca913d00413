"""What every transformation promises: on rows it does what it does to a log, and says it once."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from small_runs import small_run

from sdp_vs_penalty import check, load_problem
from sdp_vs_penalty.checks.likelihood import Likelihood
from sdp_vs_penalty.checks.regression_data import RegressionData
from sdp_vs_penalty.checks.repair import Repair
from sdp_vs_penalty.checks.transformations import TRANSFORMATIONS, Scene

PROBLEM = load_problem("two_link")
RUN = replace(small_run(PROBLEM, seconds=8.0), dq=None)
NONE = Repair.none(2, PROBLEM.robot.gravity)
REPAIRS = {
    "zero": NONE.with_entry("zero", 0, 0.3),
    "position sign": NONE.with_entry("scale", 1, -1.0),
    "order": NONE.with_swap(0, 1, positions=True, torques=True),
    "gain": NONE.with_entry("gain", 1, -2.0),
    "delay": NONE.with_entry("lead", 0, 0.03),
    "clock": replace(NONE, rate=1.5),
}


def scene(run) -> Scene:  # type: ignore[no-untyped-def]
    data = RegressionData.of(PROBLEM, run, PROBLEM.preprocessing.resolve(RUN), 200)
    return Scene(PROBLEM, Likelihood(data.few(100)), Likelihood(data))


@pytest.mark.parametrize("name", REPAIRS)
def test_rows_are_those_of_the_repaired_log(name: str) -> None:
    """The likelihood's short way against the log repaired and filtered anew: the same share is left."""
    (fast,) = scene(RUN).judged.scores([REPAIRS[name]])
    (slow,) = scene(REPAIRS[name].apply(RUN)).judged.scores([NONE])
    np.testing.assert_allclose(np.sqrt(fast.shares), np.sqrt(slow.shares), rtol=0.15, atol=0.004)


def test_every_proposal_is_told_and_can_be_taken_back() -> None:
    """Each thing that a repair does is an element, whose removal leads back to the log as it is."""
    here = scene(replace(RUN, tau=RUN.tau * np.array([1.0, -3.0])))
    (score,) = here.tried.scores([NONE])
    for transformation in TRANSFORMATIONS:
        for repair in transformation.proposals(here, NONE, score):
            now = repair
            for _ in range(4):
                elements = [e for t in TRANSFORMATIONS for e in t.elements(here, now)]
                now = elements[0].without if elements else now
            assert now == NONE, (type(transformation).__name__, repair)


@pytest.mark.parametrize("seed", range(4))
def test_two_mistakes_are_never_told_against_each_other(seed: int) -> None:
    """Of each kind a joint is named once, and the mended log has nothing left to mend."""
    rng = np.random.default_rng(seed)
    tau = RUN.tau * np.array([1.0, rng.choice([-1.0, 2.5])])
    q = RUN.q + np.array([0.0, rng.choice([0.5 * np.pi, -0.4])])
    (report,) = check(PROBLEM, replace(RUN, q=q, tau=tau), thorough=False)
    told = [(f.kind, f.where) for f in report.problems]
    assert len(told) == len(set(told))
    (again,) = check(PROBLEM, report.mended, thorough=False)
    assert not [f for f in again.problems if f.severity == "error"]


def test_a_load_in_one_of_two_runs_is_named_with_the_run() -> None:
    first, second = small_run(PROBLEM, seconds=8.0), small_run(PROBLEM, seconds=8.0)
    from sdp_vs_penalty.data import concatenate

    reports = check(PROBLEM, concatenate([first, replace(second, names=("b",))]), thorough=False)
    assert not [f for r in reports for f in r.problems]
    other = replace(second, tau=second.tau * np.array([1.0, 1.3]))
    reports = check(PROBLEM, concatenate([first, replace(other, names=("b",))]), thorough=False)
    assert [f.kind for r in reports for f in r.problems]
