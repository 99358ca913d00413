"""Where torque changes fast, being late makes errors; they are as large as it says."""

from types import SimpleNamespace

import numpy as np

from sdp_vs_penalty.signals.kernels import Decimator, Kernel
from sdp_vs_penalty.signals.timing import largest_timing_errors, torque_rates

M = 2400
#: Rows of half a second each.
STRETCHES = np.array_split(np.arange(M), 120)


def late_torque(seed):
    """Errors and rates of a torque that is 2 ms late RMS at 60 corners, in noise."""
    rng = np.random.default_rng(seed)
    rates = np.full(M, 1.0)
    corners = [rows[10] for rows in STRETCHES[::2]]
    rates[corners] = rng.uniform(100.0, 1000.0, 60)
    late = 2e-3 * rng.normal(size=M)
    return late * rates + 0.1 * rng.normal(size=M), rates


def test_the_limit_is_three_times_the_scatter_of_lateness():
    """3.29 standard deviations hold all but 0.001; 60 corners tell one within 20 %."""
    for seed in range(5):
        errors, rates = late_torque(seed)
        limits = largest_timing_errors(errors, rates, STRETCHES)
        np.testing.assert_allclose(limits / rates, 3.29 * 2e-3, rtol=0.35)


def test_errors_that_do_not_grow_with_the_rate_give_no_limit():
    """A push where the torque changes slowly says nothing of lateness."""
    _, rates = late_torque(0)
    errors = np.full(M, 0.1)
    errors[300:320] += 2.0
    limits = largest_timing_errors(errors, rates, STRETCHES)
    assert limits.max() < 0.01


def test_one_stretch_gives_no_limit():
    errors, rates = late_torque(0)
    assert not largest_timing_errors(errors, rates, [np.arange(M), np.arange(0)]).any()


def test_a_late_sample_errs_no_more_than_its_rate_says():
    """A torque that jumps, read up to half a sample late, low-passed."""
    dt = 5e-3
    cutoff = 10.0
    t = dt * np.arange(2000)
    torque = 20.0 * np.tanh((t - 5.0) / 0.02) + 3.0 * np.sin(2.0 * t)
    late = 0.5 * dt * np.random.default_rng(0).uniform(-1.0, 1.0, len(t))
    error = np.interp(t - late, t, torque) - torque
    kernel = Kernel(cutoff, dt)
    rows = np.arange(kernel.half, len(t) - kernel.half, 5)
    low_pass = Decimator(kernel, rows)
    motion = SimpleNamespace(t=t, modelled=torque[:, None])
    segment = SimpleNamespace(motion=motion, low_pass=low_pass)
    runs = SimpleNamespace(segments=[segment], cutoff=cutoff, rate=1.0 / (5.0 * dt))
    rates = torque_rates(runs)
    assert rates.shape == (len(rows), 1)
    assert (np.abs(low_pass @ error[:, None]) <= 0.5 * dt * rates).all()
    # What is far from the jump does not feel it.
    is_far = np.abs(t[rows] - 5.0) > 1.0
    assert rates[is_far].max() < 0.02 * rates.max()
