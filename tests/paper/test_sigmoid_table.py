"""Table I's sigmoid friction: recovered exactly, with honest intervals."""

import numpy as np
import pytest

from sdp_vs_penalty import InputError, Problem
from sdp_vs_penalty.effects import Motion
from sdp_vs_penalty.paper.sigmoid_friction import exact_rows, fit_sigmoid
from sdp_vs_penalty.simulation import Experiment, experiment


@pytest.fixture(scope="module")
def x(panda: Problem) -> Experiment:
    return experiment(panda)


def sampled(x: Experiment, step: float) -> tuple[Motion, np.ndarray]:
    t = np.arange(0.0, x.trajectory.duration, step)
    motion = Motion(t, *x.trajectory.states(t))
    return motion, np.sum([source(motion) for source in x.sources], axis=0)


def test_without_noise_table_one_is_recovered(panda, x):
    fit = fit_sigmoid(panda, exact_rows(*sampled(x, 0.05)))
    assert np.abs(fit.phi / x.friction - 1.0).max() < 1e-6
    assert fit.rmse.max() < 1e-9


def test_intervals_cover_the_truth_at_their_nominal_rate(panda, x):
    motion, torque = sampled(x, 0.1)
    fits = []
    for seed in range(20):
        noise = np.random.default_rng(seed).normal(size=torque.shape) * 0.3 * x.sensor.torque_std
        fits.append(fit_sigmoid(panda, exact_rows(motion, torque + noise)))
    assert x.friction is not None
    inside = [(fit.lower <= x.friction) & (x.friction <= fit.upper) for fit in fits]
    share = np.mean(inside, axis=(0, 1))
    # 140 intervals a parameter: four standard deviations of a count at 95 % are 7.4 %.
    assert np.all(share > 0.95 - 0.074)
    # Not by being too wide: at 50 % confidence they must miss as often as they hold.
    narrow = []
    for fit in fits:
        inside = np.abs(fit.phi - x.friction) < 0.6745 * fit.std
        narrow.append(inside.mean(axis=0))
    assert np.all(np.abs(np.mean(narrow, axis=0) - 0.5) < 0.17)


def test_too_few_samples_are_refused(panda, x):
    motion, torque = sampled(x, 1.0)
    with pytest.raises(InputError, match="Too few samples"):
        fit_sigmoid(panda, exact_rows(motion, torque))
