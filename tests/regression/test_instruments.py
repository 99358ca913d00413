"""Instrumental variables as a regression: right where least squares are biased, else the same."""

from __future__ import annotations

import numpy as np

from sdp_vs_penalty.regression.instruments import instrumented


def solved(factors: list[tuple[int, np.ndarray, np.ndarray]], p: int) -> np.ndarray:
    rows = np.vstack(instrumented(factors, p))
    return np.asarray(np.linalg.lstsq(rows[:, :-1], rows[:, -1], rcond=None)[0])


def test_noise_in_the_regressor_leaves_no_bias_and_blocks_add_up() -> None:
    rng = np.random.default_rng(0)
    theta = np.array([1.0, -2.0, 0.5])
    signal = rng.normal(size=(20_000, 3))
    X, Z = signal + rng.normal(size=signal.shape), 0.9 * signal
    tau = signal @ theta + 0.1 * rng.normal(size=len(signal))
    biased = np.linalg.lstsq(X, tau, rcond=None)[0]
    rows = np.column_stack([Z, X, tau])
    index = np.arange(3)
    halves = [(0, index, rows[:9000]), (0, index, rows[9000:])]
    found = solved(halves, 3)
    assert np.all(np.abs(found - theta) < 0.06)
    assert np.all(np.abs(biased - theta) > 0.2)
    np.testing.assert_allclose(solved([(0, index, rows)], 3), found, rtol=1e-9)
    # The estimate solves the instruments' equations, and its residual is that of X theta.
    np.testing.assert_allclose(Z.T @ (tau - X @ found), 0.0, atol=1e-8 * np.abs(Z.T @ tau).max())
    (whole,) = instrumented([(0, index, rows)], 3)
    np.testing.assert_allclose(whole[:, -1] - whole[:, :-1] @ found, tau - X @ found, atol=1e-9)


def test_its_own_instrument_is_least_squares() -> None:
    rng = np.random.default_rng(1)
    X, tau = rng.normal(size=(200, 4)), rng.normal(size=200)
    rows = np.column_stack([X, X, tau])
    expected = np.linalg.lstsq(X, tau, rcond=None)[0]
    np.testing.assert_allclose(solved([(0, np.arange(4), rows)], 4), expected, rtol=1e-9)
