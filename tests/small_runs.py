"""Small simulated measurements as files, for tests of readers and of the command line."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from sdp_vs_penalty.effects.effect import Motion
from sdp_vs_penalty.measurements import Measurements, save_csv
from sdp_vs_penalty.problem import Problem


def small_run(
    problem: Problem, seconds: float = 6.0, seed: int = 0, rate: float = 100.0
) -> Measurements:
    """A run of sums of sines by the problem's nominal robot with some friction and noise."""
    rng = np.random.default_rng(seed)
    n = problem.robot.n
    t = np.arange(0.0, seconds, 1.0 / rate)
    q, dq, ddq = (np.zeros((len(t), n)) for _ in range(3))
    for frequency in (0.3, 0.5, 0.8):
        amplitude, phase = rng.uniform(0.1, 0.3, n), rng.uniform(-np.pi, np.pi, n)
        w = 2.0 * np.pi * frequency
        q += amplitude * np.sin(w * t[:, None] + phase)
        dq += amplitude * w * np.cos(w * t[:, None] + phase)
        ddq -= amplitude * w**2 * np.sin(w * t[:, None] + phase)
    model = problem.model()
    theta = problem.nominal(model)
    theta[len(model.rigid_indices) :] = 0.5
    tau = model.torque(theta, Motion(t, q, dq, ddq))
    return Measurements(t, q, tau + 0.05 * rng.normal(size=tau.shape), dq)


def write_run(path: Path, problem: Problem, seconds: float = 6.0, seed: int = 0) -> Path:
    save_csv(small_run(problem, seconds, seed), path)
    return path
