"""Channels with stamps of their own cost no accuracy."""

import warnings

import numpy as np
import pytest

from sdp_vs_penalty.data import read_run
from sdp_vs_penalty.data.stretches.merging import Interpolation


def test_a_cubic_is_followed_exactly_and_a_lost_sample_by_a_line():
    stamps = np.delete(np.arange(10.0), 6)
    clock = np.array([2.25, 5.5, 8.5, 3.0])
    found = Interpolation(clock, stamps, within=0.5)
    cubic = found.values(stamps**3)
    assert cubic[0] == pytest.approx(2.25**3)
    assert cubic[3] == 27.0
    # Beside the lost sample at 6, between 5 and 7.
    assert cubic[1] == pytest.approx(125.0 + 0.25 * (343.0 - 125.0))
    assert found.is_known.tolist() == [True, True, True, True]
    assert not Interpolation(np.array([6.0]), stamps, within=0.5).is_known[0]


def test_slow_positions_serve_a_fast_torque():
    found = Interpolation(np.arange(0.0, 1.0, 0.001), np.arange(0.0, 1.1, 0.01), 0.0005)
    assert found.is_known.all()
    swing = found.values(np.sin(6.0 * np.arange(0.0, 1.1, 0.01)))
    np.testing.assert_allclose(swing, np.sin(6.0 * found.clock), atol=1e-4)


def test_between_rounded_stamps_the_nearest_sample_is_taken():
    stamps = np.repeat(np.arange(5.0), 2)
    found = Interpolation(np.array([1.4]), stamps, within=0.5)
    assert found.values(np.arange(10.0))[0] in (2.0, 3.0)


def test_rows_of_one_table_belong_together_whatever_their_stamps(tmp_path):
    """The clock is rounded to 0.1 s, and one torque is lost."""
    q = np.arange(40.0)
    rows = [
        f"{0.1 * (k // 5):.1f},{q[k]},{'' if k == 7 else 2.0 * q[k]}" for k in range(40)
    ]
    (tmp_path / "run.csv").write_text("\n".join(["t,q1,tau1", *rows]) + "\n")
    with warnings.catch_warnings(action="ignore"):
        run = read_run(tmp_path / "run.csv")
    np.testing.assert_array_equal(run.q[:, 0], np.delete(q, 7))
    np.testing.assert_array_equal(run.tau, 2.0 * run.q)
    assert run.rows_of_file([0, 6, 7]).tolist() == [2, 8, 10]
