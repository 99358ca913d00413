"""What differs between two parts of one run: told where both parts tell of a joint, and
where friction that the model lacks does not explain it."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d

from sdp_vs_penalty import Measurements, Problem
from sdp_vs_penalty.checks.constants import REQUIRED_SIGMAS
from sdp_vs_penalty.checks.likelihood import Likelihood
from sdp_vs_penalty.checks.one_arm import Cause, Difference, RunComparison, two_arms
from sdp_vs_penalty.checks.regression_data import RegressionData
from sdp_vs_penalty.checks.run_log import RunLog
from sdp_vs_penalty.simulation import experiment

#: Factor of the torque of joint 1 in the second half.
GAIN = 0.5


@pytest.fixture(scope="module")
def run(two_link: Problem) -> Measurements:
    return experiment(two_link).training_run(0)


def log_of(problem: Problem, run: Measurements) -> Likelihood:
    settings = problem.preprocessing.resolve(run)
    return Likelihood(problem, RegressionData.of(problem, run, settings))


def told(problem: Problem, run: Measurements) -> list[str]:
    log = log_of(problem, run)
    return [issue.what for issue in two_arms(log, log.as_logged)]


def late_half(run: Measurements) -> np.ndarray:
    """Which rows (N,) are in the second half."""
    return np.arange(len(run.t)) >= len(run.t) // 2


def test_a_gain_of_one_part_is_told(two_link, run):
    """It scales all that the channel measures."""
    tau = run.tau.copy()
    tau[late_half(run), 0] *= GAIN
    (what,) = told(two_link, replace(run, tau=tau))
    assert "the torque of joint 1 is" in what


def test_no_gain_is_told_where_friction_stays_as_it_is(two_link, run):
    """Dry friction as large as the arm's torque, which alone is halved."""
    speed = gaussian_filter1d(np.gradient(run.q[:, 0], run.t), 10.0)
    friction = np.abs(run.tau[:, 0]).max() * np.tanh(speed / 0.1)
    tau = run.tau.copy()
    tau[late_half(run), 0] *= GAIN
    tau[:, 0] += friction
    assert told(two_link, replace(run, tau=tau)) == []


def test_a_part_in_which_a_joint_hardly_moves_tells_nothing_of_it(two_link, run):
    """Joint 2 rests but for a short time at the end of the second half."""
    q = run.q.copy()
    n = len(run.t)
    q[n // 2 : n - n // 30, 1] = q[n // 2, 1]
    q[n - n // 30 :, 1] += q[n // 2, 1] - q[n - n // 30, 1]
    log = log_of(two_link, replace(run, q=q, dq=None))
    row = log.data.count // 2
    parts = [
        RunLog(log.select_rows(rows), log.as_logged, "part")
        for rows in (slice(row), slice(row, None))
    ]
    assert parts[1].log.moving[1]
    assert parts[1].log.torque_mask(log.as_logged)[1].any()
    comparison = RunComparison(parts)
    np.testing.assert_array_equal(comparison.moving, [[True, True], [True, False]])
    of_joint_2 = {
        cause.difference.kind
        for cause in comparison.judge_numbers()
        if cause.difference.joint == 1
    }
    assert of_joint_2 <= {"another load"}


@pytest.mark.parametrize(("fall", "is_claimed"), [(2.1, True), (1.9, False)])
def test_a_number_explains_as_much_as_another_arm_would(
    fall, is_claimed, two_link, run, monkeypatch
):
    """That of another arm is 2; what friction leaves is less."""
    log = log_of(two_link, run)
    row = log.data.count // 2
    parts = [
        RunLog(log.select_rows(rows), log.as_logged, "part")
        for rows in (slice(row), slice(row, None))
    ]
    comparison = RunComparison(parts)
    monkeypatch.setattr(comparison, "judge", lambda x: Cause(x, 2.0, 9.0))
    load = Difference(run=0, kind="another load", columns=np.ones((2, 1, 10)))
    is_as_good = comparison.explains_as_another_arm(Cause(load, fall, 9.0, 2.0))
    assert is_as_good is is_claimed


def test_evidence_is_kept_as_it_is_and_weighed_apart(two_link, run):
    """Another arm explains much with its many parameters; a number's interval speaks for
    it as well."""
    arm = Cause(Difference(run=0, kind="another arm"), 6.0, 3.0)
    gain = Difference(run=0, kind="torque gain", columns=np.ones((2, 1, 1)))
    number = Cause(gain, 6.0, 3.0, 0.2)
    as_logged = log_of(two_link, run).as_logged
    fault = Cause(Difference(run=0, kind="torque sign", repair=as_logged), 6.0, 3.0)
    assert [x.score for x in (arm, number, fault)] == [3.0, 6.0, 6.0]
    assert arm.required_sigmas == fault.required_sigmas == REQUIRED_SIGMAS
    assert number.required_sigmas == 0.5 * REQUIRED_SIGMAS
