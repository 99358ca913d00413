"""What has been trained on: its record, and splits by phase with no motion on both
sides."""

import json

import numpy as np
import pytest
from drawn import given, seeds, st
from numpy.testing import assert_allclose, assert_array_equal
from small_runs import SETTINGS, periodic, run_of

from sdp_vs_penalty.data import Measurements, concatenate
from sdp_vs_penalty.effects.bristles import dahl
from sdp_vs_penalty.signals import (
    FilteredRuns,
    MotionRecord,
    is_still,
    motion,
    phases,
    record_motion,
    repeat_period,
    sliding,
    subsample_sentence,
    unexplained_standstill_torque,
    window_subsample,
)


def share(train, judged):
    record = record_motion(FilteredRuns.filtering(train, SETTINGS))
    kept = MotionRecord.from_dict(json.loads(json.dumps(record.to_dict())))
    return kept.new_share(FilteredRuns.filtering(judged, SETTINGS))


def test_what_has_been_trained_on_is_not_new():
    """Off the samples, at another rate, a period later; with a stand before it, of
    which only the sudden start is new."""
    once = run_of(10, 11.0)
    for same in (
        once,
        run_of(11, 9.0, 0.3137),
        run_of(12, 9.0, 9.63 + 0.3137, dt=3.1e-3),
    ):
        assert share(once, same) == 0.0
    assert share(once, run_of(13, 8.0, 1.0, still=4.0)) < 0.05
    assert share(run_of(14, 9.0, 1.0, still=4.0), run_of(15, 7.0, 1.1)) < 0.05
    both = concatenate([run_of(20, 9.0), once])
    assert share(both, run_of(16, 9.0, 0.9)) == 0.0


def test_other_motion_is_new():
    once = run_of(10, 11.0)
    assert share(once, run_of(20, 11.0)) > 0.9
    assert share(run_of(10, 5.0), run_of(11, 4.0, 5.2)) > 0.9
    part = share(run_of(10, 6.0), run_of(11, 6.0, 3.0))
    assert part == pytest.approx(3.0 / 4.7, abs=0.02)  # without 0.65 s at either end
    moved = run_of(11, 9.0)
    moved.q[:, 3] += 0.5  # the joint that stands, elsewhere
    assert share(once, moved) == 1.0
    slower = run_of(11, 11.0, period=20.0)  # the same positions, half as fast
    assert share(once, slower) > 0.8


def test_the_record_is_bounded(monkeypatch):
    """Periods add nothing; much motion is kept more coarsely, and stays known, or not
    at all."""
    one = record_motion(FilteredRuns.filtering(run_of(10, 11.0), SETTINGS))
    ten = record_motion(FilteredRuns.filtering(run_of(10, 96.0), SETTINGS))
    points = [sum(map(len, record.lines)) for record in (one, ten)]
    assert points[1] < 1.5 * points[0]
    rng = np.random.default_rng(3)
    wild = run_of(10, 120.0)
    smooth = np.convolve(rng.normal(size=len(wild.t) + 200), np.hanning(201), "valid")
    wild.q[:, 0] = smooth / smooth.std()
    monkeypatch.setattr(motion, "_LARGEST_RECORD", 14_000)
    record = record_motion(FilteredRuns.filtering(wild, SETTINGS))
    assert sum(line.size for line in record.lines) <= 14_000
    assert record.distance > motion.DISTANCE
    assert record.new_share(FilteredRuns.filtering(wild, SETTINGS)) == 0.0
    monkeypatch.setattr(motion, "_LARGEST_RECORD", 100)
    assert record_motion(FilteredRuns.filtering(wild, SETTINGS)) is None


@pytest.mark.parametrize(("seconds", "still"), [(27.0, 0.0), (27.0, 3.0), (8.0, 0.0)])
def test_every_instant_is_tested_once_with_all_its_periods_and_the_guard_is_kept(
    seconds, still
):
    run = run_of(10, seconds, still=still)
    split = phases.phase_folds(run, SETTINGS, 5)
    (clock,) = split.clocks
    assert clock.periodic == (seconds > 20.0)
    assert clock.length == pytest.approx(9.63 if clock.periodic else seconds, abs=0.01)
    t = run.t[run.t > still + 0.1]
    at = clock.at(t)
    cell = split.cell(0, t)
    stretch = clock.length / 5
    for k in range(5):
        tested = np.isin(cell, split.tested(k))
        trained = np.isin(cell, split.training(k))
        assert np.array_equal(tested, split.fold(0, t) == k)
        assert np.all((at[tested] >= k * stretch) & (at[tested] <= (k + 1) * stretch))
        ahead = at[trained] - (k + 1) * stretch, k * stretch - at[trained]
        round_ = np.min([x % clock.length for x in ahead], axis=0)
        away = round_ if clock.periodic else np.max(ahead, axis=0)
        assert np.all(away >= split.guard - 1e-9)
        kept = (
            clock.length
            - stretch
            - (2 if clock.periodic or 0 < k < 4 else 1) * split.guard
        )
        assert np.mean(trained) == pytest.approx(kept / clock.length, abs=0.1)


def test_runs_of_one_motion_share_its_clock():
    """Whether it repeats itself in them or not, wherever each begins; other runs have
    their own."""
    runs = [run_of(10, 8.0), run_of(20, 8.0), run_of(11, 7.0, 1.3)]
    clocks = phases.motion_clocks(phases.tracks_of(concatenate(runs)))
    assert [c.motion for c in clocks] == [0, 1, 0]
    assert clocks[2].at(runs[2].t[100]) == pytest.approx(
        clocks[0].at(runs[2].t[100] + 1.3), abs=2e-3
    )
    periodic = [run_of(10, 22.0), run_of(11, 22.0, 6.0)]
    clocks = phases.motion_clocks(phases.tracks_of(concatenate(periodic)))
    assert [c.motion for c in clocks] == [0, 0]
    assert clocks[1].at(0.0) == pytest.approx(clocks[0].at(6.0), abs=2e-3)


def test_ramps_and_stands_hide_no_period():
    """A way to where the motion repeats, and one from there, of up to two seconds."""
    run = run_of(10, 24.0)
    edge = np.clip(np.minimum(run.t, run.t[-1] - run.t) / 1.2, 0.0, 1.0)[:, None]
    assert repeat_period(run.t, run.q * edge) == pytest.approx(9.63, abs=0.01)
    assert repeat_period(run.t, run_of(10, 24.0, period=40.0).q) is None


def test_a_split_that_is_too_narrow_for_the_filters_is_none():
    (clock,) = phases.motion_clocks(phases.tracks_of(run_of(10, 27.0)))
    assert phases.phase_windows(clock, 27.0, 0.7, 0.5, 5.0) is None


#: A motion of so many seconds that does not repeat.
ONCE = [20.0, 60.0, 600.0]


@pytest.mark.parametrize("length", ONCE)
def test_a_fifth_of_the_motion_is_left_for_testing_behind_the_filters(length):
    pause = 0.65  # half of what the filters take of a window
    clock = phases.MotionClock(0, 0.0, length, False)
    _, test = phases.phase_windows(clock, length, 0.7, pause, 1.95)
    left = sum(b - a - 2.0 * pause for a, b in test)
    assert left >= 0.2 * length - 1e-9


def test_a_long_run_is_split_over_all_of_it():
    clock = phases.MotionClock(0, 0.0, 600.0, False)
    train, test = phases.phase_windows(clock, 600.0, 0.7, 0.65, 1.95)
    assert len(train) == len(test) == 5
    assert test[0][1] < 130.0
    assert test[-1][1] == 600.0


def test_a_run_that_is_too_short_to_tell_is_not_split():
    """With a fifth left for testing, less than half would be for training."""
    clock = phases.MotionClock(0, 0.0, 7.0, False)
    assert phases.phase_windows(clock, 7.0, 0.7, 0.65, 1.95) is None


def test_a_long_recording_is_seen_in_windows_spread_over_it():
    """At most 4000 rows at twice 8 Hz: 250 s, here a quarter of all."""

    def ramp(name, seconds):
        t = np.arange(0.0, seconds + 0.05, 0.1)
        return Measurements(t, t[:, None], t[:, None], names=(name,))

    short = concatenate([ramp("a", 120.0), ramp("b", 130.0)])
    long = ramp("long", 1000.0)
    assert window_subsample(short, SETTINGS) is short
    assert subsample_sentence(short, short, "noise of") is None
    part = window_subsample(long, SETTINGS)
    ends = [(run.t[0], run.t[-1]) for run in part.runs()]
    assert_allclose(
        ends, 62.5 * np.array([[0, 1], [5, 6], [10, 11], [15, 16]]), atol=0.11
    )
    assert part.names[1] == "long, 312.5 s to 375 s"
    said = subsample_sentence(part, long, "noise of")
    assert (
        said
        == "Long recording: noise of 250 s of its 1000 s, 4 windows spread over it."
    )
    many = window_subsample(
        concatenate([ramp(str(k), 10.0) for k in range(100)]), SETTINGS
    )
    assert len(many.names) == 25
    assert many.names[0].startswith("0, 0 s to 10 s")
    assert many.names[-1].startswith("99, ")


@given(seeds, st.floats(4.0, 9.0))
def test_the_period_is_found_between_the_samples(seed, period):
    rng = np.random.default_rng(seed)
    t = np.arange(3.0, 24.0, 0.031)
    q = periodic(rng, t, period) + 1e-4 * rng.normal(size=(len(t), 3))
    assert repeat_period(t, q) == pytest.approx(period, abs=2e-3)


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
    "one does not, however small its motion": (
        T,
        np.column_stack([FIVE[:, :2], 0.01 * np.sin(1.1 * T) * T / 20.0]),
        None,
    ),
    "one only flickers": (T, np.column_stack([FIVE[:, :2], 1e-6 * NOISE]), 5.0),
    "standing still": (T, np.zeros((len(T), 2)), None),
    "too short": (
        T[T < 2.5],
        periodic(np.random.default_rng(0), T[T < 2.5], 1.0),
        None,
    ),
    # Neighbouring samples are alike; only a valley of the difference is a repeat.
    "slow": (SLOW, np.sin(2.0 * np.pi * SLOW / 400.0)[:, None], None),
}


@pytest.mark.parametrize("name", MOTIONS)
def test_what_has_a_period(name):
    t, q, period = MOTIONS[name]
    assert repeat_period(t, q) == (
        None if period is None else pytest.approx(period, abs=2e-3)
    )


def positions(held, resolution):
    """(N, 1) of a joint that swings to and fro and is held so long [s] at each end; and
    when it is."""
    turns, into = np.divmod(np.arange(0.0, 20.0, 1.0 / 250.0), 1.0 + held)
    q = 0.3 * np.cos(np.pi * (turns + np.minimum(into, 1.0)))
    return (resolution * np.round(q / resolution))[:, None], into > 1.0


@pytest.mark.parametrize("held", [0.06, 0.3, 1.0])
def test_a_joint_that_is_held_stands_still_that_long(held):
    q, standing = positions(held, 2e-5)
    found = is_still(q)[:, 0]
    assert found[standing].mean() > 0.95
    # Beside it: as long as the encoder shows no motion.
    assert found[~standing].mean() < 0.05
    for resolution in (1e-5, 5e-5, 2e-4):  # a smooth reversal is no standstill
        assert not is_still(positions(0.0, resolution)[0]).any()


def test_noise_on_positions_is_told_from_motion():
    q, standing = positions(0.3, 1e-9)
    noisy = q + np.random.default_rng(0).normal(0.0, 2e-5, q.shape)
    assert is_still(noisy)[standing].mean() > 0.9
    smooth = positions(0.0, 1e-9)[0]
    assert not is_still(
        smooth + np.random.default_rng(1).normal(0.0, 2e-5, q.shape)
    ).any()


@pytest.mark.parametrize("law", ["dahl", "anything"])
def test_what_a_law_of_friction_says_is_evidence_and_what_none_says_weighs_as_one_row(
    law,
):
    """A joint creeps while friction yields, or is held by a torque that no position
    shows."""
    rng = np.random.default_rng(4)
    t = np.arange(4000) / 100.0
    rests = np.sin(0.4 * np.pi * t) > 0.6
    q = np.cumsum(np.where(rests, 1e-5, 0.5 * np.cos(0.8 * np.pi * t) / 100.0))
    says = dahl(q, 2e-3, 1.0)
    held = np.interp(t, np.arange(0.0, 41.0, 0.7), rng.uniform(-1.0, 1.0, 59))
    friction = says if law == "dahl" else np.where(rests, held, says)
    left = friction + 0.02 * rng.normal(size=len(t))
    laws = np.column_stack([dahl(q, d, 1.0) for d in (1e-3, 2e-3, 4e-3)])
    std, none = unexplained_standstill_torque(left, laws, rests.astype(float))
    assert none == (law == "anything")
    if none:  # all rests together tell no more than one row of the friction's size
        assert std / np.sqrt(rests.sum()) == pytest.approx(0.6, abs=0.25)
    else:
        assert std < 0.02


@pytest.mark.parametrize("width", [3, 5, 7, 33, 1001])
def test_extremes_of_neighbours_are_scipys(width):
    from scipy.ndimage import maximum_filter1d, minimum_filter1d

    x = np.random.default_rng(0).normal(size=(3, 4000))
    half = width // 2
    near = np.pad(x, ((0, 0), (half, half)), mode="symmetric")
    largest = sliding(np.maximum, near, width)
    smallest = sliding(np.minimum, near, width)
    assert_array_equal(largest, maximum_filter1d(x, width))
    assert_array_equal(smallest, minimum_filter1d(x, width))
