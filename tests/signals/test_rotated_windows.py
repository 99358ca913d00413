"""Other splits of a run: tested stretches elsewhere in its motion."""

import numpy as np
import pytest

from sdp_vs_penalty.signals import MotionClock, rotated_windows

PAUSE = 0.5
SHORTEST = 1.0
ONCE = MotionClock(motion=0, start=0.0, length=20.0, periodic=False)
REPEATS = MotionClock(motion=0, start=0.0, length=8.0, periodic=True)


def rotated(clock, offset, tested=((5.0, 7.0),), span=20.0):
    return rotated_windows(tested, clock, span, offset, PAUSE, SHORTEST)


def distance(train, test):
    """Seconds between the closest windows of the two sides."""
    return min(max(c - b, a - d) for a, b in train for c, d in test)


@pytest.mark.parametrize("offset", np.linspace(0.0, 19.0, 12))
@pytest.mark.parametrize("clock", [ONCE, REPEATS])
def test_training_keeps_off_the_tested_windows(clock, offset):
    train, test = rotated(clock, offset)
    assert distance(train, test) >= PAUSE - 1e-9


@pytest.mark.parametrize("offset", np.linspace(0.0, 7.5, 9))
def test_no_phase_of_a_repeated_motion_is_on_both_sides(offset):
    train, test = rotated(REPEATS, offset)
    phases = [
        {round(t % 8.0, 1) for a, b in side for t in np.arange(a, b, 0.1)}
        for side in (train, test)
    ]
    assert not phases[0] & phases[1]


def test_a_stretch_that_passes_the_end_goes_on_at_the_beginning():
    _, test = rotated(ONCE, 14.0)
    assert test == [(19.0, 20.0)] or test == [(0.0, 1.0), (19.0, 20.0)]


def test_windows_that_meet_between_repetitions_are_one():
    train, _ = rotated(REPEATS, 0.0)
    assert train[1] == pytest.approx((7.5, 12.5))


def test_short_windows_are_left_out():
    train, test = rotated(ONCE, 0.0, tested=((0.8, 3.0), (19.5, 20.0)))
    assert all(b - a >= SHORTEST for a, b in (*train, *test))
