"""Where a motion comes back: the period, and what counts as a repeat."""

import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sdp_vs_penalty.signals import repeat_period
from sdp_vs_penalty.signals.repetition import recurring

seeds = st.integers(0, 2**32 - 1)


def periodic(rng: np.random.Generator, t: np.ndarray, period: float, joints: int = 3) -> np.ndarray:
    """Five harmonics a joint (N, joints)."""
    w = 2.0 * np.pi / period * np.arange(1, 6)
    a, b = rng.normal(size=(2, joints, 5)) / np.arange(1, 6)
    return np.sin(np.outer(t, w)) @ a.T + np.cos(np.outer(t, w)) @ b.T


@settings(max_examples=20, deadline=None, derandomize=True)
@given(seeds, st.floats(4.0, 9.0))
def test_the_period_is_found_between_the_samples(seed, period):
    rng = np.random.default_rng(seed)
    t = np.arange(3.0, 24.0, 0.031)
    q = periodic(rng, t, period) + 1e-4 * rng.normal(size=(len(t), 3))
    assert repeat_period(t, q) == pytest.approx(period, abs=2e-3)


@settings(max_examples=20, deadline=None, derandomize=True)
@given(seeds)
def test_motion_without_repetition_has_no_period(seed):
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 20.0, 0.03)
    q = np.sin(np.outer(t, rng.uniform(0.3, 4.0, 12))) @ rng.normal(size=(12, 3))
    assert repeat_period(t, q + 0.3 * t[:, None]) is None


T = np.arange(0.0, 20.0, 0.03)
FIVE = periodic(np.random.default_rng(0), T, 5.0)
NOISE = np.random.default_rng(1).normal(size=len(T))
SLOW = np.arange(0.0, 300.0, 0.1)
#: name : (instants, positions, period or None)
MOTIONS = {
    "all joints repeat": (T, FIVE, 5.0),
    "one does not, however small its motion": (
        T, np.column_stack([FIVE[:, :2], 0.01 * np.sin(1.1 * T) * T / 20.0]), None,
    ),
    "one only flickers": (T, np.column_stack([FIVE[:, :2], 1e-6 * NOISE]), 5.0),
    "standing still": (T, np.zeros((len(T), 2)), None),
    "too short": (T[T < 2.5], periodic(np.random.default_rng(0), T[T < 2.5], 1.0), None),
    # Neighbouring samples are alike; only a valley of the difference is a repeat.
    "slow": (SLOW, np.sin(2.0 * np.pi * SLOW / 400.0)[:, None], None),
}  # fmt: skip


@pytest.mark.parametrize("name", MOTIONS)
def test_what_has_a_period(name):
    t, q, period = MOTIONS[name]
    assert repeat_period(t, q) == (None if period is None else pytest.approx(period, abs=2e-3))


def test_long_logs_take_no_quadratic_time():
    rng = np.random.default_rng(0)
    t = np.arange(0.0, 3600.0, 0.031)  # an hour of rows
    q = periodic(rng, t, 700.0, 6)
    start = time.perf_counter()
    period = repeat_period(t, q)
    assert time.perf_counter() - start < 5.0  # all lags one by one would take minutes
    assert period == pytest.approx(700.0, abs=1e-2)


def test_what_differs_at_one_phase_between_other_instants_too_is_no_event():
    """Five periods of 100 rows: rows 20 to 23 of one period are odd, or others are too."""
    rows = np.arange(400)
    both, phase = np.column_stack([rows, rows + 100]), rows % 100.0
    odd = np.isin(rows, [120, 121, 122, 220, 221, 222])  # differences that hold the third period
    assert not recurring(both, phase, odd, odd, 10).any()
    faint = odd | np.isin(rows, [25, 325])
    assert not recurring(both, phase, odd, faint, 2).any()
    assert recurring(both, phase, odd, faint, 10)[[120, 220]].all()
