"""What differs between two parts of one run: told where both parts tell of a joint, and
where friction that the model lacks does not explain it."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d

from sdp_vs_penalty.checks import check, explain
from sdp_vs_penalty.race import Hypothesis, Part
from sdp_vs_penalty.race.chain import LogTransform
from sdp_vs_penalty.simulation import experiment

#: Factor of the torque of joint 1 in the second half.
GAIN = 0.5


@pytest.fixture(scope="module")
def run(two_link):
    return experiment(two_link).training_run(0)


def told(problem, run):
    (report,) = check(problem, run, thorough=False)
    return [
        issue.what for issue in report.issues if issue.kind == "change within the run"
    ]


def late_half(run):
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


def test_a_rival_of_no_joint_in_a_part_has_words():
    transform = LogTransform.unchanged(2, (0.0, 0.0, -9.81))
    push = Hypothesis(
        "passing force", (), -20.0, transform, part=Part(None, 10.9, 11.4)
    )
    rival = SimpleNamespace(hypothesis=push)
    said = explain._of_rival(None, rival, 0.3, ()).what
    assert said == "passing force in a part of the log"
