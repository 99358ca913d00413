"""The noise floor: that of the true noise, whatever the model gets wrong and wherever
samples fall."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy import signal
from small_runs import periodic

from sdp_vs_penalty import Measurements
from sdp_vs_penalty.data import concatenate
from sdp_vs_penalty.signals import (
    REPETITION,
    SPECTRUM,
    Kernel,
    Preprocessing,
    noise_of,
    segmented,
    spectral_floor,
)

DT = 4e-3
CUTOFF = 8.0
JOINTS = 6
SETTINGS = Preprocessing(5.0, CUTOFF)


def run_of(seed, period, seconds, ar=0.0, first=0.0):
    """A motion from its instant ``first`` on: its torque is error of the model, and
    AR(1) noise."""
    t = np.arange(0.0, seconds, DT)
    q = periodic(np.random.default_rng(7), t + first, period, JOINTS)
    white = np.random.default_rng(seed).normal(size=(len(t) + 4000, JOINTS))
    noise = signal.lfilter([1.0], [1.0, -ar], white, axis=0)[4000:]
    return Measurements(
        t + 100.0 * seed, q, 20.0 * np.tanh(q) + noise, names=(f"run {seed}",)
    )


def without_model(*runs):
    """Filtered runs beside a model that predicts nothing: all torque is residual."""

    def attach(motion):
        return replace(motion, torque=np.zeros_like(motion.q))

    return segmented(concatenate(list(runs)), SETTINGS).with_model(attach)


def true_floor(ar):
    """Standard deviation of the low-passed noise: h^T C h with C its autocovariance."""
    h = Kernel(CUTOFF, DT).value
    lags = np.abs(np.subtract.outer(np.arange(len(h)), np.arange(len(h))))
    return float(np.sqrt(h @ (ar**lags / (1.0 - ar**2)) @ h))


#: On the rows' grid (one in 60 ms), between two samples of the log, and between two
#: rows.
PERIODS = {
    "on the rows": 9.6,
    "off the log": 9.6 + 0.37 * DT,
    "off the rows": 9.63 + 0.37 * DT,
}


@pytest.mark.parametrize(
    ("period", "ar"),
    [
        # Each period and each colour once; every pair of both is slow.
        pytest.param(
            x,
            ar,
            marks=pytest.mark.long if i == k else pytest.mark.slow,
            id=f"{name}, {ar}",
        )
        for i, (name, x) in enumerate(PERIODS.items())
        for k, ar in enumerate((0.0, 0.6, 0.98))
    ],
)
def test_the_floor_is_the_true_noises(period, ar):
    """Within 1 %, white or coloured, wherever the period ends between samples."""
    squares = []
    for seed in range(6):
        floor = noise_of(without_model(run_of(100 + seed, period, 160.0, ar))).floor
        squares.append(np.mean(floor**2))
    assert np.sqrt(np.mean(squares)) / true_floor(ar) == pytest.approx(1.0, abs=0.01)


def test_the_floor_of_runs_that_repeat_each_other():
    """Four runs with one motion, none of which repeats itself; each starts at another
    instant."""
    shown = []
    for seed in range(0, 16, 4):
        rows = without_model(
            *(run_of(seed + k, 80.0, 30.0, 0.6, 0.317 * k) for k in range(4))
        )
        noise = noise_of(rows)
        assert noise.source == REPETITION
        assert np.all(
            noise.degrees < 3.0 * len(rows.t) / 4
        )  # six pairs, three new differences
        shown.append(np.mean(noise.floor**2))
    assert np.sqrt(np.mean(shown)) / true_floor(0.6) == pytest.approx(1.0, abs=0.03)


@pytest.mark.parametrize("ar", [0.0, 0.6])
def test_the_floor_from_the_spectrum_is_that_of_the_filtered_noise(ar):
    run = run_of(4, 1000.0, 240.0, ar)
    loud = np.array([0.3, 2.0, 1.0, 1.0, 1.0, 1.0])
    floor = spectral_floor(segmented(replace(run, tau=loud * run.tau), SETTINGS))
    assert_allclose(floor, loud * true_floor(ar), rtol=0.05)


def behind_a_filter(order, corner):
    """A run, white noise (N, JOINTS) behind a drive's filter, and its true floor."""
    b, a = signal.butter(order, corner, fs=1.0 / DT)
    run = run_of(3, 500.0, 40.0)
    white = np.random.default_rng(9).normal(size=(len(run.t) + 1000, JOINTS))
    passed = signal.lfilter(b, a, np.eye(1, 400)[0])
    true = np.linalg.norm(np.convolve(Kernel(CUTOFF, DT).value, passed))
    return run, signal.lfilter(b, a, white, axis=0)[1000:], true


@pytest.mark.parametrize("order", [1, 2])
def test_noise_behind_a_drives_filter_is_not_taken_for_more(order):
    """It is flat below the corner of 60 Hz, and falls above, where it is fitted."""
    run, noise, true = behind_a_filter(order, 60.0)
    filtered = replace(run, tau=20.0 * np.tanh(run.q) + noise)
    floor = noise_of(without_model(filtered)).floor
    assert floor == pytest.approx(np.full(JOINTS, true), rel=0.25)


@pytest.mark.parametrize("corner", [10.0, 15.0, 20.0])
@pytest.mark.parametrize("step", [0.02, 0.05, 0.1, 0.2, 0.3])
def test_coarse_noise_behind_a_drives_filter_is_unknown_or_known(corner, step):
    """Above the motion little is left of it, and the steps of the log hide that: no
    floor is stated that is below half the true one."""
    run, noise, true = behind_a_filter(2, corner)
    in_steps = step * np.round((20.0 * np.tanh(run.q) + noise) / step)
    floor = spectral_floor(segmented(replace(run, tau=in_steps), SETTINGS))
    assert floor is None or floor.min() > 0.5 * true


def test_drift_and_events_are_no_noise():
    run = run_of(3, 10.0, 80.0)
    clean = noise_of(without_model(run)).floor
    t = run.t[:, None] - run.t[0]
    rate = np.gradient(run.q, run.t, axis=0)
    disturbed = (
        run.tau + 0.02 * t + 1e-3 * t**2 + (0.02 * t + 1e-3 * t**2) * rate
    )  # ever faster
    disturbed[5000:5060, 2] += 30.0
    noise = noise_of(without_model(replace(run, tau=disturbed)))
    assert_allclose(noise.floor, clean, rtol=0.05)
    assert noise.suspect[:, 2].any()
    assert not noise.suspect[:, [0, 1, 3, 4, 5]].any()


def test_noise_that_swells_with_the_velocity_has_its_profile():
    run = run_of(4, 9.63, 80.0)
    speed = np.gradient(run.q, run.t, axis=0)
    swell = np.sqrt(0.2 + 0.8 * speed**2 / np.mean(speed**2, axis=0))
    own = 20.0 * np.tanh(run.q)
    rows = without_model(replace(run, tau=own + swell * (run.tau - own)))
    noise = noise_of(rows)
    for j in range(JOINTS):
        wanted = np.interp(rows.t, run.t, swell[:, j])
        assert np.corrcoef(noise.profile[:, j], wanted)[0, 1] > 0.9
        assert np.mean(noise.profile[:, j] ** 2) == pytest.approx(1.0, rel=0.05)


def test_two_seconds_of_repetition_are_too_little():
    assert noise_of(without_model(run_of(6, 20.0, 23.0))).source != REPETITION


def test_a_run_is_whitened_by_another_ones_noise():
    noise = noise_of(without_model(run_of(8, 9.63, 160.0, 0.98)))
    other = run_of(9, 9.63, 160.0, 0.98)
    rows = without_model(replace(other, tau=other.tau - 20.0 * np.tanh(other.q)))
    for j in range(JOINTS):
        white = noise.whiten(rows.residual[:, j], j, rows.pieces[j])
        assert white[white != 0.0].std() == pytest.approx(1.0, abs=0.06)


@pytest.mark.parametrize("period", [10.0, 9.63], ids=["whole steps", "between rows"])
@pytest.mark.parametrize("digits", [15, 2], ids=["no noise", "rounded"])
def test_what_numbers_and_filters_leave_is_no_noise(period, digits):
    """A run beside its own copy, or a simulation without noise: 5e6 'times its noise'
    was a ratio to rounding."""
    run = run_of(3, period, 40.0)
    exact = replace(run, tau=np.round(20.0 * np.tanh(run.q), digits))
    known = noise_of(without_model(exact)).source == REPETITION
    # Rounding to 0.01 N m is noise, unless each period rounds alike.
    assert known == (digits == 2 and period == 9.63)


def test_a_window_has_the_floor_of_the_whole():
    """A training window may throw the repetition away; the noise is that of all that
    was measured."""
    run = run_of(3, 9.63, 60.0)
    tau = run.tau.copy()
    tau[500:540, 2] += 30.0  # an event, inside the window
    run = replace(run, tau=tau)
    window = without_model(run.window(0.7, 8.0))
    whole = without_model(run)
    alone = noise_of(window)
    beside = noise_of(window, whole)
    assert alone.source == SPECTRUM
    assert beside.source == REPETITION
    assert_array_equal(beside.floor, noise_of(whole).floor)
    assert beside.profile.shape == window.residual.shape
    shown = window.t[beside.suspect[:, 2]] - run.t[0]
    assert len(shown)
    assert np.all((shown > 1.0) & (shown < 4.5))
    assert not beside.suspect[:, [0, 1, 3, 4, 5]].any()
