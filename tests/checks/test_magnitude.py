"""A torque of one sign is a magnitude only where the motion contradicts it."""

from dataclasses import replace

import numpy as np
import pytest
from small_runs import small_run

from sdp_vs_penalty import load_problem
from sdp_vs_penalty.checks.facts.magnitude import magnitudes
from sdp_vs_penalty.checks.glance import RunSummary
from sdp_vs_penalty.effects import Motion
from sdp_vs_penalty.race.evidence import without_inertial_power

PROBLEM = load_problem("two_link")
RUN = small_run(PROBLEM, seconds=8.0)


def run_with(offset):
    """A run of the nominal arm with friction, and with an offset of joint 2 [N m]."""
    model = PROBLEM.model()
    theta = PROBLEM.nominal(model)
    theta[len(model.rigid_indices) :] = 0.5
    ddq = np.gradient(RUN.dq, RUN.t, axis=0)
    tau = model.torque(theta, Motion(RUN.t, RUN.q, RUN.dq, ddq))
    tau += 0.02 * np.random.default_rng(4).normal(size=tau.shape)
    tau[:, 1] += offset
    return replace(RUN, tau=tau)


def test_a_torque_without_its_sign_contradicts_the_arm():
    run = run_with(-float(run_with(0.0).tau[:, 1].mean()))
    assert run.tau[:, 1].min() < 0.0 < run.tau[:, 1].max()
    logged = replace(run, tau=np.abs(run.tau))
    assert magnitudes(RunSummary(logged, PROBLEM), np.array([1])) == [1]


@pytest.mark.parametrize("above_zero", [0.0, 0.5])
def test_a_torque_that_has_one_sign_by_itself_is_no_magnitude(above_zero):
    """Also where it comes down to zero, as weight and friction may make it."""
    lowest = run_with(0.0).tau[:, 1].min()
    logged = run_with(above_zero - lowest)
    assert magnitudes(RunSummary(logged, PROBLEM), np.array([1])) == []


def test_inertia_takes_no_mean_power_in_few_rows_of_a_trapezoid():
    """Rows miss the short ends of its accelerations."""
    t = np.arange(0.0, 12.0, 0.23)
    phase = t % 4.0
    acceleration = np.where(phase < 0.3, 4.0, np.where(phase > 3.7, -4.0, 0.0))
    velocity = np.clip(4.0 * np.minimum(phase, 4.0 - phase), 0.0, 1.2)
    states = np.stack([velocity[None], acceleration[None]])
    states -= states.mean(axis=2, keepdims=True)
    left = without_inertial_power(*states)
    assert abs(states[0] @ acceleration).max() > 1.0
    np.testing.assert_allclose(left @ acceleration, 0.0, atol=1e-9)
