"""Filters: exact where they claim it, zero phase, the same in pieces as in one go."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
import scipy
from numpy.testing import assert_allclose, assert_array_equal
from random_robots import driven, sines, tree
from recorded import refusal

from sdp_vs_penalty import Measurements
from sdp_vs_penalty.effects import Model, parse_effects
from sdp_vs_penalty.signals import (
    Decimator,
    FilteredRun,
    Kernel,
    Preprocessing,
    autoregressive,
    filtered,
    preprocessing,
)

CASES = [(5.0, 1e-3), (8.0, 2e-3), (10.0, 0.01), (0.7, 0.02)]


def responses(cutoff, dt, share):
    """Complex gains (3,) of value, first and second derivative at share * cutoff over
    the ideal ones."""
    kernel = Kernel(cutoff, dt)
    w = 2.0 * np.pi * share * cutoff
    wave = np.exp(-1j * w * dt * np.arange(-kernel.half, kernel.half + 1))
    orders = (kernel.value, kernel.first, kernel.second)
    return np.array([h @ wave / (1j * w) ** k for k, h in enumerate(orders)])


@pytest.mark.parametrize(("cutoff", "dt"), CASES)
def test_gain_is_what_the_docstring_says(cutoff, dt):
    """Of no phase: the imaginary part is zero as well."""
    assert_allclose(responses(cutoff, dt, 0.1), 1.0, atol=6e-7)
    assert responses(cutoff, dt, 0.1)[0] == pytest.approx(1.0, abs=6e-8)
    assert_allclose(responses(cutoff, dt, 0.5), 1.0, atol=0.012)
    assert_allclose(responses(cutoff, dt, 1.0), 0.5, atol=0.005)
    stop = [
        abs(responses(cutoff, dt, x)[0])
        for x in np.linspace(1.4, 0.5 / dt / cutoff, 100)
    ]
    assert max(stop) < 0.04


def test_a_position_far_from_zero_keeps_its_derivatives():
    """A continuous joint after a thousand turns: rounding stays relative to the motion."""
    kernel = Kernel(5.0, 1e-3)
    t = np.arange(6000) * 1e-3
    q = np.sin(2 * np.pi * 0.3 * t)[:, None]
    near = kernel.states(q)
    far = kernel.states(q + 6283.0)
    for a, b in zip(near[1:], far[1:], strict=True):
        assert_allclose(a, b, atol=1e-7 * np.abs(a).max())


@pytest.mark.parametrize("chunk", [pytest.param(1, marks=pytest.mark.long), 500])
def test_pieces_give_exactly_the_whole(chunk, monkeypatch):
    model, _, run = driven()
    settings = Preprocessing(4.0, 6.0).resolve(run)
    whole = FilteredRun(run, settings).all_rows(model)
    monkeypatch.setattr(filtered, "PART", chunk)
    monkeypatch.setattr(filtered, "SAMPLES", 0)  # what is kept is kept in one piece
    cut = FilteredRun(run, settings)
    pieces = list(cut.rows(model))
    assert len(pieces) > 1
    # Once more, of what waits in a file; another process is not sent it.
    for rows, again in zip(pieces, cut.rows(model), strict=True):
        assert_array_equal(rows.torque, again.torque)
        for one, same in zip(rows.columns, again.columns, strict=True):
            assert_array_equal(one.columns, same.columns)
    assert len(list(pickle.loads(pickle.dumps(cut)).rows(model))) == len(pieces)
    assert_array_equal(np.concatenate([p.motion.t for p in pieces]), whole.motion.t)
    for name in ("q", "dq", "ddq"):
        joined = np.concatenate([getattr(p.motion, name) for p in pieces])
        assert_allclose(joined, getattr(whole.motion, name), atol=1e-9)
    assert_allclose(
        np.concatenate([p.torque for p in pieces]), whole.torque, atol=1e-12
    )
    for k, columns in enumerate(whole.columns):
        joined = np.concatenate([p.columns[k].columns for p in pieces])
        assert_allclose(joined, columns.columns, atol=1e-9)


@pytest.mark.parametrize(
    ("clock", "bound"), [("even", 1e-6), ("jittered", 2e-4), ("with a gap", 1e-6)]
)
def test_rows_obey_the_model_where_the_measurements_do(clock, bound):
    """Between the samples of a jittering clock too; no row holds what lies on both
    sides of a gap."""
    model, theta, run = driven(seconds=20.0, dt=1e-3)
    if clock == "jittered":
        t = np.cumsum(np.random.default_rng(5).uniform(3e-4, 1.7e-3, 12_000))
        q = np.column_stack([np.interp(t, run.t, x) for x in run.q.T])
        tau = np.column_stack([np.interp(t, run.t, x) for x in run.tau.T])
        run = Measurements(t, q, tau)
    elif clock == "with a gap":
        run = run.rows((run.t < 8.0) | (run.t > 9.5))
    rows = FilteredRun(run, Preprocessing(5.0, 8.0)).all_rows(model)
    modelled = np.column_stack([c.columns @ theta[c.indices] for c in rows.columns])
    assert np.linalg.norm(modelled - rows.torque) < bound * np.linalg.norm(rows.torque)
    margin = 2.0 / 5.0 + 2.0 / 8.0
    near = (rows.motion.t > 8.0 - margin) & (rows.motion.t < 9.5 + margin)
    assert near.any() == (clock != "with a gap")
    assert rows.motion.t.max() > 9.5 + margin


def test_idle_joints_do_not_set_the_filters():
    """One joint moves, the others' encoders flicker: neither cut-off nor standstill is
    theirs."""
    rng = np.random.default_rng(3)
    t = np.arange(0.0, 40.0, 0.01)
    q = np.zeros((len(t), 3))
    q[:, 1] = np.where(
        t < 30.0, np.sin(2 * np.pi * 0.3 * t), np.sin(2 * np.pi * 0.3 * 30.0)
    )
    q = q + rng.choice([0.0, 1e-5], size=q.shape)
    run = Measurements(t, q, rng.normal(size=q.shape))
    settings = Preprocessing().resolve(run)
    assert 4.8 <= settings.torque_cutoff < 12.8
    robot = tree(rng, 3)
    model = Model(robot, parse_effects("torque_offset", robot))
    kept = (
        FilteredRun(run, replace(settings, standstill=settings.standstill))
        .all_rows(model)
        .motion.t
    )
    every = FilteredRun(run, replace(settings, standstill=0.0)).all_rows(model).motion.t
    assert kept.max() < 30.5
    assert every.max() > 39.0
    assert_array_equal(every[every < 29.5], kept[kept < 29.5])


@pytest.mark.parametrize("base", [0.05, 0.2, 0.8])
def test_default_cutoff_is_ten_times_the_highest_harmonic(base):
    t = np.arange(0.0, 4.0 / base, 1e-3 / base)
    rng = np.random.default_rng(2)
    motion = sines(rng, 4, t, base, 5)
    noise = 1e-4 * rng.normal(size=(2, *motion.q.shape))
    run = Measurements(t, motion.q + noise[0], motion.q + noise[1])
    settings = Preprocessing().resolve(run)
    assert settings.torque_cutoff == pytest.approx(10 * 5 * base, rel=0.35)
    assert settings.torque_cutoff <= settings.state_cutoff
    assert settings.resolve(run) == settings


def test_torque_that_was_smoothed_is_not_fitted_above_its_own_band():
    """Friction turns round sharply, and the drive's zero-phase filter has taken that
    away."""
    from scipy.signal import butter, sosfiltfilt

    t = np.arange(0.0, 40.0, 0.004)
    q = np.sin(2 * np.pi * 0.25 * t)[:, None]
    sharp = (
        5.0 * q
        + np.sign(np.gradient(q, t, axis=0))
        + 1e-3 * np.random.default_rng(1).normal(size=q.shape)
    )
    smooth = sosfiltfilt(butter(3, 1.5, fs=250.0, output="sos"), sharp, axis=0)
    assert Preprocessing().resolve(
        Measurements(t, q, sharp)
    ).torque_cutoff == pytest.approx(2.75, rel=1e-3)
    found = Preprocessing().resolve(Measurements(t, q, smooth)).torque_cutoff
    assert 1.0 <= found <= 2.5
    assert (
        Preprocessing(torque_cutoff=4.0)
        .resolve(Measurements(t, q, smooth))
        .torque_cutoff
        == 4.0
    )


def test_cutoffs_stay_below_what_the_rate_allows():
    t = np.arange(0.0, 10.0, 0.02)
    run = Measurements(t, np.sin(2 * np.pi * 3.0 * t)[:, None], t[:, None])
    settings = Preprocessing().resolve(run)
    assert settings.state_cutoff == pytest.approx(10.0)
    assert settings.torque_cutoff == pytest.approx(5.0)
    given = Preprocessing(100.0, 200.0).resolve(run)
    assert given.state_cutoff == given.torque_cutoff == pytest.approx(10.0)


def test_what_cannot_be_filtered_is_refused():
    model, _, run = driven(seconds=0.5)
    short = FilteredRun(run, Preprocessing(2.0, 4.0))
    refusal(lambda: short.all_rows(model), "filters need more than", "record longer")
    broken = Measurements(run.t + np.arange(len(run.t)) // 10, run.q, run.tau)
    refusal(
        lambda: Preprocessing().resolve(broken), "no 16 consecutive ones without a gap"
    )
    model, _, long = driven(seconds=8.0)
    pieces = replace(long, t=long.t + np.floor(long.t / 1.6))
    torn = FilteredRun(pieces, Preprocessing(2.0, 4.0))
    refusal(lambda: torn.all_rows(model), "no continuous motion longer than 3 s")
    still = Measurements(run.t, 0.0 * run.q, run.tau)
    refusal(lambda: Preprocessing().resolve(still), "does not move")
    noise = np.random.default_rng(0).normal(size=run.q.shape)
    refusal(
        lambda: Preprocessing().resolve(Measurements(run.t, 1e-5 * noise, run.tau)),
        "does not move",
    )


@pytest.mark.parametrize("cutoffs", [(5.0, 8.0), (20.0, 8.0), (3.0, 12.0)])
def test_columns_of_the_links_are_those_at_every_sample(cutoffs):
    model, _, run = driven(seconds=8.0, dt=1e-3, effects="rigid_body")
    settings = Preprocessing(*cutoffs)
    found = FilteredRun(run, settings).all_rows(model)
    filters = preprocessing.RunFilter(run, settings)
    half = filters.state.half
    assert filters.smooth_stride > 4
    dense = preprocessing.Motion(run.t[half:-half], *filters.state.states(run.q))
    at = np.rint(found.motion.t / filters.dt).astype(int) - half
    for own, exact in zip(found.columns, model.columns(dense), strict=True):
        low = Decimator(filters.column, at) @ exact.columns
        assert_allclose(own.columns, low, rtol=0.0, atol=1e-5 * np.abs(low).max())


@pytest.mark.parametrize(("noise", "ratio"), [(3e-6, 3.0), (3e-3, 1.9), (3e-2, 1.0)])
def test_states_are_as_sharp_as_their_noise_allows(noise, ratio):
    """Noise of a velocity turns dry friction round at the wrong time."""
    t = np.arange(0.0, 20.0, 0.002)
    rng = np.random.default_rng(1)
    q = np.sin(np.pi * t) + noise * rng.normal(size=len(t))
    torque = np.cos(np.pi * t) + rng.normal(0.0, 0.01, len(t))
    found = Preprocessing().resolve(Measurements(t, q[:, None], torque[:, None]))
    assert found.state_cutoff / found.torque_cutoff == pytest.approx(ratio, rel=0.3)


@pytest.mark.parametrize("poles", [[1.0], [1.0, -0.9], [1.0, -1.2, 0.5, -0.1, 0.05]])
def test_an_autoregressive_process_is_that_of_scipy(poles):
    white = np.random.default_rng(0).normal(size=300)
    expected = scipy.signal.lfilter([1.0], poles, white)
    assert_allclose(autoregressive(poles, white), expected, atol=1e-12)
