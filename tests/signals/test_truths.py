"""What is measured of clocks, motion and noise against what is known of drawn ones."""

import numpy as np
import pytest
from drawn import given, seeds
from numpy.testing import assert_allclose, assert_array_equal
from scipy import signal

from sdp_vs_penalty import Measurements, signals
from sdp_vs_penalty.signals import (
    noise,
    read_again,
    repetition,
    runs,
    segmented,
    spectrum,
    standstill,
)


def log(t, q=None, tau=None):
    q = np.sin(t)[:, None] if q is None else q
    return Measurements(t, q, np.cos(q) if tau is None else tau)


@pytest.mark.parametrize(
    ("dt", "bridged", "gap"), [(1e-3, 0.049, 0.051), (0.01, 0.19, 0.21)]
)
def test_a_gap_is_twenty_usual_steps_and_at_least_fifty_milliseconds(dt, bridged, gap):
    even = dt * np.arange(400.0)
    for step, cut in ((bridged, False), (gap, True)):
        run = log(np.append(even, even + even[-1] + step))
        found = list(runs.split_at_gaps(run))
        assert [len(part.t) for part in found] == ([400, 400] if cut else [800])
        for part in found:
            assert part.dt == pytest.approx(dt)
            grid = part.resampled(part.q, 0, part.count)
            assert_allclose(grid[-1], np.sin(part.clock(part.count - 1)), atol=0.01)
            assert 0.0 <= part.t[-1] - part.clock(part.count - 1) < dt
    lone = log(np.append(even, [even[-1] + 9.0]))  # one sample is no stretch
    assert [len(part.t) for part in runs.split_at_gaps(lone)] == [400]


def test_stamps_in_bursts_are_resampled_at_ten_points_a_sample():
    k = np.arange(2000)
    bursts = 0.02 * (k // 20) + 1e-6 * (k % 20)
    assert runs.sample_rate(log(bursts)) == pytest.approx(1e4, rel=0.01)
    pause = np.append(bursts, bursts + 60.0)  # which counts as 50 ms
    assert runs.sample_rate(log(pause)) == pytest.approx(1e4, rel=0.01)
    assert runs.sample_rate(log(0.004 * k)) == pytest.approx(250.0)


def test_what_moves_at_all():
    """Four times as far as from row to row, that is over 25 samples a period, or by
    more than 1 cm."""
    k = np.arange(5000)
    waves = [1e-4 * np.sin(2.0 * np.pi * k / period) for period in (27.0, 23.0)]
    white = np.random.default_rng(0).normal(size=(5000, 2)) * [0.0098, 0.0102]
    assert runs.moving_joints(
        log(0.01 * k, np.column_stack([*waves, white]))
    ).tolist() == [True, False, False, True]


def test_a_joint_that_its_servo_holds_does_not_move():
    """It gives way to the weight of the others, smoothly and by 5 mrad of their 1 rad; a
    joint that goes as far as that by itself moves."""
    t = 0.01 * np.arange(2000)
    sag, swing = 5e-3 * np.sin(1.3 * t), np.sin(1.3 * t + 0.2)
    for others, moves in ((swing, [False, True]), (0.1 * swing, [True, True])):
        run = log(t, np.column_stack([sag, others]))
        assert runs.moving_joints(run).tolist() == moves


def test_an_instant_is_of_motion_where_half_a_second_goes_as_far_as_the_share():
    """Of a quarter of a second to either side; a joint that only flickers does not
    count."""
    t = np.arange(0.0, 30.0, 0.01)
    q = np.column_stack([np.clip(t - 10.0, 0.0, 10.0), 1e-5 * (np.arange(3000) % 2)])
    moves = t[runs.Movement(log(t, q), 0.2).moves]
    assert_allclose(moves[[0, -1]], [9.85, 20.15], atol=0.02)
    assert len(moves) == pytest.approx(1030, abs=3)


@pytest.mark.parametrize(("share", "last"), [(0.012, 3.0), (0.008, 1.0)])
def test_the_highest_harmonic_has_a_hundredth_of_the_largest_amplitude(share, last):
    t = np.arange(0.0, 40.0, 0.01)
    q = np.sin(2.0 * np.pi * t) + share * np.sin(6.0 * np.pi * t)
    assert spectrum.highest_harmonic(log(t, q[:, None])) == pytest.approx(
        last, abs=0.03
    )


def test_noise_of_a_short_stretch_in_which_a_joint_rests_is_no_harmonic():
    """Behind a gap: what is large there is small beside the motion before."""
    t = np.concatenate([np.arange(0.0, 30.0, 0.01), np.arange(32.0, 34.0, 0.01)])
    noise = 1e-4 * np.random.default_rng(1).normal(size=len(t))
    q = np.where(t < 31.0, np.sin(2.0 * np.pi * t), 0.5) + noise
    assert spectrum.highest_harmonic(log(t, q[:, None])) == pytest.approx(1.0, abs=0.1)


def test_the_trembling_of_a_joint_that_is_held_still_is_no_harmonic():
    t = np.arange(0.0, 40.0, 0.01)
    moving = np.sin(2.0 * np.pi * t)
    trembling = 1e-3 * np.sign(np.sin(2.0 * np.pi * 0.4 * t))  # odd harmonics
    run = log(t, np.column_stack([moving, trembling]))
    assert spectrum.highest_harmonic(run) < 20.0


def coloured(seed, ar, count, dt=4e-3):
    """Slow motion whose torque has autoregressive noise, and that noise."""
    white = np.random.default_rng(seed).normal(size=(count, 2)) * [0.3, 2.0]
    shown = signal.lfilter([1.0], [1.0, -ar], white, axis=0)
    t = dt * np.arange(count)
    q = np.column_stack([np.sin(t), np.cos(1.3 * t)])
    return log(t, q, 5.0 * q + shown), shown


@pytest.mark.parametrize("ar", [-0.3, 0.0, 0.6])
def test_the_spectrum_of_a_torque_is_that_of_its_noise(ar):
    run, shown = coloured(1, ar, 60_000)
    parts = list(runs.split_at_gaps(run))
    known = spectrum.torque_spectrum(parts, 8.0)
    w = 2.0 * np.pi * known.frequency * 4e-3
    law = 1.0 / (1.0 + ar**2 - 2.0 * ar * np.cos(w))
    assert_allclose(known.spectrum, np.outer([0.3**2, 4.0], law), rtol=0.08)
    assert (known.is_smoothed, known.is_uneven) == (False, False)
    low = signal.sosfiltfilt(
        signal.butter(2, 4.0, fs=250.0, output="sos"), run.tau, axis=0
    )
    louder = run.tau + 19.0 * shown * (run.t % 40.0 > 20.0)[:, None]
    for tau, flags in (
        (low, (True, False)),
        (louder, (False, True)),
    ):  # as of a UR10, of a TX40
        other = log(run.t, run.q, tau)
        known = spectrum.torque_spectrum(list(runs.split_at_gaps(other)), 8.0)
        assert (known.is_smoothed, known.is_uneven) == flags
        assert (
            noise.spectral_floor(segmented(other, signals.Preprocessing(5.0, 8.0)))
            is None
        )
    # What fits into the motion's band, or into two windows, shows nothing.
    assert spectrum.torque_spectrum(parts, 60.0) is None
    assert (
        spectrum.torque_spectrum(list(runs.split_at_gaps(run.window(0.0, 0.5))), 8.0)
        is None
    )
    assert spectrum.torque_spectrum([], 8.0) is None


@given(seeds)
def test_an_autoregression_filters_row_by_row(seed):
    rng = np.random.default_rng(seed)
    ends = np.sort(
        rng.choice(np.arange(1, 80), 5, replace=False)
    )  # some too short to predict
    pieces = signals.coloured_noise.Pieces(p[1:] for p in np.split(np.arange(80), ends))
    x = rng.normal(size=(80, 3))
    ar = rng.normal(size=4)
    expected = np.zeros_like(x)
    for piece in pieces:
        for k in range(4, len(piece)):
            expected[piece[k]] = x[piece[k]] - sum(
                a * x[piece[k - 1 - m]] for m, a in enumerate(ar)
            )
    assert_allclose(pieces.filter(ar, 80) @ x, expected, atol=1e-12)
    # The noise of innovations sigma, where the motion swells them and a joint stands
    # still.
    profile, held = rng.uniform(0.5, 2.0, (2, 80, 1))
    known = noise.Noise(
        np.ones(1),
        ar[None],
        np.array([1.7]),
        np.ones(1),
        "",
        np.zeros((80, 1), bool),
        profile,
        held,
    )
    scale = (1.7 * profile[:, 0]) ** 2 + held[:, 0] ** 2
    for k in range(80):
        scale[k] += sum(
            (a * held[k - 1 - m, 0]) ** 2 for m, a in enumerate(ar) if k > m
        )
    assert_allclose(known.whiten(x, 0, pieces), expected / np.sqrt(scale)[:, None])
    assert_array_equal(
        known.whiten(x[:, 0], 0, pieces), known.whiten(x, 0, pieces)[:, 0]
    )
    assert_allclose(known.worth[:, 0], (1.7 * profile[:, 0]) ** 2 / scale)


def test_an_autoregression_is_found_and_what_is_too_short_for_one_is_white():
    truth = np.array([0.9, -0.5, 0.2, 0.1])
    x = signal.lfilter(
        [0.7], np.append(1.0, -truth), np.random.default_rng(2).normal(size=40_000)
    )
    pieces = signals.coloured_noise.Pieces(np.array_split(np.arange(len(x)), 10))
    ar, sigma, degrees = signals.coloured_noise.autoregression(x, pieces)
    assert_allclose(ar, truth, atol=0.02)
    assert sigma == pytest.approx(0.7, rel=0.02)
    assert degrees == 40_000 - 10 * 4 - 4
    few = signals.coloured_noise.Pieces([np.arange(3, 18)])
    ar, sigma, degrees = signals.coloured_noise.autoregression(x, few)
    assert (ar.any(), sigma, degrees) == (False, pytest.approx(x[3:18].std()), 14.0)


def test_events_are_what_noise_does_not_reach():
    """One in a million rows is 5 sigma off; four rows of 4, or sixteen of 2.8, are as
    unlikely."""
    rows = [np.arange(2000), np.arange(2001, 4000)]
    for seed in range(10):
        white = np.random.default_rng(seed).normal(size=4000)
        assert not signals.coloured_noise.local_excess(white, rows, 6, 4000.0).any()
        for length, size in ((1, 7.0), (4, 5.0), (16, 3.2)):
            odd = white.copy()
            odd[700 : 700 + length] = size
            found = np.flatnonzero(
                signals.coloured_noise.local_excess(odd, rows, 6, 4000.0)
            )
            assert {*range(700, 700 + length)} <= {*found.tolist()}
            assert np.abs(found - 700).max() < 32
        slow = np.arange(4000) % 400 < 100
        assert not signals.coloured_noise.lone_windows(white, rows, slow, 16.0, 6).any()
        odd = white.copy()
        odd[1000:1008] = 40.0
        found = np.flatnonzero(
            signals.coloured_noise.lone_windows(odd, rows, slow, 16.0, 6)
        )
        assert {*range(1000, 1008)} <= {*found.tolist()} <= {*range(984, 1024)}


@given(seeds)
def test_what_the_repeats_of_a_motion_share(seed):
    """Instants with the same motion are what the differences connect: counted, and
    numbered, by hand."""
    rng = np.random.default_rng(seed)
    period = int(rng.integers(3, 9))
    count = 40
    both = [
        (k, k + n * period)
        for k in range(count)
        for n in (1, 2)
        if k + n * period < count
    ]
    both = np.array([pair for pair in both if rng.random() < 0.8])
    group = np.arange(count)
    for _ in range(count):
        for a, b in both:
            group[[a, b]] = min(group[a], group[b])
    n_independent, phase = repetition.motions_of_rows(both, count)
    assert n_independent == count - len(set(group.tolist()))
    assert phase.tolist() == group[both[:, 0]].tolist()
    marked = rng.random(len(both)) < 0.4
    reach = int(rng.integers(0, 2))
    expected = [
        bool(marked[k])
        and any(
            marked[m]
            and abs(phase[m] - phase[k]) <= reach
            and min(abs(a - b) for a in both[m] for b in both[k]) > 2 * reach
            for m in range(len(both))
        )
        for k in range(len(both))
    ]
    assert (
        repetition.recurring_differences(both, phase, reach, marked).tolist()
        == expected
    )


def test_rows_that_only_a_later_row_connects_are_one_motion():
    both = np.array([[0, 2], [1, 2]])
    assert repetition.motions_of_rows(both, 3)[1].tolist() == [0, 0]


def test_the_resolution_of_positions_is_four_of_their_noises_deviations():
    t = np.arange(0.0, 60.0, 0.004)[:, None]
    q = np.sin(t) + 1e-4 * np.random.default_rng(5).normal(size=(len(t), 3))
    assert_allclose(standstill.resolution(q), 4e-4, rtol=0.03)


def test_the_same_motion_read_again_has_errors_of_other_steps():
    """Uniform and not correlated; what has no steps stays as it is."""
    t = np.arange(0.0, 40.0, 0.002)
    q = np.sin(0.7 * t)[:, None]
    errors = []
    for step in (1e-2, 1e-7):
        read = step * np.round(q / step)
        errors.append(np.hstack([read, read_again(log(t, read)).q]) - q)
    assert_allclose(errors[0].std(axis=0), 1e-2 / np.sqrt(12.0), rtol=0.1)
    assert abs(np.corrcoef(errors[0].T)[0, 1]) < 0.15
    assert np.abs(errors[1]).max() < 1e-6
