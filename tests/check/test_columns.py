"""What is had without asking the arm again is what asking it would give."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sdp_vs_penalty.check.channels import _LATE, _lead
from sdp_vs_penalty.check.columns import independent_of
from sdp_vs_penalty.check.hypothesis import all_fitted, best_numbers
from sdp_vs_penalty.check.motion import at_zeros
from sdp_vs_penalty.check.physics import Physics, settled
from sdp_vs_penalty.check.rows import physics_of
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.problem.load import load_problem
from tests.helpers.arms import SCARA, THREE, Axis, write_urdf


@pytest.fixture(scope="module", params=[THREE, SCARA], ids=["three", "scara"])
def physics(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Physics:
    """A smooth motion of an arm, its torque that of the nominal links with friction."""
    axes: tuple[Axis, ...] = request.param
    problem = load_problem(write_urdf(tmp_path_factory.mktemp("arm") / "arm.urdf", "arm", axes))
    rng, n = np.random.default_rng(0), len(axes)
    t = np.arange(0.0, 12.0, 0.004)
    omega, phase = rng.uniform(1.0, 4.0, n), rng.uniform(0.0, 6.0, n)
    size = 0.3
    q, dq = size * np.sin(omega * t[:, None] + phase), size * omega * np.cos(omega * t[:, None] + phase)
    ddq = -size * omega**2 * np.sin(omega * t[:, None] + phase)
    tau = problem.robot.inverse_dynamics(problem.nominal_links.ravel(), q, dq, ddq)
    tau += 0.5 * dq + 0.3 * np.tanh(dq / 0.01) + 0.01 * rng.normal(size=q.shape)
    run = Measurements(t, q, tau)
    return physics_of(problem, run, problem.preprocessing.resolve(run), 150)


def same(found: Physics, direct: Physics) -> None:
    direct.__dict__.pop("acting", None)
    for a, b in zip(found.acting, direct.acting, strict=True):
        np.testing.assert_array_equal(a.indices, b.indices)
        np.testing.assert_allclose(a.columns, b.columns, atol=1e-10 * np.abs(b.columns).max())


@pytest.mark.parametrize("shift", [-1.3, 0.4])
def test_columns_at_another_zero(physics: Physics, shift: float) -> None:
    one, order = np.ones(physics.n), np.arange(physics.n)
    for j in range(physics.n):
        direct = replace(physics.with_motion(one, order, shift * np.eye(physics.n)[j]))
        same(at_zeros(physics, j)(shift), direct)


def test_columns_by_another_clock_and_under_another_gravity(physics: Physics) -> None:
    same(physics.with_clock(1.7), replace(physics.with_clock(1.7)))
    vector = (1.0, -4.0, 8.0)
    direct = replace(physics.with_gravity(vector))
    assert len(physics.by_gravity) == 4
    same(physics.with_gravity(vector), direct)


def test_independent_columns_explain_what_all_explain(physics: Physics) -> None:
    every = replace(physics, independent=None)
    np.testing.assert_allclose(physics.evidence.shares, every.evidence.shares, rtol=1e-3)
    kept, nominal = independent_of(physics.model, np.arange(float(len(physics.model.parameters))))
    assert kept[nominal != 0.0].all()
    links = physics.model.rigid_indices
    states = physics.motion.q, physics.motion.dq, physics.motion.ddq
    regressor = physics.model.robot.regressor(*states)
    np.testing.assert_allclose(regressor @ nominal[links], regressor @ links, rtol=1e-8, atol=1e-8)


def test_side_by_side_is_one_after_the_other(physics: Physics) -> None:
    numbers = [_lead(np.eye(physics.n)[j], 2) for j in range(physics.n)]
    for together, number in zip(all_fitted(numbers, physics, _LATE), numbers, strict=True):
        assert together.value == pytest.approx(number.fitted(physics, _LATE).value, abs=1e-7)
    moved = [physics.with_lead(x * np.ones(physics.n)) for x in (0.0, 0.01, 0.02)]
    scores = [e.score for e in settled(moved)]
    alone = [replace(p).evidence.score for p in moved]
    np.testing.assert_allclose(scores, alone, rtol=1e-9)


def test_searches_side_by_side_find_their_own_minima() -> None:
    aims = (0.3, -1.2, 2.0)

    def scores(asked: list[tuple[int, float]]) -> list[float]:
        return [float(np.log((x - aims[k]) ** 2 + 1e-3)) for k, x in asked]

    found = best_numbers(scores, [np.linspace(-3.0, 3.0, 7).tolist()] * 3, 20)
    np.testing.assert_allclose(found, aims, atol=0.05)
