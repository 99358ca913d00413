"""The noise floor from repetition: the period, what counts as a repeat, and how large the noise is."""

from __future__ import annotations

import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sdp_vs_penalty.signals.noise import _differences, noise_floor, repeat_period

seeds = st.integers(0, 2**32 - 1)


def periodic(rng: np.random.Generator, t: np.ndarray, period: float, joints: int = 3) -> np.ndarray:
    """Five harmonics a joint (N, joints)."""
    w = 2.0 * np.pi / period * np.arange(1, 6)
    a, b = rng.normal(size=(2, joints, 5)) / np.arange(1, 6)
    return np.sin(np.outer(t, w)) @ a.T + np.cos(np.outer(t, w)) @ b.T


@settings(max_examples=20, deadline=None, derandomize=True)
@given(seeds, st.floats(4.0, 9.0))
def test_the_period_is_found_between_the_samples(seed: int, period: float) -> None:
    rng = np.random.default_rng(seed)
    t = np.arange(3.0, 24.0, 0.031)
    q = periodic(rng, t, period) + 1e-4 * rng.normal(size=(len(t), 3))
    assert repeat_period(t, q) == pytest.approx(period, abs=2e-3)


@settings(max_examples=20, deadline=None, derandomize=True)
@given(seeds)
def test_motion_without_repetition_has_no_period(seed: int) -> None:
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 20.0, 0.03)
    q = np.sin(np.outer(t, rng.uniform(0.3, 4.0, 12))) @ rng.normal(size=(12, 3))
    assert repeat_period(t, q + 0.3 * t[:, None]) is None


def test_one_joint_that_does_not_repeat_is_enough_however_small_its_motion() -> None:
    rng = np.random.default_rng(0)
    t = np.arange(0.0, 20.0, 0.03)
    q = periodic(rng, t, 5.0)
    assert repeat_period(t, q) == pytest.approx(5.0, abs=2e-3)
    q[:, 2] = 0.01 * np.sin(1.1 * t) * t / 20.0
    assert repeat_period(t, q) is None


def test_a_joint_that_only_flickers_does_not_hide_the_period() -> None:
    rng = np.random.default_rng(0)
    t = np.arange(0.0, 20.0, 0.03)
    q = periodic(rng, t, 5.0)
    q[:, 2] = 1e-6 * rng.normal(size=len(t))
    assert repeat_period(t, q) == pytest.approx(5.0, abs=2e-3)


def test_standing_still_and_short_runs_have_no_period() -> None:
    t = np.arange(0.0, 10.0, 0.03)
    assert repeat_period(t, np.zeros((len(t), 2))) is None
    short = t[t < 2.5]
    assert repeat_period(short, periodic(np.random.default_rng(0), short, 1.0)) is None


def test_slow_motion_is_not_its_own_repetition() -> None:
    """Neighbouring samples of a slow motion are alike; only a valley of the difference is a repeat."""
    t = np.arange(0.0, 300.0, 0.1)
    q = np.sin(2.0 * np.pi * t / 400.0)[:, None]
    assert repeat_period(t, q) is None


@settings(max_examples=10, deadline=None, derandomize=True)
@given(seeds)
def test_differences_are_those_of_the_definition(seed: int) -> None:
    x = np.random.default_rng(seed).normal(size=(200, 3))
    lags = np.array([1, 7, 50, 150, 199])
    expected = [np.sqrt(np.mean((x[k:] - x[:-k]) ** 2)) for k in lags]
    np.testing.assert_allclose(_differences(x, lags), expected, rtol=1e-9)


@pytest.mark.parametrize("repeats", ["in one run", "in two runs"])
def test_the_floor_is_the_noise_whatever_the_model_gets_wrong(repeats: str) -> None:
    """A residual that repeats with the motion (model error) does not count, noise does."""
    rng = np.random.default_rng(1)
    sigma = np.array([0.1, 0.5, 2.0])
    t = np.arange(0.0, 40.0, 0.03)
    q = periodic(rng, t, 10.0 if repeats == "in one run" else 80.0)
    model_error = 10.0 * np.tanh(q)
    runs = []
    for start in [0.0] if repeats == "in one run" else [0.0, 100.0]:
        runs.append((t + start, q, model_error + sigma * rng.normal(size=q.shape)))
    floor = noise_floor(runs)
    assert floor is not None
    # Reading white noise between samples averages neighbours: up to 1 / sqrt(2) below.
    assert np.all(floor > 0.68 * sigma)
    assert np.all(floor < 1.1 * sigma)


def test_the_floor_of_noise_in_the_band_is_unbiased() -> None:
    """What compare() hands over has passed the low-pass and is sampled at twice its Nyquist rate."""
    from sdp_vs_penalty.signals.kernels import Kernel

    rng = np.random.default_rng(2)
    kernel = Kernel(8.0, 1e-3)
    raw = rng.normal(size=(120_000, 2))
    band, _, _ = kernel.states(raw)
    rows = band[::31]
    t = np.linspace(0.0, 0.031 * (len(rows) - 1), len(rows))
    q = periodic(rng, t, 10.0, 2)
    floor = noise_floor([(t, q, rows + np.tanh(q))])
    assert floor is not None
    np.testing.assert_allclose(floor, rows.std(axis=0), rtol=0.12)


def test_there_is_no_floor_without_repetition() -> None:
    rng = np.random.default_rng(0)
    t = np.arange(0.0, 20.0, 0.03)
    q = np.cumsum(rng.normal(size=(len(t), 2)), axis=0)
    assert noise_floor([(t, q, q)]) is None
    assert noise_floor([(t, q, q), (t, q[::-1], q)]) is None


def test_long_logs_take_no_quadratic_time() -> None:
    rng = np.random.default_rng(0)
    t = np.arange(0.0, 3600.0, 0.031)  # an hour of rows
    q = periodic(rng, t, 700.0, 6)
    start = time.perf_counter()
    period = repeat_period(t, q)
    assert time.perf_counter() - start < 5.0  # all lags one by one would take minutes
    assert period == pytest.approx(700.0, abs=1e-2)
