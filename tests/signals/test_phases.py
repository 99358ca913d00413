"""Splits by phase: no motion on both sides, whatever the period, the stand before it, the run."""

import numpy as np
import pytest
from periodic_runs import SETTINGS, run_of

from sdp_vs_penalty import Measurements
from sdp_vs_penalty.data import concatenate
from sdp_vs_penalty.signals import repeat_period
from sdp_vs_penalty.signals.phases import (
    MotionClock,
    PhaseFolds,
    motion_clocks,
    phase_folds,
    phase_windows,
    tracks_of,
)


def folds_of(*runs: Measurements, count: int = 5) -> PhaseFolds:
    return phase_folds(concatenate(list(runs)), SETTINGS, count)


@pytest.mark.parametrize("still", [0.0, 3.0])
def test_samples_a_period_apart_are_on_one_side(still):
    run = run_of(10, 27.0, still=still)
    (clock,) = motion_clocks(tracks_of(run))
    assert clock.periodic
    assert clock.length == pytest.approx(9.63, abs=0.01)
    split = folds_of(run)
    t = run.t[run.t > still + 0.1]
    later = t + 9.63
    for fold in range(5):
        uses = [np.isin(split.cell(0, x), split.tested(fold)) for x in (t, later)]
        assert np.mean(uses[0] != uses[1]) < 0.01  # but for the border's own rounding
        kept = [np.isin(split.cell(0, x), split.training(fold)) for x in (t, later)]
        assert not np.any(uses[0] & kept[1])
        assert not np.any(uses[1] & kept[0])


def test_every_instant_is_tested_once_and_the_guard_is_kept():
    run = run_of(10, 8.0)  # not long enough to repeat itself
    split = folds_of(run, count=4)
    assert not split.clocks[0].periodic
    cell = split.cell(0, run.t)
    tested = sum(np.isin(cell, split.tested(k)).astype(int) for k in range(4))
    assert np.all(tested == 1)
    for k in range(4):
        test, train = run.t[np.isin(cell, split.tested(k))], run.t[np.isin(cell, split.training(k))]
        assert np.all((train < test.min() - split.guard) | (train > test.max() + split.guard))
        assert len(train) > 0.3 * len(run.t)


def test_runs_of_one_motion_share_its_clock():
    """Whether it repeats itself in them or not, wherever each begins; other runs have their own."""
    runs = [run_of(10, 8.0), run_of(20, 8.0), run_of(11, 7.0, 1.3)]
    clocks = motion_clocks(tracks_of(concatenate(runs)))
    assert [c.motion for c in clocks] == [0, 1, 0]
    assert clocks[2].at(runs[2].t[100]) == pytest.approx(clocks[0].at(runs[2].t[100] + 1.3), abs=0.02)
    periodic = [run_of(10, 22.0), run_of(11, 22.0, 6.0)]
    clocks = motion_clocks(tracks_of(concatenate(periodic)))
    assert [c.motion for c in clocks] == [0, 0]
    assert clocks[1].at(0.0) == pytest.approx(clocks[0].at(6.0), abs=0.02)


def test_ramps_and_stands_hide_no_period():
    """A way to where the motion repeats, and one from there, of up to two seconds."""
    run = run_of(10, 24.0)
    edge = np.clip(np.minimum(run.t, run.t[-1] - run.t) / 1.2, 0.0, 1.0)[:, None]
    assert repeat_period(run.t, run.q * edge) == pytest.approx(9.63, abs=0.01)
    assert repeat_period(run.t, run_of(10, 24.0, period=40.0).q) is None


def test_a_run_is_split_by_phase():
    """Two parts of one period, and of all its repetitions; none where it repeats too fast."""
    run = run_of(10, 27.0)
    (clock,) = motion_clocks(tracks_of(run))
    windows = phase_windows(clock, 27.0, 0.7, 0.5, 1.5)
    assert windows is not None
    train, test = (
        np.concatenate([clock.at(np.linspace(a, b, 100)) for a, b in side]) for side in windows
    )
    assert len(windows[0]) == 3
    assert train.max() < test.min() - 0.4
    assert test.max() < clock.length - 0.4
    assert phase_windows(clock, 27.0, 0.7, 0.5, 5.0) is None
    once = MotionClock(0, 0.0, 20.0, False)
    assert phase_windows(once, 20.0, 0.7, 0.5, 1.5) == ([(0.0, 14.0)], [(14.5, 20.0)])
