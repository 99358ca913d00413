"""A joint that rests is held by any torque between two limits: it is no evidence against a file."""

from dataclasses import replace

import numpy as np
import pytest

from sdp_vs_penalty import Measurements, Problem, check, load_problem
from tests.helpers.arms import THREE, write_urdf

RATE, SECONDS, MOVES = 250, 40.0, 12
COULOMB, VISCOUS = np.array([4.0, 5.0, 2.0]), np.array([1.0, 2.0, 0.5])
NOISE = 0.02  # N m


@pytest.fixture(scope="module")
def stopping(tmp_path_factory: pytest.TempPathFactory) -> tuple[Problem, Measurements]:
    """From point to point with pauses, one joint after the other started and stopped at its own time;
    at each stop the controller's integrator leaves another torque within Coulomb's limits."""
    problem = load_problem(write_urdf(tmp_path_factory.mktemp("arm") / "arm.urdf", "stops", THREE))
    rng = np.random.default_rng(3)
    t = np.arange(0.0, SECONDS, 1.0 / RATE)
    q, held = np.zeros((2, len(t), 3))
    for j in range(3):
        place = 0.0
        for k in range(MOVES):
            start = SECONDS * (k + 0.2 + 0.1 * rng.uniform()) / MOVES
            length = SECONDS / MOVES * rng.uniform(0.35, 0.6)
            u = np.clip((t - start) / length, 0.0, 1.0)
            aim = rng.uniform(-1.5, 1.5)
            q[:, j] += (aim - place) * u**3 * (10.0 - 15.0 * u + 6.0 * u**2)
            held[t > start + length, j] = rng.uniform(-1.0, 1.0)
            place = aim
    dq, ddq = (np.gradient(np.gradient(q, t, axis=0) if k else q, t, axis=0) for k in (0, 1))
    rests = np.abs(dq) < 1e-9
    dry = np.where(rests, held, np.sign(dq))
    rigid = problem.robot.inverse_dynamics(problem.nominal_links.ravel(), q, dq, ddq)
    tau = rigid + VISCOUS * dq + COULOMB * dry + NOISE * rng.normal(size=q.shape)
    return problem, Measurements(t, q + 1e-6 * rng.normal(size=q.shape), tau)


def test_no_cause_is_named_of_a_clean_log_whose_joints_stick(stopping):
    (report,) = check(*stopping, thorough=False)
    assert [f"{f.kind} ({f.where})" for f in report.problems] == []


@pytest.mark.parametrize("factor", [1.3, 0.75])
def test_a_gain_is_named_beside_joints_that_stick(stopping, factor):
    problem, run = stopping
    scaled = replace(run, tau=run.tau * np.array([1.0, factor, 1.0]))
    (report,) = check(problem, scaled, thorough=False)
    found = [f for f in report.problems if f.kind == "torque gain"]
    assert [f.where for f in found] == ["joint 2"]
    assert found[0].figures["factor"] == pytest.approx(1.0 / factor, rel=0.05)


def test_a_drift_is_named_beside_joints_that_stick(stopping):
    problem, run = stopping
    drifted = run.tau + np.array([0.0, 0.0, 1.0]) * (run.t / run.t[-1])[:, None]
    (report,) = check(problem, replace(run, tau=drifted), thorough=False)
    assert ("torque drift", "joint 3") in [(f.kind, f.where) for f in report.problems]
