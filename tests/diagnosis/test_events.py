"""What happens once is an event; what comes back with the motion is none."""

from types import SimpleNamespace

import numpy as np
import pytest

from sdp_vs_penalty.diagnosis.events import outliers
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
