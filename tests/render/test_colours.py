"""One colour a meaning, also for people who see no red, no green or no blue."""

import re
from itertools import combinations

import numpy as np
import pytest

from sdp_vs_penalty.colours import ADDED, AFTER, BEFORE, MEASURED, model_colour
from sdp_vs_penalty.render.pieces import LOOK

#: Linear RGB as it looks without one kind of cone (Machado, Oliveira, Fernandes 2009).
SIGHT = {
    "all cones": np.eye(3),
    "no red": [
        [0.152286, 1.052583, -0.204868],
        [0.114503, 0.786281, 0.099216],
        [-0.003882, -0.048116, 1.051998],
    ],
    "no green": [
        [0.367322, 0.860646, -0.227968],
        [0.280085, 0.672501, 0.047413],
        [-0.011820, 0.042940, 0.968881],
    ],
    "no blue": [
        [1.255528, -0.076749, -0.178779],
        [-0.078411, 0.930809, 0.147602],
        [0.004733, 0.691367, 0.303900],
    ],
}
#: From linear sRGB to XYZ over that of white (D65).
XYZ = np.array(
    [
        [0.43395, 0.37622, 0.18983],
        [0.21267, 0.71515, 0.07218],
        [0.01776, 0.10947, 0.87277],
    ]
)
#: CIELAB distance: 2.3 is just noticeable, 20 is told at a glance.
GLANCE = 20.0


def lab(colour, sight):
    """(3,) CIELAB of a "#rrggbb" colour as it looks by a matrix of SIGHT."""
    rgb = np.array([int(colour[k : k + 2], 16) / 255.0 for k in (1, 3, 5)])
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    xyz = XYZ @ np.clip(np.asarray(sight) @ linear, 0.0, 1.0)
    f = np.where(xyz > 0.008856, np.cbrt(xyz), 7.787 * xyz + 16.0 / 116.0)
    return np.array([116.0 * f[1] - 16.0, 500.0 * (f[0] - f[1]), 200.0 * (f[1] - f[2])])


@pytest.mark.parametrize("sight", SIGHT)
def test_the_four_meanings_are_told_apart_without_any_cone(sight):
    seen = [lab(x, SIGHT[sight]) for x in (MEASURED, BEFORE, AFTER, ADDED)]
    for first, second in combinations(seen, 2):
        assert np.linalg.norm(first - second) > GLANCE


def test_the_first_model_is_before_and_the_last_one_after():
    assert [model_colour(k, 2) for k in range(2)] == [BEFORE, AFTER]
    assert model_colour(0, 1) == AFTER


@pytest.mark.parametrize(("kind", "colour"), [("before", BEFORE), ("after", AFTER)])
def test_bars_have_the_colours_of_the_charts(kind, colour):
    (rule,) = re.findall(rf"\.bars [^{{]*\.{kind}\)? {{ background: (#\w+)", LOOK)
    assert rule == colour.lower()
