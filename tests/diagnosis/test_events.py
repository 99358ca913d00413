"""What happens once is an event; what comes back with the motion is none."""

from types import SimpleNamespace

import numpy as np
import pytest

from sdp_vs_penalty.diagnosis import events
from sdp_vs_penalty.diagnosis.events import (
    Event,
    find_events,
    hann_spectrum,
    outliers,
    stands_alone,
)
from sdp_vs_penalty.diagnosis.findings import event_lines
from sdp_vs_penalty.signals import REPETITION, SPECTRUM, Repeat
from sdp_vs_penalty.signals.coloured_noise import Pieces

M = 1200
HALF = M // 2


def data_of(source):
    """Two periods of a motion at 40 Hz: they repeat, or nobody knows."""
    first = np.arange(HALF)
    second = first + HALF
    repeat = Repeat(first, 0, second / 40.0, second)
    noise = SimpleNamespace(
        suspect=np.zeros((M, 1), bool),
        repeats=(repeat,) if source == REPETITION else (),
        degrees=np.array([1000.0]),
        source=source,
    )
    rows = SimpleNamespace(
        t=np.arange(M) / 40.0,
        run=np.zeros(M, int),
        names=("run1",),
        n=1,
        rate=40.0,
        pieces=[Pieces((np.arange(M),))],
        slow=np.zeros((M, 1)),
        still=np.zeros((M, 1)),
        keep=np.ones((M, 1), bool),
    )
    return SimpleNamespace(rows=rows, noise=noise, rates=np.zeros((1, M, 2)))


def residual(at, push=15.0):
    """White noise with pushes of half a second."""
    out = np.random.default_rng(0).normal(size=(M, 1))
    for row in at:
        out[row : row + 20] += push
    return out


def fast_corners(white):
    """Data in which the torque changes fast at six instants, with a larger residual."""
    data = data_of(SPECTRUM)
    corners = np.arange(100, 1150, 200)
    data.rates[0, corners, 0] = 100.0
    white[corners] = 5.0 * np.sign(white[corners])
    white[corners[3]] *= 3.0
    return data


@pytest.mark.parametrize(
    ("source", "pushes", "corners", "is_event"),
    [
        (REPETITION, [300], False, True),
        (SPECTRUM, [300], False, True),
        (REPETITION, [300, 300 + HALF], False, False),  # it repeats: the model errs
        (SPECTRUM, [], False, False),
        # Late torque errs where it changes fast; one such error is larger than others.
        (SPECTRUM, [], True, False),
        (SPECTRUM, [350], True, True),
    ],
)
def test_a_push_that_happens_once_is_an_event(source, pushes, corners, is_event):
    white = residual(pushes)
    data = fast_corners(white) if corners else data_of(source)
    found = outliers(data, white, 0.1 * white)
    assert found.any() == is_event
    assert all(found[at : at + 20].all() for at in pushes * is_event)


@pytest.mark.parametrize(("steep", "count"), [(0.0, 1), (1.0, 0)])
def test_what_one_sharp_corner_explains_is_no_event(monkeypatch, steep, count):
    """The torque is 5 ms late: six corners show it, and a seventh is four times as sharp.

    The same error without a corner is an event.
    """
    corners = np.arange(100, 1150, 160)
    rates = np.ones((M, 1))
    rates[corners] = 1000.0
    rates[corners[3]] = 4000.0
    error = residual([])
    error[corners] = 0.005 * rates[corners]
    rates[corners[3]] *= steep
    monkeypatch.setattr(events, "torque_rates", lambda _: rates)
    data = data_of(SPECTRUM)
    data.rows.segment = np.zeros(M, int)
    is_outlier = np.zeros((M, 1), bool)
    is_outlier[corners[3] - 8 : corners[3] + 8] = True
    monkeypatch.setattr(
        events, "_groups_in_time", lambda _, flags, joint: [np.flatnonzero(flags)]
    )
    found = find_events(data, is_outlier, error, [])
    assert len(found) == count
    for event in found:
        assert event.t_start == pytest.approx(corners[3] / 40.0, abs=0.5)


def test_the_list_gives_a_hum_its_amplitude():
    hum = Event(3, 0.0, 10.0, what="hum", frequency=23.7, amplitude=0.28)
    diagnosis = SimpleNamespace(
        events_without_cause=(hum,),
        acting_for_a_time=(),
        torque_unit=lambda joint: "N m",
    )
    (line,) = event_lines(diagnosis)
    assert line == "a hum of 23.7 Hz (0.28 N m) on joint 3: 0.00 s to 10.00 s"


@pytest.mark.parametrize(("beside", "alone"), [(0.3, True), (0.6, False)])
def test_a_hum_stands_alone_and_a_line_of_the_motion_does_not(beside, alone):
    """A second line 1.3 Hz away, with a share of the amplitude; power is its square."""
    rate = 100.0
    t = np.arange(0.0, 20.0, 1.0 / rate)
    series = np.sin(2.0 * np.pi * 6.0 * t) + beside * np.sin(2.0 * np.pi * 7.3 * t)
    assert stands_alone(6.0, *hann_spectrum(series, rate)) == alone
