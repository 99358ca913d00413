"""Noise, events and hums against brute force and against their own promises."""

import numpy as np
import pytest
from challenge.judge import wilson
from numpy.typing import NDArray

from sdp_vs_penalty.diagnosis.events import spectral_lines
from sdp_vs_penalty.signals.autoregression import autoregression
from sdp_vs_penalty.signals.outliers import local_excess, lone_windows, noise_profile

Array = NDArray[np.float64]


def test_autoregression_whitens():
    rng = np.random.default_rng(7)
    x = np.zeros(4000)
    for k in range(2, len(x)):
        x[k] = 0.6 * x[k - 1] - 0.3 * x[k - 2] + rng.normal()
    a, sigma, degrees = autoregression(x, [np.arange(2000), np.arange(2000, 4000)])
    np.testing.assert_allclose(a, [0.6, -0.3, 0.0, 0.0], atol=0.06)
    assert sigma == pytest.approx(1.0, abs=0.04)
    assert degrees == 3988.0


def test_events_are_found_and_noise_is_left_alone():
    rng = np.random.default_rng(8)
    pieces = [np.arange(500), np.arange(500, 1000)]
    false = sum(local_excess(rng.normal(size=1000), pieces, 1, 1000.0).any() for _ in range(200))
    assert false <= 3
    x = rng.normal(size=1000)
    x[700:708] += 4.0
    found = local_excess(x, pieces, 1, 1000.0)
    assert found[700:708].mean() > 0.7
    assert found[:650].sum() == found[760:].sum() == 0


def test_noise_that_follows_a_rate_is_no_event():
    rng = np.random.default_rng(9)
    t = np.arange(1000) / 16.0
    rates = np.column_stack([np.sin(0.5 * t), np.cos(0.3 * t)]) ** 2
    spread = np.sqrt(0.3 + 3.0 * rates[:, 0])
    profile = noise_profile(spread * rng.normal(size=1000), rates, rates)
    assert np.corrcoef(profile, spread)[0, 1] > 0.9
    assert np.mean(profile**2) == pytest.approx(1.0)
    faster = noise_profile(spread * rng.normal(size=1000), rates, 2.0 * rates)
    assert 1.6 < np.mean(faster**2) < 2.0


def test_a_hum_is_a_line_and_noise_is_not():
    rng = np.random.default_rng(10)
    t = np.arange(330) / 16.5
    runs = [rng.normal(size=330) + 0.8 * np.sin(2 * np.pi * 3.1 * (t + 7 * k)) for k in range(3)]
    assert [round(f, 1) for f in spectral_lines(runs, 16.5, 7)] == [3.1]
    false = sum(bool(spectral_lines(list(rng.normal(size=(3, 330))), 16.5, 7)) for _ in range(200))
    assert false <= 3


def test_wilson_interval():
    low, high = wilson(297, 300)
    assert low == pytest.approx(0.9710, abs=5e-4)
    assert high == pytest.approx(0.9966, abs=5e-4)
    assert wilson(0, 0) == (0.0, 1.0)


def test_a_window_is_an_event_beside_a_models_error_only_if_no_like_motion_comes_near():
    rng, M = np.random.default_rng(5), 1800
    pieces, even = [np.arange(900), np.arange(900, M)], np.ones(M)
    slow = np.arange(M) % 120 < 30

    def found(white: Array, jerk: Array = even) -> Array:
        return lone_windows(white, pieces, slow, jerk, 30.0, 7)

    # Error that swells at reversals, with tails.
    error = rng.normal(size=M) * np.where(slow, 6.0, 1.0) * np.exp(rng.normal(0.0, 0.3, M))
    assert not found(error).any()
    knock = error.copy()
    knock[700:704] += 60.0
    where = np.flatnonzero(found(knock))
    assert where.min() > 660
    assert where.max() < 740
    assert np.isin([700, 701, 702, 703], where).all()
    assert not found(rng.standard_t(2, size=M)).any()
    sharp = even.copy()
    sharp[690:710] = 3.0  # a motion like no other
    assert not found(knock, sharp).any()
