"""What friction that sticks does to a diagnosis: nothing."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from sdp_vs_penalty import add, compare, diagnose, identify, simulate
from sdp_vs_penalty.data import Measurements
from sdp_vs_penalty.diagnosis import diagnosis_rows, whiten_rows
from sdp_vs_penalty.diagnosis.sliding import holding, where_joints_slide
from sdp_vs_penalty.simulation import HiddenRuns


def sticking(run: Measurements, rng: np.random.Generator) -> Measurements:
    """A run in which dry friction holds another torque at each reversal."""
    dq = np.gradient(run.q, run.t, axis=0)
    tau = run.tau.copy()
    for j in range(tau.shape[1]):
        slow = np.abs(dq[:, j]) < 0.1 * dq[:, j].std()
        ends = np.flatnonzero(np.diff(slow.astype(int), prepend=0, append=0))
        for start, stop in zip(ends[::2], ends[1::2], strict=True):
            tau[start:stop, j] += 0.3 * run.tau[:, j].std() * rng.uniform(-1.0, 1.0)
    return replace(run, tau=tau)


@pytest.fixture(scope="module")
def spring() -> HiddenRuns:
    return simulate("two_link", hide="joint_spring:1", seed=1)


@pytest.fixture(scope="module")
def stuck(spring: HiddenRuns) -> dict[str, Any]:
    rng = np.random.default_rng(0)
    train = sticking(spring.train[0], rng)
    test = sticking(spring.test, rng)
    model = identify("two_link", train, check=False)
    found = diagnose(model, train, test, check=False)
    return {"train": train, "test": test, "model": model, "found": found}


def test_a_spring_is_sure_where_friction_sticks_at_reversals(spring, stuck):
    (finding,) = stuck["found"].effects
    assert (finding.effect, finding.rating) == ("joint_spring", "confident")
    assert abs(finding.size - spring.hidden[0].size) < finding.half_width_95


def test_add_fits_what_slides(stuck):
    found = stuck["found"]
    # Joint 1 has the spring; of joint 2, which has no finding, all rows are alike.
    assert found.turning_weights[0] < 0.5
    assert found.turning_weights[1] == 1.0
    better = add(stuck["model"], found, stuck["train"])
    before, after = compare([stuck["model"], better], stuck["test"])
    assert after.errors_sliding.rmse[0] < 0.5 * before.errors_sliding.rmse[0]


def test_rows_in_which_a_joint_turns_round_say_nothing(stuck):
    model = stuck["model"]
    rows = diagnosis_rows(stuck["train"], model, model.preprocessing)
    data = whiten_rows(rows, model)
    sliding = where_joints_slide(data)
    slides = rows.slides.T
    assert np.abs(sliding.y[~slides]).max() < 0.1
    assert np.all(sliding.count < data.count)
    as_before = holding(sliding, data.noise.held)
    np.testing.assert_allclose(as_before.y, data.y, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(as_before.X, data.X, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(as_before.count, data.count)
