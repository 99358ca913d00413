"""Evidence: deviance, rows that count as one, and errors without one part each."""

import numpy as np
import pytest

from sdp_vs_penalty.regression import (
    deviance,
    independent_rows,
    jackknifed,
    log_odds,
    rows_worth_one,
    standard_errors_above_zero,
    student_95,
)


def test_the_deviance_counts_each_joint_with_its_own_variance():
    squares = np.array([8.0, 50.0])
    degrees = np.array([4.0, 10.0])
    expected = 4.0 * np.log(2.0) + 4.0 + 10.0 * np.log(5.0) + 10.0
    assert deviance(squares, degrees) == pytest.approx(expected)


def test_no_joint_is_fitted_better_than_its_noise():
    by_noise = deviance(np.array([1e-9]), 4.0, smallest_variance=0.5)
    assert by_noise == pytest.approx(4.0 * np.log(0.5), abs=1e-6)


def test_a_residual_that_halves_is_worth_half_its_rows_times_the_logarithm():
    before = np.array([2.0, 3.0])
    odds = log_odds(before, before / [2.0, 1.0], 30.0)
    assert odds == pytest.approx(15.0 * np.log(2.0))


def test_rows_that_repeat_count_once():
    noise = np.random.default_rng(0).normal(size=(3, 500))
    assert independent_rows(np.repeat(noise, 8, axis=1)) == pytest.approx(
        independent_rows(noise), rel=0.2
    )


def test_clusters_of_equal_rows_are_worth_one_row():
    scores = np.random.default_rng(1).normal(size=(400, 1))
    repeated = np.repeat(scores, 5, axis=0)
    inverse = np.array([[1.0 / float(np.sum(repeated**2))]])
    clusters = [np.repeat(np.arange(400), 5)]
    assert rows_worth_one(clusters, repeated, inverse, 1.0) == pytest.approx(5.0)


def test_the_jackknife_of_a_mean_is_its_standard_error():
    values = np.random.default_rng(2).normal(size=20)
    without = (values.sum() - values) / 19.0
    _, deviation = jackknifed(without)
    assert deviation == pytest.approx(values.std(ddof=1) / np.sqrt(20.0))


@pytest.mark.parametrize("n_parts", [3, 8, 20])
def test_an_interval_of_few_parts_covers_95_percent(n_parts):
    """Of a mean by the jackknife; 2 standard deviations of 3 parts cover 82 %."""
    n_draws = 20_000
    values = np.random.default_rng(n_parts).normal(size=(n_parts, n_draws))
    without = (values.sum(axis=0) - values) / (n_parts - 1.0)
    mean, deviation = jackknifed(without)
    covered = np.mean(np.abs(mean) <= student_95(n_parts) * deviation)
    assert covered == pytest.approx(0.95, abs=0.005)  # 3 standard deviations


def test_the_scatter_of_a_mean_is_that_of_the_parts_about_the_mean_of_their_log():
    """Two logs that differ are no noise: only the parts of one log scatter."""
    parts = np.random.default_rng(0).normal(size=(2, 8))
    apart = parts + np.array([[0.0], [10.0]])
    error = np.sqrt(np.var(parts, axis=1).mean() / parts.size)
    assert standard_errors_above_zero(apart) == pytest.approx(apart.mean() / error)
