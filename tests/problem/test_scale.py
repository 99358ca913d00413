"""Arms of any size: the lower bounds of masses fit the links, and an arm ten times
larger or smaller gets the same verdict and the same relative error."""

from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from arms import Axis, write_urdf

import sdp_vs_penalty as sdp
from sdp_vs_penalty.effects import Motion

BASE = (
    Axis("revolute", "0 0 1", "0 0 0.3", 0.5, "0.02 0.01 0.1"),
    Axis("revolute", "0 1 0", "0 0 0.2", 0.4, "0.2 0.01 0.02"),
    Axis("revolute", "0 1 0", "0.4 0 0", 0.2, "0.15 0.01 0.01"),
)


def scaled(axis: Axis, length: float) -> Axis:
    """Of one material: masses go with the cube, moments with the fifth power."""
    places = [
        [length * float(word) for word in str(x).split()]
        for x in (axis.origin, axis.com)
    ]
    ball = 0.4 * axis.mass * 0.08**2 * length**5
    moments = [ball, 0.0, ball, 0.0, 0.0, ball]
    return replace(
        axis,
        origin=places[0],
        com=places[1],
        mass=axis.mass * length**3,
        moments=moments,
    )


def run_of(problem: sdp.Problem, seed: int) -> sdp.Measurements:
    """Twenty seconds with friction of 1 % of a usual torque and noise of .3 % of it."""
    rng = np.random.default_rng(seed)
    n = problem.robot.n
    t = np.arange(0.0, 20.0, 0.01)
    q, dq, ddq = np.zeros((3, len(t), n))
    for frequency in (0.1, 0.2, 0.3, 0.5, 0.7):
        w = 2.0 * np.pi * frequency
        phase = rng.uniform(-3.0, 3.0, n)
        a = rng.uniform(0.1, 0.4, n)
        q += a * np.sin(w * t[:, None] + phase)
        dq += a * w * np.cos(w * t[:, None] + phase)
        ddq -= a * w**2 * np.sin(w * t[:, None] + phase)
    model = problem.model()
    theta = problem.nominal(model)
    states = problem.robot.random_states
    size = problem.robot.inverse_dynamics(problem.nominal_links, *states).std(axis=0)
    names = [p.name for p in model.parameters[len(model.rigid_indices) :]]
    theta[len(model.rigid_indices) :] = [0.01 * size[int(x[-1]) - 1] for x in names]
    tau = model.torque(theta, Motion(t, q, dq, ddq))
    tau += 0.003 * np.sqrt(np.mean(tau**2, axis=0)) * rng.normal(size=tau.shape)
    return sdp.Measurements(t, q, tau)


@cache
def judged(length: float) -> tuple[str, float, np.ndarray]:
    """The verdict on another run, its relative error, and masses over the true ones."""
    with TemporaryDirectory() as folder:
        axes = [scaled(axis, length) for axis in BASE]
        problem = sdp.load_problem(write_urdf(Path(folder) / "arm.urdf", "arm", axes))
        estimate = sdp.identify(problem, run_of(problem, 1), check=False)
        found = sdp.compare(estimate, run_of(problem, 2))[0]
    masses = estimate.links[:, 0] / problem.nominal_links[:, 0]
    return str(found.verdict).partition(".")[0], found.relative_error_percent, masses


@pytest.mark.parametrize("length", [0.1, 1.0, 10.0])
def test_the_verdict_does_not_depend_on_the_size(length):
    assert judged(length)[0] == "Good"


@pytest.mark.parametrize("length", [0.1, 10.0])
def test_the_relative_error_does_not_depend_on_the_size(length):
    assert judged(length)[1] == pytest.approx(judged(1.0)[1], rel=0.05)


@pytest.mark.parametrize("length", [0.1, 1.0, 10.0])
def test_masses_are_right_at_any_size(length):
    np.testing.assert_allclose(judged(length)[2], 1.0, atol=0.03)


def test_light_links_may_be_lighter_than_ten_grams(tmp_path):
    axes = [
        replace(axis, mass=m) for axis, m in zip(BASE, (3e-3, 0.02, 5.0), strict=True)
    ]
    problem = sdp.load_problem(write_urdf(tmp_path / "arm.urdf", "arm", axes))
    np.testing.assert_allclose(problem.box[:, 0, 0], [1e-3, 0.02 / 3.0, 0.01])
