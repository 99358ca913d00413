"""The noise floor from the spectrum above the motion's band."""

from __future__ import annotations

import numpy as np
import pytest

from sdp_vs_penalty import Measurements
from sdp_vs_penalty.signals import Preprocessing, segmented
from sdp_vs_penalty.signals.noise import spectral_floor


@pytest.mark.parametrize(("rate", "colour"), [(250.0, 0.0), (500.0, 0.5), (1000.0, 0.7)])
def test_the_floor_is_right_within_30_percent(rate: float, colour: float) -> None:
    """Of a motion that never repeats, with friction that turns round, below coloured noise."""
    from scipy.signal import lfilter

    rng = np.random.default_rng(3)
    t = np.arange(0.0, 24.0, 1.0 / rate)
    waves = [(0.31, 0.9), (0.47, 0.7), (0.83, 0.4)]
    q = np.column_stack([sum(a * np.sin(2.0 * np.pi * f * t + k) for f, a in waves) for k in (0.0, 2.0)])
    torque = 8.0 * q + 1.0 * np.tanh(np.gradient(q, t, axis=0) / 0.01)
    noise = lfilter([1.0], [1.0, -colour], rng.normal(size=(len(t), 2)), axis=0) * np.array([0.3, 0.15])
    settings = Preprocessing(5.0, 8.0)
    floor = spectral_floor(segmented(Measurements(t, q, torque + noise), settings))
    rows = segmented(Measurements(t, q, noise), settings)
    assert floor is not None
    np.testing.assert_allclose(floor, rows.torque.std(axis=0), rtol=0.3)


def test_torque_that_was_smoothed_before_it_was_logged_says_nothing_of_its_noise() -> None:
    """As on a real UR10: far above the motion there is only what the drive's filter has left."""
    from scipy.signal import butter, sosfiltfilt

    t = np.arange(0.0, 24.0, 0.008)
    q = np.sin(2.0 * np.pi * 0.31 * t)[:, None] + np.cos(2.0 * np.pi * 0.83 * t)[:, None]
    torque = 8.0 * q + np.random.default_rng(3).normal(scale=0.3, size=q.shape)
    settings = Preprocessing(5.0, 8.0)
    smooth = sosfiltfilt(butter(2, 2.0, fs=125.0, output="sos"), torque, axis=0)
    assert spectral_floor(segmented(Measurements(t, q, torque), settings)) is not None
    assert spectral_floor(segmented(Measurements(t, q, smooth), settings)) is None


def test_a_log_that_is_too_slow_or_short_shows_nothing() -> None:
    t = np.arange(0.0, 3.0, 0.05)
    q = np.sin(t)[:, None]
    rows = segmented(Measurements(t, q, q), Preprocessing(2.0, 4.0))
    assert spectral_floor(rows) is None
